"""`mdb test` and `mdb compare-bodies`: is all as it should be?"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from mdb_deploy.cli.options import Commands
from mdb_protocol.errors import MdbError

PLUGINS = ("pytest_timeout", "xdist.plugin", "_hypothesis_pytestplugin")
"""What the tests use of pytest's plugins, as `pip` installs them."""
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
    if not (root / "tests").is_dir():
        raise MdbError("the tests are in a checkout of the project; this is an installed package")
    os.chdir(root)
    results = root / "runs" / "tests.xml"
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # those of others on PYTHONPATH, as ROS has them
    # The tests start programs as their users do, who have not set it.
    for inherited in ("PYTEST_ADDOPTS", "PYTEST_PLUGINS", "PYTHONSAFEPATH"):
        os.environ.pop(inherited, None)
    own = [word for name in PLUGINS for word in ("-p", name)]
    status = int(pytest.main([*own, f"--junit-xml={results}", *(arguments.words or SIDE_BY_SIDE)]))
    sys.stdout.write(f"results: {results}\n")
    return status


def _compare(_: argparse.Namespace) -> int:
    from mdb_sim.studies.twins import compare_bodies

    sys.stderr.write("both bodies do 300 actions side by side, then 1000 alone for each of two policies\n")
    sys.stdout.write(f"{compare_bodies().table()}\n")
    return 0
