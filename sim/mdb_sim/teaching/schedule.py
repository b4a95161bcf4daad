"""Who teaches when and in which language: the phases of an experiment.

Owns the `[teacher]` section. Pure: what is wanted and how an action is judged is in `teacher`.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import Annotated, Literal

from msgspec import Meta

from mdb_services.experiment.sections import Name, Probability, Section
from mdb_services.mechanism.networks import streams
from mdb_sim.body import Placement, RobotConfig
from mdb_sim.teaching.sound import SoundSection
from mdb_sim.teaching.teacher import FEEDBACKS, FeedbackKind, Language, TeacherError, make_language, wanted_action

DRAWN = "random"
"""A language drawn from the run's seed, unlike those of the other teachers."""
DRAWS = 1000
"""Languages drawn until one is unlike the others; for seven actions the second draw nearly always is."""


class Habits(Section, frozen=True, kw_only=True):
    """How a teacher errs, what of his judgement he says, and when. All of it can be combined, in this order."""

    wrong_notes: Probability = 0.0
    """How often the teacher plays another note than the one meant."""
    wrong_feedback: Probability = 0.0
    """How often the teacher rewards for punishing, and the other way round."""
    relative: Annotated[int, Meta(ge=0, le=10_000)] = 0
    """He compares with how well the robot does of late (COACH): feedback is the judgement less the mean of about so
    many judgements before it, cut to [-1, 1]. 0: he does not compare."""
    praise_half_life: Annotated[int, Meta(ge=1, le=1_000_000)] | None = None
    """So many iterations after the phase began praise is worth half, then a quarter; punishment stays."""
    says: Literal["all", "praise", "punishment"] = "all"
    """"praise": he praises and says nothing instead of punishing; "punishment": the other way round."""
    judged: Probability = 1.0
    """How often the teacher judges at all; otherwise he says "not now"."""
    delay: Annotated[int, Meta(ge=0, le=1000)] = 0
    """So many iterations late comes the feedback, ..."""
    delay_spread: Annotated[int, Meta(ge=0, le=1000)] = 0
    """... or so many more or less, each equally often."""
    named: bool = True
    """Whether feedback says which iteration it is for."""

    def __post_init__(self) -> None:
        if self.delay_spread > self.delay:
            raise ValueError(
                f"delay_spread is {self.delay_spread} and delay {self.delay}; expected at most the delay: feedback "
                "cannot come before its action"
            )

    def said(self, value: float, usual: float, age: int) -> float | None:
        """Return what is said of a judgement in [-1, 1]; None: nothing.

        usual: the mean of the judgements of late; age: iterations since the phase began.
        """
        if self.relative:
            value = min(1.0, max(-1.0, value - usual))
        if self.praise_half_life is not None and value > 0.0:
            value *= 0.5 ** (age / self.praise_half_life)
        silent = value > 0.0 if self.says == "punishment" else value < 0.0 and self.says == "praise"
        return None if silent else value


class PhaseSection(Habits, frozen=True, kw_only=True):
    """`[[teacher.phase]]`: from iteration `start` on; without a teacher the robot is alone."""

    start: Annotated[int, Meta(ge=0)]
    name: Annotated[str, Meta(min_length=1, max_length=100)]
    teacher: Name | None = None
    language: str | None = None
    """"random", or any language of `teacher.make_language`; the same teacher keeps it in later phases."""


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
    habits: Habits


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
        if rng.random() < phase.habits.wrong_notes:
            others = [other for other in phase.language.notes if other != note]
            note = int(rng.choice(others))
        return note

    def judgement(self, iteration: int, placement: Placement, action: int) -> float:
        """Return how good an action is, in an iteration that began here, as the teacher sees it: he may err."""
        value = FEEDBACKS[self.feedback](self.wanted(placement), action, self.turns_rad)
        mistaken = streams.generator(self.seed, "teacher/feedback", iteration).random()
        return -value if mistaken < self.at(iteration).habits.wrong_feedback else value

    def said(self, iteration: int, judgement: float, usual: float = 0.0) -> float | None:
        """Return the feedback for a judgement; None: nothing is said. usual: the mean of the judgements of late."""
        phase = self.at(iteration)
        if streams.generator(self.seed, "teacher/judged", iteration).random() >= phase.habits.judged:
            return None
        return phase.habits.said(judgement, usual, iteration - phase.start)

    def delay(self, iteration: int) -> int:
        """Return how many iterations late the feedback for an iteration comes."""
        habits = self.at(iteration).habits
        if not habits.delay_spread:
            return habits.delay
        rng = streams.generator(self.seed, "teacher/delay", iteration)
        return habits.delay + int(rng.integers(-habits.delay_spread, habits.delay_spread + 1))


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
        phases.append(Phase(phase.start, phase.name, phase.teacher, language, phase))
    return Schedule(tuple(phases), world.turns_rad, section.feedback, seed)


def _language(name: str, teacher: str, seed: int, world: RobotConfig, taken: list[tuple[int, ...]]) -> Language:
    if name != DRAWN:
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
