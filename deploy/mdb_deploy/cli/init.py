"""`mdb init`: an experiment of your own, to begin with."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from shlex import quote

from mdb_deploy.cli.options import Commands
from mdb_deploy.shipped import shipped

LIKE = (
    "gymnasium:ENV, any Gymnasium environment (gymnasium:CartPole-v1; gymnasium:PACKAGE:ENV for one that a package "
    "registers); arm: a planar arm that reaches; wheeled: a robot on two wheels that goes to a light; wire: that one "
    "as a program of its own, for --no-robot; ros2: a robot that speaks ROS 2"
)

PARTS = {
    "teacher": "what is wanted of the robot, and how good what it did was: make it yours",
    "body": "the robot",
    "robot": "the robot as a program of its own",
}


def add(commands: Commands) -> None:
    """Add `init`."""
    init = commands.add_parser(
        "init",
        help="write an experiment of your own: file, teacher, body",
        description="Writes an experiment file that runs, a teacher of about 20 lines, and where needed a body. "
        f"Comments say what each line does. The tutorial: {shipped('examples/ENVIRONMENT.md')}",
        allow_abbrev=False,
    )
    init.add_argument("folder", type=Path, metavar="FOLDER", help="where; made if it is not there")
    init.add_argument("--like", default="gymnasium:CartPole-v1", metavar="KIND", help=f"{LIKE} (%(default)s)")
    init.set_defaults(command=_init, extra="brain,gymnasium")


def _init(arguments: argparse.Namespace) -> int:
    from mdb_deploy.begin.folder import begin

    experiment, *others = begin(arguments.folder, arguments.like)
    sys.stdout.write(f"{experiment}: the experiment; read it first\n")
    for path in others:
        sys.stdout.write(f"{path}: {PARTS[path.stem.rpartition('_')[2]]}\n")
    sys.stdout.write("next: " + "\n      ".join(_next(arguments.folder, others)) + "\n")
    return 0


def _next(folder: Path, others: list[Path]) -> list[str]:
    """Return what to do with what was written: beside the experiment there are `others`, none for ROS 2."""
    where = quote(str(folder))
    if not others:
        return [
            "start ROS 2's router (ros2 run rmw_zenoh_cpp rmw_zenohd) and the robot; see [robot.options]",
            f"mdb up {where} --listen tcp/127.0.0.1:7448",
        ]
    quick = f"mdb up {where} --inline --iterations 300    (a quick try in one process)"
    robot = next((path for path in others if path.stem.endswith("_robot")), None)
    if robot is not None:
        return [quick, f"mdb up {where} --no-robot, and in another terminal: python {quote(str(robot))}"]
    return [quick, f"mdb up {where}                              (the whole, in processes)"]
