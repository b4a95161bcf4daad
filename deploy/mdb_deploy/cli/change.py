"""`mdb change`: something of the robot is to be another, while it runs."""

from __future__ import annotations

import argparse
import sys
import tomllib

from mdb_deploy.cli.options import Commands, add_keys
from mdb_protocol.errors import MdbError
from mdb_protocol.zenoh_bus import DEFAULT_ENDPOINT

ANSWER_S = 3.0
"""Bound on waiting for the robot."""
EPILOG = """\
what can be changed is the body's own; of the Pioneer: swapped, turn_share, left_wheel, right_wheel, blind,
object_x_m, object_y_m. The same in an experiment file: [[robot.change]] at = 700, set = { swapped = true }

  mdb change swapped=true
  mdb change left_wheel=0.5 'blind=[2, 3, 4]'
"""


def add(commands: Commands) -> None:
    """Add `change`."""
    change = commands.add_parser(
        "change",
        help="change something of the robot while it runs",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    change.add_argument("settings", nargs="+", metavar="NAME=VALUE", help="as in left_wheel=0.5")
    change.add_argument("--connect", default=DEFAULT_ENDPOINT, help="the router's endpoint")
    change.add_argument("--brain", default="pioneer", help="the brain's name")
    add_keys(change)
    change.set_defaults(command=_change)


def _change(arguments: argparse.Namespace) -> int:
    import time

    from mdb_protocol import keys
    from mdb_protocol.messages import Change, Status
    from mdb_protocol.zenoh_bus import ZenohBus

    settings = {}
    for words in arguments.settings:
        name, equals, text = words.partition("=")
        try:
            settings[name] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            equals = ""
        if not (equals and name):
            raise MdbError(f"{words!r}: expected NAME=VALUE with a value as in an experiment file: true, 0.5, [2, 3]")
    with ZenohBus(arguments.brain, arguments.connect, credentials=arguments.keys) as bus:
        if "robot/body" not in bus.alive():
            raise MdbError(
                f"no robot of brain {arguments.brain} is at {arguments.connect}; 'mdb status' shows who is"
            )

        def counts() -> tuple[float, int]:
            """Return how many changes the robot has made, and how many it has refused."""
            answers: list[Status] = bus.query(keys.STATUS, ANSWER_S, role="robot", instance="body")
            if not answers:
                raise MdbError(f"the robot does not say how it is within {ANSWER_S:g} s; see 'mdb status'")
            return answers[0].values.get("changes", 0.0), answers[0].refused.get(keys.CHANGE.path, 0)

        made, refused = counts()
        bus.publisher(keys.CHANGE).put(Change(settings=settings))
        until_s = time.monotonic() + ANSWER_S
        while (now := counts()) == (made, refused):
            if time.monotonic() > until_s:
                raise MdbError(
                    f"the robot has not changed within {ANSWER_S:g} s; may you change it? ('mdb keys roles')"
                )
            bus.wait(0.05)
        if now[1] > refused:
            raise MdbError(
                f"the robot refused {', '.join(arguments.settings)}; its log says why, --help what there is"
            )
    sys.stdout.write(f"changed: {', '.join(arguments.settings)}\n")
    return 0
