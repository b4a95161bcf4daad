"""The scripted teacher as a service: sees the scene, plays the note of its language, rewards obedience.

Owns the phases of the experiment: who teaches when. Never reads the brain's inside. It keeps nothing
between scenes but the feedback of a teacher who is late, so a restarted teacher goes on where the old one was.
"""

from __future__ import annotations

from collections import deque

import msgspec

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus, Publisher
from mdb_sim.robot import Placement, Pose
from mdb_sim.schedule import Phase, Schedule
from mdb_sim.teacher import TeacherError

ROLE = "teacher"


class ScriptedTeacher:
    """See the module's docstring."""

    role, instance = ROLE, "script"

    def __init__(self, bus: Bus, schedule: Schedule) -> None:
        self.bus = bus
        self._schedule = schedule
        names = {phase.teacher for phase in schedule.phases if phase.teacher}
        self._commands: dict[str, Publisher] = {n: bus.publisher(keys.COMMAND, teacher=n) for n in names}
        self._feedback: dict[str, Publisher] = {n: bus.publisher(keys.FEEDBACK, teacher=n) for n in names}
        self._silent: Publisher = bus.publisher(keys.COMMAND, teacher=self.instance)
        self._phases = bus.publisher(keys.PHASE)
        self._phase: Phase | None = None
        self._owed: deque[tuple[int, messages.Feedback]] = deque()
        """Feedback of teachers who are late, with the iteration in which it is due."""
        self._iteration = -1
        self._rewards = 0
        self._scenes = bus.subscriber(keys.SCENE)

    def step(self) -> bool:
        """Judge the action that led to the newest scene, then command the next."""
        scene = self._scenes.take()
        if scene is None:
            return False
        self._judge(scene)
        self._command(scene)
        self._iteration = scene.iteration
        return True

    def _judge(self, scene: messages.Scene) -> None:
        """Give the feedback that is due, and say "not now" where it comes later."""
        while self._owed and self._owed[0][0] <= scene.iteration:
            self._reward(self._owed.popleft()[1])
        if scene.action is None or scene.before is None:
            return
        phase = self._schedule.at(scene.iteration - 1)
        if phase.teacher is None:
            return
        try:
            value = self._schedule.judge(scene.iteration - 1, _placement(scene.before), scene.action)
        except TeacherError as error:
            self.bus.refusals.add(keys.SCENE.path, str(error))
            return
        message = messages.Feedback(teacher=phase.teacher, iteration=scene.iteration - 1, value=value)
        if phase.delay:
            self._owed.append((scene.iteration + phase.delay, message))
            message = msgspec.structs.replace(message, value=None)
        self._reward(message)

    def _reward(self, message: messages.Feedback) -> None:
        self._feedback[message.teacher].put(message)
        self._rewards += message.value is not None

    def _command(self, scene: messages.Scene) -> None:
        phase = self._schedule.at(scene.iteration)
        if phase is not self._phase:
            self._leave(scene.iteration, phase.teacher)
            self._phase = phase
            self._phases.put(messages.Phase(iteration=phase.start, name=phase.name, teacher=phase.teacher))
        if phase.teacher is None or phase.language is None:
            self._silent.put(messages.Command(teacher=self.instance, iteration=scene.iteration, note=None))
            return
        note = self._schedule.note(scene.iteration, _placement(scene.now))
        self._commands[phase.teacher].put(
            messages.Command(teacher=phase.teacher, iteration=scene.iteration, note=note)
        )

    def _leave(self, iteration: int, now: str | None) -> None:
        """Let the teacher of the phase before say that he is silent from now on, which frees the word."""
        before = self._phase.teacher if self._phase else None
        if before is not None and before != now:
            self._commands[before].put(messages.Command(teacher=before, iteration=iteration, note=None))

    def values(self) -> dict[str, float]:
        """Last iteration seen, and rewards and punishments given."""
        return {"iteration": float(self._iteration), "rewards": float(self._rewards)}

    def close(self) -> None:
        """Nothing to free."""


def _placement(seen: messages.Placement) -> Placement:
    return Placement(Pose(seen.x_m, seen.y_m, seen.heading_rad), seen.object_x_m, seen.object_y_m)
