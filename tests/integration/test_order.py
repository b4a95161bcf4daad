"""In lockstep it does not matter which service goes on when: the run is the same, value by value."""

from pathlib import Path

import numpy as np
import pytest

from mdb_deploy.experiments import experiment_path
from mdb_protocol.memory_bus import MemoryBus
from mdb_services.recorder import Recorder
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment
from tests.integration.brain import SHORT
from tests.integration.test_experiment import RESTLESS, repeatable
from tests.integration.test_resume import Mortal

SETTINGS = (
    *SHORT,
    *RESTLESS,
    "experiment.pace=lockstep",
    "experiment.iterations=60",
    "teacher.phase.first teacher.delay=3",
    "teacher.phase.alone.teacher=three",
    "teacher.phase.alone.language=random",
)
"""Feedback of the first teacher still comes when another one already judges at once: pairs overtake one another."""
NAMELESS = (
    "optimizer.feedback_window=12",
    "optimizer.most_late=3",
    "teacher.phase.first teacher.named=false",
    "teacher.phase.first teacher.delay_spread=1",
    "teacher.phase.alone.named=false",
)
"""The first two teachers do not say what their feedback is for, and it is credited to what fits best."""
SLOW = 0.05
STEPS = 100_000


@pytest.fixture(scope="module")
def experiment(request: pytest.FixtureRequest) -> Experiment:
    return Experiment.read(experiment_path("paper"), (*SETTINGS, *request.param))


@pytest.fixture(scope="module")
def in_turn(experiment: Experiment, tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("in turn") / "run"
    run_experiment(experiment, run)
    return run


CASES = [
    *(((), slow) for slow in ("nobody", "memory", "communication", "object", "robot", "teacher", "optimizer")),
    *((NAMELESS, slow) for slow in ("nobody", "teacher", "optimizer")),
]


@pytest.mark.parametrize(("experiment", "slow"), CASES, indirect=["experiment"])
def test_whoever_is_slow_the_run_is_the_same(
    slow: str, experiment: Experiment, in_turn: Path, tmp_path: Path
) -> None:
    brain, rng = Mortal(experiment, tmp_path / "run"), np.random.default_rng(7)
    recorder = Recorder(MemoryBus(brain._fabric, brain._name), tmp_path / "run")
    names = list(brain.services)
    chances = np.array([SLOW if name == slow else 1.0 for name in names])
    for name in rng.choice(names, STEPS, p=chances / chances.sum()):
        brain.services[name].step()
        recorder.step()
        if brain._finished.take() is not None:
            break
    recorder.close()
    expected, got = repeatable(in_turn), repeatable(tmp_path / "run")
    for key, values in expected.items():
        end = len(got[key]) if key.endswith("/command") else len(values)  # for the last command nobody waits
        assert got[key] == values[:end], key
