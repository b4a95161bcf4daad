"""The scripted teacher as a service: it commands each scene in its phase's language and judges the action."""

import math
from typing import Any

import msgspec
import pytest

from mdb_protocol import keys, messages
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_sim.body import NOTHING, Numbers
from mdb_sim.teaching.policies.pioneer import Reach
from mdb_sim.teaching.schedule import TeacherSection, schedule_of
from mdb_sim.teaching.service import ScriptedTeacher

BRAIN = "test"
PHASES = [
    {"start": 0, "name": "first", "teacher": "one", "language": "paper"},
    {"start": 2, "name": "alone"},
    {"start": 4, "name": "second", "teacher": "two", "language": "notes:6,5,4,3,2,1,0"},
]
AHEAD, LEFT = (1.0, 0.0), (0.0, 1.0)
NONE, LARGE_LEFT = 0, 6


def place(where: tuple[float, float], turned_deg: float = 0.0) -> Numbers:
    """A robot in the middle that has turned so far, and an object."""
    robot = {"x_m": 0.0, "y_m": 0.0, "heading_rad": math.radians(turned_deg)}
    return robot | {"object_x_m": where[0], "object_y_m": where[1]}


def scene(
    iteration: int, now: tuple[float, float] = AHEAD, *, turned_deg: float = 0.0, **fields: Any
) -> messages.Scene:
    """After a turn at a place where the object was ahead, unless `before` says another."""
    reached = place(AHEAD, turned_deg)
    done = {"action": {"turn": turned_deg}, "before": place(AHEAD)} if iteration else {"action": None, "before": None}
    plain = {"episode": 0, "successes": 0, "event": NOTHING, "reached": reached, "now": place(now)}
    return messages.Scene(iteration=iteration, **(plain | done | fields))


class Rig:
    def __init__(self, phases: list[dict[str, Any]] | None = None, **settings: Any) -> None:
        self.fabric = Fabric()
        self.world = MemoryBus(self.fabric, BRAIN)
        self.heard = {row.path: self.world.subscriber(row) for row in (keys.COMMAND, keys.FEEDBACK, keys.PHASE)}
        self.robot = self.world.publisher(keys.SCENE)
        section = msgspec.convert({"phase": phases or PHASES} | settings, TeacherSection)
        self.schedule = schedule_of(section, 1)
        self.teacher = self.start()

    def start(self) -> ScriptedTeacher:
        self.teacher = ScriptedTeacher(MemoryBus(self.fabric, BRAIN), self.schedule)
        return self.teacher

    def show(self, one: messages.Scene) -> None:
        self.robot.put(one)
        assert self.teacher.step() is True

    def control(self, **fields: Any) -> None:
        self.world.publisher(keys.CONTROL).put(messages.Control(iteration=0, **fields))

    def said(self, row: keys.Key) -> list[Any]:
        return list(iter(self.heard[row.path].take, None))


def test_the_first_scene_is_commanded_and_not_judged() -> None:
    rig = Rig()
    assert rig.teacher.step() is False
    rig.show(scene(0, LEFT))
    assert rig.said(keys.COMMAND) == [messages.Command(teacher="one", iteration=0, note=LARGE_LEFT)]
    assert rig.said(keys.FEEDBACK) == []
    assert rig.said(keys.PHASE) == [messages.Phase(iteration=0, name="first", teacher="one")]


def test_the_action_is_judged_where_it_was_begun() -> None:
    rig = Rig()
    rig.show(scene(1, LEFT, turned_deg=90.0, before=place(LEFT)))
    rig.show(scene(2, LEFT, before=place(LEFT)))
    feedback = rig.said(keys.FEEDBACK)
    assert [(f.teacher, f.iteration, f.value) for f in feedback] == [("one", 0, 1.0), ("one", 1, -1.0)]
    assert rig.teacher.values() == {"iteration": 2.0, "rewards": 2.0, "silenced": 0.0}


def test_phases_change_teacher_and_language_and_the_last_action_is_still_judged_by_its_teacher() -> None:
    rig = Rig()
    for iteration in range(6):
        rig.show(scene(iteration))
    assert [(c.teacher, c.iteration, c.note) for c in rig.said(keys.COMMAND)] == [
        ("one", 0, 0), ("one", 1, 0), ("script", 2, None), ("one", 2, None), ("script", 3, None), ("two", 4, 6),
        ("two", 5, 6),
    ]  # fmt: skip
    assert [(f.teacher, f.iteration) for f in rig.said(keys.FEEDBACK)] == [("one", 0), ("one", 1), ("two", 4)]
    assert [(p.iteration, p.name, p.teacher) for p in rig.said(keys.PHASE)] == [
        (0, "first", "one"), (2, "alone", None), (4, "second", "two"),
    ]  # fmt: skip


def test_a_restarted_teacher_goes_on_from_the_last_scene() -> None:
    rig = Rig()
    rig.show(scene(4))
    rig.show(scene(5, LEFT))
    expected = {row: rig.said(row)[-1] for row in (keys.COMMAND, keys.FEEDBACK)}
    rig.said(keys.PHASE)
    rig.teacher.bus.close()
    rig.start()
    assert rig.teacher.step() is True, "the last scene is there for late joiners"
    assert {row: rig.said(row)[-1] for row in expected} == expected
    assert [p.iteration for p in rig.said(keys.PHASE)] == [4], "the phase's own beginning"


def test_the_motion_is_judged_whatever_the_action_says() -> None:
    rig = Rig()
    rig.show(scene(1, turned_deg=90.0, before=place(LEFT), action={"turn": -90.0}))
    rig.show(scene(2, turned_deg=-90.0, before=place(LEFT), action={"steer": 90.0}))
    assert [f.value for f in rig.said(keys.FEEDBACK)] == [1.0, -1.0]


def test_a_scene_that_lacks_what_is_to_be_judged_is_counted_and_the_next_command_given() -> None:
    rig = Rig()
    rig.show(scene(1, reached={"x_m": 0.0}))
    assert rig.said(keys.FEEDBACK) == []
    assert rig.teacher.bus.refusals.counts[keys.SCENE.path] == 1
    assert [c.iteration for c in rig.said(keys.COMMAND)] == [1]


def test_of_a_scene_of_another_body_the_teacher_is_silent_and_it_is_counted() -> None:
    rig = Rig()
    rig.show(msgspec.structs.replace(scene(0), reached={"angle": 0.0}, now={"angle": 0.0}))
    assert [(c.iteration, c.note) for c in rig.said(keys.COMMAND)] == [(0, None)]
    assert rig.teacher.bus.refusals.counts[keys.SCENE.path] == 1


def test_a_teacher_who_wants_nothing_is_silent_and_judges_nothing() -> None:
    named = {"policy": "mdb_sim.teaching.policies.plain:Named", "options": {"commands": ["come", "go"]}}
    rig = Rig([{"start": 0, "name": "p", "teacher": "one", "language": "ordered"}], **named)
    rig.show(scene(0))
    rig.show(scene(1))
    assert [(c.iteration, c.note) for c in rig.said(keys.COMMAND)] == [(0, None), (1, None)]
    assert [f.value for f in rig.said(keys.FEEDBACK) if f.value is not None] == []
    assert rig.teacher.values()["rewards"] == 0.0


class Blind(Reach):
    """Wants what another does, and cannot tell what was done."""

    def judge(self, *_: Any) -> None:  # type: ignore[override]
        return None


@pytest.mark.parametrize(("named", "iterations"), [(True, [0, 1]), (False, [None, None])])
def test_who_cannot_tell_what_was_done_says_not_now_in_his_own_way(named: bool, iterations: list[int | None]) -> None:
    rig = Rig(only(named=named), policy="tests.sim.test_teacher_service:Blind")
    for iteration in range(3):
        rig.show(scene(iteration))
    assert [(f.teacher, f.iteration, f.value) for f in rig.said(keys.FEEDBACK)] == [
        ("one", iteration, None) for iteration in iterations
    ]
    assert [c.note for c in rig.said(keys.COMMAND)] == [0, 0, 0]


@pytest.mark.parametrize("name", ["script", "one"])
def test_a_teacher_may_have_any_name(name: str) -> None:
    rig = Rig([{"start": 0, "name": "p", "teacher": name, "language": "paper"}, {"start": 1, "name": "alone"}])
    rig.show(scene(0))
    rig.show(scene(1))
    assert [(c.teacher, c.note) for c in rig.said(keys.COMMAND)] == [(name, 0), ("script", None), (name, None)]


def only(**mistakes: Any) -> list[dict[str, Any]]:
    return [{"start": 0, "name": "p", "teacher": "one", "language": "paper", **mistakes}]


def test_a_teacher_mistakes_notes_as_often_as_the_file_says() -> None:
    rig = Rig(only(wrong_notes=0.25))
    for iteration in range(400):
        rig.show(scene(iteration))
    notes = [c.note for c in rig.said(keys.COMMAND)]
    wrong = [note for note in notes if note != 0]
    assert len(wrong) / len(notes) == pytest.approx(0.25, abs=0.06)
    assert set(wrong) == {1, 2, 3, 4, 5, 6}
    assert all(f.value == 1.0 for f in rig.said(keys.FEEDBACK)), "he means what he meant, and judges by it"
    again = Rig(only(wrong_notes=0.25))
    again.show(scene(399))
    assert again.said(keys.COMMAND)[0].note == notes[399], "the same whenever the teacher was started"


def test_a_teacher_mistakes_punishment_for_reward_as_often_as_the_file_says() -> None:
    rig = Rig(only(wrong_feedback=0.25))
    for iteration in range(401):
        rig.show(scene(iteration))
    values = [f.value for f in rig.said(keys.FEEDBACK)]
    assert values.count(-1.0) + values.count(1.0) == 400
    assert values.count(-1.0) / 400 == pytest.approx(0.25, abs=0.06)


def test_a_late_teacher_says_not_now_and_judges_so_many_iterations_later() -> None:
    rig = Rig([*only(delay=2), {"start": 3, "name": "alone"}])
    for iteration in range(6):
        rig.show(scene(iteration))
    assert [(f.iteration, f.value) for f in rig.said(keys.FEEDBACK)] == [
        (0, None), (1, None), (0, 1.0), (2, None), (1, 1.0), (2, 1.0),
    ]  # fmt: skip
    assert rig.teacher.values()["rewards"] == 3


def given(rig: Rig, scenes: int) -> list[tuple[int | None, float | None]]:
    for iteration in range(scenes):
        rig.show(scene(iteration))
    return [(f.iteration, f.value) for f in rig.said(keys.FEEDBACK)]


def test_a_teacher_who_judges_some_actions_says_not_now_to_the_others() -> None:
    said = given(Rig(only(judged=0.3)), 401)
    assert [iteration for iteration, _ in said] == list(range(400))
    assert {value for _, value in said} == {1.0, None}
    assert sum(value is not None for _, value in said) / 400 == pytest.approx(0.3, abs=0.07)
    late = given(Rig(only(judged=0.3, delay=2)), 401)
    paid = [one for one in late if one[1] is not None]
    assert paid == [one for one in said if one[1] is not None][: len(paid)]


def test_praise_that_fades_is_worth_half_after_each_half_life_and_punishment_stays() -> None:
    phases = [{"start": 0, "name": "alone"}, only(praise_half_life=10)[0] | {"start": 5}]
    said = dict(given(Rig(phases), 27))
    assert (said[5], said[15], said[25]) == (1.0, 0.5, 0.25)
    rig = Rig(phases)
    rig.show(scene(26, turned_deg=90.0))
    assert rig.said(keys.FEEDBACK)[0].value == -1.0


def test_a_teacher_who_compares_says_less_of_what_is_as_good_as_usual() -> None:
    rig = Rig(only(relative=2))
    assert [value for _, value in given(rig, 5)] == [1.0, 0.5, 0.25, 0.125]
    rig.show(scene(5, turned_deg=90.0))
    rig.show(scene(6))
    assert [f.value for f in rig.said(keys.FEEDBACK)] == [-1.0, 1.0], "cut to the range"


@pytest.mark.parametrize(("says", "expected"), [("praise", [1.0, None]), ("punishment", [None, -1.0])])
def test_a_teacher_may_say_nothing_instead_of_punishing_or_praising(says: str, expected: list[float | None]) -> None:
    rig = Rig(only(says=says))
    rig.show(scene(1))
    rig.show(scene(2, turned_deg=90.0))
    assert [f.value for f in rig.said(keys.FEEDBACK)] == expected


def test_delays_spread_over_a_range_and_nothing_is_lost() -> None:
    rig, due = Rig(only(delay=2, delay_spread=1)), {}
    for iteration in range(303):
        rig.show(scene(iteration))
        due |= {f.iteration: iteration - 1 - f.iteration for f in rig.said(keys.FEEDBACK) if f.value is not None}
    lags = [due[iteration] for iteration in range(299)]
    assert [lags.count(lag) / 299 for lag in (1, 2, 3)] == pytest.approx([1 / 3] * 3, abs=0.09)
    assert set(lags) == {1, 2, 3}


def test_a_teacher_who_names_no_iteration_says_only_what_and_never_the_same_twice() -> None:
    rig = Rig(only(named=False, delay=1))
    assert given(rig, 4) == [(None, None), (None, 1.0), (None, None), (None, 1.0), (None, None)]
    rig.start()
    rig.show(scene(4))
    assert [(f.iteration, f.value) for f in rig.said(keys.FEEDBACK)] == [(None, None)]
    at_once = Rig(only(named=False))
    assert given(at_once, 3) == [(None, 1.0), (None, 1.0)]
    at_once.start()
    assert at_once.teacher.step() is True, "the last scene is there for late joiners"
    assert [(f.iteration, f.value) for f in at_once.said(keys.FEEDBACK)] == [(None, None)]


def test_all_habits_combine() -> None:
    habits = {"judged": 0.5, "praise_half_life": 50, "relative": 5, "says": "praise", "delay": 3, "delay_spread": 2}
    rig = Rig(only(**habits, named=False, wrong_notes=0.1, wrong_feedback=0.1))
    said = given(rig, 300)
    values = [value for _, value in said if value is not None]
    assert {iteration for iteration, _ in said} == {None}
    assert 0 < len(values) < 200
    assert all(0.0 <= value <= 1.0 for value in values)


def test_a_teacher_started_again_at_a_change_of_phase_lets_the_one_before_leave() -> None:
    """Else the brain would wait for him who holds the word and says nothing any more."""
    rig = Rig()
    rig.show(scene(1))
    rig.said(keys.COMMAND)
    rig.start()
    rig.show(scene(2))
    assert [(c.teacher, c.note) for c in rig.said(keys.COMMAND)] == [("script", None), ("one", None)]
    rig.start()
    rig.show(scene(3))
    assert [(c.teacher, c.note) for c in rig.said(keys.COMMAND)] == [("script", None)]
    assert [phase.name for phase in rig.said(keys.PHASE)] == ["first", "alone", "alone"], "a late joiner asks for it"


@pytest.mark.parametrize("habits", [{}, {"named": False}, {"relative": 2}])
def test_a_scene_that_is_shown_again_is_judged_once(habits: dict[str, Any]) -> None:
    once, again = Rig(only(**habits)), Rig(only(**habits))
    for iteration in range(4):
        once.show(scene(iteration))
        for _ in range(3):
            again.show(scene(iteration))
    assert again.said(keys.FEEDBACK) == once.said(keys.FEEDBACK)


def test_a_teacher_whom_the_operator_silences_lets_another_be_obeyed_and_judges_nothing_until_he_may_again() -> None:
    rig = Rig([{"start": 0, "name": "p", "teacher": "one", "language": "paper"}])
    for iteration in range(2):
        rig.show(scene(iteration))
    rig.control(script=False)
    for iteration in range(2, 5):
        rig.show(scene(iteration))
    rig.control()
    for iteration in range(5, 7):
        rig.show(scene(iteration))
    assert [(c.teacher, c.iteration, c.note) for c in rig.said(keys.COMMAND)] == [
        ("one", 0, 0), ("one", 1, 0), ("script", 2, None), ("one", 2, None), ("script", 3, None), ("script", 4, None),
        ("one", 5, 0), ("one", 6, 0),
    ]  # fmt: skip
    assert [(f.iteration, f.value) for f in rig.said(keys.FEEDBACK)] == [(0, 1.0), (1, None), (5, 1.0)]
    assert [(p.iteration, p.name, p.teacher) for p in rig.said(keys.PHASE)] == [
        (0, "p", "one"), (2, "p", None), (5, "p", "one"),
    ]  # fmt: skip


def test_phases_go_on_while_the_teacher_is_silenced() -> None:
    rig = Rig()
    rig.control(script=False)
    for iteration in range(6):
        rig.show(scene(iteration))
    assert {c.note for c in rig.said(keys.COMMAND)} == {None}
    rig.control()
    rig.show(scene(6))
    assert [(p.iteration, p.name, p.teacher) for p in rig.said(keys.PHASE)] == [
        (0, "first", None), (2, "alone", None), (4, "second", None), (6, "second", "two"),
    ]  # fmt: skip
    assert [(c.teacher, c.iteration, c.note) for c in rig.said(keys.COMMAND)] == [("two", 6, 6)]


def test_a_phase_in_which_nobody_teaches_is_not_cut_by_who_is_silenced() -> None:
    rig = Rig()
    for iteration in range(4):
        rig.control(script=iteration != 3)
        rig.show(scene(iteration))
    assert [(p.iteration, p.name) for p in rig.said(keys.PHASE)] == [(0, "first"), (2, "alone")]


def test_feedback_that_a_silenced_teacher_owes_is_not_given() -> None:
    rig = Rig(only(delay=2))
    for iteration in range(3):
        rig.show(scene(iteration))
    rig.said(keys.FEEDBACK)
    rig.control(script=False)
    for iteration in range(3, 8):
        rig.show(scene(iteration))
    assert [(f.iteration, f.value) for f in rig.said(keys.FEEDBACK)] == [(2, None)]


def test_a_scene_that_is_answered_already_is_not_taken_back() -> None:
    rig = Rig()
    rig.show(scene(1))
    rig.said(keys.COMMAND)
    rig.control(script=False)
    rig.show(scene(1))
    assert [(c.teacher, c.iteration, c.note) for c in rig.said(keys.COMMAND)] == [("one", 1, 0)], "as it was said"
    rig.show(scene(2))
    assert [(c.teacher, c.note) for c in rig.said(keys.COMMAND)] == [("script", None), ("one", None)]


def test_a_phase_that_is_ended_early_is_followed_by_the_next_one() -> None:
    rig = Rig()
    rig.show(scene(0))
    rig.control(ended=[0])
    rig.show(scene(1))
    rig.show(scene(2))
    rig.control(ended=[0, 2])
    rig.show(scene(3))
    rig.show(scene(4))
    assert [(p.iteration, p.name, p.teacher) for p in rig.said(keys.PHASE)] == [
        (0, "first", "one"), (1, "alone", None), (3, "second", "two"),
    ]  # fmt: skip
    assert [(c.teacher, c.note) for c in rig.said(keys.COMMAND)] == [
        ("one", 0), ("script", None), ("one", None), ("script", None), ("two", 6), ("two", 6),
    ]  # fmt: skip
    assert [(f.teacher, f.iteration) for f in rig.said(keys.FEEDBACK)] == [("one", 0), ("two", 3)]


def test_a_teacher_that_is_started_again_knows_which_phases_were_ended() -> None:
    rig = Rig()
    rig.show(scene(0))
    rig.control(ended=[0, 1])
    rig.show(scene(1))
    rig.said(keys.PHASE)
    operator = MemoryBus(rig.fabric, BRAIN)
    operator.publisher(keys.CONTROL).put(messages.Control(iteration=1, ended=[0, 1]))
    rig.teacher.bus.close()
    rig.start()
    rig.show(scene(2))
    assert [(p.iteration, p.name) for p in rig.said(keys.PHASE)] == [(2, "second")]
