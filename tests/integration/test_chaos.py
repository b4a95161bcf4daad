"""A real brain whose processes are killed at random: nothing acknowledged is lost, and it comes back soon."""

import sqlite3
from pathlib import Path
from typing import Any

import pytest

from mdb_deploy.experiments import experiment_path
from mdb_deploy.supervision.compose import for_experiment, read
from mdb_deploy.trials.chaos import ChaosOptions, run
from mdb_deploy.trials.chaos_report import Report
from mdb_deploy.trials.soak import SoakOptions
from mdb_deploy.trials.soak import run as soak_run
from mdb_deploy.trials.under_test import long_experiment
from mdb_protocol import codec, messages
from mdb_services.experiment.run_folder import MEMORY_FILE
from mdb_sim.robot.state_file import StateFile
from mdb_sim.runs.experiment import ROBOT_FILE, Experiment
from mdb_sim.runs.inline import run_experiment
from mdb_sim.runs.record import read_record
from tests.integration.brain import SHORT

pytestmark = pytest.mark.long

PAPER = experiment_path("paper")
BOUND_S = 30.0
"""On a loaded machine; how long recovery takes is measured by `mdb chaos`, not here."""


def pairs_of(run_folder: Path) -> list[dict[str, Any]]:
    with sqlite3.connect(run_folder / MEMORY_FILE) as db:
        rows = db.execute("SELECT payload FROM pair ORDER BY iteration").fetchall()
    encoding = codec.encoding_of(messages.Pair)
    return [codec.to_plain(codec.decode(messages.Pair, payload, encoding)) for (payload,) in rows]


def straight_and_killed(experiment: Experiment, folder: Path, seed: int) -> tuple[Report, messages.RobotState]:
    """Run an experiment in one process (`straight`), and in many of which all but the recorder die: the same pairs.

    Return what the kills were, and where the robot was at the end.
    """
    file = folder / "experiment.toml"
    experiment.write(file)
    run_experiment(experiment, folder / "straight")
    roles = tuple(name for name in for_experiment(read(), experiment) if name != "recorder")
    options = ChaosOptions(
        file, (), folder / "killed", 8, seed, roles, bound_s=BOUND_S, pause_s=0.05, to_the_end=True
    )
    report = run(options, print)
    assert (report.findings.holds, report.status) == (True, 0)
    assert pairs_of(report.run) == pairs_of(folder / "straight")
    state = StateFile(report.run / ROBOT_FILE).read()
    assert state is not None
    return report, state


def test_after_twelve_kills_everything_acknowledged_is_there_once(tmp_path: Path) -> None:
    report = run(ChaosOptions(PAPER, SHORT, tmp_path, kills=12, seed=1, bound_s=BOUND_S, pause_s=0.3), print)
    assert len(report.kills) == 12
    assert all(kill.recovered_s is not None for kill in report.kills)
    assert report.findings.holds, report.findings
    assert report.findings.acknowledged > 24
    assert report.findings.missing == []
    assert (report.moved_alone, report.status) == (0, 130)
    assert report.logged > 0


@pytest.mark.slow  # the pendulum's is long
@pytest.mark.parametrize("seed", [1])
def test_a_lockstep_run_with_kills_ends_as_the_one_without(tmp_path: Path, seed: int) -> None:
    """All but the recorder die, whom nobody waits for."""
    settings = (*SHORT, f"experiment.seed={seed}", "experiment.pace=lockstep")
    report, state = straight_and_killed(long_experiment(PAPER, settings, 3 * 80), tmp_path, seed)
    assert len(report.kills) >= 6
    assert state.scene.successes == read_record(tmp_path / "straight").successes[-1]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_after_three_hundred_kills_everything_acknowledged_is_there_once(tmp_path: Path) -> None:
    report = run(ChaosOptions(PAPER, (), tmp_path, kills=300, seed=1), print)
    assert report.holds, report.markdown()


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_nothing_grows_at_full_speed(tmp_path: Path) -> None:
    soak = soak_run(SoakOptions(PAPER, (), tmp_path, minutes=5.0), print)
    assert soak.holds, soak.markdown()
