"""A physics client that gives its zeros back: less memory, and the same physics."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")

PLAYED = """
import re, sys, threading
from pathlib import Path
from mdb_sim.bodies.finding import get_ready, make_body

def written_mb():
    return int(re.search(r"Anonymous: +(\\d+)", Path("/proc/self/smaps_rollup").read_text())[1]) / 1e3

import mdb_sim.bodies.pioneer.physics  # what is imported is not counted
if sys.argv[1] == "more threads":
    threading.Thread(target=threading.Event().wait, daemon=True).start()
before_mb = written_mb()
get_ready("pybullet")
robot = make_body("pybullet", {})
kept_mb = written_mb() - before_mb
robot.reset(1, 0)
print(kept_mb, [robot.act({"turn": turn}) for turn in (30.0, -90.0, 0.0, 60.0, 90.0, 0.0)])
"""
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def _played(threads: str) -> tuple[float, str]:
    done = subprocess.run(
        [sys.executable, "-P", "-c", PLAYED, threads],
        capture_output=True, text=True, timeout=60, env=os.environ | ONE_THREAD, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    kept_mb, outcomes = done.stdout.splitlines()[-1].split(" ", 1)
    return float(kept_mb), outcomes


def test_zeros_are_given_back_while_there_is_one_thread_and_nothing_else_changes() -> None:
    pytest.importorskip("pybullet", reason="needs the pybullet extra (Python 3.11)")
    alone_mb, alone = _played("one thread")
    among_mb, among = _played("more threads")
    assert alone == among
    assert alone_mb < among_mb - 10.0
