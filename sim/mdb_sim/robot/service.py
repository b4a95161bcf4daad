"""The robot as a service: turns the current action into motion and the next perception and scene.

Owns a body (`mdb_sim.body.Robot`). Does each iteration's action once, however often it comes, and none whose deadline
is over (a dead-man's switch): an action answers the newest perception by its stamp, which is this process's own time,
so neither frozen processes nor clocks nor slow networks make an old action look young. A stamp from the future is
none of this robot's. While it waits it shows the same perception again, with a new stamp. Until its first action it
takes the brain's count of iterations, later only when the brain insists. Goes on after its death where it was. Never
sees a model, a reward or a note: what the optimizer meant by an action travels through it unread.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import msgspec
import structlog

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus
from mdb_services.shell.elsewhere import Elsewhere
from mdb_sim.body import Placement, Robot, RobotError, Step
from mdb_sim.placements import message_of, placement_of
from mdb_sim.robot.state_file import StateFile

log = structlog.get_logger()

ROLE = "robot"
SHOWN_AGAIN_S = 0.25
"""What is perceived is shown again after this, as long as no action comes."""


class RobotService:
    """See the module's docstring."""

    role, instance = ROLE, "body"

    def __init__(
        self,
        bus: Bus,
        body: Robot,
        seed: int,
        action_s: float = 0.0,
        file: StateFile | None = None,
        *,
        sleep: Callable[[float], None] = time.sleep,
        clock: Callable[[], float] = time.monotonic,
        deadlines: bool = True,
    ) -> None:
        """Reset the body, or put it where `file` says, and show what it perceives.

        Every action takes at least `action_s` on the wall. Without `deadlines` none comes too late: for replays.
        """
        self.bus = bus
        self._body, self._seed, self._file = body, seed, file
        self._action_s, self._sleep, self._clock = action_s, sleep, clock
        self._deadlines = deadlines
        self._elsewhere = Elsewhere()
        self._acted_s = 0.0
        self._late = self._done = self._unwritten = 0
        self._refused = False
        """Whether the disk did not take the last state."""
        self._perceptions = bus.publisher(keys.PERCEPTION)
        self._scenes = bus.publisher(keys.SCENE)
        self._actions = bus.subscriber(keys.ACTION)
        self._last = body.reset(seed)
        self._perception, self._scene = self._seen(self._last, None, None)
        state = file.read() if file is not None else None
        if state is not None:
            self._go_on(state)
        self._show()

    def _go_on(self, state: messages.RobotState) -> None:
        """Put the body where it was."""
        scene = state.scene
        counts = {"episode": scene.episode, "captures": scene.captures}
        hidden = {"episode_age": state.episode_age, "unseen": state.unseen}
        try:
            self._body.restore(placement_of(scene.now), scene.iteration, seed=self._seed, **counts, **hidden)
        except RobotError as error:
            log.warning("the state does not fit the body; it begins anew", reason=str(error))
            return
        now = placement_of(scene.now)
        seen = state.perception
        self._last = Step(scene.iteration, scene.event, now, seen.outcome, now, seen.reading, **counts, **hidden)
        self._perception, self._scene = seen, scene
        log.info("going on where it was", iteration=scene.iteration)

    def step(self) -> bool:
        """Do the newest action if it is due and not too late; show again what is perceived when that is old."""
        action = self._actions.take()
        if action is None:
            if self._clock() - self._perception.stamp >= SHOWN_AGAIN_S:
                self._show()
            return False
        if action.iteration < self._last.iteration:
            self._show()
        elif self._is_late(action):
            self._late += 1
            self._show()
        elif action.action >= self._body.actions:
            self.bus.refusals.add(keys.ACTION.path, f"action {action.action}; the body has {self._body.actions}")
        elif self._catches_up(action.iteration):
            self._do(action)
        else:
            self.bus.refusals.add(keys.ACTION.path, f"iteration {action.iteration}; now is {self._last.iteration}")
        return True

    def _is_late(self, action: messages.Action) -> bool:
        return self._deadlines and not 0.0 <= self._clock() - action.stamp <= action.valid_for_s

    def _catches_up(self, iteration: int) -> bool:
        """Bring the count to that of an action; whether it is to be done.

        A fresh body after a restart goes on with the brain's count, where it stands.
        """
        if iteration == self._last.iteration:
            self._elsewhere.nearer()
            return True
        if self._done and not self._elsewhere.believed(iteration, self._clock()):
            return False
        log.warning("going on with the brain's iteration", mine=self._last.iteration, iteration=iteration)
        last = self._last
        self._body.restore(last.now, iteration, seed=self._seed, episode=last.episode, captures=last.captures)
        return True

    def _do(self, action: messages.Action) -> None:
        started = time.perf_counter()
        before = self._last.now
        try:
            self._last = self._body.act(action.action)
        except RobotError as error:
            self.bus.refusals.add(keys.ACTION.path, str(error))
            return
        self._done += 1
        self._acted_s = time.perf_counter() - started
        if self._acted_s < self._action_s:
            self._sleep(self._action_s - self._acted_s)
        self._perception, self._scene = self._seen(self._last, action, before)
        self._keep()
        self._show()

    def _keep(self) -> None:
        """Write where the robot is; on a disk that takes nothing a death now costs the steps since."""
        if self._file is None:
            return
        try:
            self._file.write(self._state())
        except OSError as error:
            if not self._refused:
                log.error("the robot's state cannot be written; a death now costs its last steps", reason=str(error))
            self._refused = True
            self._unwritten += 1
        else:
            if self._refused:
                log.info("the robot's state is written again", unwritten=self._unwritten)
            self._refused = False

    def _state(self) -> messages.RobotState:
        last = self._last
        return messages.RobotState(
            perception=self._perception, scene=self._scene, episode_age=last.episode_age, unseen=last.unseen
        )

    def _show(self) -> None:
        """Publish what is seen, with the time of now."""
        self._perception = msgspec.structs.replace(self._perception, stamp=self._clock())
        self._scenes.put(self._scene)
        self._perceptions.put(self._perception)

    @staticmethod
    def _seen(
        step: Step, action: messages.Action | None, before: Placement | None
    ) -> tuple[messages.Perception, messages.Scene]:
        perception = messages.Perception(
            iteration=step.iteration, event=step.event, outcome=step.reading, reading=step.next_reading, done=action
        )
        scene = messages.Scene(
            iteration=step.iteration,
            episode=step.episode,
            captures=step.captures,
            event=step.event,
            action=action.action if action is not None else None,
            before=message_of(before) if before else None,
            reached=message_of(step.reached),
            now=message_of(step.now),
        )
        return perception, scene

    def values(self) -> dict[str, float]:
        """Iteration, captures, actions that came too late, states that the disk did not take and whether it takes
        none now, and how long the last action took to simulate.
        """
        last, late = self._last, float(self._late)
        counts = {"iteration": float(last.iteration), "captures": float(last.captures)}
        counts |= {"unwritten": float(self._unwritten), "disk_refuses": float(self._refused)}
        return {**counts, "late": late, "act_s": self._acted_s}

    def close(self) -> None:
        """Free the body."""
        self._body.close()
