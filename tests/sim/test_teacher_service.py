"""The scripted teacher as a service: it commands each scene in its phase's language and judges the action."""

from typing import Any

import msgspec
import pytest

from mdb_protocol import keys, messages
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_sim.robot import RobotConfig
from mdb_sim.schedule import TeacherSection, schedule_of
from mdb_sim.teacher_service import ScriptedTeacher

BRAIN = "test"
PHASES = [
    {"start": 0, "name": "first", "teacher": "one", "language": "paper"},
    {"start": 2, "name": "alone"},
    {"start": 4, "name": "second", "teacher": "two", "language": "notes:6,5,4,3,2,1,0"},
]
AHEAD, LEFT = (1.0, 0.0), (0.0, 1.0)
NONE, LARGE_LEFT = 0, 6


def placement(where: tuple[float, float]) -> messages.Placement:
    return messages.Placement(x_m=0.0, y_m=0.0, heading_rad=0.0, object_x_m=where[0], object_y_m=where[1])


def scene(iteration: int, now: tuple[float, float] = AHEAD, **fields: Any) -> messages.Scene:
    done = {"action": NONE, "before": placement(AHEAD)} if iteration else {"action": None, "before": None}
    plain = {"episode": 0, "captures": 0, "event": "none", "reached": placement(now), "now": placement(now)}
    return messages.Scene(iteration=iteration, **(plain | done | fields))


class Rig:
    def __init__(self, phases: list[dict[str, Any]] | None = None) -> None:
        self.fabric = Fabric()
        self.world = MemoryBus(self.fabric, BRAIN)
        self.heard = {row.path: self.world.subscriber(row) for row in (keys.COMMAND, keys.FEEDBACK, keys.PHASE)}
        self.robot = self.world.publisher(keys.SCENE)
        section = msgspec.convert({"phase": phases or PHASES}, TeacherSection)
        self.schedule = schedule_of(section, 1, RobotConfig())
        self.teacher = self.start()

    def start(self) -> ScriptedTeacher:
        self.teacher = ScriptedTeacher(MemoryBus(self.fabric, BRAIN), self.schedule)
        return self.teacher

    def show(self, one: messages.Scene) -> None:
        self.robot.put(one)
        assert self.teacher.step() is True

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
    rig.show(scene(1, LEFT, action=LARGE_LEFT, before=placement(LEFT)))
    rig.show(scene(2, LEFT, action=NONE, before=placement(LEFT)))
    feedback = rig.said(keys.FEEDBACK)
    assert [(f.teacher, f.iteration, f.value) for f in feedback] == [("one", 0, 1.0), ("one", 1, -1.0)]
    assert rig.teacher.values() == {"iteration": 2.0, "rewards": 2.0}


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


def test_an_action_that_no_teacher_knows_is_counted_and_the_next_command_given() -> None:
    rig = Rig()
    rig.show(scene(1, action=7, before=placement(AHEAD)))
    assert rig.said(keys.FEEDBACK) == []
    assert rig.teacher.bus.refusals.counts[keys.SCENE.path] == 1
    assert [c.iteration for c in rig.said(keys.COMMAND)] == [1]


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
