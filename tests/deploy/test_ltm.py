"""`mdb ltm`: models of one run listed, shown, carried to another, where they act."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from mdb_deploy.cli.main import main
from mdb_deploy.experiments import EXPERIMENTS
from mdb_deploy.runs import ltm
from mdb_protocol import messages
from mdb_services.experiment.run_folder import EXPERIMENT_FILE, MEMORY_FILE
from mdb_services.mechanism.learners import make_learner
from mdb_services.mechanism.networks.network import Shape
from mdb_services.mechanism.settings import LEARNER_CONFIGS
from mdb_services.memory.file import MemoryFile
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.measures import successes
from mdb_sim.runs.record import read_record

KINEMATIC = ["--set", "robot.body=kinematic"]


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose object and induced models are good enough to be stored."""
    runs = tmp_path_factory.mktemp("taught")
    words = ["up", "paper", "--inline", "--no-plot", "--runs", str(runs), "--seed", "7", "--iterations", "330"]
    assert main([*words, *KINEMATIC, "--set", "optimizer.random_iterations=150"]) == 0
    return next(runs.iterdir())


@pytest.fixture
def other(tmp_path: Path) -> Path:
    run = tmp_path / "other"
    assert main(["prepare", "paper", "--run", str(run), "--seed", "8", *KINEMATIC]) == 0
    return run


def stored(run: Path) -> list[messages.LongTermModel]:
    with MemoryFile(run / MEMORY_FILE) as file:
        return file.long_term()


def test_lists_and_shows_what_is_stored(taught: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert {model.model for model in stored(taught)} >= {"communication", "object"}
    assert main(["ltm", "list", str(taught)]) == 0
    listed = capsys.readouterr().out
    assert all(f"{model.model}/{model.id}" in listed for model in stored(taught))
    assert main(["ltm", "show", str(taught), "object"]) == 0
    shown = capsys.readouterr().out
    assert "angle: scalar -1.5708 to 1.5708" in shown
    assert "seed 7" in shown


def test_export_and_import_carry_models_with_their_context(taught: Path, other: Path, tmp_path: Path) -> None:
    file = tmp_path / "models.ltm"
    assert main(["ltm", "export", str(taught), "object", "--out", str(file)]) == 0
    exported = ltm.read(file)
    assert [model.model for model in exported] == ["object"] * len(exported)
    for times in (1, 2):  # again: they get ids of their own
        assert main(["ltm", "import", str(file), str(other)]) == 0
        assert [model.id for model in stored(other)] == list(range(1, times * len(exported) + 1))
    first, brought = exported[0], stored(other)[0]
    assert np.array_equal(first.weights, brought.weights)
    assert first.pairs == brought.pairs
    assert brought.origin.endswith(f"models.ltm: object/{first.id}")


def test_models_of_another_run_act_at_once(taught: Path, tmp_path: Path) -> None:
    """Without a teacher, without exploration: a robot that knows nothing wanders, one with models captures."""
    words = ["--inline", "--no-plot", "--iterations", "150", "--seed", "8", *KINEMATIC]
    words += ["--set", "optimizer.random_iterations=0", "--set", 'teacher.phase=[{start=0, name="alone"}]']
    for name, more in (("without", []), ("with", ["--long-term", str(taught)])):
        assert main(["up", "paper", *words, "--runs", str(tmp_path / name), *more]) == 0
    records = {name: read_record(next((tmp_path / name).iterdir())) for name in ("without", "with")}
    assert successes(records["with"], (0, 150)) > 25 + successes(records["without"], (0, 150))


def test_a_model_that_does_not_fit_is_refused_and_nothing_is_written(
    taught: Path, other: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for setting, says in (
        ("channels.angle.low=-3.14", "angle is scalar -1.5708 to 1.5708 there, scalar -3.14 to 1.5708 here"),
        ("model.object.hidden=[2]", "this experiment has room for [2], or as its 5 members together [15]"),
        ("model.object.members=1", "this experiment has room for [30]: --set"),
        ("model.object.name=thing", "no model 'object'"),
    ):
        settings = ["robot.body=kinematic", setting]
        if "name" in setting:
            settings.append("mode.induced.world=thing")
        Experiment.read(EXPERIMENTS / "paper.toml", settings).write(other / EXPERIMENT_FILE)
        assert main(["ltm", "import", str(taught), str(other)]) == 2
        assert says in capsys.readouterr().err
        assert stored(other) == []


@pytest.mark.parametrize("name", ["adam", "ridge"])
@pytest.mark.parametrize(("members", "hidden"), [(1, [4, 3]), (5, [4, 3]), (2, [6])])
def test_the_room_of_a_model_is_that_of_what_its_learners_report(name: str, members: int, hidden: list[int]) -> None:
    settings = [f"model.object.members={members}", f"model.object.hidden={hidden}", f'learner={{name="{name}"}}']
    brain = Experiment.read(EXPERIMENTS / "paper.toml", settings).brain
    shape = Shape(2, tuple(hidden), 1)
    learner = make_learner(name, shape, LEARNER_CONFIGS[name](), 1, "object", members=members)
    reported = learner.learn(np.zeros((3, 2), np.float32), np.ones((3, 1), np.float32), version=1).network
    units = brain.reported_hidden(brain.model_named("object"))
    assert units == (list(reported.sizes[1:-1]) if members > 1 or name == "ridge" else hidden)


def test_clear_errors(taught: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    damaged = tmp_path / "damaged.ltm"
    assert main(["ltm", "export", str(taught), "--out", str(damaged)]) == 0
    damaged.write_bytes(damaged.read_bytes()[:-100])
    empty = tmp_path / "empty"
    empty.mkdir()
    MemoryFile(empty / MEMORY_FILE).close()
    for words, says in (
        (["list", str(tmp_path / "nowhere")], "give a run folder or a file of 'mdb ltm export'"),
        (["list", str(tmp_path)], "no memory.sqlite"),
        (["show", str(taught), "object/77"], "no model 'object/77'"),
        (["list", str(damaged)], "is not a file of 'mdb ltm export'"),
        (["list", __file__], "is not a file of 'mdb ltm export'"),
        (["export", str(empty), "--out", str(tmp_path / "x")], "nothing to export"),
        (["import", str(taught), str(empty)], "is not a run folder ('mdb prepare --run"),
    ):
        assert main(["ltm", *words]) == 2, words
        assert says in capsys.readouterr().err


def test_the_usefulness_is_kept_and_the_touch_is_not(taught: Path, other: Path) -> None:
    with MemoryFile(taught / MEMORY_FILE) as file:
        model = file.long_term("object")[0]
    used = msgspec.structs.replace(model, uses=3, touched=99)
    path = other / "used.ltm"
    source = other / "source"
    source.mkdir()
    with MemoryFile(source / MEMORY_FILE) as file:
        file.keep_long_term([used])
    assert ltm.export(source, (), path) == 1
    assert ltm.bring(path, (), other) == 1
    assert (stored(other)[0].uses, stored(other)[0].touched) == (3, 0)
