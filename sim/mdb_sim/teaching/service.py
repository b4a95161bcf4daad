"""The scripted teacher as a service: sees the scene, plays the note of its language, rewards obedience.

Owns the phases of the experiment: who teaches when. An operator may end a phase early, and may silence the teacher:
then the phases go on, and nobody of the experiment's teaches in them. Never reads the brain's inside. It keeps two
things between scenes, which a restarted teacher begins anew: the feedback that a late teacher owes is lost, and one
who compares has no opinion yet of how well the robot does. A teacher who names no iteration does not judge the scene
that a restarted one finds: it may have been said, and twice said it would be for another action.
"""

from __future__ import annotations

from bisect import insort
from dataclasses import replace
from operator import itemgetter

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus, Publisher
from mdb_sim.teaching.schedule import Phase, Schedule
from mdb_sim.teaching.sound import Player

ROLE = "teacher"


class ScriptedTeacher:
    """See the module's docstring."""

    role, instance = ROLE, "script"

    def __init__(self, bus: Bus, schedule: Schedule, player: Player | None = None) -> None:
        """Teachers play their notes by `player`; without one they name them."""
        self.bus = bus
        self._player = player
        self._planned = self._schedule = schedule
        """As in the experiment file, and with the phases that an operator has ended early."""
        self._teaches = self._wanted = True
        """Whether it teaches, and whether the operator wants it to from the next scene on."""
        self._since = 0
        """The iteration since which it does, or does not."""
        names = {phase.teacher for phase in schedule.phases if phase.teacher}
        self._commands: dict[str, Publisher] = {n: bus.publisher(keys.COMMAND, teacher=n) for n in names}
        self._audio: dict[str, Publisher] = {n: bus.publisher(keys.AUDIO, teacher=n) for n in names if player}
        self._feedback: dict[str, Publisher] = {n: bus.publisher(keys.FEEDBACK, teacher=n) for n in names}
        self._silent: Publisher = bus.publisher(keys.COMMAND, teacher=self.instance)
        self._phases = bus.publisher(keys.PHASE)
        self._phase: Phase | None = None
        self._owed: list[tuple[int, messages.Feedback]] = []
        """Feedback of teachers who are late, with the iteration in which it is due, in that order."""
        self._usual: dict[str, float] = {}
        """The mean of each teacher's judgements of late, for those who compare."""
        self._iteration = -1
        self._rewards = 0
        self._scenes = bus.subscriber(keys.SCENE)
        self._controls = bus.subscriber(keys.CONTROL)

    def step(self) -> bool:
        """Judge the action that led to the newest scene, then command the next."""
        while (control := self._controls.take()) is not None:
            self._schedule, self._wanted = self._planned.with_ended(control.ended), control.script
        scene = self._scenes.take(lambda scene: 0 <= scene.iteration - self._iteration <= 1)
        if scene is None:
            return False
        self._turn(scene)
        self._judge(scene)
        self._command(scene)
        self._iteration = scene.iteration
        return True

    def _turn(self, scene: messages.Scene) -> None:
        """Begin to teach, or end it, if the operator wants that; to a scene that is shown again all is said."""
        if self._wanted != self._teaches:
            self._teaches = self._wanted
            self._since = scene.iteration + (scene.iteration == self._iteration)
            self._owed.clear()

    def _at(self, iteration: int) -> Phase:
        """Return the phase of an iteration; nobody teaches in it while the operator does not want it."""
        phase, since = self._schedule.at(iteration), iteration >= self._since
        if since and phase.teacher is not None:
            phase = replace(phase, start=max(phase.start, self._since))
        return phase if self._teaches == since else replace(phase, teacher=None, language=None)

    def _judge(self, scene: messages.Scene) -> None:
        """Give the feedback that is due, and say "not now" where it comes later, or not at all."""
        while self._owed and self._owed[0][0] <= scene.iteration:
            self._reward(self._owed.pop(0)[1])
        iteration = scene.iteration - 1
        if iteration < 0 or scene.iteration == self._iteration:  # a robot that waits shows it again
            return
        phase = self._at(iteration)
        if phase.teacher is None:
            return
        named = iteration if phase.habits.named else None
        if not self._teaches:  # the brain need not wait for it
            self._reward(messages.Feedback(teacher=phase.teacher, iteration=named, value=None))
            return
        try:
            judgement = self._schedule.judgement(iteration, scene)
        except LookupError as error:
            self.bus.refusals.add(keys.SCENE.path, f"no {error} in the scene; the policy looks at it")
            return
        if judgement is None:
            self._reward(messages.Feedback(teacher=phase.teacher, iteration=named, value=None))
            return
        value = self._schedule.said(iteration, judgement, self._compare(phase, phase.teacher, judgement))
        if not phase.habits.named and self._iteration < 0:
            value = None
        delay = self._schedule.delay(iteration)
        if delay and value is not None:
            owed = messages.Feedback(teacher=phase.teacher, iteration=named, value=value)
            insort(self._owed, (scene.iteration + delay, owed), key=itemgetter(0))
            value = None
        self._reward(messages.Feedback(teacher=phase.teacher, iteration=named, value=value))

    def _compare(self, phase: Phase, teacher: str, judgement: float) -> float:
        """Return a teacher's mean judgement before this one, which from now on is in it; 0 if he does not compare."""
        usual = self._usual.get(teacher, 0.0)
        if phase.habits.relative:
            self._usual[teacher] = usual + (judgement - usual) / phase.habits.relative
        return usual

    def _reward(self, message: messages.Feedback) -> None:
        self._feedback[message.teacher].put(message)
        self._rewards += message.value is not None

    def _command(self, scene: messages.Scene) -> None:
        phase = self._at(scene.iteration)
        before = self._phase or self._schedule.at(max(0, scene.iteration - 1))  # as the one knew who died before us
        if phase != self._phase:
            self._phases.put(messages.Phase(iteration=phase.start, name=phase.name, teacher=phase.teacher))
        if phase.teacher is None or phase.language is None:
            self._silent.put(messages.Command(teacher=self.instance, iteration=scene.iteration, note=None))
        else:
            note = self._note(scene)
            self._say(phase.teacher, scene.iteration, note)
        self._phase = phase
        if before.teacher is not None and before.teacher != phase.teacher:
            # He is silent from now on, so that the other is obeyed; said after the other's note, which else could
            # come too late.
            self._say(before.teacher, scene.iteration, None)

    def _note(self, scene: messages.Scene) -> int | None:
        try:
            return self._schedule.note(scene.iteration, scene.now)
        except LookupError as error:
            self.bus.refusals.add(keys.SCENE.path, f"no {error} in the scene; the policy looks at it")
            return None

    def _say(self, teacher: str, iteration: int, note: int | None) -> None:
        if self._player is None:
            self._commands[teacher].put(messages.Command(teacher=teacher, iteration=iteration, note=note))
            return
        for frame in self._player.frames(teacher, iteration, note):
            self._audio[teacher].put(frame)

    def values(self) -> dict[str, float]:
        """Last iteration seen, rewards and punishments given, and whether an operator has silenced it."""
        values = {"iteration": self._iteration, "rewards": self._rewards, "silenced": not self._teaches}
        return {name: float(value) for name, value in values.items()}

    def close(self) -> None:
        """Nothing to free."""
