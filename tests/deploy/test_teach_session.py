"""A person's session, driven by hand over the in-memory bus: what it says, refuses to say, and measures."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from mdb_deploy.experiments import experiment_path
from mdb_deploy.teach.record import CAPTURES_IN, ERROR_MEAN, OBEDIENCE_OF
from mdb_deploy.teach.screen import panel
from mdb_deploy.teach.session import WITHOUT_EFFECT, TeachingSession
from mdb_deploy.teach.view import View, meaning, swapped
from mdb_protocol import keys, messages
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.hearing.ear import Ear
from mdb_services.shell.service import announce
from mdb_sim.body import RobotConfig
from mdb_sim.runs.experiment import Experiment
from mdb_sim.teaching.schedule import TeacherSection, schedule_of
from mdb_sim.teaching.service import ScriptedTeacher
from mdb_sim.teaching.sound import Player, SoundSection
from mdb_sim.teaching.teacher import make_language

BRAIN, ANN = "test", "ann"
TURNS = RobotConfig().turns_deg
ORDERED, REVERSED = make_language("ordered", TURNS), make_language("reversed", TURNS)
AHEAD, LEFT, BEHIND = (1.0, 0.0), (0.0, 1.0), (-1.0, 0.1)
NONE, LARGE_RIGHT, LARGE_LEFT = 0, 3, 6
HEARING = Experiment.read(experiment_path("paper"), ["ear.detector=template"]).brain


def placement(where: tuple[float, float], x_m: float = 0.0) -> messages.Placement:
    return messages.Placement(x_m=x_m, y_m=0.0, heading_rad=0.0, object_x_m=where[0], object_y_m=where[1])


def scene(iteration: int, now: tuple[float, float] = AHEAD, action: int = NONE, **fields: Any) -> messages.Scene:
    done = {"action": action, "before": placement(AHEAD)} if iteration else {"action": None, "before": None}
    at = placement(now, 0.1 * iteration)
    plain: dict[str, Any] = {"episode": 0, "captures": 0, "event": "none", "reached": at, "now": at}
    return messages.Scene(iteration=iteration, **(plain | done | fields))


class Rig:
    """A session, and robot, optimizer and other teachers that a test plays by hand."""

    def __init__(self, **options: Any) -> None:
        self.fabric = Fabric()
        self.world = MemoryBus(self.fabric, BRAIN)
        self.commands, self.feedback = self.world.subscriber(keys.COMMAND), self.world.subscriber(keys.FEEDBACK)
        self.brain = MemoryBus(self.fabric, BRAIN)
        self.brain.token("optimizer", "action")
        self.now = 100.0
        self.bus = MemoryBus(self.fabric, BRAIN)
        self.session = TeachingSession(
            self.bus, ANN, options.pop("language", ORDERED), clock=lambda: self.now, **options
        )
        announce(self.session)

    def step(self) -> None:
        while self.session.step():
            pass

    def show(self, one: messages.Scene) -> None:
        self.world.publisher(keys.SCENE).put(one)
        self.step()

    def report(self, iteration: int, **fields: Any) -> None:
        plain: dict[str, Any] = {
            "mode": "taught", "action": NONE, "explored": False, "predicted": None, "note": None, "feedback": None,
            "event": "none", "prequential": {}, "versions": {}, "teacher": ANN, "holder": ANN,
        }  # fmt: skip
        self.world.publisher(keys.ITERATION).put(messages.IterationReport(iteration=iteration, **(plain | fields)))
        self.step()

    def command(self, note: int | None) -> None:
        self.session.command(note)
        self.step()

    def judge(self, value: float, iteration: int) -> None:
        self.session.feedback(value, iteration)
        self.step()

    def said(self) -> list[tuple[int, int | None]]:
        return [(command.iteration, command.note) for command in iter(self.commands.take, None)]

    def judged(self) -> list[tuple[int, float | None]]:
        return [(feedback.iteration, feedback.value) for feedback in iter(self.feedback.take, None)]

    def lesson(self, note: int, action: int, iteration: int) -> None:
        """The teacher says a note at a scene, the robot does the action."""
        self.show(scene(iteration))
        self.command(note)
        self.show(scene(iteration + 1, action=action))


def test_a_note_is_meant_for_the_newest_scene_and_each_scene_has_one() -> None:
    rig = Rig()
    rig.command(3)
    assert rig.said() == []
    assert "no scene yet" in str(rig.session.view.notice)
    rig.show(scene(0))
    rig.show(scene(1))
    rig.command(3)
    rig.command(4)
    assert rig.said() == [(1, 3)]
    assert "iteration 1 has its command" in str(rig.session.view.notice)
    rig.show(scene(1))
    rig.show(scene(2))
    rig.command(None)
    assert rig.said() == [(2, None)]


def test_orders_from_another_thread_are_carried_out_by_the_next_step_only() -> None:
    rig = Rig()
    rig.show(scene(0))
    rig.session.command(2)
    assert rig.said() == []
    assert rig.bus.wait(0.0), "an order wakes the session"
    rig.step()
    assert rig.said() == [(0, 2)]


def test_feedback_names_the_iteration_of_its_action_and_is_given_once() -> None:
    rig = Rig()
    rig.judge(1.0, -1)
    assert rig.judged() == []
    assert "no action yet" in str(rig.session.view.notice)
    rig.lesson(3, NONE, 0)
    rig.judge(0.5, 0)
    rig.judge(-1.0, 0)
    assert rig.judged() == [(0, 0.5)]
    assert "judged already" in str(rig.session.view.notice)
    assert rig.session.view.exchanges[0].feedback == 0.5


def test_the_next_note_tells_the_brain_not_to_wait_and_the_feedback_may_come_later() -> None:
    rig = Rig()
    rig.lesson(3, NONE, 0)
    rig.command(3)
    assert rig.judged() == [(0, None)]
    rig.judge(-1.0, 0)
    assert rig.judged() == [(0, -1.0)]
    rig.show(scene(2))
    rig.judge(1.0, 1)
    rig.command(3)
    assert rig.judged() == [(1, 1.0)], "what is judged is not deferred"
    rig.show(scene(3))
    rig.command(None)
    rig.show(scene(4))
    rig.command(3)
    assert rig.judged() == [(2, None)], "nobody waits for a judgement on what was done in silence"


def test_in_a_pause_the_teacher_is_there_and_silent() -> None:
    rig = Rig()
    rig.show(scene(0))
    rig.session.pause()
    rig.step()
    rig.show(scene(1))
    rig.show(scene(2))
    assert rig.said() == [(0, None), (1, None), (2, None)]
    assert rig.session.view.paused
    assert f"teacher/{ANN}" in rig.world.alive()
    rig.session.pause()
    rig.step()
    rig.show(scene(3))
    assert rig.said() == []
    rig.command(5)
    assert rig.said() == [(3, 5)]


def test_no_screen_sees_a_scene_before_what_was_said_to_it_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[View] = []

    def published(session: TeachingSession, name: str, value: object) -> None:
        if name == "view":
            assert isinstance(value, View)
            seen.append(value)
        object.__setattr__(session, name, value)

    monkeypatch.setattr(TeachingSession, "__setattr__", published)
    rig = Rig()
    rig.show(scene(0))
    rig.session.pause()
    rig.step()
    seen.clear()
    rig.show(scene(1))
    assert seen
    for view in seen:
        spoken = {exchange.iteration for exchange in view.exchanges if exchange.spoke}
        assert view.scene is not None
        assert view.scene.iteration in spoken


def test_presence_ends_with_the_bus() -> None:
    rig = Rig()
    assert f"teacher/{ANN}" in rig.world.alive()
    rig.session.close()
    rig.bus.close()
    assert f"teacher/{ANN}" not in rig.world.alive()


def test_obedience_is_by_what_the_note_meant_when_it_was_said() -> None:
    rig = Rig()
    note = ORDERED.note(LARGE_LEFT)
    rig.lesson(note, LARGE_LEFT, 0)
    assert (rig.session.view.obedience, rig.session.view.judged) == (1.0, 1)
    rig.session.speak(REVERSED)
    rig.lesson(note, LARGE_LEFT, 1)
    assert (rig.session.view.obedience, rig.session.view.judged) == (0.5, 2)
    assert [e.command for e in rig.session.view.exchanges[:2]] == [LARGE_RIGHT, LARGE_LEFT]
    rig.lesson(REVERSED.note(NONE), NONE, 2)
    assert rig.session.view.obedience == pytest.approx(2 / 3)
    for i in range(3, 3 + OBEDIENCE_OF):
        rig.lesson(REVERSED.note(LARGE_LEFT), LARGE_LEFT, i)
    assert (rig.session.view.obedience, rig.session.view.judged) == (1.0, OBEDIENCE_OF)


def test_the_language_stays_the_teachers_own() -> None:
    rig = Rig()
    tap = rig.world.tap()
    rig.session.speak(REVERSED)
    rig.step()
    assert tap.take() is None
    assert rig.session.view.language == REVERSED


def test_swapping_two_notes_changes_two_meanings() -> None:
    language = swapped(ORDERED, LARGE_LEFT, ORDERED.note(NONE))
    assert language.command(ORDERED.note(NONE)) == LARGE_LEFT
    assert language.command(ORDERED.note(LARGE_LEFT)) == NONE
    assert swapped(language, NONE, ORDERED.note(NONE)).notes == ORDERED.notes
    assert make_language(language.name, TURNS) == language


def test_actions_are_told_by_side_and_angle() -> None:
    assert [meaning(turn) for turn in TURNS] == [
        "ahead", "right 20", "right 45", "right 90", "left 20", "left 45", "left 90",
    ]  # fmt: skip


def test_commands_without_effect_are_told_with_the_one_who_holds_the_word() -> None:
    rig = Rig()
    for i in range(WITHOUT_EFFECT):
        assert rig.session.view.trouble is None
        rig.lesson(3, NONE, i)
        rig.report(i, teacher="bob", holder="bob")
    assert "bob holds the word" in str(rig.session.view.trouble)
    assert rig.session.view.exchanges[0].heard is False
    words = panel.panel(rig.session.view, ANN, TURNS).plain
    assert f"{WITHOUT_EFFECT - 1} v ahead    ahead    not heard" in words
    assert "word     bob" in words
    rig.lesson(3, NONE, WITHOUT_EFFECT)
    rig.report(WITHOUT_EFFECT)
    assert rig.session.view.trouble is None


def test_commands_that_nobody_hears_are_told_as_such() -> None:
    rig = Rig()
    for i in range(WITHOUT_EFFECT):
        rig.lesson(3, NONE, i)
        rig.report(i, teacher=None, holder=None)
    assert "your commands do not arrive" in str(rig.session.view.trouble)
    for i in range(WITHOUT_EFFECT, 9):
        rig.show(scene(i))
        rig.report(i, teacher=None, holder=None)
    rig.lesson(3, NONE, 9)
    rig.report(9)
    assert rig.session.view.trouble is None


def test_commands_that_come_after_the_report_are_told_to_be_too_late() -> None:
    rig = Rig()
    for i in range(WITHOUT_EFFECT):
        rig.show(scene(i))
        rig.report(i, teacher=None, holder=None)
        rig.command(3)
    assert "your notes come too late" in str(rig.session.view.trouble)


def test_who_is_there_is_told() -> None:
    rig = Rig()
    bob = MemoryBus(rig.fabric, BRAIN)
    bob.token("teacher", "bob")
    rig.step()
    assert (rig.session.view.others, rig.session.view.trouble) == (("bob",), None)
    bob.close()
    rig.brain.close()
    rig.step()
    assert rig.session.view.others == ()
    assert "no brain is at work" in str(rig.session.view.trouble)
    rig.world.publisher(keys.FINISHED).put(messages.Finished(iterations=3))
    rig.step()
    assert (rig.session.view.finished, rig.session.view.trouble) == (True, None)


def test_a_router_that_is_gone_is_told() -> None:
    rig = Rig()
    session = TeachingSession(MemoryBus(rig.fabric, BRAIN), "eve", ORDERED)
    session.step()
    assert "the router is gone" in str(session.view.trouble), "without router nobody sees a token, and this has none"
    announce(session)
    session.step()
    assert session.view.trouble is None


def test_captures_are_counted_and_their_rate_is_of_the_last_hundred_iterations() -> None:
    rig = Rig()
    rig.show(scene(0))
    assert rig.session.view.captures_per_100 is None
    for i in range(1, 301):
        rig.show(scene(i, captures=i // 4 if i <= 200 else 50))
    assert rig.session.view.captures == 50
    assert rig.session.view.captures_per_100 == 0.0
    rig.show(scene(400, captures=60))
    assert rig.session.view.captures_per_100 == pytest.approx(CAPTURES_IN * 10 / 100)


def test_errors_are_the_mean_of_the_last_reports() -> None:
    rig = Rig()
    for i in range(2 * ERROR_MEAN):
        rig.report(i, prequential={"communication": 1.0 if i < ERROR_MEAN else 0.25})
    rig.report(2 * ERROR_MEAN, prequential={"object": 0.5})
    assert rig.session.view.errors == {"communication": 0.25, "object": 0.5}


def test_latency_is_from_the_command_to_its_action_and_to_its_report() -> None:
    rig = Rig()
    rig.show(scene(0))
    rig.command(3)
    rig.now += 0.2
    rig.show(scene(1))
    rig.now += 0.3
    rig.report(0)
    rig.world.publisher(keys.TIMING).put(messages.Timing(iteration=0, perception_to_action_s=0.05, cycle_s=0.5))
    rig.step()
    latency = rig.session.view.latency
    assert latency.to_action_s == pytest.approx(0.2)
    assert latency.to_report_s == pytest.approx(0.5)
    assert latency.perception_to_action_s == 0.05


def test_the_trail_is_of_this_episode_and_a_scene_shown_again_adds_nothing() -> None:
    rig = Rig()
    for i in (0, 1, 1, 2):
        rig.show(scene(i))
    assert [x for x, _ in rig.session.view.trail] == pytest.approx([0.0, 0.1, 0.2])
    rig.show(scene(3, event="capture", episode=1))
    assert [x for x, _ in rig.session.view.trail] == pytest.approx([0.3])


def test_another_run_begins_anew() -> None:
    rig = Rig()
    rig.lesson(3, NONE, 7)
    rig.show(scene(0))
    assert (rig.session.view.exchanges, rig.session.view.judged) == ((), 0)
    rig.command(2)
    assert rig.said() == [(7, 3), (0, 2)]


def test_the_right_command_is_known_from_the_scene() -> None:
    rig = Rig()
    rig.show(scene(0, LEFT))
    assert rig.session.view.wanted == LARGE_LEFT
    rig.show(scene(1, (math.cos(-1.5), math.sin(-1.5))))
    assert rig.session.view.wanted == LARGE_RIGHT


def test_on_its_own_it_teaches_as_the_scripted_teacher_does() -> None:
    rig = Rig(auto=True, language=REVERSED)
    other = MemoryBus(Fabric(), BRAIN)
    commands, feedback = other.subscriber(keys.COMMAND), other.subscriber(keys.FEEDBACK)
    phase = {"start": 0, "name": "all", "teacher": ANN, "language": "reversed"}
    section = msgspec.convert({"phase": [phase]}, TeacherSection)
    script = ScriptedTeacher(MemoryBus(other.fabric, BRAIN), schedule_of(section, 1, RobotConfig()))
    places = (AHEAD, LEFT, BEHIND, AHEAD)
    for i, (now, action) in enumerate(zip(places, (NONE, LARGE_LEFT, NONE, 5), strict=True)):
        before = placement(places[i - 1], 0.1 * (i - 1)) if i else None
        one = scene(i, now, action, before=before)
        rig.show(one)
        other.publisher(keys.SCENE).put(one)
        script.step()
    assert rig.said() == [(c.iteration, c.note) for c in iter(commands.take, None)]
    assert rig.judged() == [(f.iteration, f.value) for f in iter(feedback.take, None)]


def flute() -> Player:
    assert HEARING.ear is not None
    return Player(SoundSection(instrument="flute"), HEARING.ear.notes_hz, seed=0)


def listening(rig: Rig) -> Ear:
    """A real ear, which is there."""
    ear = Ear(MemoryBus(rig.fabric, BRAIN), HEARING)
    announce(ear)
    return ear


def test_without_an_ear_who_plays_is_told() -> None:
    rig = Rig(player=flute())
    rig.step()
    assert "nobody listens to sound" in str(rig.session.view.trouble)
    listening(rig)
    rig.step()
    assert rig.session.view.trouble is None


def test_notes_that_are_played_are_heard_by_the_ear() -> None:
    rig = Rig(player=flute())
    ear, heard = listening(rig), rig.world.subscriber(keys.HEARD)
    for i, note in enumerate((0, 6, 3)):
        rig.show(scene(i))
        rig.command(note)
        while ear.step():
            pass
        assert heard.take() == messages.Command(teacher=ANN, iteration=i, note=note)
        rig.step()
        assert rig.session.view.notice is None
    assert rig.said() == [], "nothing is said by name"
    rig.show(scene(3))
    rig.command(None)
    assert rig.said() == [(3, None)], "silence needs no sound"


def test_a_note_heard_through_the_microphone_is_the_teachers() -> None:
    rig = Rig(listens=True)
    ear = listening(rig)
    rig.session.microphone(np.zeros(800, np.int16), 16_000)
    rig.step()
    assert not ear.step(), "there is no scene that sound could be about"
    rig.show(scene(5))
    sound = np.concatenate([frame.samples for frame in flute().frames(ANN, 0, ORDERED.note(LARGE_LEFT))])
    for piece in np.array_split(np.concatenate([sound, np.zeros(16_000, np.int16)]), 20):
        rig.session.microphone(piece, 16_000)
        rig.step()
        while ear.step():
            pass
    rig.step()
    exchange = rig.session.view.exchanges[0]
    assert (exchange.iteration, exchange.command, exchange.spoke) == (5, LARGE_LEFT, True)
    rig.show(scene(6, action=LARGE_LEFT))
    assert rig.session.view.obedience == 1.0


def test_what_the_ear_took_for_another_note_is_told() -> None:
    rig = Rig(player=flute())
    listening(rig)
    rig.show(scene(0))
    rig.command(2)
    rig.world.publisher(keys.HEARD, teacher=ANN).put(messages.Command(teacher=ANN, iteration=0, note=3))
    rig.step()
    assert "the ear heard note 3 of note 2" in str(rig.session.view.notice)
    assert rig.session.view.exchanges[0].note == 2
