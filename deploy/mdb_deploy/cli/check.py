"""`mdb test` and `mdb compare-bodies`: is all as it should be?"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from mdb_deploy.cli.options import Commands
from mdb_protocol.errors import MdbError

SIDE_BY_SIDE = ("-n", "2", "--dist", "worksteal")
"""How the default suite is run: many of its tests wait for processes, so two workers take half the time."""


def add(commands: Commands) -> None:
    """Add `test` and `compare-bodies`."""
    test = commands.add_parser(
        "test", help="run the tests, two at a time; words, if any, go to pytest as they are", add_help=False
    )
    test.set_defaults(command=_test, takes_words=True)
    compare = commands.add_parser("compare-bodies", help="PyBullet and its kinematic twin side by side")
    compare.set_defaults(command=_compare)


def _test(arguments: argparse.Namespace) -> int:
    try:
        import pytest
    except ModuleNotFoundError as error:
        raise MdbError("the tests need pytest: pip install -e '.[test]', or use ./deploy/compose test") from error
    root = Path(__file__).parents[3]
    os.chdir(root)
    results = root / "runs" / "tests.xml"
    status = int(pytest.main([f"--junit-xml={results}", *(arguments.words or SIDE_BY_SIDE)]))
    sys.stdout.write(f"results: {results}\n")
    return status


def _compare(_: argparse.Namespace) -> int:
    from mdb_sim.studies.twins import compare_bodies

    sys.stdout.write(f"{compare_bodies().table()}\n")
    return 0
