"""A person's session, driven by hand over the in-memory bus: what it says, refuses to say, and measures."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from mdb_deploy.experiments import experiment_path
from mdb_deploy.teach.presence import WITHOUT_EFFECT
from mdb_deploy.teach.record import ERROR_MEAN, KEPT, OBEDIENCE_OF, SUCCESSES_IN
from mdb_deploy.teach.screen import panel
from mdb_deploy.teach.session import MOST_ORDERS, MOST_SOUND, TeachingSession
from mdb_deploy.teach.turns import AGAIN_S, MOST_S
from mdb_deploy.teach.view import Summary, Turn, View, swapped
from mdb_protocol import keys, messages
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.hearing.ear import Ear
from mdb_services.shell.service import announce
from mdb_sim.runs.experiment import Experiment
from mdb_sim.teaching.languages import make_language
from mdb_sim.teaching.policies.pioneer import Reach
from mdb_sim.teaching.policies.plain import Named
from mdb_sim.teaching.schedule import TeacherSection, schedule_of
from mdb_sim.teaching.service import ScriptedTeacher
from mdb_sim.teaching.sound import Player, SoundSection

BRAIN, ANN = "test", "ann"
REACH = Reach()
ORDERED, REVERSED = make_language("ordered", REACH.order), make_language("reversed", REACH.order)
AHEAD, LEFT, BEHIND = (1.0, 0.0), (0.0, 1.0), (-1.0, 0.1)
NONE, LARGE_RIGHT, LARGE_LEFT = 0, 3, 6
HEARING = Experiment.read(experiment_path("paper"), ["ear.detector=template"]).brain


def placed(where: tuple[float, float], x_m: float = 0.0, turned_deg: float = 0.0) -> dict[str, float]:
    """A scene's numbers; where: the object, as seen from the robot, x to its front and y to its left."""
    turned_rad = math.radians(turned_deg)
    (x, y), cos, sin = where, math.cos(turned_rad), math.sin(turned_rad)
    there = {"object_x_m": x_m + x * cos - y * sin, "object_y_m": x * sin + y * cos}
    return {"x_m": x_m, "y_m": 0.0, "heading_rad": turned_rad, **there}


def scene(iteration: int, now: tuple[float, float] = AHEAD, did: int = NONE, **fields: Any) -> messages.Scene:
    """A scene after the robot did what a command wants."""
    turn_deg = REACH.turns_deg[did]
    done: dict[str, Any] = {"action": None, "before": None}
    if iteration:
        done = {"action": {"turn": turn_deg}, "before": placed(AHEAD, 0.1 * (iteration - 1))}
    at = placed(now, 0.1 * iteration, turn_deg if iteration else 0.0)
    plain: dict[str, Any] = {"episode": 0, "successes": 0, "event": "none", "reached": at, "now": at}
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
            "mode": "taught", "action": {"turn": 0.0}, "choice": NONE, "explored": False, "predicted": None,
            "note": None, "feedback": None, "event": "none", "prequential": {}, "versions": {}, "teacher": ANN,
            "holder": ANN,
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

    def lesson(self, note: int, did: int, iteration: int) -> None:
        """The teacher says a note at a scene, the robot does what a command wants."""
        self.show(scene(iteration))
        self.command(note)
        self.show(scene(iteration + 1, did=did))


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
    """What the notes mean is said for the log alone, on a key that nothing of the brain reads."""
    rig = Rig()
    rig.show(scene(0))
    tap = rig.world.tap()
    while tap.take() is not None:
        pass
    rig.session.speak(REVERSED)
    rig.step()
    assert rig.session.view.language == REVERSED
    rig.show(scene(1))
    said = [keys.find(BRAIN, raw.key) for raw in iter(tap.take, None)]
    assert said == [keys.LESSON, keys.SCENE]


def test_those_who_watch_learn_who_teaches_what_his_notes_mean_and_when_he_left() -> None:
    rig, commands = Rig(), list(REACH.commands)
    lessons = rig.world.subscriber(keys.LESSON)
    rig.session.speak(REVERSED)
    rig.step()
    assert lessons.take() is None, "there is no iteration yet from which on it holds"
    for i in (3, 4):
        rig.show(scene(i))
    rig.session.speak(ORDERED)  # before the note of iteration 4
    rig.step()
    rig.session.command(0)
    rig.session.speak(REVERSED)  # after it
    rig.step()
    rig.show(scene(5))
    rig.session.close()
    assert list(lessons.some()) == [
        messages.Lesson(teacher=ANN, iteration=3, commands=commands, notes=list(REVERSED.notes)),
        messages.Lesson(teacher=ANN, iteration=4, commands=commands, notes=list(ORDERED.notes)),
        messages.Lesson(teacher=ANN, iteration=5, commands=commands, notes=list(REVERSED.notes)),
        messages.Lesson(teacher=ANN, iteration=5, commands=[], notes=[], over=True),
    ]


def test_swapping_two_notes_changes_two_meanings() -> None:
    language = swapped(ORDERED, LARGE_LEFT, ORDERED.note(NONE))
    assert language.command(ORDERED.note(NONE)) == LARGE_LEFT
    assert language.command(ORDERED.note(LARGE_LEFT)) == NONE
    assert swapped(language, NONE, ORDERED.note(NONE)).notes == ORDERED.notes
    assert make_language(language.name, REACH.order) == language


def test_commands_are_told_by_side_and_angle() -> None:
    assert REACH.commands == ("ahead", "right 20", "right 45", "right 90", "left 20", "left 45", "left 90")
    assert Rig().session.policy.commands == REACH.commands, "what can be wanted when nothing is said of it"


def test_commands_without_effect_are_told_with_the_one_who_is_being_obeyed() -> None:
    rig = Rig()
    for i in range(WITHOUT_EFFECT):
        assert rig.session.view.trouble is None
        rig.lesson(3, NONE, i)
        rig.report(i, teacher="bob", holder="bob")
    assert "bob is being obeyed" in str(rig.session.view.trouble)
    assert rig.session.view.exchanges[0].heard is False
    words = panel.panel(rig.session.view, ANN, REACH.commands).plain
    assert f"{WITHOUT_EFFECT - 1} v ahead    ahead    not heard" in words
    assert "teacher   bob" in words
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


def test_successes_are_counted_and_their_rate_is_of_the_last_hundred_iterations() -> None:
    rig = Rig()
    rig.show(scene(0))
    assert rig.session.view.successes_per_100 is None
    for i in range(1, 301):
        rig.show(scene(i, successes=i // 4 if i <= 200 else 50))
    assert rig.session.view.successes == 50
    assert rig.session.view.successes_per_100 == 0.0
    rig.show(scene(400, successes=60))
    assert rig.session.view.successes_per_100 == pytest.approx(SUCCESSES_IN * 10 / 100)
    assert "successes 60, 10.0 in 100" in panel.panel(rig.session.view, ANN, REACH.commands).plain


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


def test_a_scene_shown_again_adds_nothing() -> None:
    rig = Rig(auto=True)
    for i in (0, 1, 1, 2):
        rig.show(scene(i))
    assert [command for command, _ in rig.said()] == [0, 1, 2]
    assert rig.judged() == [(0, 1.0), (1, 1.0)]
    assert rig.session.view.judged == 2


def test_what_the_robot_did_is_told_by_the_command_that_it_is_most_like() -> None:
    rig = Rig()
    rig.lesson(ORDERED.note(LARGE_LEFT), LARGE_RIGHT, 0)
    exchange = rig.session.view.exchanges[0]
    assert (exchange.command, exchange.did, exchange.obeyed) == (LARGE_LEFT, LARGE_RIGHT, False)
    words = panel.panel(rig.session.view, ANN, REACH.commands).plain
    assert "0 m left 90  right 90" in words
    rig.show(scene(1))
    rig.show(scene(2, did=LARGE_LEFT))
    silent = rig.session.view.exchanges[0]
    assert (silent.command, silent.did, silent.obeyed) == (None, LARGE_LEFT, None)


def test_a_turn_between_two_commands_is_most_like_the_nearer_one_and_obeys_neither() -> None:
    rig = Rig()
    rig.show(scene(0))
    rig.command(ORDERED.note(LARGE_LEFT))
    at = placed(AHEAD, 0.1, turned_deg=75.0)
    rig.show(msgspec.structs.replace(scene(1), action={"turn": 75.0}, reached=at, now=at))
    exchange = rig.session.view.exchanges[0]
    assert (exchange.did, exchange.obeyed) == (LARGE_LEFT, False)


def test_what_the_robot_did_is_seen_and_not_read_from_its_action() -> None:
    """A robot whose motors are swapped does not obey, whatever it meant to do."""
    rig = Rig()
    rig.show(scene(0))
    rig.command(ORDERED.note(LARGE_LEFT))
    rig.show(scene(1, did=LARGE_RIGHT, action={"turn": REACH.turns_deg[LARGE_LEFT]}))
    assert (rig.session.view.obedience, rig.session.view.exchanges[0].did) == (0.0, LARGE_RIGHT)


def test_the_picture_is_shown_as_the_robot_sends_it() -> None:
    rig = Rig()
    rig.show(scene(0))
    assert rig.session.view.picture is None
    line = messages.Shape(kind="line", points=[(0.0, 0.0), (1.0, 1.0)], what="trail")
    for i in range(2):
        one = messages.Picture(iteration=i, drawing=messages.Drawing(shapes=[line], box=(0.0, 0.0, 1.0, i + 1.0)))
        rig.world.publisher(keys.PICTURE).put(one)
        rig.step()
        assert rig.session.view.picture == one


WANTS_NOTHING = Named(("faster", "slower", "jump"))


def test_where_nothing_is_known_of_what_is_right_commands_are_said_and_nothing_is_thought_of_them() -> None:
    language = make_language("ordered", WANTS_NOTHING.order)
    rig = Rig(policy=WANTS_NOTHING, language=language)
    rig.show(scene(0, now=LEFT))
    rig.command(2)
    rig.show(scene(1))
    rig.judge(0.5, 0)
    view = rig.session.view
    assert (rig.said(), rig.judged()) == ([(0, 2)], [(0, 0.5)])
    exchange = view.exchanges[0]
    assert (exchange.command, exchange.did, exchange.obeyed, exchange.feedback) == (2, None, None, 0.5)
    assert (view.wanted, view.obedience, view.judged) == (None, None, 0)
    assert "0 c jump     …        +0.50" in panel.panel(view, ANN, WANTS_NOTHING.commands).plain
    assert panel.says(view, WANTS_NOTHING.commands, rig.now, suggest=True).plain == ""
    assert panel.note_keys(view, WANTS_NOTHING.commands, 80, suggest=True).plain.split() == [
        "z", "faster", "x", "slower", "c", "jump",
    ]  # fmt: skip


def test_on_its_own_it_is_silent_where_nothing_is_known_of_what_is_right() -> None:
    rig = Rig(auto=True, policy=WANTS_NOTHING, language=make_language("ordered", WANTS_NOTHING.order))
    for i in range(3):
        rig.show(scene(i))
    assert rig.said() == [(i, None) for i in range(3)]
    assert rig.judged() == []


def test_in_a_scene_without_what_the_policy_looks_at_nothing_is_thought_and_nobody_falls() -> None:
    rig, place = Rig(), {"pole_rad": 0.1}
    rig.show(msgspec.structs.replace(scene(0), reached=place, now=place))
    rig.command(3)
    rig.show(msgspec.structs.replace(scene(1), action={"push": 1.0}, before=place, reached=place, now=place))
    exchange = rig.session.view.exchanges[0]
    assert (exchange.note, exchange.did, exchange.obeyed, rig.session.view.wanted) == (3, None, None, None)


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
    script = ScriptedTeacher(MemoryBus(other.fabric, BRAIN), schedule_of(section, 1))
    places = (AHEAD, LEFT, BEHIND, AHEAD)
    for i, (now, did) in enumerate(zip(places, (NONE, LARGE_LEFT, LARGE_LEFT, 5), strict=True)):
        before = placed(places[i - 1], 0.1 * (i - 1)) if i else None
        one = scene(i, now, did, before=before)
        rig.show(one)
        other.publisher(keys.SCENE).put(one)
        script.step()
    judged = rig.judged()
    assert rig.said() == [(c.iteration, c.note) for c in iter(commands.take, None)]
    assert judged == [(f.iteration, f.value) for f in iter(feedback.take, None)]
    assert len({value for _, value in judged}) == 3, "praise, some, and punishment"


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
    rig.show(scene(6, did=LARGE_LEFT))
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


def test_whose_turn_it_is_follows_what_was_said() -> None:
    rig = Rig()
    assert rig.session.view.turn == Turn("watch", 0)
    rig.show(scene(0))
    assert rig.session.view.turn == Turn("play", 0), "there is nothing to judge yet"
    rig.command(3)
    assert rig.session.view.turn == Turn("watch", 0)
    rig.show(scene(1))
    assert rig.session.view.turn == Turn("both", 1)
    rig.judge(0.5, 0)
    assert rig.session.view.turn == Turn("play", 1)
    rig.command(None)
    rig.show(scene(2))
    assert rig.session.view.turn == Turn("play", 2), "what was done in silence need not be judged"
    rig.command(3)
    rig.show(scene(3))
    rig.command(2)
    assert rig.session.view.turn == Turn("judge", 3), "the note came first; the judgement may come later"
    rig.judge(1.0, 2)
    rig.session.pause()
    rig.show(scene(4))
    assert rig.session.view.turn == Turn("watch", 4)
    rig.world.publisher(keys.FINISHED).put(messages.Finished(iterations=4))
    rig.step()
    assert rig.session.view.turn == Turn("over", 4)


def test_a_turn_ends_when_the_brain_goes_on_by_the_patience_of_the_experiment() -> None:
    rig = Rig(patience_s=(20.0, 5.0))
    rig.show(scene(0))
    assert rig.session.view.turn == Turn("play", 0, rig.now + 20.0)
    rig.command(3)
    rig.now += 3.0
    rig.show(scene(1))
    assert rig.session.view.turn == Turn("both", 1, rig.now + 25.0), "feedback is waited for first"
    rig.now += 1.0
    rig.judge(0.5, 0)
    assert rig.session.view.turn == Turn("play", 1, rig.now + 20.0)
    rig.session.wait_for_me(True)
    rig.step()
    assert rig.session.view.turn == Turn("play", 1), "it waits"
    rig.session.wait_for_me(False)
    rig.report(0, teacher="bob", holder="bob")
    assert rig.session.view.turn == Turn("play", 1), "it waits for somebody else"


def test_who_wants_to_be_waited_for_says_so_again_and_again_while_something_is_due() -> None:
    def said(rig: Rig) -> list[tuple[str, int | None]]:
        took = [*rig.feedback.some(), *rig.commands.some()]
        return [(type(one).__name__, one.iteration) for one in took if one.later]

    rig = Rig(patience_s=(2.0, 2.0))
    rig.session.wait_for_me(True)
    rig.step()
    assert said(rig) == [], "nothing is due yet"
    rig.show(scene(0))
    assert rig.session.view.waits
    assert said(rig) == [("Command", 0)]
    rig.step()
    assert said(rig) == []
    rig.now += AGAIN_S
    rig.step()
    assert said(rig) == [("Command", 0)]
    rig.command(3)
    rig.now += AGAIN_S
    rig.step()
    assert said(rig) == [], "it has its note"
    rig.show(scene(1))
    assert said(rig) == [("Feedback", 0), ("Command", 1)]
    rig.judge(1.0, 0)
    rig.now += AGAIN_S
    rig.step()
    assert said(rig) == [("Command", 1)]
    rig.now += MOST_S
    rig.step()
    assert said(rig) == [], "for one scene not for ever"
    rig.show(scene(2))
    assert said(rig) == [("Command", 2)]
    rig.session.wait_for_me(False)
    rig.now += AGAIN_S
    rig.step()
    assert said(rig) == []


def test_what_an_operator_wants_is_shown() -> None:
    rig = Rig()
    assert rig.session.view.control is None
    control = messages.Control(iteration=3, paused=True)
    rig.world.publisher(keys.CONTROL).put(control)
    rig.step()
    assert rig.session.view.control == control


def test_the_summary_is_of_all_that_the_teacher_lived() -> None:
    rig, count = Rig(), 3 * OBEDIENCE_OF + KEPT
    assert rig.session.view.summary == Summary()
    rig.show(scene(0, successes=7))
    for i in range(count):
        obeys = i >= OBEDIENCE_OF // 2
        rig.command(ORDERED.note(LARGE_LEFT))
        rig.show(scene(i + 1, did=LARGE_LEFT if obeys else NONE, successes=7 + (i + 1) // 10))
        rig.judge(1.0 if obeys else -0.5, i)
    rig.command(None)
    rig.show(scene(count + 1, successes=7 + count // 10))
    half = OBEDIENCE_OF // 2
    assert rig.session.view.summary == Summary(
        commands=count,
        judged=count,
        obeyed=count - half,
        rewards=count - half,
        punishments=half,
        successes=count // 10,
        first=0.5,
        last=1.0,
    )


def test_while_a_router_hangs_what_is_ordered_and_heard_needs_bounded_memory() -> None:
    rig = Rig(listens=True)
    rig.show(scene(0))
    for _ in range(3 * MOST_SOUND):
        rig.session.microphone(np.zeros(8, np.int16), 16_000)
    assert rig.session._orders.qsize() == MOST_SOUND
    rig.session.command(2)
    for _ in range(2 * MOST_ORDERS):
        rig.session.pause()
    assert rig.session._orders.qsize() == MOST_ORDERS
    assert set(rig.bus.refusals.dropped) == {keys.AUDIO.path, keys.COMMAND.path}
    rig.step()
    assert rig.said()[0] == (0, 2), "sound does not keep out a note"
