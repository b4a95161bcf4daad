"""What `mdb up` does when its own ground is taken away: logs or the whole run folder deleted, processes dead."""

import shutil
from pathlib import Path

import pytest

from mdb_deploy.experiments import experiment_path
from mdb_deploy.trials.chaos import ChaosOptions
from mdb_deploy.trials.chaos import run as run_chaos
from tests.integration.brain import SHORT, Brain, until
from tests.integration.ears import Ears
from tests.integration.test_deadman import goes_on
from tests.integration.test_survival import LONG

pytestmark = [pytest.mark.long, pytest.mark.timeout(200)]


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


@pytest.mark.timeout(400)
def test_with_hangs_among_kills_nothing_acknowledged_is_lost(tmp_path: Path) -> None:
    options = ChaosOptions(
        experiment_path("paper"), SHORT, tmp_path, kills=8, hangs=0.5, seed=3, bound_s=90.0, pause_s=0.3
    )
    report = run_chaos(options, print)
    assert {kill.hang for kill in report.kills} == {True, False}
    assert all(kill.recovered_s is not None for kill in report.kills)
    assert report.findings.holds, report.findings
    assert (report.moved_alone, report.status) == (0, 130)
