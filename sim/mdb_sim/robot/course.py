"""A body on its course: actions, episodes and successes are counted, and an episode that is over begins anew. No bus.

Owns the rules of an experiment for its body: which events are successes, which end an episode, and when one has
lasted long enough.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from mdb_protocol import messages
from mdb_protocol.messages import NOTHING
from mdb_sim.body import Body, BodyError, Changeable, Numbers, Reading, Sensing

TIMEOUT = "timeout"
"""The event when an episode has lasted as long as it may, and nothing else happened."""


@dataclass(frozen=True, slots=True)
class Rules:
    """`successes`, `ends`: events; `longest`: actions in an episode at most, None: any number."""

    successes: frozenset[str] = frozenset()
    ends: frozenset[str] = frozenset()
    longest: int | None = None


@dataclass(frozen=True, slots=True)
class Step:
    """What one action did; at iteration 0 none was done.

    `outcome` was perceived at `reached`, where the action led to; `reading` at `now`, where the next one starts: the
    same unless the episode `ended`. `iteration` counts actions, `age` those of this episode, after this step.
    """

    iteration: int
    episode: int
    successes: int
    age: int
    event: str
    success: bool
    ended: bool
    action: Numbers | None
    before: Numbers | None
    reached: Numbers
    now: Numbers
    outcome: Reading
    reading: Reading

    def scene(self) -> messages.Scene:
        """Return what a bystander sees of it."""
        return messages.Scene(
            iteration=self.iteration,
            episode=self.episode,
            successes=self.successes,
            event=self.event,
            action=self.action,
            before=self.before,
            reached=self.reached,
            now=self.now,
            success=self.success,
            ended=self.ended,
        )

    def perception(self, done: messages.Action | None = None) -> messages.Perception:
        """Return what the robot perceived, after the action that was `done`."""
        return messages.Perception(
            iteration=self.iteration, event=self.event, outcome=self.outcome, reading=self.reading, done=done
        )


class Course:
    """See the module's docstring; `last` is the newest step."""

    def __init__(
        self, body: Body, rules: Rules, seed: int, changes: Mapping[int, Mapping[str, Any]] | None = None
    ) -> None:
        """Begin with the first episode of the run of this seed.

        `changes`: what of the body changes before the action of an iteration.
        """
        self.body, self._rules, self._seed, self._changes = body, rules, seed, changes or {}
        self.begin()

    def begin(self) -> None:
        """Begin anew."""
        reading = self.body.reset(self._seed, 0)
        now = self.body.scene()
        self.last = Step(0, 0, 0, 0, NOTHING, False, False, None, None, now, now, reading, reading)

    def act(self, values: Mapping[str, float]) -> Step:
        """Carry out an action; end the episode if it is over. BodyError: nothing was done."""
        return self._act(values, 1)

    def hold(self, values: Mapping[str, float]) -> Step:
        """Carry out the last action for longer: no iteration more."""
        return self._act(values, 0)

    def _act(self, values: Mapping[str, float], iterations: int) -> Step:
        last = self.last
        outcome = self.body.act(values)
        reached = now = self.body.scene()
        reading, age, event = outcome.reading, last.age + 1, outcome.event
        timed_out = self._rules.longest is not None and age >= self._rules.longest
        if timed_out and event == NOTHING:
            event = TIMEOUT
        success, ended = event in self._rules.successes, timed_out or event in self._rules.ends
        episode = last.episode + ended
        if ended:
            age = 0
            reading = self.body.reset(self._seed, episode)
            now = self.body.scene()
        self.last = Step(
            iteration=last.iteration + iterations,
            episode=episode,
            successes=last.successes + success,
            age=age,
            event=event,
            success=success,
            ended=ended,
            action=dict(values),
            before=last.now,
            reached=reached,
            now=now,
            outcome=outcome.reading,
            reading=reading,
        )
        if iterations and (settings := self._changes.get(self.last.iteration)) is not None:
            self.change(settings)
        return self.last

    def change(self, settings: Mapping[str, Any]) -> Step:
        """Change something of the body; return the last step with what is true and perceived now.

        BodyError when it cannot be changed: nothing is.
        """
        if not isinstance(self.body, Changeable):
            raise BodyError(f"change {dict(settings)!r}: nothing of this body can be changed while it runs")
        self.body.change(**settings)
        reading = self.body.sense() if isinstance(self.body, Sensing) else self.last.reading
        self.last = replace(self.last, now=self.body.scene(), reading=reading)
        return self.last

    def count(self, iteration: int) -> None:
        """Take another count of iterations."""
        self.last = replace(self.last, iteration=iteration)

    def state(self) -> messages.RobotState:
        """Return all from which `go_on` goes on, in this process or another."""
        return messages.RobotState(
            perception=self.last.perception(), scene=self.last.scene(), age=self.last.age, body=self.body.state()
        )

    def go_on(self, state: messages.RobotState) -> None:
        """Go on from a state. BodyError when it does not fit the body."""
        scene, seen = state.scene, state.perception
        if state.body is None:
            self.body.reset(self._seed, scene.episode)
        else:
            self.body.restore(state.body)
        self.last = Step(
            iteration=scene.iteration,
            episode=scene.episode,
            successes=scene.successes,
            age=state.age,
            event=scene.event,
            success=scene.success,
            ended=scene.ended,
            action=scene.action,
            before=scene.before,
            reached=scene.reached,
            now=scene.now,
            outcome=seen.outcome,
            reading=seen.reading,
        )
