"""The whole experiment file, and the whole brain in one process."""

from pathlib import Path
from typing import Any

import pytest

from mdb_protocol import keys
from mdb_protocol.codec import to_plain
from mdb_protocol.errors import ConfigError
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.experiment.reading import read_file
from mdb_services.recorder import read_log
from mdb_sim.runs.compare import timeless
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment

PAPER = Path(__file__).parents[2] / "deploy" / "experiments" / "paper.toml"
SHORT = [
    "robot.body=kinematic", "experiment.pace=lockstep", "experiment.iterations=24", "optimizer.random_iterations=6",
    "teacher.phase.alone.start=8", "teacher.phase.second teacher.start=14", "teacher.phase.alone again.start=20",
    "evolution.population=20", "evolution.generations=1",
]  # fmt: skip


def test_a_written_experiment_is_read_again_as_it_was(tmp_path: Path) -> None:
    experiment = Experiment.read(PAPER, SHORT)
    experiment.write(tmp_path / "experiment.toml")
    again = Experiment.read(tmp_path / "experiment.toml")
    assert again.content == experiment.content
    assert again.brain == experiment.brain
    assert (again.robot, again.teacher) == (experiment.robot, experiment.teacher)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["robto.body=kinematic"], "unknown section 'robto'; sections are"),
        (["robot.bdy=kinematic"], "bdy"),
        (["robot.world.arena_m=-1"], "arena_m"),
        (["robot.world.place_min_m=9"], "place_min_m"),
        (["optimizer.actions=5", "channels.action.values=[1,2,3,4,5]"], "robot.world.turns_deg has 7"),
        (["teacher.phase.alone.start=5000"], "teacher: phases start at"),
        (["teacher.phase.first teacher.language=elvish"], "teacher: no language 'elvish'"),
        (["teacher.feedback=kind"], "kind"),
        (["robot.action_s=-1"], "action_s"),
    ],
)
def test_what_is_wrong_is_a_config_error_that_says_where(settings: list[str], said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        Experiment.read(PAPER, settings)
    assert said in str(caught.value)
    assert str(PAPER) in str(caught.value)


def test_services_that_cannot_be_had_are_config_errors() -> None:
    content = {name: section for name, section in read_file(PAPER).items() if name != "teacher"}
    with pytest.raises(ConfigError, match=r"no \[teacher\] section"):
        Experiment(content, "file").teacher_service(MemoryBus(Fabric(), "test"))
    for body, said in (("submarine", "no body named 'submarine'"), ("no.such:Body", "importing no.such failed")):
        with pytest.raises(ConfigError, match=said):
            Experiment.read(PAPER, [f"robot.body={body}"]).robot_service(MemoryBus(Fabric(), "test"))


def run(folder: Path, *settings: str) -> list[tuple[str, dict[str, Any]]]:
    """Every repeatable message of a run in one process without its stamp, in order."""
    run_experiment(Experiment.read(PAPER, [*SHORT, *settings]), folder)
    return [(r.key, to_plain(timeless(r.message))) for r in read_log(folder) if r.row.repeatable]


@pytest.fixture(scope="module")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, dict[str, Any]]]:
    return run(tmp_path_factory.mktemp("first"))


def test_one_seed_gives_one_run(first_run: list[tuple[str, dict[str, Any]]], tmp_path: Path) -> None:
    assert by_key(run(tmp_path)) == by_key(first_run)


def by_key(log: list[tuple[str, dict[str, Any]]]) -> dict[str, list[dict[str, Any]]]:
    """The messages on each key; what was sent again, the machine being slow, counts once."""
    values: dict[str, list[dict[str, Any]]] = {}
    for key, plain in log:
        if plain not in values.setdefault(key, [])[-3:]:
            values[key].append(plain)
    return values


def test_a_run_in_one_process_is_whole(first_run: list[tuple[str, dict[str, Any]]]) -> None:
    values = by_key(first_run)
    reports = values[keys.ITERATION.at("pioneer")]
    assert [r["iteration"] for r in reports] == list(range(24))
    taught = [i for i in range(24) if i < 8 or 14 <= i < 20]
    assert [r["iteration"] for r in reports if r["note"] is not None] == taught
    assert [r["iteration"] for r in reports if r["feedback"] is not None] == taught
    assert [p["iteration"] for p in values[keys.PAIR_STORED.at("pioneer")]] == list(range(24))
    assert len(values[keys.CURRENT_MODEL.at("pioneer", model="communication")]) == len(taught)
    assert len(values[keys.FINISHED.at("pioneer")]) == 1
    for model in ("communication", "object", "induced"):
        changed = [c["version"] for c in values[keys.MEMORY_CHANGE.at("pioneer", model=model)]]
        learnt = [m["version"] for m in values[keys.CURRENT_MODEL.at("pioneer", model=model)]]
        assert changed == learnt == list(range(1, len(changed) + 1)), "every version gets its generations"


def test_a_run_can_be_stopped_and_watched(tmp_path: Path) -> None:
    seen: list[int] = []
    run_experiment(
        Experiment.read(PAPER, SHORT),
        tmp_path,
        on_iteration=lambda report: seen.append(report.iteration),
        stop=lambda: len(seen) >= 5,
    )
    assert seen[:5] == [0, 1, 2, 3, 4]
    assert len(seen) < 24
    assert [r.row for r in read_log(tmp_path) if r.row is keys.FINISHED] == []
