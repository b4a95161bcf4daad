"""The robot as a service: carries out the current action and shows what is perceived, and the scene.

Owns a body (`mdb_sim.body.Body`). Does each iteration's action once, however often it comes, and none whose deadline
is over (a dead-man's switch): an action answers the newest perception by its stamp, which is this process's own time,
so neither frozen processes nor clocks nor slow networks make an old action look young. A stamp from the future is
none of this robot's. While nobody commands it its body is halted, and it shows the same perception again, with a new
stamp. Until its first action it takes the brain's count of iterations, later only when the brain insists. Goes on
after its death where it was. While an operator has it paused it takes no new action. Never sees a model, a reward or
a note: what the optimizer meant by an action travels through it unread.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import structlog

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus
from mdb_protocol.duties import SHOWN_AGAIN_S
from mdb_services.shell.elsewhere import Elsewhere
from mdb_services.shell.heartbeat import SILENT_S
from mdb_sim.body import Body, BodyError, check, picture_of
from mdb_sim.robot.acting import Acting
from mdb_sim.robot.clock import Clock
from mdb_sim.robot.course import Course, Rules
from mdb_sim.robot.state_file import StateFile

log = structlog.get_logger()

ROLE = "robot"
WATCHING = ("teacher/", "viewer/")
"""Whose liveliness tokens mean that somebody watches, ..."""
ACTION_S = 30.0
"""An action that the body is at for longer, beyond its least time, hangs: then this process is to be ended."""
SCRIPT = "teacher/script"
"""... but for the scripted teacher's."""


class RobotService:
    """See the module's docstring."""

    role, instance = ROLE, "body"

    def __init__(
        self,
        bus: Bus,
        body: Body,
        rules: Rules,
        seed: int,
        *,
        action_s: float = 0.0,
        fixed_pace: bool = False,
        changes: Mapping[int, Mapping[str, Any]] | None = None,
        period_s: float | None = None,
        hold_s: float = 1.0,
        file: StateFile | None = None,
        threaded: bool = False,
        clock: Callable[[], float] = time.monotonic,
        deadlines: bool = True,
    ) -> None:
        """Reset the body, or put it where `file` says, and show what it perceives.

        `changes`: see `Course`. Every action takes at least `action_s` on the wall, or as long as an operator says,
        unless the pace is fixed. With `period_s`, which fixes it, the robot acts every period: an action that does
        not come is held for `hold_s`, then the body is halted. `threaded`: actions are carried out in a thread, so
        that what is asked meanwhile is answered, and an action whose commander is silent for `hold_s` is interrupted.
        Without `deadlines` no action comes too late: for replays.
        """
        self.bus = bus
        self._body, self._file, self._clock = body, file, clock
        self._deadlines, self._hold_s = deadlines, hold_s
        self._elsewhere = Elsewhere()
        self._halted_at = 0
        """Actions begun when the body was halted for want of a commander."""
        self._late = self._done = self._halts = self._changes = self._unwritten = 0
        self._refused = False
        """Whether the disk did not take the last state."""
        self._dark = False
        """Whether an image could not be made."""
        self._perceptions = bus.publisher(keys.PERCEPTION)
        self._scenes = bus.publisher(keys.SCENE)
        self._pictures = bus.publisher(keys.PICTURE)
        self._actions = bus.subscriber(keys.ACTION)
        self._asked = bus.subscriber(keys.CHANGE)
        self._controls = bus.subscriber(keys.CONTROL)
        self._paused = False
        """Whether an operator wants no action to be taken."""
        self._least_s, self._fixed_pace = action_s, fixed_pace or period_s is not None
        self._course = Course(body, rules, seed, changes)
        self._acting = Acting(self._course, least_s=action_s, threaded=threaded, woken=bus.poke)
        self._ticks = None if period_s is None else Clock(period_s, clock())
        self._perception = self._course.last.perception()
        self._scene = self._course.last.scene()
        self._action: messages.Action | None = None
        """The action that is being carried out, or was last."""
        self._next: messages.Action | None = None
        """The action for the next period."""
        self._heard_s = clock()
        """When the commander was last heard."""
        state = file.read() if file is not None else None
        if state is not None:
            self._go_on(state)
        self._show()

    def _go_on(self, state: messages.RobotState) -> None:
        """Put the body where it was."""
        try:
            self._course.go_on(state)
        except BodyError as error:
            log.warning("the state does not fit the body; it begins anew", reason=str(error))
            self._course.begin()
            return
        self._perception, self._scene = state.perception, state.scene
        log.info("going on where it was", iteration=state.scene.iteration)

    def due_in_s(self) -> float:
        """Return in how many seconds there is something to do whatever comes."""
        due_s = self._perception.stamp + SHOWN_AGAIN_S if self._ticks is None else self._ticks.due_s
        if self._acting.busy and not self._halted:
            due_s = min(due_s, self._heard_s + self._hold_s)
        return max(0.0, due_s - self._clock())

    def step(self) -> bool:
        """Take what an action led to and what is commanded, and act when it is time."""
        moved = self._conclude()
        while (control := self._controls.take()) is not None:
            self._obey(control)
        if not self._acting.busy and (asked := self._asked.take()) is not None:
            self._change(asked)
            moved = True
        action = self._actions.take(lambda action: 0 <= action.iteration - self._perception.iteration <= 1)
        if action is not None and self._paused and not self._is_underway(action):
            action = None
        if action is not None:
            self._heard_s = self._clock()
            self._take(action)
            moved = True
        elif self._acting.busy:
            self._rest()
        if self._ticks is not None:
            return self._tick(self._ticks) or moved
        if self._next is not None and not self._acting.busy:
            self._begin(self._next)
            self._conclude()
        elif action is None and self._clock() - self._perception.stamp >= SHOWN_AGAIN_S:
            self._rest()
            self._show()
        return moved

    def _obey(self, control: messages.Control) -> None:
        """Pause or go on, and take another pace, as an operator wants it. An action that goes on comes to its end."""
        if control.paused != self._paused:
            self._paused = control.paused
            log.info("paused" if self._paused else "going on after a pause", iteration=self._perception.iteration)
        if self._paused:
            self._next = None
            if not self._acting.busy:
                self._rest()
        if not self._fixed_pace:
            self._acting.least_s = self._least_s if control.action_s is None else control.action_s

    def _is_underway(self, action: messages.Action) -> bool:
        """Whether this is the action that is being carried out."""
        return self._acting.busy and self._acting.counted and action.iteration == self._perception.iteration

    def _change(self, asked: messages.Change) -> None:
        """Change something of the body, and show what is true now."""
        try:
            step = self._course.change(asked.settings)
        except BodyError as error:
            self.bus.refusals.add(keys.CHANGE.path, str(error))
            return
        log.info("changed", **asked.settings)
        self._changes += 1
        self._perception = msgspec.structs.replace(self._perception, reading=step.reading)
        self._scene = msgspec.structs.replace(self._scene, now=step.now)
        self._keep()
        self._show()

    def _take(self, action: messages.Action) -> None:
        """Keep an action that is due and not too late, to be carried out next; otherwise show again where we are."""
        now = self._perception.iteration
        if self._is_underway(action):
            return  # it was sent again
        if action.iteration < now:
            self._show()
        elif self._is_late(action):
            self._late += 1
            self._show()
        elif not self._fits(action):
            pass
        elif not (self._acting.busy and self._acting.counted) and self._catches_up(action.iteration):
            self._next = action
        else:
            self.bus.refusals.add(keys.ACTION.path, f"iteration {action.iteration}; now is {now}")

    def _fits(self, action: messages.Action) -> bool:
        """Whether the body could carry out an action; else it is refused."""
        try:
            check(self._body.spec, action.action)
        except BodyError as error:
            self.bus.refusals.add(keys.ACTION.path, str(error))
            return False
        return True

    def _tick(self, ticks: Clock) -> bool:
        """Begin a period: with the action that came, or the last one held, or, when nobody commands, at rest."""
        if not ticks.tick(self._clock()):
            return False
        if self._acting.busy:
            ticks.miss()
        elif self._next is not None:
            self._begin(self._next)
        elif self._action is not None and not self._paused and self._clock() - self._heard_s <= self._hold_s:
            self._acting.begin(self._action.action, counted=False)
        else:
            self._rest()
            self._show()
        self._conclude()
        return True

    def _begin(self, action: messages.Action) -> None:
        self._action, self._next = action, None
        self._acting.begin(action.action)

    @property
    def _begun(self) -> int:
        """Actions begun, the one under way included."""
        return self._done + self._acting.busy

    @property
    def _halted(self) -> bool:
        """Whether the body was halted since the last action began."""
        return self._halted_at == self._begun

    def _rest(self) -> None:
        """Halt a body that nobody commands, once after each action; also while it acts, when that is so for long."""
        if self._acting.busy and self._clock() - self._heard_s < self._hold_s:
            return
        if not self._halted:
            self._halted_at = self._begun
            self._halts += 1
            self._acting.halt()

    def _is_late(self, action: messages.Action) -> bool:
        return self._deadlines and not 0.0 <= self._clock() - action.stamp <= action.valid_for_s

    def _catches_up(self, iteration: int) -> bool:
        """Bring the count to that of an action; whether it is to be done.

        A fresh body after a restart goes on with the brain's count, where it stands.
        """
        now = self._perception.iteration
        if iteration == now:
            self._elsewhere.nearer()
            return True
        if self._done and not self._elsewhere.believed(iteration, self._clock()):
            return False
        log.warning("going on with the brain's iteration", mine=now, iteration=iteration)
        self._course.count(iteration)
        return True

    def _conclude(self) -> bool:
        """Keep and show what an action led to, if one is over."""
        try:
            step = self._acting.outcome()
        except BodyError as error:
            self.bus.refusals.add(keys.ACTION.path, str(error))
            return True
        if step is None:
            return False
        held = step.iteration == self._perception.iteration
        self._done += not held
        self._perception = step.perception(self._perception.done if held else self._action)
        self._scene = step.scene()
        self._keep()
        self._show()
        return True

    def _keep(self) -> None:
        """Write where the robot is; on a disk that takes nothing a death now costs the steps since."""
        if self._file is None:
            return
        try:
            self._file.write(msgspec.structs.replace(self._course.state(), perception=self._perception))
        except OSError as error:
            if not self._refused:
                log.error("the robot's state cannot be written; a death now costs its last steps", reason=str(error))
            self._refused = True
            self._unwritten += 1
        else:
            if self._refused:
                log.info("the robot's state is written again", unwritten=self._unwritten)
            self._refused = False

    def _show(self) -> None:
        """Publish what is seen, with the time of now."""
        self._perception = msgspec.structs.replace(self._perception, stamp=self._clock())
        self._scenes.put(self._scene)
        watched = any(name.startswith(WATCHING) and name != SCRIPT for name in self.bus.alive())
        if watched and not self._acting.busy:  # a body that acts cannot be drawn: the last picture stays
            self._pictures.put(self._picture())
        self._perceptions.put(self._perception)

    def _picture(self) -> messages.Picture:
        """Return what the scene looks like, as far as the body can show it."""
        seen = self._perception
        try:
            return picture_of(self._body, seen.reading, seen.iteration)
        except BodyError as error:
            if not self._dark:
                log.warning("no image of the scene; those who watch see its numbers", reason=str(error))
            self._dark = True
            return messages.Picture(iteration=seen.iteration)

    def next_s(self) -> float:
        """See `Bounded`: a body that does not come back from an action is seen here, for it acts in a thread."""
        return 0.0 if self._acting.busy_s() > ACTION_S else SILENT_S

    def values(self) -> dict[str, float]:
        """Iteration, successes, actions that came too late, how often nobody commanded the body, changes that clients
        made, states that the disk did not take and whether it takes none now, how long the last action took, whether
        it is paused, and the least time of an action; of a clocked robot also its jitter, see `Clock.values`.
        """
        counts = {
            "iteration": self._perception.iteration,
            "successes": self._scene.successes,
            "late": self._late,
            "halts": self._halts,
            "changes": self._changes,
            "unwritten": self._unwritten,
            "disk_refuses": self._refused,
            "act_s": self._acting.took_s,
            "paused": self._paused,
            "least_s": self._acting.least_s,
        }
        clocked = {} if self._ticks is None else self._ticks.values()
        return {name: float(value) for name, value in counts.items()} | clocked

    def close(self) -> None:
        """Bring the body to rest, and free it."""
        self._acting.close()
        if self._file is not None:
            self._file.close()
