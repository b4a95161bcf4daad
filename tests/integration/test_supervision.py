"""What `mdb up` does when its own ground is taken away: logs or the whole run folder deleted, processes dead."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mdb_deploy.experiments import experiment_path
from mdb_deploy.trials.chaos import ChaosOptions
from mdb_deploy.trials.chaos import run as run_chaos
from mdb_protocol import messages
from tests.integration.brain import SHORT, Brain, until
from tests.integration.ears import Ears, of
from tests.integration.test_deadman import goes_on
from tests.integration.test_survival import LONG

pytestmark = [pytest.mark.long, pytest.mark.timeout(200)]


@pytest.mark.edge("the run folder taken away", "the logs deleted, two processes killed")
def test_after_the_logs_were_deleted_who_is_killed_comes_back(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        ears = Ears(bus)
        goes_on(ears)
        shutil.rmtree(brain.run / "logs")
        for word in ("recorder", "teacher"):
            child = brain.child(word)
            assert child is not None
            child.kill()
        for word in ("recorder", "teacher"):
            until(lambda word=word: (brain.run / "logs" / f"{word}.log").exists() and brain.child(word))  # type: ignore[misc]
        goes_on(ears)
        assert brain.process.poll() is None


@pytest.mark.edge("the run folder taken away", "moved away while it runs")
def test_a_run_folder_that_is_moved_away_is_said_at_once_and_is_no_result(tmp_path: Path) -> None:
    settings = (*SHORT, "experiment.iterations=300", "robot.action_s=0.02", "store.when_full=act")
    with Brain(tmp_path, experiment=("paper", settings)) as brain, brain.bus() as bus:
        ears = Ears(bus)
        goes_on(ears)
        run = brain.run
        run.rename(tmp_path / "elsewhere")  # deleting it file by file would race with those who write
        until(lambda: "the run folder is lost" in brain.output(), 10.0)
        assert brain.process.poll() is None, "acting goes on, as configured"
        assert brain.wait(120.0) == 2
        said = " ".join(brain.output().split())
        assert "was deleted or moved away: there are no results in its place" in said
        assert "results:" not in said
        assert "Traceback" not in said
        assert not run.exists()


@pytest.mark.edge("the run folder taken away", "deleted, and processes die")
def test_when_processes_die_and_the_run_folder_is_gone_the_run_ends_saying_why(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        goes_on(Ears(bus))
        brain.run.rename(tmp_path / "elsewhere")
        child = brain.child("teacher")
        assert child is not None
        child.kill()
        assert brain.wait(120.0) == 2
        said = " ".join(brain.output().split())
        assert "teacher died 5 times in a row" in said
        assert "it cannot be started: [Errno 2] No such file or directory" in said
        assert "results:" not in said


@pytest.mark.edge("the run folder taken away", "read-only while it runs, then not")
@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("mount") is None, reason="a read-only mount needs root")
def test_a_run_folder_that_becomes_read_only_is_said_nothing_is_acknowledged_and_afterwards_it_goes_on(
    tmp_path: Path,
) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        ears = Ears(bus)
        goes_on(ears)
        with read_only(brain.run):
            until(lambda: "the run folder is lost" in brain.output(), 10.0)
            assert "read-only" in brain.output()
            ears.listen(5.0)
            ears.heard.clear()
            ears.listen(1.0)
            assert not of(ears.heard, messages.PairStored), "nothing is acknowledged"
            assert not of(ears.heard, messages.IterationReport), "the robot stands still"
        until(lambda: "the run folder is back" in brain.output(), 10.0)
        goes_on(ears)


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Mount a folder over itself, read-only."""
    subprocess.run(["mount", "--bind", folder, folder], check=True)
    try:
        remount = ["mount", "-o", "remount,bind,ro", folder]  # refused while somebody writes a file there
        until(lambda: subprocess.run(remount, capture_output=True, check=False).returncode == 0, 10.0)
        yield
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_with_hangs_among_kills_nothing_acknowledged_is_lost(tmp_path: Path) -> None:
    options = ChaosOptions(
        experiment_path("paper"), SHORT, tmp_path, kills=8, hangs=0.5, seed=3, bound_s=90.0, pause_s=0.3
    )
    report = run_chaos(options, print)
    assert {kill.hang for kill in report.kills} == {True, False}
    assert all(kill.recovered_s is not None for kill in report.kills)
    assert report.total.kills + sum(row.kills for row in report.hung) == len(report.kills)
    assert report.findings.holds, report.findings
    assert (report.moved_alone, report.status) == (0, 130)
