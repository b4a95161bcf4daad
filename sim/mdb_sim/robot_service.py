"""The robot as a service: turns the current action into motion and the next perception and scene.

Owns a body (`robot.Robot`). Does each iteration's action once, however often it comes. Never sees a model, a
reward or a note.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import structlog

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus
from mdb_sim.robot import Placement, Robot, RobotError, Step

log = structlog.get_logger()

ROLE = "robot"


class RobotService:
    """See the module's docstring."""

    role, instance = ROLE, "body"

    def __init__(
        self, bus: Bus, body: Robot, seed: int, action_s: float = 0.0, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        """Reset the body and show the first perception; every action takes at least `action_s` on the wall."""
        self.bus = bus
        self._body, self._seed = body, seed
        self._action_s, self._sleep = action_s, sleep
        self._acted_s = 0.0
        self._perceptions = bus.publisher(keys.PERCEPTION)
        self._scenes = bus.publisher(keys.SCENE)
        self._actions = bus.subscriber(keys.ACTION)
        self._last = body.reset(seed)
        self._perception: messages.Perception
        self._show(self._last, None, None)

    def step(self) -> bool:
        """Do the newest action if it is due; show the last perception again when the action was done before."""
        action = self._actions.take()
        if action is None:
            return False
        if action.iteration < self._last.iteration:
            self._perceptions.put(self._perception)
        elif action.action >= self._body.actions:
            self.bus.refusals.add(keys.ACTION.path, f"action {action.action}; the body has {self._body.actions}")
        else:
            if action.iteration > self._last.iteration:
                self._catch_up(action.iteration)
            self._do(action.action)
        return True

    def _catch_up(self, iteration: int) -> None:
        """A fresh body after a restart goes on with the brain's count, where it stands."""
        log.warning("going on with the brain's iteration", mine=self._last.iteration, iteration=iteration)
        last = self._last
        self._body.restore(last.now, iteration, seed=self._seed, episode=last.episode, captures=last.captures)

    def _do(self, action: int) -> None:
        started = time.perf_counter()
        before = self._last.now
        try:
            self._last = self._body.act(action)
        except RobotError as error:
            self.bus.refusals.add(keys.ACTION.path, str(error))
            return
        self._acted_s = time.perf_counter() - started
        if self._acted_s < self._action_s:
            self._sleep(self._action_s - self._acted_s)
        self._show(self._last, action, before)

    def _show(self, step: Step, action: int | None, before: Placement | None) -> None:
        self._perception = messages.Perception(
            iteration=step.iteration, event=step.event, outcome=step.reading, reading=step.next_reading
        )
        scene = messages.Scene(
            iteration=step.iteration,
            episode=step.episode,
            captures=step.captures,
            event=step.event,
            action=action,
            before=_placement(before) if before else None,
            reached=_placement(step.reached),
            now=_placement(step.now),
        )
        self._scenes.put(scene)
        self._perceptions.put(self._perception)

    def values(self) -> dict[str, float]:
        """Iteration, captures, and how long the last action took to simulate."""
        last = self._last
        return {"iteration": float(last.iteration), "captures": float(last.captures), "act_s": self._acted_s}

    def close(self) -> None:
        """Free the body."""
        self._body.close()


def _placement(placement: Placement) -> messages.Placement:
    return messages.Placement(
        x_m=placement.robot.x_m,
        y_m=placement.robot.y_m,
        heading_rad=placement.robot.heading_rad,
        object_x_m=placement.object_x_m,
        object_y_m=placement.object_y_m,
    )
