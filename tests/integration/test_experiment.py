"""A shortened experiment over a local router with real processes, to its end."""

from pathlib import Path
from typing import Any

import pytest

from mdb_deploy.experiments import experiment_path
from mdb_protocol import keys
from mdb_protocol.codec import to_plain
from mdb_services.recorder import read_log
from mdb_sim.runs.compare import timeless
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment
from mdb_sim.runs.replay import Run, replay, roles
from tests.integration.brain import SHORT, Brain

EXPERIMENT = experiment_path("paper")


def repeatable(run: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the values on each repeatable key without their stamps; what was sent again counts once."""
    values: dict[str, list[dict[str, Any]]] = {}
    for recorded in read_log(run):
        if recorded.row.repeatable:
            plain = to_plain(timeless(recorded.message))
            sequence = values.setdefault(recorded.key, [])
            if plain not in sequence[-3:]:
                sequence.append(plain)
    return values


def check_replay(folder: Path) -> None:
    """Each service alone says what its process said, in the order in which the recorder got it through the router."""
    run = Run.read(folder)
    assert [(role, found) for role in roles(run.experiment) if (found := replay(run, role).difference)] == []


RESTLESS = (
    "experiment.seed=7",
    "context.known_pairs=2",
    "context.known_error=2.0",
    "context.margin=0.05",
    "context.threshold=1.01",
    "long_term.stable_pairs=5",
    "long_term.good_error=0.8",
    "long_term.fit_error=0.5",
    "long_term.same_error=0.0001",
    "teacher.phase.second teacher.delay=2",
    "optimizer.praise_window=3",
    "teacher.phase.first teacher.praise_half_life=10",
    "teacher.phase.second teacher.praise_half_life=10",
)
"""Settings with which a short run changes context again and again, stores and recalls models, and measures
praise that fades."""


@pytest.fixture(scope="module")
def inline_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("inline")
    run_experiment(Experiment.read(EXPERIMENT, [*SHORT, "experiment.pace=lockstep"]), run)
    return run


@pytest.mark.parametrize("body", ["kinematic", "pybullet"])
def test_lockstep_processes_log_what_one_process_logs(body: str, tmp_path: Path, inline_run: Path) -> None:
    if body == "pybullet":
        pytest.importorskip("pybullet", reason="needs the pybullet extra (Python 3.11)")
        inline_run = tmp_path / "inline"
        settings = [*SHORT, "experiment.pace=lockstep", "robot.body=pybullet"]
        run_experiment(Experiment.read(EXPERIMENT, settings), inline_run)
    folder = tmp_path / "processes"
    folder.mkdir()
    with Brain(folder, f"robot.body={body}", pace="lockstep") as brain:
        assert brain.wait() == 0, brain.output()
        expected, got = repeatable(inline_run), repeatable(brain.run)
    assert set(got) == set(expected)
    for key, values in expected.items():
        assert got[key] == values, key
    assert len(expected[keys.ITERATION.at("pioneer")]) == 80
    check_replay(brain.run)


@pytest.mark.long
def test_lockstep_processes_change_context_as_one_process_does(tmp_path: Path) -> None:
    run_experiment(Experiment.read(EXPERIMENT, [*SHORT, *RESTLESS, "experiment.pace=lockstep"]), tmp_path / "inline")
    folder = tmp_path / "processes"
    folder.mkdir()
    with Brain(folder, *RESTLESS, pace="lockstep") as brain:
        assert brain.wait() == 0, brain.output()
        expected, got = repeatable(tmp_path / "inline"), repeatable(brain.run)
    assert got == expected
    events = expected[keys.CONTEXT.at("pioneer", model="communication")]
    assert {event["kind"] for event in events} == {"changed", "known", "stored", "recalled"}
    recalled = [c["pairs"] for c in expected[keys.MEMORY_CHANGE.at("pioneer", model="communication")] if c["seeds"]]
    assert any(min(pairs, default=0) < 0 for pairs in recalled)
    check_replay(brain.run)


def test_same_seed_gives_the_same_run_and_another_seed_another(tmp_path: Path, inline_run: Path) -> None:
    settings = [*SHORT, "experiment.pace=lockstep"]
    run_experiment(Experiment.read(EXPERIMENT, settings), tmp_path / "again")
    run_experiment(Experiment.read(EXPERIMENT, [*settings, "experiment.seed=2"]), tmp_path / "other")
    assert repeatable(tmp_path / "again") == repeatable(inline_run)
    assert repeatable(tmp_path / "other") != repeatable(inline_run)


def test_pairs_without_teacher_leave_the_communication_memory_alone(inline_run: Path) -> None:
    changes = [r.message for r in read_log(inline_run) if r.row is keys.MEMORY_CHANGE]
    taught = {pair for pair in range(80) if pair < 30 or 50 <= pair < 70}
    pairs = {
        name: {int(pair) for c in changes if c.model == name for pair in c.pairs}  # type: ignore[attr-defined]
        for name in ("communication", "object")
    }
    communication, alone = pairs["communication"], pairs["object"] - taught
    assert communication == taught
    assert alone, "the object model learns on without a teacher"


@pytest.mark.long
def test_concurrent_experiment_runs_to_its_end(tmp_path: Path) -> None:
    with Brain(tmp_path) as brain:
        assert brain.wait() == 0, brain.output()
        values = repeatable(brain.run)
        assert str(brain.run) in brain.output().replace("\n", "")
    assert [p["iteration"] for p in values[keys.PAIR.at("pioneer")]] == list(range(80))
    stored = {p["iteration"] for p in values[keys.PAIR_STORED.at("pioneer")]}
    assert stored == set(range(80))
    for model in ("communication", "object", "induced"):
        assert values[keys.CURRENT_MODEL.at("pioneer", model=model)], model
