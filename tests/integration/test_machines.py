"""What holds for the Pioneer holds for machines of another make: one run a seed, replay, kills."""

from pathlib import Path

import numpy as np
import pytest

from mdb_deploy.experiments import EXPERIMENTS, experiment_path
from mdb_sim.body import NOTHING
from mdb_sim.robot.course import TIMEOUT
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment
from mdb_sim.runs.measures import obeyed
from mdb_sim.runs.record import RunRecord, read_record
from mdb_sim.studies.ideal import ideal_successes
from tests.integration.brain import Brain
from tests.integration.test_chaos import straight_and_killed
from tests.integration.test_experiment import check_replay, repeatable

SHORT = (
    "experiment.brain=pioneer",
    "experiment.iterations=100",
    "optimizer.random_iterations=30",
    'teacher.phase=[{start=0, name="taught", teacher="one", language="random"}, {start=60, name="alone"}]',
)
MACHINES = ("cartpole", "mountaincar", "pendulum")


@pytest.fixture(autouse=True)
def _gymnasium() -> None:
    pytest.importorskip("gymnasium")


@pytest.mark.parametrize("name", sorted(path.stem for path in EXPERIMENTS.glob("*.toml")))
def test_each_shipped_file_fits_its_machine(name: str) -> None:
    experiment = Experiment.read(experiment_path(name))
    if experiment.robot.body in ("pybullet", "iiwa", "racecar"):
        pytest.importorskip("pybullet")
    if name == "reacher":
        pytest.importorskip("mujoco")
    experiment.check_machine()
    assert experiment.brain.experiment.name == name


@pytest.mark.long
@pytest.mark.parametrize("machine", MACHINES)
def test_lockstep_processes_log_what_one_process_logs(machine: str, tmp_path: Path) -> None:
    settings = (*SHORT, "experiment.pace=lockstep")
    run_experiment(Experiment.read(experiment_path(machine), settings), tmp_path / "inline")
    folder = tmp_path / "processes"
    folder.mkdir()
    with Brain(folder, pace="lockstep", experiment=(machine, SHORT)) as brain:
        assert brain.wait() == 0, brain.output()
        assert repeatable(brain.run) == repeatable(tmp_path / "inline")
    check_replay(brain.run)


@pytest.mark.long
@pytest.mark.parametrize("machine", ["pendulum"])
def test_a_lockstep_run_with_kills_ends_as_the_one_without(machine: str, tmp_path: Path) -> None:
    settings = (*SHORT, "experiment.pace=lockstep", "experiment.iterations=250")
    report, state = straight_and_killed(Experiment.read(experiment_path(machine), settings), tmp_path, 1)
    assert len(report.kills) >= 4
    straight = read_record(tmp_path / "straight").scenes[250]
    assert (state.scene.now, state.scene.episode) == (straight.now, straight.episode)


@pytest.mark.parametrize(("machine", "least"), [("cartpole", 0.9), ("mountaincar", 0.9), ("pendulum", 0.6)])
def test_a_machine_learns_to_obey(machine: str, least: float, tmp_path: Path) -> None:
    settings = (
        "experiment.pace=lockstep",
        "experiment.iterations=300",
        'teacher.phase=[{start=0, name="taught", teacher="one", language="random"}]',
    )
    run_experiment(Experiment.read(experiment_path(machine), settings), tmp_path)
    record = read_record(tmp_path)
    chosen = ~record.explored & (np.arange(record.iterations) >= 240)
    assert np.nanmean(obeyed(record)[chosen]) >= least  # of some commands the policy cannot say
    assert {*record.event} <= {NOTHING, *record.experiment.robot.ends}


def taught(machine: str, iterations: int, forced: int, run: Path) -> RunRecord:
    settings = (
        "experiment.pace=lockstep",
        f"experiment.iterations={iterations}",
        f"optimizer.random_iterations={forced}",
        'teacher.phase=[{start=0, name="taught", teacher="one", language="random"}]',
    )
    run_experiment(Experiment.read(experiment_path(machine), settings), run)
    return read_record(run)


def test_a_car_learns_to_obey(tmp_path: Path) -> None:
    pytest.importorskip("pybullet")
    record = taught("car", 300, 100, tmp_path)
    chosen = ~record.explored & (np.arange(record.iterations) >= 200)
    assert obeyed(record)[chosen].mean() >= 0.8
    assert {*record.event} <= {NOTHING, TIMEOUT, *record.experiment.robot.ends}
    ideal = ideal_successes(record, (200, 300))
    assert 20 <= ideal <= 40


def test_an_arm_learns_which_way_it_is_guided(tmp_path: Path) -> None:
    """How much is won depends on how far the point is, and how much the arm is bent; at random nothing is."""
    pytest.importorskip("pybullet")
    record = taught("arm", 400, 150, tmp_path)
    chosen = ~record.explored & (np.arange(record.iterations) >= 250)
    assert record.feedback[chosen].mean() >= 0.15
    assert record.feedback[:150].mean() < 0.05
    assert {*record.event} <= {NOTHING, TIMEOUT, *record.experiment.robot.ends}
