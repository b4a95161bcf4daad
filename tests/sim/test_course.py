"""A body on its course: what is counted, what ends an episode, and how it goes on elsewhere."""

from collections.abc import Mapping, Sequence

import pytest

from mdb_sim.body import NOTHING, Actuator, BodyError, Numbers, Outcome, Reading, Resting, Sensor, Spec
from mdb_sim.robot.course import TIMEOUT, Course, Rules

PUSH = {"push": 1.0}


class Script(Resting):
    """Says the events that it was given, one an action; knows how many actions it has done in the episode."""

    def __init__(self, *events: str, keeps: bool = True) -> None:
        self.events, self.keeps = list(events), keeps
        self.resets: list[tuple[int, int]] = []
        self.episode, self.steps, self.done = -1, 0, 0

    @property
    def spec(self) -> Spec:
        sensor, push = Sensor(name="steps", low=0.0, high=9.0), Actuator(name="push", low=-1.0, high=1.0)
        return Spec(sensors=(sensor,), actuators=(push,), events=("won", "hit"), scene=("episode", "steps"))

    def reset(self, seed: int, episode: int) -> Reading:
        self.resets.append((seed, episode))
        self.episode, self.steps = episode, 0
        return {"steps": 0.0}

    def act(self, values: Mapping[str, float]) -> Outcome:
        if values.keys() != {"push"}:
            raise BodyError("expected push")
        self.steps += 1
        self.done += 1
        event = self.events[self.done - 1] if self.done <= len(self.events) else NOTHING
        return Outcome(event, {"steps": float(self.steps)})

    def scene(self) -> Numbers:
        return {"episode": float(self.episode), "steps": float(self.steps)}

    def state(self) -> bytes | None:
        return bytes([self.episode, self.steps, self.done]) if self.keeps else None

    def restore(self, state: bytes) -> None:
        if len(state) != 3:
            raise BodyError("no state of a script")
        self.episode, self.steps, self.done = state

    def close(self) -> None:
        pass


def rules(successes: Sequence[str] = (), ends: Sequence[str] = (), longest: int | None = None) -> Rules:
    return Rules(frozenset(successes), frozenset(ends), longest)


def at(episode: int, steps: int) -> Numbers:
    return {"episode": float(episode), "steps": float(steps)}


def test_a_course_begins_with_episode_nought_of_its_seed_where_nothing_was_done() -> None:
    course = Course(body := Script(), rules(), 7)
    assert body.resets == [(7, 0)]
    last = course.last
    assert (last.iteration, last.episode, last.successes, last.age) == (0, 0, 0, 0)
    assert (last.event, last.success, last.ended, last.action, last.before) == (NOTHING, False, False, None, None)
    assert last.reached == last.now == at(0, 0)
    assert last.outcome == last.reading == {"steps": 0.0}


def test_an_action_goes_from_one_place_to_the_next() -> None:
    course = Course(Script(), rules(), 7)
    for number in range(1, 4):
        step = course.act(PUSH)
        assert step is course.last
        assert (step.iteration, step.age, step.action) == (number, number, PUSH)
        assert (step.before, step.reached, step.now) == (at(0, number - 1), at(0, number), at(0, number))
        assert step.outcome == step.reading == {"steps": float(number)}


def test_an_event_that_ends_the_episode_begins_the_next_and_both_places_are_shown() -> None:
    course = Course(body := Script(NOTHING, "hit"), rules(ends=["hit"]), 7)
    course.act(PUSH)
    step = course.act(PUSH)
    assert (step.event, step.ended, step.success) == ("hit", True, False)
    assert (step.iteration, step.episode, step.age) == (2, 1, 0)
    assert (step.before, step.reached, step.now) == (at(0, 1), at(0, 2), at(1, 0))
    assert (step.outcome, step.reading) == ({"steps": 2.0}, {"steps": 0.0})
    assert body.resets == [(7, 0), (7, 1)]
    step = course.act(PUSH)
    assert (step.episode, step.age, step.before, step.ended) == (1, 1, at(1, 0), False)


def test_an_event_that_ends_nothing_is_told_and_the_episode_goes_on() -> None:
    course = Course(body := Script("hit", "won"), rules(), 7)
    assert [(step.event, step.ended, step.success) for step in (course.act(PUSH), course.act(PUSH))] == [
        ("hit", False, False), ("won", False, False),
    ]  # fmt: skip
    assert (course.last.episode, course.last.age, body.resets) == (0, 2, [(7, 0)])


def test_successes_are_the_events_that_the_experiment_calls_so_whether_they_end_an_episode_or_not() -> None:
    events = ["won", "hit", NOTHING, "won"]
    course = Course(Script(*events), rules(successes=["won"], ends=["hit"]), 7)
    steps = [course.act(PUSH) for _ in events]
    assert [step.success for step in steps] == [True, False, False, True]
    assert [step.successes for step in steps] == [1, 1, 1, 2]
    assert [step.episode for step in steps] == [0, 1, 1, 1]


def test_an_episode_that_lasts_too_long_times_out_and_the_next_has_its_whole_time() -> None:
    course = Course(body := Script(), rules(longest=3), 7)
    steps = [course.act(PUSH) for _ in range(6)]
    assert [step.event for step in steps] == [NOTHING, NOTHING, TIMEOUT] * 2
    assert [step.age for step in steps] == [1, 2, 0] * 2
    assert [step.ended for step in steps] == [False, False, True] * 2
    assert body.resets == [(7, 0), (7, 1), (7, 2)]


def test_what_happened_last_is_no_timeout() -> None:
    course = Course(Script(NOTHING, "won"), rules(successes=["won"], ends=["won"], longest=2), 7)
    course.act(PUSH)
    step = course.act(PUSH)
    assert (step.event, step.success, step.ended, step.episode) == ("won", True, True, 1)


def test_an_episode_ends_in_time_also_when_something_happens_then_that_ends_nothing() -> None:
    course = Course(Script(*["hit"] * 9), rules(longest=3), 7)
    steps = [course.act(PUSH) for _ in range(6)]
    assert [step.ended for step in steps] == [False, False, True] * 2
    assert [step.episode for step in steps] == [0, 0, 1, 1, 1, 2]
    assert [step.event for step in steps][:2] == ["hit", "hit"]


def test_a_timeout_can_be_a_success() -> None:
    course = Course(Script(), rules(successes=[TIMEOUT], longest=2), 7)
    assert [course.act(PUSH).successes for _ in range(4)] == [0, 1, 1, 2]


def test_a_refused_action_is_not_counted() -> None:
    course = Course(body := Script("won"), rules(successes=["won"]), 7)
    before = course.last
    with pytest.raises(BodyError):
        course.act({"pull": 1.0})
    assert course.last is before
    assert body.done == 0
    assert course.act(PUSH).iteration == 1


def test_what_was_done_is_not_changed_by_who_asked_for_it() -> None:
    course, asked = Course(Script(), rules(), 7), dict(PUSH)
    step = course.act(asked)
    asked["push"] = 99.0
    assert step.action == PUSH


def test_another_count_of_iterations_changes_nothing_else() -> None:
    course = Course(body := Script(), rules(longest=2), 7)
    course.act(PUSH)
    course.count(57)
    assert (course.last.iteration, course.last.age, course.last.episode) == (57, 1, 0)
    assert (course.act(PUSH).iteration, course.last.event) == (58, TIMEOUT)
    assert body.resets == [(7, 0), (7, 1)]


def test_a_course_can_begin_anew() -> None:
    course = Course(body := Script("won"), rules(successes=["won"], ends=["won"]), 7)
    first = course.last
    course.act(PUSH)
    course.begin()
    assert course.last == first
    assert body.resets == [(7, 0), (7, 1), (7, 0)]


def test_step_and_messages_say_the_same() -> None:
    course = Course(Script("won"), rules(successes=["won"], ends=["won"]), 7)
    step = course.act(PUSH)
    scene, perception = step.scene(), step.perception()
    assert (scene.iteration, scene.episode, scene.successes, scene.event) == (1, 1, 1, "won")
    assert (scene.action, scene.before, scene.reached, scene.now) == (PUSH, at(0, 0), at(0, 1), at(1, 0))
    assert (scene.success, scene.ended) == (True, True)
    assert (perception.iteration, perception.event, perception.done) == (1, "won", None)
    assert (perception.outcome, perception.reading) == ({"steps": 1.0}, {"steps": 0.0})


EVENTS = [NOTHING, "hit", NOTHING, "won", NOTHING, NOTHING, NOTHING, "hit"]
RULES = rules(successes=["won"], ends=["won", "hit"], longest=3)


def test_a_state_goes_on_as_if_nothing_had_been_between() -> None:
    straight = Course(Script(*EVENTS), RULES, 7)
    expected = [straight.act(PUSH) for _ in EVENTS]
    course, got = Course(Script(*EVENTS), RULES, 7), []
    for _ in EVENTS:
        elsewhere = Course(Script(*EVENTS), RULES, 7)
        elsewhere.go_on(course.state())
        assert elsewhere.last == course.last
        course = elsewhere
        got.append(course.act(PUSH))
    assert got == expected
    assert {step.event for step in got} == {NOTHING, "hit", "won", TIMEOUT}


def test_a_body_that_cannot_be_put_back_goes_on_in_the_episode_where_it_was() -> None:
    course = Course(Script("hit", NOTHING, keeps=False), rules(ends=["hit"], longest=3), 7)
    for _ in range(2):
        course.act(PUSH)
    state = course.state()
    assert state.body is None
    elsewhere = Course(body := Script(keeps=False), rules(longest=3), 7)
    elsewhere.go_on(state)
    assert elsewhere.last == course.last
    assert body.resets == [(7, 0), (7, 1)]
    assert elsewhere.act(PUSH).age == 2


def test_a_state_of_another_body_is_refused() -> None:
    course = Course(Script(), RULES, 7)
    state = course.state()
    before = course.last

    class Other(Script):
        def state(self) -> bytes | None:
            return b"another"

    with pytest.raises(BodyError, match="no state of a script"):
        course.go_on(Course(Other(), RULES, 7).state())
    assert course.last is before
    assert course.state() == state


# ---- actions that are held, changes ----


def test_a_held_action_is_no_iteration_more_but_all_else_goes_on() -> None:
    course = Course(body := Script(NOTHING, "won"), rules(successes=["won"], longest=3), 7)
    course.act(PUSH)
    step = course.hold(PUSH)
    assert (step.iteration, step.age, step.event, step.successes) == (1, 2, "won", 1)
    assert (step.before, step.reached) == (at(0, 1), at(0, 2))
    step = course.hold(PUSH)
    assert (step.iteration, step.event, step.episode) == (1, TIMEOUT, 1)
    assert body.done == 3


class Windy(Script):
    """A script in which the wind can be changed, and what is perceived with it."""

    def __init__(self, *events: str) -> None:
        super().__init__(*events)
        self.wind = 0.0

    def change(self, **settings: float) -> None:
        if settings.keys() != {"wind"}:
            raise BodyError(f"{settings}; expected wind")
        self.wind = settings["wind"]

    def scene(self) -> Numbers:
        return super().scene() | {"wind": self.wind}

    def sense(self) -> Reading:
        return {"steps": self.steps + 0.5}


def test_a_change_shows_what_is_true_and_perceived_from_then_on() -> None:
    course = Course(body := Windy("won"), rules(successes=["won"]), 7)
    before = course.act(PUSH)
    step = course.change({"wind": 2.0})
    assert (step.now, step.reading) == (at(0, 1) | {"wind": 2.0}, {"steps": 1.5})
    assert (step.reached, step.outcome, step.iteration) == (before.reached, before.outcome, 1), "what was, was"
    assert (course.last.event, course.last.successes, body.done) == ("won", 1, 1)
    assert course.act(PUSH).before == step.now


def test_changes_come_before_the_action_of_their_iteration_and_once() -> None:
    course = Course(body := Windy(), rules(longest=2), 7, {2: {"wind": 2.0}, 4: {"wind": 4.0}})
    winds = []
    for _ in range(5):
        winds.append(body.wind)
        course.act(PUSH)
        if course.last.iteration == 3:
            course.hold(PUSH)
            body.wind += 0.5
            course.hold(PUSH)
    assert winds == [0.0, 0.0, 2.0, 2.5, 4.0]


def test_what_cannot_be_changed_changes_nothing() -> None:
    course = Course(Windy(), rules(), 7)
    before = course.last
    with pytest.raises(BodyError, match="expected wind"):
        course.change({"light": 1.0})
    assert course.last is before
    with pytest.raises(BodyError, match="nothing of this body can be changed"):
        Course(Script(), rules(), 7).change({"wind": 1.0})
