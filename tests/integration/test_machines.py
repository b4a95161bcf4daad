"""What holds for the Pioneer holds for machines of another make: one run a seed, replay, kills."""

from pathlib import Path

import pytest

from mdb_deploy.experiments import EXPERIMENTS, experiment_path
from mdb_sim.body import NOTHING
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment
from mdb_sim.runs.measures import obeyed
from mdb_sim.runs.record import read_record
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
    if experiment.robot.body == "pybullet":
        pytest.importorskip("pybullet")
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
@pytest.mark.parametrize("machine", ["cartpole", "pendulum"])
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
    commanded = obeyed(record)[-60:]
    assert commanded.mean() >= least
    assert {*record.event} <= {NOTHING, *record.experiment.robot.ends}
