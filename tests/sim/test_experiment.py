"""The whole experiment file, and the whole brain in one process."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mdb_protocol import codec, keys
from mdb_protocol.codec import to_plain
from mdb_protocol.errors import ConfigError
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_protocol.messages import IterationReport
from mdb_protocol.waiting import Raw
from mdb_services.experiment.reading import read_file
from mdb_services.recorder import read_log
from mdb_sim.runs import experiment as experiments
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


def test_who_reads_what_a_kept_experiment_wrote_gets_that_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(experiments, "_kept", {})
    experiment, file = Experiment.read(PAPER, SHORT), tmp_path / "experiment.toml"
    experiment.keep()
    experiment.write(file)
    assert Experiment.read(file) is experiment
    assert Experiment.read(file, ["experiment.iterations=25"]).brain.experiment.iterations == 25
    file.write_text(file.read_text().replace("iterations = 24", "iterations = 23"))
    assert Experiment.read(file).brain.experiment.iterations == 23
    with pytest.raises(ConfigError, match="cannot read"):
        Experiment.read(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["robto.body=kinematic"], "unknown section 'robto'; did you mean 'robot'"),
        (["robot.bdy=kinematic"], "bdy"),
        (["robot.world.arena_m=-1"], "world"),
        (["robot.options=5"], "options"),
        (["robot.episode_iterations=0"], "episode_iterations"),
        (["robot.successes=capture"], "successes"),
        (["actuators.turn.low=-60"], "turn = -90.0; expected -60"),
        (["teacher.phase.alone.start=5000"], "teacher: phases start at"),
        (["teacher.policy=obey"], "teacher: no policy named 'obey'; expected 'reach'"),
        (["teacher.policy=no.such:Policy"], "teacher: policy='no.such:Policy': importing no.such failed"),
        (["teacher.options.turns=3"], "teacher: policy='reach' does not take the options {'turns': 3}"),
        (["teacher.options.turns_deg=[20]"], "expected two or more of -180 to 180, all different"),
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
        experiment = Experiment.read(PAPER, [f"robot.body={body}"])
        with pytest.raises(ConfigError, match=said):
            experiment.robot_service(MemoryBus(Fabric(), "test"))
        with pytest.raises(ConfigError, match=said):
            experiment.check_machine()
    for setting, said in (("robot.options.arena_m=-1", "arena_m"), ("robot.options.wheels=3", "wheels")):
        experiment = Experiment.read(PAPER, ["robot.body=kinematic", setting])
        with pytest.raises(ConfigError, match=said):
            experiment.robot_service(MemoryBus(Fabric(), "test"))
        with pytest.raises(ConfigError, match=rf"{PAPER.name}: robot\.options: .*{said}"):
            experiment.check_machine()


# ---- the file and the body that it names ----


def files() -> list[Path]:
    return sorted(PAPER.parent.glob("*.toml"))


@pytest.mark.parametrize("path", files(), ids=lambda path: path.stem)
def test_a_shipped_experiment_fits_its_body(path: Path) -> None:
    experiment = Experiment.read(path)
    pytest.importorskip(experiment.robot.body if experiment.robot.body != "kinematic" else "numpy")
    experiment.check_machine()


@pytest.mark.parametrize("body", ["kinematic", "pybullet"])
def test_the_papers_experiment_fits_both_pioneers_and_what_does_not_fit_is_told(body: str) -> None:
    if body == "pybullet":
        pytest.importorskip("pybullet")
    own = f"robot.body={body}"
    Experiment.read(PAPER, [own]).check_machine()
    Experiment.read(PAPER, [own, "robot.options.advance_m=0.1"]).check_machine()
    for settings, said in (
        (['robot.ends=["bump", "hit"]'], "robot.ends has 'hit', which is none of its events"),
        (["robot.successes=[]", "robot.ends=[]"], None),
        (["actuators.turn.high=200"], "actuators.turn goes from -90 to 200, the body's from -180 to 180 deg"),
        (["channels.light.low=0"], "channels.light: it has no such sensor or actuator"),
        (["channels.distance.numbers=2"], "channels.distance: the sensor gives 1 numbers, not 2"),
        (["teacher.options.turns_deg=[0.0, 30.0]"], "the teacher's policy has 2 commands, but channels.note 7 notes"),
    ):
        experiment = Experiment.read(PAPER, [own, *settings])
        if said is None:
            experiment.check_machine()
            continue
        with pytest.raises(ConfigError) as caught:
            experiment.check_machine()
        assert str(caught.value).startswith(f"{PAPER}: body {body!r} is another one: ")
        assert said in str(caught.value)


def test_of_a_body_of_another_kind_every_difference_is_told_at_once() -> None:
    crane = "robot.body=tests.conformance.small_bodies:Crane"
    with pytest.raises(ConfigError) as caught:
        Experiment.read(PAPER, [crane]).check_machine()
    told = str(caught.value)
    for said in (
        "it has no actuator 'turn' (there are along, up)",
        "its actuator 'along' is not in the file",
        "channels.distance: it has no such sensor or actuator (there are load, rows)",
        "robot.successes has 'capture', which is none of its events (there are end, timeout)",
        "its event 'end' ends an episode; add it to robot.ends",
        "the teacher's policy looks at 'heading_rad', which its scene does not have (there are height_m, x_m)",
    ):
        assert said in told
    assert told.count("; ") >= 12


# ---- bodies and policies beside the file ----

BESIDE = """
from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.teaching.policies.pioneer import Reach

class Robot(KinematicRobot):
    "A robot whose motors are swapped."
    def act(self, values):
        return super().act({"turn": -values["turn"]})

class Wants(Reach):
    "What somebody else wants."
"""


@pytest.fixture
def beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The paper's experiment in a folder of its own, with a body and a policy in a file beside it."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    path = tmp_path / "own" / "own.toml"
    path.parent.mkdir()
    path.write_text(PAPER.read_text(encoding="utf-8"), encoding="utf-8")
    (path.parent / "robots_of_mine.py").write_text(BESIDE)
    yield path
    sys.modules.pop("robots_of_mine", None)


OWN = ["robot.body=robots_of_mine:Robot", "teacher.policy=robots_of_mine:Wants"]


def test_a_body_and_a_policy_beside_the_file_are_found_also_from_a_run_folder(beside: Path, tmp_path: Path) -> None:
    experiment = Experiment.read(beside, [*SHORT, *OWN])
    assert experiment.folder == beside.parent
    experiment.check_machine()
    run_experiment(experiment, tmp_path / "run")
    again = Experiment.read(tmp_path / "run" / "experiment.toml")
    assert again.folder == beside.parent, "where the first file lay"
    assert again.content == experiment.content
    again.check_machine()
    assert type(again.body()).__name__ == "Robot"
    assert type(again.schedule().policy).__name__ == "Wants"
    feedback = [r.message.feedback for r in read_log(tmp_path / "run") if isinstance(r.message, IterationReport)]
    assert 1.0 in feedback, "swapped motors can be taught"


@pytest.mark.parametrize("own", OWN)
def test_the_folder_is_written_when_something_may_be_there_and_only_then(beside: Path, own: str) -> None:
    assert Experiment.read(beside, [own]).content["experiment"]["folder"] == str(beside.parent)
    plain = Experiment.read(beside)
    assert plain.folder is None
    assert "folder" not in plain.content["experiment"]


def test_the_folder_of_a_file_named_by_a_relative_path_is_whole(
    beside: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(beside.parent)
    assert Experiment.read(Path("own.toml"), OWN).folder == beside.parent


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


def test_no_service_changes_a_message_that_all_who_read_it_share(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[Raw] = []
    put = Fabric.put

    def keep(fabric: Fabric, owner: MemoryBus, row: keys.Key, raw: Raw) -> None:
        said.append(raw)
        put(fabric, owner, row, raw)

    monkeypatch.setattr(Fabric, "put", keep)
    run_experiment(Experiment.read(PAPER, SHORT), tmp_path / "run")
    read = [(raw.payload, raw.message) for raw in said if raw.message is not None]
    assert len(read) > 24
    assert [message for payload, message in read if codec.encode(message) != payload] == []


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


def test_without_phases_nobody_teaches_and_what_can_be_wanted_is_known() -> None:
    content = read_file(PAPER, SHORT)
    del content["teacher"]["phase"]
    alone = Experiment(content, PAPER)
    assert alone.teacher is None
    assert not alone.scripted_teachers
    assert (policy := alone.policy()) is not None
    assert policy.commands == Experiment.read(PAPER).schedule().policy.commands
    del content["teacher"]
    names = Experiment(content, PAPER).policy()
    assert names is not None
    assert names.commands == tuple(choice["name"] for choice in content["choice"]), "one command a choice"
    content["teacher"] = {"policy": "reech"}
    with pytest.raises(ConfigError, match="reach"):
        Experiment(content, PAPER)
