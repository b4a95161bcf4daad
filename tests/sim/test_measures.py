"""Measures against values worked out by hand, from real log files on disk."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from mdb_protocol import keys
from mdb_protocol.errors import MdbError
from mdb_protocol.keys import Key
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_protocol.messages import (
    NOTHING,
    Control,
    CurrentModel,
    IterationReport,
    Lesson,
    Message,
    Pair,
    Phase,
    Scene,
    Timing,
)
from mdb_services.experiment.reading import read_file
from mdb_services.mechanism.networks.network import Network
from mdb_services.recorder import EmptyLogError, Recorder
from mdb_sim.body import Numbers
from mdb_sim.runs import measures
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.record import EXPERIMENT_FILE, RunRecord, read_record
from mdb_sim.studies.rows import rows_of
from mdb_sim.teaching.languages import Language, make_language
from mdb_sim.teaching.policies.pioneer import PAPERS_TURNS_DEG, Reach
from mdb_sim.verdicts.acceptance import acceptance_table

PAPER = Path(__file__).parents[2] / "deploy" / "experiments" / "paper.toml"
TURNS, REACH = PAPERS_TURNS_DEG, Reach()
ONE, TWO = make_language("ordered", REACH.order), make_language("reversed", REACH.order)
PHASE, ITERATIONS, RANDOM = 100, 400, 20
CAPTURE_EVERY = 5
Report = Callable[[int], IterationReport]


def small_experiment(*, scripted: bool = True) -> Experiment:
    """The paper's experiment with phases of 100 iterations, and known languages."""
    content = read_file(PAPER, [f"experiment.iterations={ITERATIONS}", f"optimizer.random_iterations={RANDOM}"])
    for number, phase in enumerate(content["teacher"]["phase"]):
        phase["start"] = number * PHASE
        if "language" in phase:
            phase["language"] = "ordered" if number == 0 else "reversed"
    if not scripted:
        del content["teacher"]
    return Experiment(content, "test")


class Log:
    """A run folder being written: real messages over a bus, through the recorder, onto disk."""

    def __init__(self, run: Path, experiment: Experiment | None = None) -> None:
        run.mkdir(parents=True, exist_ok=True)
        self.run = run
        (experiment or small_experiment()).write(run / EXPERIMENT_FILE)
        fabric = Fabric()
        self._bus = MemoryBus(fabric, "pioneer")
        self._recorder = Recorder(MemoryBus(fabric, "pioneer"), run)

    def put(self, row: Key, message: Message, **parameters: str) -> None:
        self._bus.publisher(row, **parameters).put(message)

    def close(self) -> RunRecord:
        self._recorder.close()
        return read_record(self.run)


def language_at(iteration: int) -> Language | None:
    return (ONE, None, TWO, None)[iteration // PHASE]


def place(step: int, direction_rad: float = 0.4, turned_deg: float = 0.0) -> Numbers:
    """Where a robot is that came straight to an object 1.5 m away, and turned there."""
    x_m, y_m = 0.2 * step * math.cos(direction_rad), 0.2 * step * math.sin(direction_rad)
    heading_rad = direction_rad + math.radians(turned_deg)
    object_m = {"object_x_m": 1.5 * math.cos(direction_rad), "object_y_m": 1.5 * math.sin(direction_rad)}
    return {"x_m": x_m, "y_m": y_m, "heading_rad": heading_rad} | object_m


def choice_at(iteration: int) -> int:
    """Commands go round; obeyed from the middle of a phase on, but for every fourth iteration."""
    command = iteration % len(TURNS)
    obeys = iteration % PHASE >= PHASE // 2 and iteration % 4 != 0
    return command if obeys else (command + 1) % len(TURNS)


def scene(count: int, *, successes: int | None = None) -> Scene:
    """After `count` actions; every fifth ends an episode with a capture."""
    step, episode = (count - 1) % CAPTURE_EVERY, (count - 1) // CAPTURE_EVERY
    captured = step == CAPTURE_EVERY - 1
    direction_rad = 1.1 * episode
    turned_deg = [sum(TURNS[choice_at(i)] for i in range(count - 1 - step, stop)) for stop in (count - 1, count)]
    reached = place(step + 1, direction_rad, turned_deg[1]) if count else place(0)
    return Scene(
        iteration=count,
        episode=max(episode, 0) + captured,
        successes=count // CAPTURE_EVERY if successes is None else successes,
        event="capture" if captured and count else NOTHING,
        action={"turn": TURNS[choice_at(count - 1)]} if count else None,
        before=place(step, direction_rad, turned_deg[0]) if count else None,
        reached=reached,
        now=place(0, direction_rad + 1.1) if captured or not count else reached,
        success=captured and count > 0,
        ended=captured and count > 0,
    )


def graded_feedback(command: int, choice: int) -> float:
    """What a teacher says of a turn that was made as it was meant."""
    said = REACH.expected(command, {"turn": TURNS[choice]})
    assert said is not None
    return said


def report(iteration: int) -> IterationReport:
    """Of an action as in `choice_at`."""
    language, in_phase = language_at(iteration), iteration % PHASE
    command, choice = iteration % len(TURNS), choice_at(iteration)
    version = 0 if iteration == 0 else 1 if iteration < 50 else 2 if iteration < 250 else 3
    foreseen_wrongly = 0.5 if in_phase < 20 else 0.0
    error = foreseen_wrongly if iteration < 2 * PHASE else 0.2
    return IterationReport(
        iteration=iteration,
        mode="taught" if language else "induced",
        action={"turn": TURNS[choice]},
        choice=choice,
        explored=iteration < RANDOM,
        predicted=None,
        note=language.note(command) if language else None,
        feedback=graded_feedback(command, choice) if language else None,
        event="capture" if (iteration + 1) % CAPTURE_EVERY == 0 else NOTHING,
        prequential={"communication": error} if language else {},
        versions={"communication": version} if version else {},
    )


def constant_network(value: float) -> Network:
    return Network([np.zeros((1, 9)), np.array([[0.0, value]])])


def perfect_network(language: Language) -> Network:
    """Foresees every feedback: six steep units count the steps of turn missed, three on each side."""
    meant = [REACH.order[language.command(note)] - 3.0 for note in range(len(TURNS))]
    steep = 20.0
    towards = np.array([*meant, -3.0])
    hidden = [[*(steep * side * towards), -steep * t] for side in (1, -1) for t in (0.5, 1.5, 2.5)]
    return Network([np.array(hidden), np.array([[-1 / 3] * 6 + [1 - 6 / 3]])])


def current_model(version: int, network: Network, error: float) -> CurrentModel:
    layers, weights = network.to_arrays()
    return CurrentModel(
        model="communication",
        version=version,
        generation=version,
        layers=layers,
        weights=weights,
        error=error,
    )


def write_run(
    run: Path,
    iterations: int = ITERATIONS,
    *,
    scenes: Callable[[int], Scene] = scene,
    experiment: Experiment | None = None,
) -> RunRecord:
    """Write a run of the small experiment, or of another, and read it back."""
    log = Log(run, experiment)
    names = ("first teacher", "alone", "second teacher", "alone again")
    log.put(keys.SCENE, scenes(0))
    models = (constant_network(0.0), perfect_network(ONE), perfect_network(TWO))
    for version, (network, error) in enumerate(zip(models, (0.6, 0.01, 0.02), strict=True), start=1):
        log.put(keys.CURRENT_MODEL, current_model(version, network, error), model="communication")
    for i in range(iterations):
        if i % PHASE == 0:
            teacher = ("one", None, "two", None)[i // PHASE]
            log.put(keys.PHASE, Phase(iteration=i, name=names[i // PHASE], teacher=teacher))
        log.put(keys.SCENE, scenes(i + 1))
        log.put(keys.ITERATION, report(i))
        log.put(keys.TIMING, Timing(iteration=i, perception_to_action_s=0.001 * (i + 1), cycle_s=0.5))
    return log.close()


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return write_run(tmp_path_factory.mktemp("runs") / "full")


def test_phases_come_with_their_ends_teachers_and_languages(record: RunRecord) -> None:
    assert [(s.start, s.stop, s.teacher) for s in record.spans] == [
        (0, 100, "one"), (100, 200, None), (200, 300, "two"), (300, 400, None),
    ]  # fmt: skip
    assert [s.language.notes if s.language else None for s in record.spans] == [
        ONE.notes, None, TWO.notes, None,
    ]  # fmt: skip


def test_phases_that_were_ended_early_are_where_they_were(tmp_path: Path) -> None:
    log = Log(tmp_path / "run")
    first, then = Phase(iteration=0, name="first teacher", teacher="one"), Phase(iteration=41, name="alone")
    log.put(keys.CONTROL, Control(iteration=3, paused=True))
    for i in range(60):
        if i == 40:
            log.put(keys.CONTROL, Control(iteration=i, ended=[i]))
        if i in (0, 41):
            log.put(keys.PHASE, first if i == 0 else then)
        log.put(keys.ITERATION, report(i))
    found = log.close()
    assert [(s.start, s.stop, s.name, s.teacher) for s in found.spans] == [
        (0, 41, "first teacher", "one"), (41, 141, "alone", None), (141, 241, "second teacher", "two"),
        (241, 400, "alone again", None),
    ]  # fmt: skip
    assert [s.language.notes if s.language else None for s in found.spans] == [ONE.notes, None, TWO.notes, None]
    assert [control.ended for control in found.controls] == [[], [40]]


def test_a_phase_in_which_the_teacher_was_silenced_for_a_while_keeps_its_language(tmp_path: Path) -> None:
    log = Log(tmp_path / "run")
    for i, teacher in ((0, "one"), (20, None), (50, "one")):
        log.put(keys.PHASE, Phase(iteration=i, name="first teacher", teacher=teacher))
    lesson = Lesson(teacher="anna", iteration=20, commands=["go"], notes=[0])
    log.put(keys.LESSON, lesson, teacher="anna")
    for i in range(60):
        log.put(keys.ITERATION, report(i))
    found = log.close()
    assert [(s.start, s.stop, s.teacher, s.language.notes if s.language else None) for s in found.spans[:3]] == [
        (0, 20, "one", ONE.notes), (20, 50, None, None), (50, 100, "one", ONE.notes),
    ]  # fmt: skip
    assert found.lessons == (lesson,)


def test_obedience_is_the_share_of_commands_obeyed_in_the_last_part_of_a_phase(record: RunRecord) -> None:
    windows = [measures.obedience_window(span) for span in record.taught]
    assert windows == [(60, 100), (260, 300)]
    assert [measures.obedience(record, window) for window in windows] == [0.75, 0.75]
    assert measures.obedience(record, (0, 50)) == 0.0
    assert math.isnan(measures.obedience(record, (100, 200)))


def test_successes_are_counted_by_phase_without_the_random_iterations(record: RunRecord) -> None:
    windows = [measures.success_window(record, span) for span in record.spans]
    assert windows == [(20, 100), (100, 200), (200, 300), (300, 400)]
    assert [measures.successes(record, window) for window in windows] == [16, 20, 20, 20]
    assert record.successes[[0, 4, 5, 400]].tolist() == [0, 0, 1, 80]


def test_feedback_that_came_after_the_report_counts_as_if_it_had_been_in_time(tmp_path: Path) -> None:
    log = Log(tmp_path)
    log.put(keys.CURRENT_MODEL, current_model(1, constant_network(0.25), 0.5), model="communication")
    for i in range(4):
        late = {"feedback": None, "prequential": {"object": 0.125}, "versions": {"communication": 1 if i else 0}}
        log.put(keys.ITERATION, replace(report(i), **(late if i < 3 else {})))
    for i, feedback in ((0, 1.0), (1, None), (1, -0.5), (1, 1.0), (3, -1.0)):
        action = {"turn": TURNS[2]}
        pair = Pair(iteration=i, before={}, note=1, action=action, choice=2, after={}, feedback=feedback, versions={})
        log.put(keys.PAIR, pair)
    record = log.close()
    assert record.feedback.tolist()[:2] == [1.0, -0.5]
    assert math.isnan(record.feedback[2]), "it never came"
    assert record.feedback[3] == report(3).feedback, "it was in time"
    errors = measures.prequential_error(record)
    assert np.isnan(errors[[0, 2]]).all(), "no model, no feedback"
    assert errors[1] == pytest.approx(0.75**2)
    assert errors[3] == report(3).prequential["communication"]
    assert record.prequential["object"][:3].tolist() == [0.125] * 3


def test_running_mean_begins_anew_with_each_teacher(record: RunRecord) -> None:
    means = measures.running_mean(record, measures.prequential_error(record))
    assert means[[0, 19, 39, 99]] == pytest.approx([0.5, 0.5, 0.25, 0.0])
    assert np.isnan(means[100:200]).all()
    assert means[[200, 299]] == pytest.approx([0.2, 0.2])
    assert np.isnan(measures.running_mean(record, measures.prequential_error(record), full=True)[:39]).all()


def test_first_crossing_needs_a_full_mean_and_may_never_come(record: RunRecord) -> None:
    first, second = record.taught
    # Of the last 40 errors 59 - k are still 0.5: the mean is below 0.1 when fewer than 8 are, at the 53rd.
    assert measures.iterations_below(record, first) == 53
    assert measures.iterations_below(record, second) == math.inf


def test_memory_error_is_that_of_the_model_in_use_where_a_command_came(record: RunRecord) -> None:
    errors = measures.memory_error(record)
    assert np.isnan(errors[0])
    assert errors[[1, 49, 50, 99, 249, 250]] == pytest.approx([0.6, 0.6, 0.01, 0.01, 0.01, 0.02])
    assert np.isnan(errors[100:200]).all()


def test_pair_error_judges_the_model_in_use_by_the_language_that_is_present(record: RunRecord) -> None:
    errors = measures.pair_error(record)
    # 7 pairs of feedback 1, 12 of 1/3, 10 of -1/3 and 20 of -1, against a network that always says 0.
    assert errors[5] == pytest.approx((7 + 12 / 9 + 10 / 9 + 20) / 49)
    assert errors[95] == pytest.approx(0.0, abs=1e-6)
    assert errors[200] == pytest.approx(_mistaken())
    assert errors[299] == pytest.approx(0.0, abs=1e-6)
    assert np.flatnonzero(np.isfinite(errors[:100])).tolist() == [*range(5, 100, 5), 99]
    assert np.isnan(errors[100:200]).all()
    assert np.isnan(errors[300:]).all()


def _mistaken() -> float:
    """Error of knowing the first language perfectly while the second is spoken."""
    gaps = [
        graded_feedback(ONE.command(n), a) - graded_feedback(TWO.command(n), a) for n in range(7) for a in range(7)
    ]
    return float(np.mean(np.square(gaps)))


def test_latency_gives_median_tail_and_maximum(record: RunRecord) -> None:
    latency = measures.latency(record)
    assert latency.median_s == pytest.approx(0.2005)
    assert latency.p99_s == pytest.approx(0.39601)
    assert latency.max_s == pytest.approx(0.4)


def test_episodes_hold_the_way_from_placement_to_capture(record: RunRecord) -> None:
    episodes = list(record.episodes())
    assert len(episodes) == 80
    assert {episode.steps for episode in episodes} == {5}
    assert episodes[1].start == 5
    assert (episodes[1].event, episodes[1].success) == ("capture", True)
    assert episodes[1].places[0] == place(0, 1.1)
    assert episodes[1].places[-1] == place(5, 1.1, sum(TURNS[choice_at(i)] for i in range(5, 10)))


def test_a_resent_message_does_not_replace_the_first(tmp_path: Path) -> None:
    log = Log(tmp_path / "run")
    log.put(keys.ITERATION, report(0))
    log.put(keys.ITERATION, _with(report(0), choice=6, event="capture"))
    log.put(keys.SCENE, scene(1))
    found = log.close()
    assert found.choice.tolist() == [report(0).choice]
    assert found.successes.tolist() == [0, 0]


def _with(message: IterationReport, **changes: object) -> IterationReport:
    fields = {name: getattr(message, name) for name in message.__struct_fields__}
    return IterationReport(**(fields | changes))


def test_successes_go_on_when_a_robot_was_restarted_and_counts_from_zero(tmp_path: Path) -> None:
    def restarted(count: int) -> Scene:
        return scene(count, successes=count // 5 if count < 23 else count // 5 - 4)

    found = write_run(tmp_path / "run", 40, scenes=restarted)
    assert found.successes[[20, 22, 25, 40]].tolist() == [4, 4, 5, 8]


def test_successes_while_nobody_recorded_come_from_the_robots_count(tmp_path: Path) -> None:
    log = Log(tmp_path / "run")
    for count in (*range(12), *range(31, 41)):
        log.put(keys.SCENE, scene(count))
        if count < 40:
            log.put(keys.ITERATION, report(count))
    found = log.close()
    assert found.successes[[11, 40]].tolist() == [2, 8]
    assert not found.reported[20]
    assert len(list(found.episodes())) == 3


def test_a_log_cut_short_is_measured_as_far_as_it_goes(tmp_path: Path, record: RunRecord) -> None:
    run = tmp_path / "cut"
    run.mkdir()
    whole = (record.run / "run.mcap").read_bytes()
    (run / "run.mcap").write_bytes(whole[: len(whole) * 6 // 10])
    (run / EXPERIMENT_FILE).write_bytes((record.run / EXPERIMENT_FILE).read_bytes())
    found = read_record(run)
    assert 200 < found.iterations < 300
    assert [(s.start, s.stop) for s in found.spans] == [(0, 100), (100, 200), (200, 300), (300, 400)]
    rows = rows_of(found)
    assert rows[0].iterations_to_error == 53
    assert math.isnan(rows[2].iterations_to_error)
    assert [row.captures for row in rows[:2]] == [16, 20]
    assert [math.isnan(row.captures) for row in rows] == [False, False, True, True]
    assert math.isnan(rows[2].pair_error)
    assert "| – (–) |" in acceptance_table({1: rows})


def test_a_log_without_any_message_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(EmptyLogError, match="no message of brain"):
        Log(tmp_path / "run").close()


def test_a_log_without_any_iteration_has_no_measures(tmp_path: Path) -> None:
    log = Log(tmp_path / "run")
    log.put(keys.PHASE, Phase(iteration=0, name="a person", teacher="anna"))
    for row in rows_of(log.close()):
        values = (row.iterations_to_error, row.pair_error, row.obedience, row.captures, row.ideal_captures)
        assert all(math.isnan(value) for value in values)


def test_without_a_known_language_full_reward_means_obedience(tmp_path: Path) -> None:
    log = Log(tmp_path / "run", small_experiment(scripted=False))
    log.put(keys.PHASE, Phase(iteration=0, name="a person", teacher="anna"))
    for i in range(100):
        log.put(keys.ITERATION, report(i))
    found = log.close()
    assert [(s.name, s.teacher, s.language) for s in found.spans] == [("a person", "anna", None)]
    assert measures.obedience(found, (60, 100)) == 0.75
    assert np.isnan(measures.pair_error(found)).all()


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MdbError, match="experiment file"):
        read_record(tmp_path)
    small_experiment().write(tmp_path / EXPERIMENT_FILE)
    with pytest.raises(MdbError, match="no run log"):
        read_record(tmp_path)


# ---- of other bodies and other teachers ----


def of_another_body(count: int) -> Scene:
    """The same run of a machine of which two other numbers are known."""

    def numbers(place: Numbers | None) -> Numbers | None:
        return None if place is None else {"angle": place["heading_rad"], "height": place["x_m"]}

    shown = scene(count)
    return replace(shown, **{name: numbers(getattr(shown, name)) for name in ("before", "reached", "now")})


def with_another_body() -> Experiment:
    content = small_experiment().content
    return Experiment(content | {"robot": content["robot"] | {"body": "somewhere:Machine"}}, "test")


def test_obedience_is_what_was_done_and_not_what_was_said_to_the_motors(tmp_path: Path) -> None:
    """Motors that turn the other way: only what is symmetric is obeyed."""

    def swapped(count: int) -> Scene:
        shown = scene(count)
        if shown.before is None:
            return shown
        turn_rad = shown.reached["heading_rad"] - shown.before["heading_rad"]
        return replace(shown, reached=shown.reached | {"heading_rad": shown.before["heading_rad"] - turn_rad})

    found = measures.obeyed(write_run(tmp_path / "run", PHASE, scenes=swapped))
    done = [-TURNS[choice_at(i)] for i in range(PHASE)]
    assert found.tolist() == [float(done[i] == TURNS[i % len(TURNS)]) for i in range(PHASE)]
    assert 0.0 < found.mean() < 0.3


def test_a_command_whose_scene_is_not_in_the_log_is_neither_obeyed_nor_not(tmp_path: Path) -> None:
    log = Log(tmp_path / "run")
    for i in range(60):
        log.put(keys.ITERATION, report(i))
        if i % 2:
            log.put(keys.SCENE, scene(i + 1))
    found = measures.obeyed(log.close())
    assert np.isnan(found[0:60:2]).all()
    assert found[51:60:2].tolist() == [1.0] * 5


def test_of_scenes_without_what_the_policy_needs_there_is_no_obedience(tmp_path: Path) -> None:
    record = write_run(tmp_path / "run", 150, scenes=of_another_body, experiment=with_another_body())
    assert np.isnan(measures.obeyed(record)).all()
    assert record.successes[-1] == 30
    assert len(list(record.episodes())) == 30
    rows = rows_of(record)
    assert math.isnan(rows[0].obedience)
    assert rows[0].captures == 16
    assert {path.size for row in rows for path in row.paths} <= {0}


def test_what_ends_an_episode_need_be_no_success(tmp_path: Path) -> None:
    def without(count: int) -> Scene:
        shown = scene(count, successes=0)
        return replace(shown, event="bump" if shown.ended else NOTHING, success=False)

    record = write_run(tmp_path / "run", 100, scenes=without)
    assert record.successes.tolist() == [0] * 101
    episodes = list(record.episodes())
    assert {(episode.event, episode.success, episode.steps) for episode in episodes} == {("bump", False, 5)}
    assert len(episodes) == 20


def test_without_scenes_the_events_of_the_reports_are_counted_by_the_experiments_own_words(tmp_path: Path) -> None:
    for name, words, expected in (("capture", ["capture"], 20), ("none", ["bump"], 0)):
        experiment = Experiment(
            small_experiment().content | {"robot": {"body": "kinematic", "successes": words}}, "t"
        )
        log = Log(tmp_path / name, experiment)
        for i in range(100):
            log.put(keys.ITERATION, report(i))
        assert log.close().successes[-1] == expected


def test_where_nothing_can_be_expected_of_an_action_there_is_no_error_over_all_pairs(tmp_path: Path) -> None:
    content = small_experiment().content
    names = [f"call {number}" for number in range(len(TURNS))]
    named = {"policy": "mdb_sim.teaching.policies.plain:Named", "options": {"commands": names}}
    log = Log(tmp_path / "run", Experiment(content | {"teacher": content["teacher"] | named}, "test"))
    log.put(keys.CURRENT_MODEL, current_model(1, constant_network(0.0), 0.5), model="communication")
    for i in range(PHASE):
        log.put(keys.ITERATION, report(i))
        log.put(keys.SCENE, scene(i + 1))
    record = log.close()
    assert np.isnan(measures.pair_error(record)).all()
    assert np.nanmax(measures.obeyed(record)) == 0.0, "who judges nothing has seen no obedience"
