"""Who teaches when and in which language: the phases of an experiment.

Owns the `[teacher]` section. Pure: what is wanted and how an action is judged is in `teacher`.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta

from mdb_services.config import Name, Probability, Section
from mdb_services.mechanism import streams
from mdb_sim.robot import Placement, RobotConfig
from mdb_sim.sound import SoundSection
from mdb_sim.teacher import FEEDBACKS, FeedbackKind, Language, TeacherError, make_language, wanted_action

RANDOM = "random"
"""A language drawn from the run's seed, unlike those of the other teachers."""
DRAWS = 1000
"""Languages drawn until one is unlike the others; for seven actions the second draw nearly always is."""


class PhaseSection(Section, frozen=True, kw_only=True):
    """`[[teacher.phase]]`: from iteration `start` on; without a teacher the robot is alone."""

    start: Annotated[int, Meta(ge=0)]
    name: Annotated[str, Meta(min_length=1, max_length=100)]
    teacher: Name | None = None
    language: str | None = None
    """"random", or any language of `teacher.make_language`; the same teacher keeps it in later phases."""
    wrong_notes: Probability = 0.0
    """How often the teacher plays another note than the one meant."""
    wrong_feedback: Probability = 0.0
    """How often the teacher rewards for punishing, and the other way round."""
    delay: Annotated[int, Meta(ge=0, le=1000)] = 0
    """So many iterations late comes the feedback."""


class TeacherSection(Section, frozen=True, kw_only=True):
    """`[teacher]`: how the scripted teacher judges, and its phases."""

    feedback: FeedbackKind = "graded"
    sound: SoundSection | None = None
    """How the notes sound; without it the teachers name them."""
    phase: Annotated[tuple[PhaseSection, ...], Meta(min_length=1)]


@dataclass(frozen=True)
class Phase:
    """From iteration `start` on `teacher` teaches in `language`; None and None: nobody does."""

    start: int
    name: str
    teacher: str | None
    language: Language | None
    wrong_notes: float = 0.0
    wrong_feedback: float = 0.0
    delay: int = 0


@dataclass(frozen=True)
class Schedule:
    """The phases in order, and how their teachers see and judge."""

    phases: tuple[Phase, ...]
    turns_rad: tuple[float, ...]
    feedback: FeedbackKind
    seed: int

    def at(self, iteration: int) -> Phase:
        """Return the phase of an iteration."""
        return self.phases[bisect_right(self.phases, iteration, key=lambda phase: phase.start) - 1]

    def wanted(self, placement: Placement) -> int:
        """Return the action that a teacher commands here."""
        return wanted_action(placement, self.turns_rad)

    def note(self, iteration: int, placement: Placement) -> int | None:
        """Return the note that is played for an iteration that begins here; None: nobody teaches."""
        phase = self.at(iteration)
        if phase.language is None:
            return None
        note = phase.language.note(self.wanted(placement))
        rng = streams.generator(self.seed, "teacher/note", iteration)
        if rng.random() < phase.wrong_notes:
            others = [other for other in phase.language.notes if other != note]
            note = int(rng.choice(others))
        return note

    def judge(self, iteration: int, placement: Placement, action: int) -> float:
        """Return the feedback for an action done in an iteration that began here."""
        value = FEEDBACKS[self.feedback](self.wanted(placement), action, self.turns_rad)
        mistaken = streams.generator(self.seed, "teacher/feedback", iteration).random()
        return -value if mistaken < self.at(iteration).wrong_feedback else value


def schedule_of(section: TeacherSection, seed: int, world: RobotConfig) -> Schedule:
    """Return the schedule of a `[teacher]` section; TeacherError when its phases make none."""
    starts = [phase.start for phase in section.phase]
    if starts[0] != 0 or starts != sorted(set(starts)):
        raise TeacherError(f"phases start at {starts}; expected 0 first and then growing iterations")
    languages: dict[str, Language] = {}
    phases = []
    for phase in section.phase:
        if phase.teacher is None and phase.language is not None:
            raise TeacherError(f'phase {phase.name!r}: a language needs its teacher; add teacher = "NAME"')
        if phase.teacher is not None and phase.language is not None:
            taken = [language.notes for name, language in languages.items() if name != phase.teacher]
            languages[phase.teacher] = _language(phase.language, phase.teacher, seed, world, taken)
        if phase.teacher is not None and phase.teacher not in languages:
            raise TeacherError(f"phase {phase.name!r}: teacher {phase.teacher!r} needs a language")
        language = languages[phase.teacher] if phase.teacher else None
        mistakes = phase.wrong_notes, phase.wrong_feedback, phase.delay
        phases.append(Phase(phase.start, phase.name, phase.teacher, language, *mistakes))
    return Schedule(tuple(phases), world.turns_rad, section.feedback, seed)


def _language(name: str, teacher: str, seed: int, world: RobotConfig, taken: list[tuple[int, ...]]) -> Language:
    if name != RANDOM:
        return make_language(name, world.turns_deg)
    for counter in range(DRAWS):
        key = streams.key(seed, f"language/{teacher}/{counter}")
        language = make_language(f"random:{key}", world.turns_deg)
        if language.notes not in taken:
            return language
    raise TeacherError(
        f"no language is left for teacher {teacher!r}: {len(taken)} others speak those that {len(world.turns_deg)} "
        "actions allow; expected fewer teachers, or a language given by name"
    )
