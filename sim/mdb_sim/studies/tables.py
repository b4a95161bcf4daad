"""The studies: which variants of an experiment each of them compares, as overrides of the experiment file.

Owns the tables. Overrides are computed from the experiment itself, so that they fit any file. To add a variant,
add a line here; to add a study, add it to `catalogue`, to `VARIANTS` here, and to `report.sections`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence

import msgspec

from mdb_services.experiment.brain import BrainConfig
from mdb_services.mechanism.memories.stm import MemoryConfig
from mdb_services.mechanism.settings import EvolutionConfig
from mdb_sim.runs.experiment import Experiment
from mdb_sim.studies import machines
from mdb_sim.studies.catalogue import ACCEPTANCE, PHASE, Study, Variant
from mdb_sim.studies.ideal import KNOWN_BODIES

AS_SHIPPED = "as shipped"
PROMOTERS = "pbga"
"""The learner whose promoters "promoters off" takes away, and as which the shipped one is known."""
LEARNERS = ("ga", "de", "cma", "adam", "ridge")
COMINGS = ("A", "B", "A", "B", "A")
"""Who teaches, phase by phase, where teachers return."""
LIFE = 5
"""Teachers of a long life, one after the other."""
SMALLER = 4
"""Smaller memories hold this part of the pairs."""
KINEMATIC = "robot.body=kinematic"
"""Studies are run with the kinematic twin unless the command line says another body."""

Overrides = tuple[str, ...]


Variants = Callable[[Experiment], list[Variant]]


# ---- what a variant changes ----


def without_promoters(brain: BrainConfig) -> Overrides:
    """Return what makes the promoter-based learner a plain one."""
    evolved = [model for model in brain.model if brain.learner_of(model)[0] == PROMOTERS]
    return _where({model.name: "name" in model.learner for model in evolved}, "learner.name=ga")


def without_committees(brain: BrainConfig) -> Overrides:
    """Return one learner a model, with the population of all members together."""
    overrides = []
    for model in brain.model:
        settings = brain.learner_of(model)[1]
        if model.members > 1:
            overrides.append(f"model.{model.name}.members=1")
            if isinstance(settings, EvolutionConfig):
                overrides.append(f"model.{model.name}.evolution.population={settings.population * model.members}")
    return tuple(overrides)


def without_long_term(brain: BrainConfig) -> Overrides:
    """Return what takes the long-term memory away."""
    stored = [model for model in brain.model if brain.long_term_of(model).capacity > 0]
    return _where({model.name: "capacity" in model.long_term for model in stored}, "long_term.capacity=0")


def without_context(brain: BrainConfig) -> Overrides:
    """Return what takes the detector of changes of context away."""
    watched = [model for model in brain.model if brain.context_of(model).enabled]
    return _where({model.name: "enabled" in model.context for model in watched}, "context.enabled=false")


def first_in_first_out(brain: BrainConfig) -> Overrides:
    """Return what makes recency alone decide which pair leaves a memory."""
    others = "".join(f", {term}=0.0" for term in brain.memory if term != "recency")
    labelled = [model for model in brain.model if brain.memory_of(model) != MemoryConfig()]
    return tuple(f"model.{model.name}.memory={{recency=1.0{others}}}" for model in labelled)


def punishments_not_kept(brain: BrainConfig) -> Overrides:
    """Return what makes pairs alike that began alike, however they ended: the older leaves."""
    keeping = [model for model in brain.model if brain.memory_of(model).outcome > 0]
    return _where({model.name: "outcome" in model.memory for model in keeping}, "memory.outcome=0")


def without_support(brain: BrainConfig) -> Overrides:
    """Return modes that believe a model wherever they ask it.

    All modes, written anew: a setting cannot be taken back, and a great reach is not none, for what is supported
    everywhere is hardly explored.
    """
    if all(mode.reach is None for mode in brain.mode):
        return ()
    plain = [msgspec.structs.asdict(mode) | {"reach": None} for mode in brain.mode]
    entries = [{name: value for name, value in mode.items() if value is not None} for mode in plain]
    texts = [", ".join(f"{name}={_toml(value)}" for name, value in mode.items()) for mode in entries]
    return (f"mode=[{', '.join(f'{{{text}}}' for text in texts)}]",)


def without_aspiration(brain: BrainConfig) -> Overrides:
    """Return what takes away the exploration of a robot that is promised too little, curiosity among it."""
    aspiring = [mode for mode in brain.mode if mode.aspiration is not None]
    exploring = [
        (mode.name, name) for mode in aspiring for name in ("exploration", "curiosity") if getattr(mode, name)
    ]
    return tuple(f"mode.{mode}.{name}=0" for mode, name in exploring)


def praise_as_given(brain: BrainConfig) -> Overrides:
    """Return what makes praise count as it was given, however much it fades."""
    return ("optimizer.praise_window=0",) if brain.optimizer.praise_window else ()


def scalar_note(brain: BrainConfig) -> Overrides:
    """Return what makes the note one number."""
    notes = brain.variables()["note"].indices if "note" in brain.channels else None
    return () if notes is None else (f"channels.note={{low=0, high={notes - 1}}}",)


def listed_actions(brain: BrainConfig) -> Overrides:
    """Return what makes the action one number, its place in the paper's listing, wherever it is read."""
    listed = f"channels.action={{low=0, high={len(brain.choice) - 1}}}"
    reading = [model for model in brain.model if set(model.inputs) & set(brain.actuators)]
    inputs = {m.name: ["action" if name in brain.actuators else name for name in m.inputs] for m in reading}
    return (listed, *(f"model.{name}.inputs={json.dumps(read)}" for name, read in inputs.items()))


def smaller_memories(brain: BrainConfig) -> Overrides:
    """Return memories of a quarter of the pairs."""
    smaller = {model.name: max(1, model.capacity // SMALLER) for model in brain.model}
    return tuple(f"model.{name}.capacity={capacity}" for name, capacity in smaller.items())


def learner(brain: BrainConfig, name: str) -> Overrides:
    """Return what makes every model learn by one such learner."""
    own = {model.name: bool(model.learner) for model in brain.model}
    return without_committees(brain) + _where(own, f'learner={{name="{name}"}}')


def _where(own: Mapping[str, bool], override: str) -> Overrides:
    """Return a file-level override for models that take the file's setting, and one each for those with their own."""
    of = [f"model.{name}.{override}" if its_own else override for name, its_own in own.items()]
    return tuple(dict.fromkeys(of))


def taught(experiment: Experiment, **settings: str | float | bool) -> Overrides:
    """Return these settings for every phase in which somebody teaches."""
    phases = experiment.teacher.phase if experiment.teacher is not None else ()
    return tuple(
        f"teacher.phase.{phase.name}.{name}={_toml(value)}"
        for phase in phases
        if phase.teacher is not None
        for name, value in settings.items()
    )


def _toml(value: str | float | bool) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else f"{value}"


def phases(who: Sequence[str | None], iterations: int) -> Overrides:
    """Return a schedule: who teaches in each phase of so many iterations; None: nobody."""
    entries = []
    for place, teacher in enumerate(who):
        coming = who[: place + 1].count(teacher)
        returns = who.count(teacher) > 1
        name = f"alone {coming}" if teacher is None else f"{teacher}, coming {coming}" if returns else teacher
        of = "" if teacher is None else f', teacher="{teacher}"'
        language = ', language="random"' if teacher is not None and coming == 1 else ""
        entries.append(f'{{start={place * iterations}, name="{name}"{of}{language}}}')
    return f"experiment.iterations={len(who) * iterations}", f"teacher.phase=[{', '.join(entries)}]"


# ---- the tables ----

PUNISHMENTS = "punishments kept"
PRAISE = "praise by the best of late"
DEPENDENT = (PUNISHMENTS, PRAISE)
"""What alone does nothing: part of the memory by relevance, and what matters only where praise fades."""
ADDITIONS: tuple[tuple[str, Callable[[BrainConfig], Overrides]], ...] = (
    ("notes without order", scalar_note),
    ("actions in the actuators' order", listed_actions),
    ("memory by relevance", first_in_first_out),
    (PUNISHMENTS, punishments_not_kept),
    ("detector of changes", without_context),
    ("committees", without_committees),
    (PRAISE, praise_as_given),
    ("support", without_support),
    ("aspiration", without_aspiration),
    ("long-term memory", without_long_term),
)
"""What we add to the paper as it is written, and what takes it away again; in this order, for what takes support away
writes all modes anew."""
AS_WRITTEN = "paper as written"


def reproduction(experiment: Experiment) -> list[Variant]:
    """Graded reward, as shipped, and the binary one."""
    del experiment
    graded, binary = 'teacher.feedback="graded"', 'teacher.feedback="binary"'
    return [Variant("graded reward", (graded,)), Variant("binary reward", (binary,))]


def paper(experiment: Experiment) -> list[Variant]:
    """As shipped, the paper as written, and each addition: alone, and all others without it."""
    without = {name: away(experiment.brain) for name, away in ADDITIONS}

    def but(kept: Iterable[str]) -> Overrides:
        return tuple(override for name, away in without.items() if name not in kept for override in away)

    found = [Variant(AS_SHIPPED), Variant(AS_WRITTEN, but(()))]
    alone = {name: bool(away) and name not in DEPENDENT for name, away in without.items()}
    found += [Variant(f"written + {name}", but((name,)), applies=applies) for name, applies in alone.items()]
    return found + [Variant(f"shipped - {name}", away, applies=bool(away)) for name, away in without.items()]


KNOWS = "knows the language"
"""A player who obeys each note as it sounds."""
AS_GIVEN = "counted as given"
"""Praise that the brain does not measure by the best of late."""
Setting = str | float | bool
TEACHERS: tuple[tuple[str, dict[str, Setting]], ...] = (
    ("30 % judged", {"judged": 0.3}),
    *((f"late by {n}", dict[str, Setting](delay=n)) for n in range(1, 6)),
    *((f"late by {n}, not named", dict[str, Setting](delay=n, named=False)) for n in range(1, 6)),
    ("late by 1 to 3, not named", {"delay": 2, "delay_spread": 1, "named": False}),
    ("10 % wrong notes", {"wrong_notes": 0.1}),
    ("20 % wrong notes", {"wrong_notes": 0.2}),
    ("10 % wrong feedback", {"wrong_feedback": 0.1}),
    ("20 % wrong feedback", {"wrong_feedback": 0.2}),
    ("praise that fades (half in 100)", {"praise_half_life": 100}),
    ("praise relative to the last 20", {"relative": 20}),
    ("praises only", {"says": "praise"}),
    ("punishes only", {"says": "punishment"}),
)
"""Teachers as they are: settings of a `[[teacher.phase]]`."""


def teachers(experiment: Experiment) -> list[Variant]:
    """A perfect teacher, a binary one, and all of `TEACHERS`, in both taught phases."""
    found = [Variant("perfect"), Variant("binary", ('teacher.feedback="binary"',))]
    for name, settings in TEACHERS:
        found.append(Variant(name, taught(experiment, **settings)))
        if "wrong_notes" in settings:
            # Nobody can do what was meant where another note sounds: the bound is lower than the ideal.
            found.append(Variant(f"{name}: {KNOWS}", taught(experiment, **settings), player="obedient"))
        if {"praise_half_life", "relative"} & settings.keys():
            given = praise_as_given(experiment.brain)
            found.append(
                Variant(f"{name}: {AS_GIVEN}", (*taught(experiment, **settings), *given), applies=bool(given))
            )
    return found


def learners(experiment: Experiment) -> list[Variant]:
    """Every learner for all models, and players without our mechanism."""
    found = [Variant(f"{PROMOTERS} (as shipped)")]
    found += [Variant(f"{name} for all models", learner(experiment.brain, name)) for name in LEARNERS]
    return [
        *found,
        Variant("Gaussian processes", player="gaussian"),
        Variant(KNOWS, player="obedient"),
        Variant("ideal policy", player="ideal"),
        Variant("random", player="random"),
    ]


LONG_TERM_ON, LONG_TERM_OFF = "long-term memory on", "long-term memory off"


def comings(experiment: Experiment) -> list[Variant]:
    """Long-term memory on and off."""
    without = without_long_term(experiment.brain)
    return [Variant(LONG_TERM_ON), Variant(LONG_TERM_OFF, without, applies=bool(without))]


def memory(experiment: Experiment) -> list[Variant]:
    """Long-term memory on and off, with teachers who never err and with two kinds who do."""
    wrong_notes, wrong_feedback = taught(experiment, wrong_notes=0.1), taught(experiment, wrong_feedback=0.1)
    found = []
    for teacher, errors in (("", ()), (", 10 % wrong notes", wrong_notes), (", 10 % wrong feedback", wrong_feedback)):
        for variant in comings(experiment):
            settings = (*variant.overrides, *errors)
            found.append(Variant(f"{variant.name}{teacher}", settings, applies=variant.applies))
    return found


CHANGED_AT = 600
"""The iteration before whose action the body changes."""
WINDOW = 150
"""Iterations of the windows at and after a change."""
BODY_CHANGES: tuple[tuple[str, dict[str, object]], ...] = (
    ("no change", {}),
    ("motors swapped", {"swapped": True}),
    ("half turns", {"turn_share": 0.5}),
    ("left wheel at half", {"left_wheel": 0.5}),
    ("three sonars blind", {"blind": [2, 3, 4]}),
    ("object moved once", {"object_x_m": 1.0, "object_y_m": 0.6}),
)
"""What changes of a Pioneer: settings of `[[robot.change]]`."""
STOPPED = "learning stopped"
"""How a variant's name ends in which nothing is learnt from the change on."""


def readapt(experiment: Experiment) -> list[Variant]:
    """Each change of the body: alone and taught, learning on and stopped when the body changes."""
    found = []
    for name, settings in BODY_CHANGES:
        applies = not settings or experiment.robot.body in KNOWN_BODIES
        text = ", ".join(f"{key}={json.dumps(value)}" for key, value in settings.items())
        change = (f"robot.change=[{{at={CHANGED_AT}, set={{{text}}}}}]",) if settings else ()
        for who in ("alone", "taught"):
            shown = (*windows(taught=who == "taught"), *change)
            stopped = (*shown, f"store.learns_until={CHANGED_AT}")
            found.append(Variant(f"{name}, {who}", shown, applies=applies))
            found.append(Variant(f"{name}, {who}, {STOPPED}", stopped, applies=applies))
    return found


def windows(*, taught: bool) -> Overrides:
    """Return a schedule whose phases are what is looked at: one teacher, who goes before, or stays."""
    starts = {"before": CHANGED_AT - 100, "at": CHANGED_AT, "after": CHANGED_AT + WINDOW}
    of = ', teacher="one"' if taught else ""
    entries = ['{start=0, name="first teacher", teacher="one", language="random"}']
    entries += [f'{{start={start}, name="{name}"{of}}}' for name, start in starts.items()]
    return f"experiment.iterations={starts['after'] + WINDOW}", f"teacher.phase=[{', '.join(entries)}]"


def as_shipped(experiment: Experiment) -> list[Variant]:
    """The experiment as it is."""
    del experiment
    return [Variant(AS_SHIPPED)]


def ablation(experiment: Experiment) -> list[Variant]:
    """As shipped, and one ingredient less each."""
    brain = experiment.brain
    variants: dict[str, Overrides] = {
        "promoters off": without_promoters(brain),
        "long-term memory off": without_long_term(brain),
        "no context detection": without_context(brain),
        "FIFO only": (*first_in_first_out(brain), *without_context(brain)),
        "punishments not kept": punishments_not_kept(brain),
        "no committees": without_committees(brain),
        "no support": without_support(brain),
        "no aspiration": without_aspiration(brain),
        "scalar note": scalar_note(brain),
        "smaller memories": smaller_memories(brain),
    }
    return [Variant(AS_SHIPPED), *(Variant(name, away, applies=bool(away)) for name, away in variants.items())]


VARIANTS: dict[str, Variants] = {
    "reproduction": reproduction,
    "paper": paper,
    "teachers": teachers,
    "learners": learners,
    "memory": memory,
    "life": as_shipped,
    "alone": as_shipped,
    "ablation": ablation,
    "comings": comings,
    "readapt": readapt,
    "machines": machines.taught,
    "rivals": machines.rivals,
    "acceptance": as_shipped,
}
"""What each study compares; the first variant is what the others are compared with."""


def overrides_of(study: Study, iterations: int = PHASE) -> Overrides:
    """Return what a study changes in every variant; iterations: of a phase, where it makes its own."""
    body = () if study is ACCEPTANCE or study.name in machines.STUDIES else (KINEMATIC,)
    if not study.own_schedule:
        return body
    names = [chr(ord("A") + place) for place in range(LIFE)]
    long_life = [who for name in names for who in (name, None)]
    return (*body, *phases(long_life if study.name == "life" else COMINGS, iterations))
