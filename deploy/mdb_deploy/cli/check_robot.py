"""`mdb check-robot`: does a robot over the wire do its duties?"""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack

from mdb_deploy.cli.options import Commands, add_experiment, add_keys, content_of
from mdb_deploy.experiments import experiment_path
from mdb_protocol.endpoints import USUAL
from mdb_protocol.errors import MdbError

DESCRIPTION = """\
Takes the place of the brain for a robot that you start, and says of each duty whether it holds. The duties are in
protocol/README.md ('mdb keys duties'). The exit status is 0 only when all hold. The robot will move.
"""


def add(commands: Commands) -> None:
    """Add `check-robot`."""
    check = commands.add_parser(
        "check-robot",
        help="try a robot of yours: which of its duties hold",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add_experiment(check)
    check.add_argument("--listen", help=f"start a router here ({USUAL})")
    check.add_argument("--connect", metavar="ENDPOINT", help="start no router: join the one that runs there")
    add_keys(check)
    check.add_argument("--wait", type=float, default=30.0, metavar="SECONDS", help="for the robot to come (30)")
    check.add_argument("--patience", type=float, default=5.0, metavar="SECONDS", help="for an action to be done (5)")
    check.set_defaults(command=_check)


def _check(arguments: argparse.Namespace) -> int:
    from mdb_deploy.supervision.processes import RouterOptions, open_router
    from mdb_deploy.trials.robot_check import RobotCheck
    from mdb_deploy.trials.robot_link import Link
    from mdb_protocol.holding import hold
    from mdb_protocol.zenoh_bus import ZenohBus
    from mdb_sim.runs.experiment import Experiment

    if arguments.connect and arguments.listen:
        raise MdbError("--connect starts no router: leave --listen out")
    path = experiment_path(arguments.experiment)
    experiment = Experiment(content_of(path, arguments), path)
    experiment.check_machine(elsewhere=True)
    brain = experiment.brain.experiment.brain
    with ExitStack() as opened:
        connect = arguments.connect
        if connect is None:
            router = open_router(RouterOptions(None, arguments.listen or USUAL, arguments.keys))
            opened.callback(router.close)
            connect = router.endpoint()
        bus = ZenohBus(brain, connect, credentials=arguments.keys)
        opened.callback(bus.close)
        hold(bus, "optimizer", "action")
        sys.stdout.write(f"waiting for a robot of brain {brain} at {connect}\n")
        sys.stdout.flush()
        report = RobotCheck(Link(bus), experiment, wait_s=arguments.wait, patience_s=arguments.patience).run()
    sys.stdout.write(report.text() + "\n")
    return 0 if report.holds() else 1
