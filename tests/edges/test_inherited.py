"""Settings of others: pytest's plugins on PYTHONPATH, as ROS has them, do not take part in the project's tests."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BOUND_S = 100.0


@pytest.mark.edge("inherited settings", "PYTHONPATH with ROS's pytest plugins, PYTEST_ADDOPTS, in mdb test")
def test_plugins_of_others_stay_out(tmp_path: Path) -> None:
    (tmp_path / "launch_testing.py").write_text("raise RuntimeError('a plugin of ROS, for another pytest')\n")
    described = tmp_path / "launch_testing-1.0.dist-info"
    described.mkdir()
    (described / "METADATA").write_text("Metadata-Version: 2.1\nName: launch-testing\nVersion: 1.0\n")
    (described / "entry_points.txt").write_text("[pytest11]\nlaunch = launch_testing\n")
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, "-m", "mdb_deploy.cli", "test", "tests/protocol/test_keys.py", "-p", "no:cacheprovider"],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": path, "PYTEST_ADDOPTS": "--no-such-option"},
        capture_output=True, text=True, timeout=BOUND_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"results: {ROOT / 'runs' / 'tests.xml'}" in done.stdout
