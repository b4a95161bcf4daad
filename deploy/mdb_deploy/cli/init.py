"""`mdb init`: an experiment of your own, to begin with."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from mdb_deploy.cli.options import Commands

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
        "Comments say what each line does. The tutorial: deploy/examples/ENVIRONMENT.md.",
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
    sys.stdout.write(f"next: mdb up {arguments.folder} --inline --iterations 300    (a quick try in one process)\n")
    robots = [path for path in others if path.stem.endswith("_robot")]
    for robot in robots:
        sys.stdout.write(f"      mdb up {arguments.folder} --no-robot, and in another terminal: python {robot}\n")
    if not robots:
        sys.stdout.write(f"      mdb up {arguments.folder}                              (the whole, in processes)\n")
    return 0
