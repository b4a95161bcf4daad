"""Each service, replayed alone against a recorded run, says what it said; what says something else is found.

The golden logs are small runs in the repository. When one of them differs and the change is wanted, record them
again: `python -m tests.replay.record`.
"""

from collections.abc import Callable
from fnmatch import fnmatchcase
from pathlib import Path

import msgspec
import numpy as np
import pytest

from mdb_deploy.cli.main import main
from mdb_deploy.experiments import experiment_path
from mdb_protocol import keys, messages
from mdb_protocol.bus import read
from mdb_protocol.errors import MdbError
from mdb_protocol.memory_bus import MemoryBus
from mdb_protocol.messages import Message
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_services.recorder import Recorded, Recorder, read_log
from mdb_services.shell.service import Service
from mdb_sim.runs import replay as module
from mdb_sim.runs.compare import within
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment
from mdb_sim.runs.replay import Role, Run, raw_of, replay, roles
from tests.integration.brain import SHORT
from tests.integration.test_resume import IMPATIENT, Mortal
from tests.replay.record import GOLDEN, PROCESSOR_FILE, RUNS, processor

TOLERANCE = 1e-5
"""numpy and BLAS add floats in another order on another processor: 1e-6 was seen."""
ALIKE = 3
"""Values that evolvers have in common at least, on another processor."""
LARGEST_BYTES = 150_000

GOLDEN_RUNS = {name: Run.read(GOLDEN / name) for name in RUNS}
ALL = [(golden, role) for golden, run in GOLDEN_RUNS.items() for role in roles(run.experiment)]


@pytest.mark.parametrize(("golden", "role"), ALL)
def test_a_service_alone_says_what_it_said(golden: str, role: str) -> None:
    outcome = replay(GOLDEN_RUNS[golden], role, within(TOLERANCE))
    if role.startswith("evolver/") and outcome.difference and made_elsewhere(golden):
        check_kinship(GOLDEN_RUNS[golden], role)
        return
    assert outcome.difference is None, "if this is wanted: python -m tests.replay.record"
    assert min(outcome.heard, outcome.compared) > 0


def made_elsewhere(golden: str) -> bool:
    return (GOLDEN / golden / PROCESSOR_FILE).read_text().strip() != processor()


def check_kinship(run: Run, role: str) -> None:
    """The kernels add floats in vectors as wide as the processor's (see `kernel`).

    Where two genomes are nearly as good, another one is taken on another processor, and the population goes its own
    way from there: it keeps pace, begins alike and is as good.
    """
    both: list[tuple[messages.CurrentModel, messages.CurrentModel]] = []

    def keep(recorded: Message, replayed: Message) -> None:
        assert isinstance(recorded, messages.CurrentModel)
        assert isinstance(replayed, messages.CurrentModel)
        both.append((recorded, replayed))

    assert replay(run, role, keep).difference is None
    assert all((a.version, a.generation) == (b.version, b.generation) for a, b in both)
    assert [within(TOLERANCE)(*pair) for pair in both[:ALIKE]] == [None] * ALIKE
    recorded, replayed = (np.mean([pair[i].error for pair in both]) for i in (0, 1))
    assert recorded / 2 < replayed < recorded * 2


def test_golden_logs_are_small_and_show_what_they_are_for() -> None:
    assert max((GOLDEN / name / "run.mcap").stat().st_size for name in RUNS) < LARGEST_BYTES
    late = [recorded.message for recorded in GOLDEN_RUNS["late"].log]
    kinds = {message.kind for message in late if isinstance(message, messages.ContextEvent)}
    assert kinds == {"changed", "known", "stored", "recalled"}
    judged = [message.iteration for message in late if isinstance(message, messages.PairStored) and message.judged]
    assert judged != sorted(judged), "late feedback overtook some that came at once"


def test_every_key_that_is_repeatable_has_one_service_that_writes_it() -> None:
    run = GOLDEN_RUNS["sound"]
    found = roles(run.experiment)
    for row in keys.KEYS:
        if row.repeatable:
            written = [role for role, service in found.items() if any(row_of(key) is row for key in service.writes)]
            assert len({role.partition("/")[0] for role in written}) == 1, row.path
    for recorded in run.log:
        assert sum(role.wrote(recorded.key) for role in found.values()) == 1, recorded.key


def row_of(pattern: str) -> keys.Key:
    brain = pattern.split("/")[1]
    return next(row for row in keys.KEYS if fnmatchcase(pattern, row.at(brain)))


def differing(run: Run, tolerance: float = 0.0) -> dict[str, str]:
    """The services of a run that say something else, and what."""
    outcomes = [replay(run, role, within(tolerance)) for role in roles(run.experiment)]
    return {outcome.role: outcome.difference for outcome in outcomes if outcome.difference}


# ---- what is found ----


def tampered(run: Run, path: str, number: int, **fields: object) -> Run:
    """The run with other fields in the message `number` (from 0) of a key's row."""
    places = [place for place, recorded in enumerate(run.log) if recorded.row.path == path]
    log, place = list(run.log), places[number]
    log[place] = log[place]._replace(message=msgspec.structs.replace(log[place].message, **fields))
    return run._replace(log=log)


def test_what_was_changed_in_a_log_is_named() -> None:
    run = tampered(GOLDEN_RUNS["paper"], "pair", 7, action={"turn": 77.0}, choice=6, feedback=None)
    found = replay(run, "optimizer", within(TOLERANCE)).difference
    assert found is not None
    assert found.startswith("pair, value 8 (iteration 7): action.turn is 77.0 in the log, ")
    assert found.endswith(" in the replay")
    heard = replay(run, "memory", within(TOLERANCE)).difference
    assert heard is not None, "the store heard something else, and says something else"
    assert "(iteration 7): judged is True in the log, False in the replay" in heard or "change, value 8" in heard


def test_a_message_that_is_not_in_the_log_is_missed() -> None:
    run = GOLDEN_RUNS["paper"]
    places = [place for place, recorded in enumerate(run.log) if recorded.row is keys.ACTION]
    without = run._replace(log=[recorded for place, recorded in enumerate(run.log) if place != places[5]])
    found = differing(without, TOLERANCE)
    assert found["optimizer"] == "action, value 6 (iteration 6): iteration is 6 in the log, 5 in the replay"
    assert {role for role in found if not role.startswith("evolver/")} == {"optimizer", "robot"}


@pytest.mark.parametrize(
    ("setting", "differ"),
    [
        ("experiment.seed=2", {"evolver/communication", "evolver/induced", "optimizer", "robot", "teacher"}),
        ("optimizer.random_iterations=0", {"optimizer"}),
        ("model.communication.evolution.generations=1", {"evolver/communication"}),
        ("model.object.capacity=5", {"memory", "evolver/object"}),
        ("teacher.feedback=binary", {"teacher"}),
    ],
)
def test_a_service_that_works_differently_is_found_and_no_other(setting: str, differ: set[str]) -> None:
    golden = GOLDEN_RUNS["paper"]
    run = golden._replace(experiment=Experiment.read(GOLDEN / "paper" / EXPERIMENT_FILE, [setting]))
    found = set(differing(run, TOLERANCE))
    assert found - {f"evolver/{model.name}" for model in run.experiment.brain.model} == {
        role for role in differ if not role.startswith("evolver/")
    }
    assert {role for role in differ if role.startswith("evolver/")} <= found


def test_a_service_that_never_rests_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def restless(experiment: Experiment) -> dict[str, Role]:
        def build(bus: MemoryBus, folder: Path) -> Service:
            service = found["robot"].build(bus, folder)
            service.step = lambda: True  # type: ignore[method-assign]
            return service

        found = roles(experiment)
        return found | {"robot": found["robot"]._replace(build=build)}

    monkeypatch.setattr(module, "roles", restless)
    with pytest.raises(MdbError, match="robot/body does not come to rest"):
        replay(GOLDEN_RUNS["paper"], "robot")


# ---- which logs ----


@pytest.mark.parametrize("share", [0.0, 0.01, 0.37, 0.8])
def test_a_log_that_breaks_off_is_replayed_as_far_as_it_goes(share: float) -> None:
    run = GOLDEN_RUNS["sound"]
    run = run._replace(log=run.log[: round(share * len(run.log))])
    found = differing(run, TOLERANCE)
    assert [role for role in found if not (role.startswith("evolver/") and made_elsewhere("sound"))] == []


def test_a_run_in_which_services_died_is_replayed_as_if_they_had_lived(tmp_path: Path) -> None:
    settings = [*SHORT, *IMPATIENT, "experiment.iterations=40", "experiment.pace=lockstep"]
    experiment, rng = Experiment.read(experiment_path("paper"), settings), np.random.default_rng(5)
    brain = Mortal(experiment, tmp_path / "run")
    recorder = Recorder(MemoryBus(brain._fabric, brain._name), tmp_path / "run")
    killed = 0

    def between() -> None:
        nonlocal killed
        recorder.step()
        for name in brain.services:
            if rng.random() < 0.03:
                brain.kill(name)
                killed += 1

    brain.finish(between)
    while recorder.step():
        pass
    recorder.close()
    assert killed > 10
    run = Run(experiment, list(read_log(tmp_path / "run")))
    assert differing(run) == {}


@pytest.mark.parametrize(
    ("answer", "asked"), [(messages.PairStored, messages.Pair), (messages.Perception, messages.Action)]
)
def test_answers_that_the_recorder_heard_too_early_come_when_they_are_due(
    answer: type[Message], asked: type[Message]
) -> None:
    run = GOLDEN_RUNS["late"]
    log, moved = list(run.log), 0
    for place, recorded in enumerate(run.log):
        if isinstance(recorded.message, answer):
            earlier = max(place - 8, 0)
            moved += any(isinstance(r.message, asked) for r in log[earlier:place])
            log.insert(earlier, log.pop(place))
    assert moved > 50
    assert replay(run._replace(log=log), "optimizer", within(TOLERANCE)).difference is None


def test_a_run_that_began_with_models_of_another_is_replayed_from_there(tmp_path: Path) -> None:
    committees = [f"model.{name}.members=2" for name in ("object", "induced")]
    settings = [word for setting in (*SHORT, *committees) for word in ("--set", setting)]
    words = ["up", "paper", "--inline", "--no-plot", "--iterations", "30", "--runs", str(tmp_path), *settings]
    source = tmp_path / "source"
    run_experiment(Experiment.read(GOLDEN / "late" / EXPERIMENT_FILE, ["model.object.hidden=[30]"]), source)
    assert main([*words, "--set", "model.communication.hidden=[16]", "--long-term", str(source)]) == 0
    (folder,) = tmp_path.glob("paper-*")
    assert main(["replay", str(folder)]) == 0


@pytest.fixture(scope="module")
def concurrent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("concurrent") / "run"
    run_experiment(Experiment.read(experiment_path("paper"), [*SHORT, "experiment.iterations=30"]), folder)
    return folder


def test_of_a_concurrent_log_only_that_is_replayed_what_it_says(
    concurrent: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(concurrent)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1].startswith("not replayed: memory, optimizer (concurrent pace: ")
    assert [line.split()[0] for line in lines[:-1]] == [
        *(f"evolver/{name}" for name in ("communication", "object", "induced")), "robot", "teacher",
    ]  # fmt: skip
    for role in ("memory", "optimizer"):
        assert main(["replay", str(concurrent), role]) == 2
        assert f"what had come to {role} when it went on is not in the log" in capsys.readouterr().err


def losing(log: list[Recorded], *lost: Callable[[Recorded], bool]) -> list[Recorded]:
    return [recorded for recorded in log if not any(is_lost(recorded) for is_lost in lost)]


def test_latest_values_that_a_concurrent_log_has_lost_are_no_difference(concurrent: Path) -> None:
    run = Run.read(concurrent)

    def lost(row: keys.Key, iteration: int) -> Callable[[Recorded], bool]:
        return lambda recorded: recorded.row is row and recorded.message.iteration == iteration  # type: ignore[attr-defined]

    log = losing(run.log, lost(keys.ACTION, 5), lost(keys.SCENE, 9), lost(keys.PERCEPTION, 12), lost(keys.SCENE, 20))
    run = run._replace(log=log)
    robot, teacher = replay(run, "robot"), replay(run, "teacher")
    assert (robot.difference, robot.unmatched, robot.heard) == (None, 3, 30)
    assert teacher.difference is None
    assert teacher.unmatched >= 2, "it said something at the scenes that are lost"


def test_an_evolver_that_learnt_several_versions_at_once_is_replayed(concurrent: Path) -> None:
    run, name = Run.read(concurrent), "evolver/object"
    role = roles(run.experiment)[name]
    changes = [recorded for recorded in run.log if recorded.key.endswith("object/change")]
    with module.alone(run, role) as (service, bus, said):
        module.drive(service)
        for number, change in enumerate(changes):
            bus.feed(raw_of(change))
            if number % 4 == 3:
                module.drive(service)
        row = keys.CURRENT_MODEL
        models = [Recorded(row, raw.key, read(row, bus.brain, raw), 0.0) for raw in said()]
    batches = len(changes) // 4
    assert len(models) == batches > 5
    outcome = replay(run._replace(log=[*changes, *models]), name)
    assert (outcome.difference, outcome.compared) == (None, batches)


# ---- mdb replay ----


def test_mdb_replay_prints_a_line_for_each_service_and_its_status_says_whether_all_are_equal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tolerance = ["--tolerance", str(TOLERANCE)]
    assert main(["replay", str(GOLDEN / "sound"), "ear", "teacher", "optimizer", *tolerance]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["optimizer", "teacher", "ear"]
    assert all(line.endswith(" equal") for line in lines)
    changed = tmp_path / "changed"
    changed.mkdir()
    (changed / "run.mcap").write_bytes((GOLDEN / "sound" / "run.mcap").read_bytes())
    Experiment.read(GOLDEN / "sound" / EXPERIMENT_FILE, ["teacher.sound.instrument=piano"]).write(
        changed / EXPERIMENT_FILE
    )
    assert main(["replay", str(changed), "ear", "teacher", *tolerance]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert "DIFFERS: teacher/one/audio, value 1 (iteration 0): samples[" in lines[0]
    assert lines[1].endswith(" equal")


def test_evolver_stands_for_all_evolvers_and_what_is_not_there_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    main(["replay", str(GOLDEN / "sound"), "evolver"])
    assert len(capsys.readouterr().out.splitlines()) == 3
    assert main(["replay", str(GOLDEN / "paper"), "ear"]) == 2
    assert "no service 'ear' to be replayed; this run has memory, evolver/communication" in capsys.readouterr().err
    assert main(["replay", str(GOLDEN)]) == 2
    with pytest.raises(MdbError, match="no service 'nobody'"):
        replay(GOLDEN_RUNS["paper"], "nobody")
