"""What a story gives to whom, when, and at what cost."""

import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from mdb_deploy.experiments import experiment_path
from mdb_deploy.web.telling.kept.rows import AT_ONCE, MOST_ROWS, Rows
from mdb_deploy.web.telling.plan import Plan
from mdb_deploy.web.telling.story import LARGE_S, MOST_ALIVE, MOST_TOLD, WAITS_S, Story
from mdb_protocol import keys
from mdb_protocol import messages as m
from mdb_services.mechanism.actions.foresight import Known
from mdb_sim.runs import measures
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.record import read_record
from tests.web.telling.told import checked, experiment_of, log_of, story_of

PAPER = ("robot.body=kinematic",)
AT = {"x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0, "object_x_m": 0.0, "object_y_m": 1.0}


class Clock:
    """Seconds that are told by the test."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def paper(*overrides: str) -> Experiment:
    return Experiment.read(experiment_path("paper"), [*PAPER, *overrides])


def report_of(iteration: int, **fields: Any) -> m.IterationReport:
    plain: dict[str, Any] = {
        "mode": "taught", "action": {"turn": 0.0}, "choice": 0, "explored": False, "predicted": None, "note": None,
        "feedback": None, "event": "none", "prequential": {}, "versions": {},
    }  # fmt: skip
    return m.IterationReport(iteration=iteration, **(plain | fields))


def scene_of(iteration: int, turned_deg: float) -> m.Scene:
    turned = AT | {"heading_rad": math.radians(turned_deg)}
    return m.Scene(
        iteration=iteration, episode=0, successes=0, event="none", action={"turn": turned_deg}, before=AT,
        reached=turned, now=turned,
    )  # fmt: skip


def test_rows_are_those_of_the_run_log(pioneer: Path) -> None:
    """Compared with what figures and tables are made of."""
    record, rows = read_record(pioneer), checked(story_of(pioneer).rows(0))
    assert rows["from"] == 0
    assert rows["iteration"] == list(range(80))
    assert rows["mode"] == record.mode.tolist()
    assert rows["explored"] == record.explored.astype(int).tolist()
    assert [-1 if note is None else note for note in rows["note"]] == record.note.tolist()
    assert [-1 if choice is None else choice for choice in rows["choice"]] == record.choice.tolist()
    assert as_doubles(rows["feedback"]) == pytest.approx(record.feedback, abs=1e-4, nan_ok=True)
    assert as_doubles(rows["obeyed"]) == pytest.approx(measures.obeyed(record), nan_ok=True)
    assert rows["success"] == np.diff(record.successes).tolist()
    for name, errors in record.prequential.items():
        assert as_doubles(rows["errors"][name]) == pytest.approx(errors, abs=1e-5, nan_ok=True)


def as_doubles(values: list[float | None]) -> np.ndarray:
    return np.array([math.nan if value is None else value for value in values])


def test_each_reader_gets_what_is_new_for_it(pioneer: Path) -> None:
    story, log = Story(experiment_of(pioneer), clock=None), log_of(pioneer)
    early: dict[str, int] = {}
    late: dict[str, int] = {}
    for each in log[: len(log) // 2]:
        story.take(each.row, each.message)
    first = checked(story.parts(early))
    assert {"scene", "thought", "beliefs", "models", "memory", "rows", "phase", "teachers"} <= set(first)
    assert story.parts(early) == {}
    for each in log[len(log) // 2 :]:
        story.take(each.row, each.message)
    new, whole = checked(story.parts(early)), checked(story.parts(late))
    assert new["rows"]["from"] == len(first["rows"]["iteration"])
    assert [*first["rows"]["iteration"], *new["rows"]["iteration"]] == whole["rows"]["iteration"] == [*range(80)]
    assert new["scene"] == whole["scene"]
    assert new["finished"] is whole["finished"] is True
    assert story.rows_count == 80
    assert story.parts(late) == {}


def test_taking_costs_little(pioneer: Path) -> None:
    story, log = Story(experiment_of(pioneer), clock=None), log_of(pioneer)
    began_s = time.process_time()
    for each in log:
        story.take(each.row, each.message)
    assert (time.process_time() - began_s) / len(log) < 50e-6


def test_feedback_that_came_late_changes_its_row() -> None:
    story, seen = Story(paper(), clock=None), dict[str, int]()
    for iteration in range(5):
        story.take(keys.ITERATION, report_of(iteration, note=2, teacher="one"))
    assert story.parts(seen)["rows"]["feedback"] == [None] * 5
    pair = m.Pair(
        iteration=3, before={}, note=2, action={"turn": 0.0}, choice=0, after={}, feedback=0.5, versions={},
        teacher="one",
    )  # fmt: skip
    story.take(keys.PAIR, structs.replace(pair, feedback=None))
    assert story.parts(seen) == {}
    story.take(keys.PAIR, pair)
    story.take(keys.PAIR, structs.replace(pair, feedback=0.9))
    assert story.parts(seen)["rows"] == story.rows(3) | {"from": 3}
    assert story.rows(3)["feedback"] == [0.5, None]
    assert story.parts(seen) == {}


def test_a_person_is_obeyed_by_what_his_lesson_says() -> None:
    """Also when his scene comes after the report; what he does not mean cannot be told."""
    story = Story(paper(), clock=None)
    commands = list(story.plan.policy.commands) if story.plan.policy is not None else []
    story.take(keys.LESSON, m.Lesson(teacher="ann", iteration=0, commands=commands, notes=[6, 5, 4, 3, 2, 1, 0]))
    left_90 = 0  # the note of the last command
    story.take(keys.SCENE, scene_of(1, 90.0))
    story.take(keys.ITERATION, report_of(0, note=left_90, teacher="ann"))
    story.take(keys.SCENE, scene_of(2, -90.0))
    story.take(keys.ITERATION, report_of(1, note=left_90, teacher="ann"))
    story.take(keys.ITERATION, report_of(2, note=left_90, teacher="ann"))
    story.take(keys.ITERATION, report_of(3, note=left_90, teacher="ben"))
    assert story.rows(0)["obeyed"] == [1, 0, None, None]
    story.take(keys.SCENE, scene_of(4, 90.0))
    assert story.rows(0)["obeyed"] == [1, 0, None, None]
    story.take(keys.ITERATION, report_of(4, note=left_90, teacher="ann"))
    story.take(keys.SCENE, scene_of(5, 90.0))
    assert story.rows(0)["obeyed"] == [1, 0, None, None, 1]
    assert story.part("teachers") == [
        {"name": "ann", "obeyed": False, "notes": [6, 5, 4, 3, 2, 1, 0], "person": True}
    ]
    story.take(keys.LESSON, m.Lesson(teacher="ann", iteration=5, commands=[], notes=[], over=True))
    assert story.part("teachers") == []
    assert len(story.part("lessons")) == 2


def test_who_is_there_and_who_is_obeyed() -> None:
    story = Story(paper(), clock=None)
    story.take(keys.PHASE, m.Phase(iteration=0, name="first teacher", teacher="one"))
    story.take(keys.COMMAND, m.Command(teacher="ben", iteration=0, note=3))
    language = story.plan.languages["one"]
    meant = m.Intention(
        before={}, note=3, teacher="ben", holder="ben", mode="taught", explored=False, predicted=None, versions={}
    )
    story.take(keys.ACTION, m.Action(iteration=0, action={"turn": 0.0}, choice=0, valid_for_s=1.0, intention=meant))
    one = {"name": "one", "obeyed": False, "notes": list(language.notes), "person": False}
    ben = {"name": "ben", "obeyed": True, "notes": None, "person": True}
    assert story.part("teachers") == [one, ben]
    story.alive(["teacher/script", "optimizer/action"])
    assert story.part("teachers") == [one]
    story.take(keys.CONTROL, m.Control(iteration=0, script=False))
    assert story.part("teachers") == []


def test_that_the_brain_waits_is_said_after_a_while() -> None:
    clock, seen = Clock(), dict[str, int]()
    story = Story(paper(), clock)
    perception = m.Perception(iteration=0, outcome={}, reading={"distance": 1.0})
    story.take(keys.PHASE, m.Phase(iteration=0, name="first teacher", teacher="one"))
    story.take(keys.PERCEPTION, perception)
    assert "thought" not in story.parts(seen)
    clock.now_s += WAITS_S
    story.take(keys.PERCEPTION, structs.replace(perception, stamp=3.0))  # a robot that waits shows itself again
    told = story.parts(seen)["thought"]
    assert (told["badge"], told["badge_words"]) == ("waits", "waits for one to play")
    assert story.parts(seen) == {}
    story.take(keys.CONTROL, m.Control(iteration=0, paused=True))
    clock.now_s += WAITS_S
    told = story.parts(seen)
    assert told["control"]["paused"] is True
    assert told["thought"]["badge_words"] == "is paused"
    story.take(keys.CONTROL, m.Control(iteration=0))
    meant = m.Intention(
        before={}, note=3, teacher="one", holder="one", mode="random", explored=True, predicted=None, versions={}
    )
    story.take(keys.ACTION, m.Action(iteration=0, action={"turn": 0.0}, choice=0, valid_for_s=1.0, intention=meant))
    assert story.parts(seen)["thought"]["badge"] == "explores"
    story.take(keys.PERCEPTION, structs.replace(perception, iteration=1))
    clock.now_s += WAITS_S
    told = story.parts(seen)["thought"]
    assert (told["badge"], told["badge_words"]) == ("waits", "waits for one to judge")
    assert len(told["actions"]) == 7  # those of the last choice stay
    story.take(keys.FINISHED, m.Finished(iterations=1))
    clock.now_s += WAITS_S
    assert story.parts(seen)["thought"]["badge"] == "explores"


def test_large_parts_are_not_renewed_each_time(pioneer: Path) -> None:
    clock, seen = Clock(), dict[str, int]()
    story = Story(experiment_of(pioneer), clock)
    changes = [e for e in log_of(pioneer) if isinstance(e.message, m.MemoryChange) and e.message.model == "object"]
    story.take(changes[0].row, changes[0].message)
    assert story.parts(seen)["memory"]["object"]["version"] == 1
    for change in changes[1:]:
        story.take(change.row, change.message)
    clock.now_s += LARGE_S / 2
    assert "memory" not in story.parts(seen)
    clock.now_s += LARGE_S
    assert story.parts(seen)["memory"]["object"]["version"] == len(changes)
    assert story.parts(seen) == {}


def test_a_story_that_begins_late_asks_for_what_it_missed(pioneer: Path) -> None:
    story = Story(experiment_of(pioneer), clock=None)
    changes = [
        e.message for e in log_of(pioneer) if isinstance(e.message, m.MemoryChange) and e.message.model == "object"
    ]
    assert story.missing_memories == ()
    story.take(keys.MEMORY_CHANGE, changes[10])
    assert story.missing_memories == ("object",)
    whole = m.MemorySnapshot(
        model="object", version=11, slots=np.arange(3), pairs=np.arange(3), inputs=changes[10].inputs[[0, 0, 0]],
        targets=changes[10].targets[[0, 0, 0]],
    )  # fmt: skip
    story.take(keys.MEMORY_SNAPSHOT, whole)
    assert story.missing_memories == ()
    assert story.part("memory/object")["used"] == 3


def test_what_is_not_of_this_experiment_is_passed_over() -> None:
    story = Story(paper(), clock=None)
    layers, rows = [3, 2, 1], np.zeros((1, 3), np.float32)
    one = np.array([0])
    strange: list[m.Message] = [
        m.CurrentModel(
            model=name, version=1, generation=1, layers=layers, weights=np.zeros(11, np.float32), error=0.0
        )
        for name in ("communication", "unknown")
    ]
    strange += [
        m.MemoryChange(
            model=name, version=1, slots=slot, pairs=one, inputs=rows, targets=rows[:, :1], freed=one[:0],
            evicted=one[:0],
        )
        for name, slot in (("communication", one), ("communication", np.array([9999])), ("unknown", one))
    ]  # fmt: skip
    strange.append(m.PairStored(iteration=3, versions={}))
    for message in strange:
        story.take("somewhere", message)
    assert story.parts({}) == {}


def test_rows_are_bounded() -> None:
    rows = Rows(Plan(paper()))
    for iteration in range(MOST_ROWS + AT_ONCE + 1):
        rows.add(report_of(iteration), None)
    assert rows.count == MOST_ROWS + AT_ONCE + 1
    told = rows.since(0, 10)
    assert (told["from"], told["iteration"][0]) == (AT_ONCE, AT_ONCE)
    assert rows.since(rows.count - 1)["iteration"] == [MOST_ROWS + AT_ONCE]

    def known(name: str, version: int) -> Known | None:
        del name, version
        return None

    gone = m.Pair(iteration=3, before={}, note=2, action={}, after={}, feedback=0.5, versions={})
    assert not rows.judge(gone, known)
    assert not rows.add(report_of(3), None)


def test_a_policy_that_fails_keeps_nothing_else_from_being_told(monkeypatch: pytest.MonkeyPatch) -> None:
    story = Story(paper(), clock=None)

    def fails(*_: object) -> float:
        raise ZeroDivisionError

    monkeypatch.setattr(type(story.plan.policy), "judge", fails)
    story.take(keys.PHASE, m.Phase(iteration=0, name="first teacher", teacher="one"))
    story.take(keys.SCENE, scene_of(1, 90.0))
    story.take(keys.ITERATION, report_of(0, note=3, teacher="one"))
    assert story.rows(0)["obeyed"] == [None]


def test_a_finished_run_that_is_gone_on_with_is_not_finished() -> None:
    story = Story(paper(), clock=None)
    story.take(keys.FINISHED, m.Finished(iterations=3))
    story.take(keys.ITERATION, report_of(2))
    assert story.part("finished"), "its last report may come after"
    story.take(keys.ITERATION, report_of(3))
    assert not story.part("finished")


def test_who_is_alive_and_what_is_taught_is_bounded() -> None:
    story = Story(paper(), clock=None)
    story.alive(f"teacher/t{number}" for number in range(10 * MOST_ALIVE))
    assert len(story.part("alive")) == MOST_ALIVE
    for number in range(3 * MOST_TOLD):
        lesson = m.Lesson(teacher=f"t{number % 50}", iteration=number, commands=[], notes=[])
        story.take(keys.LESSON, lesson)
    told = story.part("lessons")
    assert len(told) == MOST_TOLD
    assert told[-1]["iteration"] == 3 * MOST_TOLD - 1, "the newest ones"
