"""What the notes of each teacher mean, as far as it was announced; obedience is told by it."""

from __future__ import annotations

from collections import deque

from mdb_deploy.web.telling.plan import Plan
from mdb_protocol.messages import IterationReport, Lesson, Phase, Scene
from mdb_sim.teaching import policy as policies
from mdb_sim.teaching.languages import Language
from mdb_sim.teaching.policies.plain import Named

MOST_PHASES = 1000
MOST_LESSONS = 32
"""Lessons of one teacher that are remembered, ..."""
MOST_TEACHERS = 64
"""... and teachers."""


class Speech:
    """What the notes of each teacher mean, as far as it was announced: by phases and lessons."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self.phases: deque[Phase] = deque(maxlen=MOST_PHASES)
        self.lessons: dict[str, deque[Lesson]] = {}
        self._planned: dict[tuple[str, str], Language] = {}
        for phase in () if plan.schedule is None else plan.schedule.phases:
            if phase.teacher is not None and phase.language is not None:
                self._planned.setdefault((phase.name, phase.teacher), phase.language)

    def take(self, message: Phase | Lesson) -> bool:
        """Remember what was announced; return whether it is new."""
        if isinstance(message, Phase):
            if any(phase == message for phase in self.phases):
                return False
            self.phases.append(message)
            return True
        if message.teacher not in self.lessons and len(self.lessons) >= MOST_TEACHERS:
            del self.lessons[next(iter(self.lessons))]
        of = self.lessons.setdefault(message.teacher, deque(maxlen=MOST_LESSONS))
        if of and of[-1] == message:
            return False
        of.append(message)
        return True

    def lesson(self, teacher: str, iteration: int) -> Lesson | None:
        """Return the lesson of a teacher that holds in an iteration; None: none began, or it is over."""
        for lesson in reversed(self.lessons.get(teacher, ())):
            if lesson.iteration <= iteration:
                return None if lesson.over else lesson
        return None

    def phase(self, iteration: int) -> Phase | None:
        """Return the phase of an iteration, as far as it was announced."""
        return next((phase for phase in reversed(self.phases) if phase.iteration <= iteration), None)

    def language(self, teacher: str, iteration: int) -> Language | None:
        """Return what the notes of one of the experiment's own teachers mean."""
        phase = self.phase(iteration)
        if phase is not None and phase.teacher == teacher and (phase.name, teacher) in self._planned:
            return self._planned[phase.name, teacher]
        return self._plan.languages.get(teacher)

    def command(self, teacher: str | None, note: int, iteration: int) -> int | None:
        """Return the command of the policy that a note means; None: that is not known."""
        policy = self._plan.policy
        if policy is None or teacher is None:
            return None
        lesson = self.lesson(teacher, iteration)
        if lesson is not None:
            said = dict(zip(lesson.notes, lesson.commands, strict=True)).get(note)
            return policy.commands.index(said) if said in policy.commands else None
        language = self.language(teacher, iteration)
        return language.command(note) if language is not None and 0 <= note < len(language.notes) else None

    def obeyed(self, report: IterationReport, scene: Scene | None) -> bool | None:
        """Return whether what the note of an iteration meant was done before the scene; None: that is not known."""
        if report.note is None or scene is None or self._plan.policy is None or isinstance(self._plan.policy, Named):
            return None
        command = self.command(report.teacher, report.note, report.iteration)
        try:
            return None if command is None else policies.done(self._plan.policy, command, scene)
        except Exception:  # a mistake in a policy of somebody's own must not keep all else from those who watch
            return None
