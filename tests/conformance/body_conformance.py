"""What every body must do: derive a test class from `BodyConformance` and supply `make`.

Owns the meaning of `mdb_sim.body.Body` as tests, after dm_env's conformance suite. Uses the contract's members only,
so that it fits any body: simulated, of another make, or a machine that cannot be put anywhere.
"""

import json
import math
import re
import subprocess
import sys
import threading
from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mdb_protocol import codec, messages
from mdb_services.mechanism.networks.encoding import DERIVED, NOT_SENSED
from mdb_sim.body import (
    NOTHING,
    Body,
    BodyError,
    Changeable,
    Drawable,
    Imaging,
    Numbers,
    Outcome,
    Reading,
    Sensing,
    Spec,
)

ROOT = Path(__file__).parents[2]
NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
PROCESS_S = 60.0
IN_A_FRESH_PROCESS = """
import importlib, json, sys
module, suite = sys.argv[1:]
print(json.dumps(getattr(importlib.import_module(module), suite)().history(11, 40)))
"""

Told = tuple[Outcome, Numbers]
"""What an action led to, and the scene then."""


def random_action(spec: Spec, rng: np.random.Generator) -> Numbers:
    """Any action of a body: one of its choices, or else a value in the range of each actuator."""
    if spec.choices:
        return dict(spec.choices[int(rng.integers(len(spec.choices)))])
    return {actuator.name: float(rng.uniform(actuator.low, actuator.high)) for actuator in spec.actuators}


class Walk:
    """A body that acts, and begins the next episode when it can do nothing else."""

    def __init__(self, body: Body, seed: int) -> None:
        self.body, self._seed, self._episode = body, seed, 0
        self.first = body.reset(seed, 0), body.scene()

    def act(self, values: Numbers) -> Told:
        outcome, scene = act(self.body, values)
        if outcome.event in self.body.spec.final:
            self.next()
        return outcome, scene

    def next(self) -> tuple[Reading, Numbers]:
        self._episode += 1
        return self.body.reset(self._seed, self._episode), self.body.scene()

    def goes_on_in(self, body: Body) -> "Walk":
        """Return the same walk with another body that stands where this one does."""
        walk = copy(self)
        walk.body = body
        return walk


class BodyConformance:
    """The suite. A subclass supplies `make`, and says what is not so of its body."""

    actions = 60
    """Actions in a run; fewer when the body is slow."""
    options: dict[str, Any] = {}  # noqa: RUF012
    """What `make` makes it with."""
    random = True
    """Whether another seed, or another episode, is another place."""
    settings: dict[str, Any] = {}  # noqa: RUF012
    """Of a body that can be changed: some settings that it takes."""
    wrong_settings: dict[str, Any] = {}  # noqa: RUF012
    """The same, but for the last, which it does not take."""
    repeats = True
    """Whether the same seed and the same actions are the same run; of a machine they are not."""

    def make(self) -> Body:
        raise NotImplementedError

    def draw(self, spec: Spec, rng: np.random.Generator) -> Numbers:
        """Draw an action that the body can carry out."""
        return random_action(spec, rng)

    @pytest.fixture(scope="class")
    @classmethod
    def bodies(cls):
        made = cls().make(), cls().make()
        yield made
        for body in made:
            body.close()

    @pytest.fixture
    def body(self, bodies):
        return bodies[0]

    @pytest.fixture
    def other(self, bodies):
        return bodies[1]

    def drawn(self, body: Body, seed: int, count: int | None = None) -> list[Numbers]:
        rng = np.random.default_rng(seed)
        return [self.draw(body.spec, rng) for _ in range(count or self.actions)]

    def must_repeat(self) -> None:
        if not self.repeats:
            pytest.skip("it goes on where it stands")

    def run(self, body: Body, seed: int, count: int | None = None) -> list[Told]:
        """Act at random; return what came of each action."""
        walk = Walk(body, seed)
        return [walk.act(values) for values in self.drawn(body, seed, count)]

    def history(self, seed: int, count: int) -> list[Any]:
        """Return a run of a body of its own as plain values."""
        body = self.make()
        walk = Walk(body, seed)
        told = [walk.act(values) for values in self.drawn(body, seed, count)]
        later = walk.next()
        body.close()
        return [*walk.first, *told, *later]

    # ---- what it has ----

    def test_the_spec_is_always_the_same(self, body, other):
        spec = body.spec
        assert other.spec == spec
        self.run(body, 1, 5)
        assert body.spec == spec

    def test_names_are_valid_and_each_means_one_thing(self, body):
        spec = body.spec
        sensed = [sensor.name for sensor in spec.sensors]
        done = [actuator.name for actuator in spec.actuators]
        for names in (sensed, done, spec.events, spec.final, spec.scene, spec.changes):
            assert all(NAME.fullmatch(name) for name in names)
            assert len(set(names)) == len(names)
        assert not set(sensed) & set(done), "a sensor and an actuator are variables of one brain"
        for name in (*sensed, *done):
            assert name not in NOT_SENSED
            assert not name.startswith(DERIVED)
        assert NOTHING not in spec.events
        assert set(spec.final) <= set(spec.events)

    def test_it_has_actuators_and_every_range_and_choice_is_one(self, body):
        spec = body.spec
        assert spec.actuators, "else nothing can be learnt with it"
        for part in (*spec.sensors, *spec.actuators):
            assert math.isfinite(part.low)
            assert part.low < part.high < math.inf
        assert all(1 <= sensor.numbers <= 4096 for sensor in spec.sensors)
        ranges = {actuator.name: actuator for actuator in spec.actuators}
        for choice in spec.choices:
            assert choice.keys() == ranges.keys()
            assert all(ranges[name].low <= value <= ranges[name].high for name, value in choice.items())
        assert len({tuple(sorted(choice.items())) for choice in spec.choices}) == len(spec.choices)

    def test_what_it_has_is_known_without_making_one(self, body):
        if not hasattr(type(body), "spec_of"):
            pytest.skip("its factory does not say")
        assert type(body).spec_of(**self.options) == body.spec

    # ---- where it begins ----

    def test_the_same_seed_and_episode_are_the_same_place(self, body, other):
        self.must_repeat()
        for seed, episode in ((3, 0), (3, 7), (4, 7)):
            for one in (body, other):
                one.reset(seed, 0)
            reading, scene = body.reset(seed, episode), body.scene()
            assert (other.reset(seed, episode), other.scene()) == (reading, scene)
            self.run(body, 9, 5)
            body.reset(seed, episode)
            assert body.scene() == scene, "whatever was done before"

    def test_another_seed_or_episode_is_another_place(self, body):
        if not (self.random and self.repeats):
            pytest.skip("it always begins at the same place")
        scenes = []
        for seed, episode in ((3, 0), (4, 0), (3, 1), (3, 2)):
            body.reset(seed, episode)
            scenes.append(tuple(body.scene().items()))
        assert len(set(scenes)) == len(scenes)

    def test_the_same_seed_and_actions_are_the_same_run(self, body, other):
        self.must_repeat()
        first = self.run(body, 5)
        assert self.run(other, 5) == first
        assert self.run(body, 5) == first

    def test_in_two_fresh_processes_a_run_is_the_same(self):
        self.must_repeat()
        suite = type(self)
        command = [sys.executable, "-c", IN_A_FRESH_PROCESS, suite.__module__, suite.__qualname__]
        runs = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) for _ in range(2)]
        one, other = (run.communicate(timeout=PROCESS_S)[0].splitlines()[-1] for run in runs)
        assert len(json.loads(one)) == 2 + 40 + 2
        assert one == other == json.dumps(self.history(11, 40))

    # ---- what it says ----

    def test_events_are_its_own_words_or_nothing(self, body):
        words = {*body.spec.events, NOTHING}
        assert {outcome.event for outcome, _ in self.run(body, 1)} <= words

    def test_readings_are_of_its_sensors_with_so_many_finite_numbers_each(self, body):
        numbers = {sensor.name: sensor.numbers for sensor in body.spec.sensors}
        for reading in (body.reset(2, 0), *(outcome.reading for outcome, _ in self.run(body, 2))):
            assert reading.keys() <= numbers.keys()
            for name, value in reading.items():
                assert isinstance(value, list) == (numbers[name] > 1)
                several = value if isinstance(value, list) else [value]
                assert len(several) == numbers[name]
                assert all(math.isfinite(number) for number in several)

    def test_scenes_have_all_their_numbers_finite_and_looking_changes_nothing(self, body):
        walk = Walk(body, 2)
        for values in self.drawn(body, 2):
            walk.act(values)
            scene = body.scene()
            assert scene.keys() == set(body.spec.scene)
            assert all(math.isfinite(number) for number in scene.values())
            assert body.scene() == scene

    def test_what_it_says_can_be_sent(self, body):
        walk = Walk(body, 2)
        for values in self.drawn(body, 2, 10):
            outcome, scene = walk.act(values)
            sent = (
                messages.Perception(
                    iteration=1, event=outcome.event, outcome=outcome.reading, reading=outcome.reading
                ),
                messages.Scene(
                    iteration=1, episode=0, successes=0, event=outcome.event, action=values, before=scene,
                    reached=scene, now=scene,
                ),
            )  # fmt: skip
            for message in sent:
                cls = type(message)
                assert codec.decode(cls, codec.encode(message), codec.encoding_of(cls)) == message

    def test_what_it_said_is_not_changed_by_what_it_does_next(self, body):
        kept = [(body.reset(2, 0), body.scene()), *self.run(body, 2)]
        said = json.dumps(kept)
        self.run(body, 3, 10)
        assert json.dumps(kept) == said

    # ---- what it refuses ----

    def wrong(self, spec: Spec) -> list[Numbers]:
        """Actions that no such body can carry out."""
        right = self.draw(spec, np.random.default_rng(1))
        found: list[Numbers] = [{}, right | {"no_such_actuator": 0.0}]
        for actuator in spec.actuators:
            found.append({name: value for name, value in right.items() if name != actuator.name})
            beyond = 1.0 + 0.001 * (actuator.high - actuator.low)
            for value in (actuator.low - beyond, actuator.high + beyond, math.nan, math.inf, -math.inf):
                found.append(right | {actuator.name: value})
        if spec.choices:
            first, second = spec.choices[:2]
            found.append({name: 0.37 * first[name] + 0.63 * second[name] for name in first})
        return found

    def test_what_it_cannot_do_is_refused_and_nothing_is_done(self, body, other):
        for one in (body, other):
            one.reset(6, 0)
        before, kept = body.scene(), body.state()
        for values in self.wrong(body.spec):
            with pytest.raises(BodyError):
                body.act(values)
            assert body.scene() == before
            assert body.state() == kept
        self.must_repeat()
        walk, untouched = Walk(body, 6), Walk(other, 6)
        for values in self.drawn(body, 6, 5):
            for wrong in self.wrong(body.spec):
                with pytest.raises(BodyError):
                    body.act(wrong)
            assert walk.act(values) == untouched.act(values), "a refused action leaves no trace"

    def test_an_action_that_was_given_is_not_changed(self, body):
        body.reset(6, 0)
        for values in self.drawn(body, 6, 3):
            given = dict(values)
            body.act(values)
            assert values == given

    def test_after_a_final_event_only_a_new_episode_can_begin(self, body):
        if not body.spec.final:
            pytest.skip("it can always act")
        for seed in range(20):
            body.reset(seed, 0)
            for values in self.drawn(body, seed):
                outcome, scene = act(body, values)
                if outcome.event in body.spec.final:
                    with pytest.raises(BodyError, match="reset"):
                        body.act(values)
                    assert body.scene() == scene
                    body.reset(seed, 1)
                    body.act(values)
                    return
        pytest.fail("no episode came to such an end: draw other actions, or more")

    # ---- going on elsewhere ----

    def test_a_run_goes_on_value_by_value_in_another_body(self, body, other):
        if self.goes_on_where_it_stands(body):
            return
        walk = Walk(body, 8)
        Walk(other, 1)
        for number, values in enumerate(self.drawn(body, 8)):
            state = body.state()
            other.restore(state)
            elsewhere = walk.goes_on_in(other)
            assert other.scene() == body.scene()
            assert other.state() == state
            assert elsewhere.act(values) == walk.act(values)
            if number % 7 == 6:
                assert elsewhere.next() == walk.next(), "the next episode, too"

    def goes_on_where_it_stands(self, body: Body) -> bool:
        """Check a machine that cannot be put back; whether it is one."""
        body.reset(8, 0)
        if body.state() is not None:
            return False
        scene = body.scene()
        with pytest.raises(BodyError):
            body.restore(b"anything")
        assert body.scene() == scene
        return True

    def test_a_restored_body_needs_no_reset(self, body):
        body.reset(8, 0)
        state = body.state()
        if state is None:
            pytest.skip("it cannot be put back")
        fresh = self.make()
        fresh.restore(state)
        (values,) = self.drawn(body, 8, 1)
        assert act(fresh, values) == act(body, values)
        fresh.close()

    def test_a_broken_state_is_refused_and_nothing_changes(self, body):
        body.reset(8, 0)
        state = body.state()
        if state is None:
            pytest.skip("it cannot be put back")
        act(body, self.drawn(body, 8, 1)[0])
        scene, kept = body.scene(), body.state()
        for broken in (b"", b"nothing", b"\xff" * len(state), b"\x00" * len(state)):
            with pytest.raises(BodyError):
                body.restore(broken)
            assert (body.scene(), body.state()) == (scene, kept)

    # ---- halting, closing ----

    def test_halting_between_actions_does_nothing_to_a_body_at_rest(self, body, other):
        self.must_repeat()
        expected = self.run(other, 4, 10)
        walk, told = Walk(body, 4), []
        for values in self.drawn(body, 4, 10):
            body.halt()
            body.halt()
            told.append(walk.act(values))
        assert told == expected

    def test_halting_from_another_thread_while_it_acts_is_harmless(self, body):
        walk = Walk(body, 4)
        failed: list[BaseException] = []

        def halt() -> None:
            try:
                for _ in range(20):
                    body.halt()
            except BaseException as error:
                failed.append(error)

        for values in self.drawn(body, 4, 10):
            thread = threading.Thread(target=halt)
            thread.start()
            outcome, _ = walk.act(values)
            thread.join(PROCESS_S)
            assert not thread.is_alive()
            assert outcome.event in {*body.spec.events, NOTHING}
        assert failed == []
        assert all(math.isfinite(number) for number in body.scene().values())

    def test_before_the_first_reset_every_use_says_what_to_do(self):
        body = self.make()
        body.halt()
        assert body.spec
        values = self.drawn(body, 1, 1)[0]
        for use in (lambda: body.act(values), body.scene):
            with pytest.raises(BodyError, match="reset"):
                use()
        body.reset(1, 0)
        body.act(values)
        body.close()

    def test_a_closed_body_says_so_and_closing_or_halting_it_again_is_harmless(self):
        body = self.make()
        body.reset(1, 0)
        values = self.drawn(body, 1, 1)[0]
        body.close()
        body.close()
        body.halt()
        for use in (lambda: body.act(values), lambda: body.reset(1, 0), body.scene):
            with pytest.raises(BodyError, match="closed"):
                use()
        never_used = self.make()
        never_used.close()
        never_used.close()

    def test_one_body_that_is_closed_closes_no_other(self, body):
        another = self.make()
        another.reset(1, 0)
        another.close()
        assert len(self.run(body, 1, 3)) == 3

    # ---- what some bodies can do ----

    def test_a_drawing_is_one_whatever_is_perceived_and_changes_nothing(self, body):
        if not isinstance(body, Drawable):
            pytest.skip("it does not draw")
        walk = Walk(body, 5)
        for values in self.drawn(body, 5, 10):
            outcome, _ = walk.act(values)
            scene, state = body.scene(), body.state()
            for reading in ({}, walk.first[0], outcome.reading):
                drawing = body.draw(reading)
                assert isinstance(drawing, messages.Drawing)
                check_sent(messages.Picture(iteration=1, drawing=drawing))
            assert (body.scene(), body.state()) == (scene, state)

    def test_an_image_is_one_and_changes_nothing(self, body):
        if not isinstance(body, Imaging):
            pytest.skip("it has no image")
        body.reset(5, 0)
        scene = body.scene()
        try:
            image = body.image()
        except BodyError as error:
            pytest.skip(f"no image can be made here: {error}")
        check_sent(messages.Picture(iteration=1, image=image))
        assert body.scene() == scene

    def test_what_can_be_changed_is_told_and_nothing_else_can(self, body):
        assert bool(body.spec.changes) == isinstance(body, Changeable)
        if not isinstance(body, Changeable):
            return
        assert set(self.settings) <= set(body.spec.changes)
        body.reset(5, 0)
        scene, state = body.scene(), body.state()
        with pytest.raises(BodyError, match="no_such_setting"):
            body.change(**self.settings, no_such_setting=1)
        with pytest.raises(BodyError, match=list(self.wrong_settings)[-1]):
            body.change(**self.wrong_settings)
        assert (body.scene(), body.state()) == (scene, state), "not even those that it would take"

    def test_what_was_changed_stays_so_and_goes_with_the_state(self, body):
        if not isinstance(body, Changeable):
            pytest.skip("nothing of it can be changed")
        changed, spec = self.make(), body.spec
        walk = Walk(changed, 8)
        changed.change(**self.settings)
        assert changed.spec == spec
        elsewhere = self.make()
        walk.next()
        for values in self.drawn(changed, 8, 20):
            if (state := changed.state()) is None:
                break
            elsewhere.restore(state)
            assert walk.goes_on_in(elsewhere).act(values) == walk.act(values)
        for one in (changed, elsewhere):
            one.close()

    def test_a_fresh_reading_is_one_and_changes_nothing_of_what_comes(self, body, other):
        if not isinstance(body, Sensing):
            pytest.skip("it perceives after its actions only")
        numbers = {sensor.name for sensor in body.spec.sensors}
        walk, undisturbed = Walk(body, 5), Walk(other, 5)
        for values in self.drawn(body, 5, 10):
            scene, state = body.scene(), body.state()
            for _ in range(3):
                assert body.sense().keys() <= numbers
            assert (body.scene(), body.state()) == (scene, state)
            told, expected = walk.act(values), undisturbed.act(values)
            assert told == expected or not self.repeats


def act(body: Body, values: Numbers) -> Told:
    outcome = body.act(values)
    return outcome, body.scene()


def check_sent(picture: messages.Picture) -> None:
    again = codec.decode(messages.Picture, codec.encode(picture), codec.encoding_of(messages.Picture))
    assert codec.to_plain(again) == codec.to_plain(picture)
