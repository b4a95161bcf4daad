"""Who teaches when and in which language: the phases of an experiment.

Owns the `[teacher]` section. Pure: what is wanted and how what happened is judged is in `policy`.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from mdb_protocol import messages
from mdb_services.experiment.sections import Name, Probability, Section
from mdb_services.mechanism.networks import streams
from mdb_sim.teaching.languages import Language, TeacherError, make_language
from mdb_sim.teaching.policy import OBEYED, Policy, judgement, make_policy
from mdb_sim.teaching.sound import SoundSection

DRAWN = "random"
"""A language drawn from the run's seed, unlike those of the other teachers; of one command there is only one."""
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
    """`[teacher]`: what the scripted teachers want, how they judge, and the phases."""

    policy: str = "reach"
    """One of `policy.POLICIES`, or "package.module:Factory"."""
    options: dict[str, Any] = msgspec.field(default_factory=dict)
    """What the policy is made with."""
    feedback: Literal["graded", "binary"] = "graded"
    """"graded": the judgement itself; "binary": 1 for obedience, -1 for all else, much harder to learn from."""
    sound: SoundSection | None = None
    """How the notes sound; without it the teachers name them."""
    phase: tuple[PhaseSection, ...] = ()
    """When who teaches; without any, nobody does by himself: then this section says what people can want."""


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
    policy: Policy
    binary: bool
    seed: int

    def at(self, iteration: int) -> Phase:
        """Return the phase of an iteration."""
        return self.phases[bisect_right(self.phases, iteration, key=lambda phase: phase.start) - 1]

    def with_ended(self, ended: Iterable[int]) -> Schedule:
        """Return the schedule in which the phase that goes on at each of these iterations ends with it.

        The next phase begins with the next iteration, and all later ones begin earlier by as much. The last phase has
        no next one: it goes on.
        """
        phases = list(self.phases)
        for iteration in sorted(ended):
            following = bisect_right(phases, iteration, key=lambda phase: phase.start)
            if following < len(phases):
                earlier = phases[following].start - (iteration + 1)
                phases[following:] = [
                    replace(p, start=p.start - earlier) if earlier else p for p in phases[following:]
                ]
        return replace(self, phases=tuple(phases))

    def note(self, iteration: int, scene: Mapping[str, float]) -> int | None:
        """Return the note that is played for an iteration that begins here; None: silence."""
        phase, wanted = self.at(iteration), self.policy.want(scene)
        if phase.language is None or wanted is None:
            return None
        note = phase.language.note(wanted)
        rng = streams.generator(self.seed, "teacher/note", iteration)
        if rng.random() < phase.habits.wrong_notes:
            others = [other for other in phase.language.notes if other != note]
            note = int(rng.choice(others))
        return note

    def judgement(self, iteration: int, scene: messages.Scene) -> float | None:
        """Return how good what happened in an iteration is, as the teacher sees it: he may err. None: no judgement.

        The iteration is the one that led to the scene.
        """
        found = judgement(self.policy, scene)
        if found is None:
            return None
        value = graded(found, binary=self.binary)
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


def graded(judgement: float, *, binary: bool) -> float:
    """Return a judgement as it is said, or, of a teacher who knows obedience only, 1 for it and -1 for all else."""
    if not binary:
        return judgement
    return 1.0 if judgement >= OBEYED else -1.0


def schedule_of(section: TeacherSection, seed: int, folder: Path | None = None) -> Schedule:
    """Return the schedule of a `[teacher]` section; TeacherError when its policy or its phases make none."""
    policy = make_policy(section.policy, section.options, folder)
    starts = [phase.start for phase in section.phase]
    if starts[:1] != [0] or starts != sorted(set(starts)):
        raise TeacherError(f"phases start at {starts}; expected 0 first and then growing iterations")
    languages: dict[str, Language] = {}
    phases = []
    for phase in section.phase:
        if phase.teacher is None and phase.language is not None:
            raise TeacherError(f'phase {phase.name!r}: a language needs its teacher; add teacher = "NAME"')
        if phase.teacher is not None and phase.language is not None:
            taken = [language.notes for name, language in languages.items() if name != phase.teacher]
            languages[phase.teacher] = _language(phase.language, phase.teacher, seed, policy, taken)
        if phase.teacher is not None and phase.teacher not in languages:
            raise TeacherError(f"phase {phase.name!r}: teacher {phase.teacher!r} needs a language")
        language = languages[phase.teacher] if phase.teacher else None
        if phase.wrong_notes > 0 and len(policy.commands) == 1:
            raise TeacherError(
                f"phase {phase.name!r}: wrong_notes is {phase.wrong_notes}, but policy {section.policy!r} has one "
                "command, and there is no wrong note; expected 0"
            )
        phases.append(Phase(phase.start, phase.name, phase.teacher, language, phase))
    return Schedule(tuple(phases), policy, section.feedback == "binary", seed)


def _language(name: str, teacher: str, seed: int, policy: Policy, taken: list[tuple[int, ...]]) -> Language:
    if name != DRAWN:
        return make_language(name, policy.order)
    for counter in range(DRAWS):
        key = streams.key(seed, f"language/{teacher}/{counter}")
        language = make_language(f"random:{key}", policy.order)
        if language.notes not in taken or len(policy.commands) == 1:
            return language
    raise TeacherError(
        f"no language is left for teacher {teacher!r}: {len(taken)} others speak those that "
        f"{len(policy.commands)} commands allow; expected fewer teachers, or a language given by name"
    )
