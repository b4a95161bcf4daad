"""Runs that are told: short ones, in lockstep, made once for all tests of this folder."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from mdb_deploy.experiments import experiment_path
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment

Made = Callable[..., Path]

SHORT = ("experiment.pace=lockstep", "experiment.iterations=80", "optimizer.random_iterations=25")
TAUGHT_AND_ALONE = ("robot.body=kinematic", "teacher.phase.alone.start=60")
"""The paper's robot: taught for 60 iterations, then alone."""


@pytest.fixture(scope="session")
def run_of(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Make the run of an experiment with overrides, or give the one that was made already."""

    @cache
    def made(name: str, *overrides: str) -> Path:
        run = tmp_path_factory.mktemp(name) / "run"
        run_experiment(Experiment.read(experiment_path(name), [*SHORT, *overrides]), run)
        return run

    return made


@pytest.fixture(scope="session")
def pioneer(run_of: Made) -> Path:
    """The run folder of a Pioneer, taught and then alone."""
    return run_of("paper", *TAUGHT_AND_ALONE)
