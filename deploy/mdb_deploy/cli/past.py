"""`mdb export`, `mdb replay` and `mdb rescue`: a run of before, as tables, said again, or saved."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from mdb_deploy.cli.options import Commands, number


def add(commands: Commands) -> None:
    """Add `export`, `replay` and `rescue`."""
    export = commands.add_parser("export", help="a run's tables as Parquet or CSV: pairs, iterations, models, ...")
    export.add_argument("run", type=Path, metavar="RUN", help="run folder")
    export.add_argument("--to", choices=["parquet", "csv"], default="csv", help="kind of file (%(default)s)")
    export.add_argument("--out", type=Path, metavar="FOLDER", help="where (RUN/tables)")
    export.set_defaults(command=_export)
    replay = commands.add_parser(
        "replay",
        help="do the services of a recorded run say the same again?",
        description="Each service hears what it heard then, and must say what it said then, value by value; "
        "otherwise the exit status is 1. Of a concurrent run robot, teacher, ear and evolvers can be replayed.",
    )
    replay.add_argument("run", type=Path, metavar="RUN", help="run folder")
    replay.add_argument("roles", nargs="*", metavar="ROLE", help="as memory, evolver, evolver/object, robot (all)")
    replay.add_argument(
        "--tolerance",
        type=number(0, kind=float),
        default=0.0,
        help="by which floats may differ: a log of another processor (0)",
    )
    replay.set_defaults(command=_replay)
    rescue = commands.add_parser("rescue", help="a new run folder from one whose memory file is damaged")
    rescue.add_argument("run", type=Path, metavar="RUN", help="run folder, in which nothing is changed")
    rescue.add_argument("--out", type=Path, required=True, metavar="NEW", help="the new one, for 'mdb up --resume'")
    rescue.set_defaults(command=_rescue)


def _export(arguments: argparse.Namespace) -> int:
    from mdb_deploy.runs.python import Run

    for path in Run(arguments.run).export(arguments.to, arguments.out):
        sys.stdout.write(f"{path}\n")
    return 0


def _replay(arguments: argparse.Namespace) -> int:
    from mdb_deploy.runs.replay import replay_run

    return replay_run(arguments.run, arguments.roles, arguments.tolerance)


def _rescue(arguments: argparse.Namespace) -> int:
    from mdb_deploy.runs.rescue import rescue_run

    found = rescue_run(arguments.run, arguments.out)
    sys.stdout.write(f"{found.words()}\ngo on with: mdb up --resume {arguments.out}\n")
    return 0
