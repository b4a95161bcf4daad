"""`mdb change`: something of the robot is to be another, while it runs."""

from __future__ import annotations

import argparse
import sys
import tomllib

from mdb_deploy.cli.options import Commands, add_keys
from mdb_protocol.endpoints import USUAL
from mdb_protocol.errors import MdbError

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
    change.add_argument("--connect", default=USUAL, help="the router's endpoint")
    change.add_argument("--brain", default="pioneer", help="the brain's name")
    add_keys(change)
    change.set_defaults(command=_change)


def _change(arguments: argparse.Namespace) -> int:
    from mdb_deploy.running.changing import change_robot
    from mdb_protocol import keys
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
        change_robot(bus, bus.publisher(keys.CHANGE), settings)
    sys.stdout.write(f"changed: {', '.join(arguments.settings)}\n")
    return 0
