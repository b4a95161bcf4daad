"""`mdb study`: what each ingredient brings, and what it takes a teacher who comes again, over many seeds.

Owns the variants: overrides that are computed from the experiment itself, so that they fit any file. The
runs are those of `mdb_deploy.acceptance`; what is made of them is in `mdb_sim.study`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from mdb_deploy.acceptance import Job, run_all
from mdb_protocol.errors import ConfigError
from mdb_services.config import BrainConfig
from mdb_services.mechanism.stm import MemoryConfig
from mdb_sim.acceptance import acceptance_row, acceptance_table
from mdb_sim.experiment import Experiment
from mdb_sim.figures import need_matplotlib
from mdb_sim.record import RunRecord
from mdb_sim.study import ablation_quantities, ablation_table, comings_row, comings_table, seeds_text
from mdb_sim.study_figures import draw_ablation, draw_comings

T = TypeVar("T")

AS_SHIPPED = "as shipped"
LONG_TERM_ON, LONG_TERM_OFF = "long-term memory on", "long-term memory off"
PROMOTERS = "pbga"
"""The learner whose promoters "promoters off" takes away."""
COMINGS = ("A", "B", "A", "B", "A")
"""Who teaches, phase by phase, in `mdb study comings`."""
SMALLER = 4
"""Smaller memories hold this part of the pairs."""


@dataclass(frozen=True)
class Study:
    """What the command line says of a study."""

    experiment: Path
    seeds: tuple[int, ...]
    overrides: tuple[str, ...]
    out: Path
    workers: int
    fresh: bool = False
    """Whether runs that are there already are done again."""


@dataclass(frozen=True)
class Variant:
    """An experiment file with something changed."""

    name: str
    overrides: tuple[str, ...] = ()

    @property
    def folder(self) -> str:
        """Its name as one word."""
        return self.name.lower().replace(" ", "-")


def ablation_variants(brain: BrainConfig) -> list[Variant]:
    """Return what is compared, as shipped first. A variant without overrides has nothing to change in this file."""
    return [
        Variant(AS_SHIPPED),
        Variant("promoters off", _without_promoters(brain)),
        Variant(LONG_TERM_OFF, _without_long_term(brain)),
        Variant("no context detection", _without_context(brain)),
        Variant("FIFO only", (*_first_in_first_out(brain), *_without_context(brain))),
        Variant("no aspiration", _without_aspiration(brain)),
        Variant("scalar note", _scalar_note(brain)),
        Variant("smaller memories", _smaller_memories(brain)),
    ]


def _without_promoters(brain: BrainConfig) -> tuple[str, ...]:
    evolved = [model for model in brain.model if brain.learner_of(model)[0] == PROMOTERS]
    return _where({model.name: "name" in model.learner for model in evolved}, "learner.name=ga")


def _without_long_term(brain: BrainConfig) -> tuple[str, ...]:
    stored = [model for model in brain.model if brain.long_term_of(model).capacity > 0]
    return _where({model.name: "capacity" in model.long_term for model in stored}, "long_term.capacity=0")


def _without_context(brain: BrainConfig) -> tuple[str, ...]:
    watched = [model for model in brain.model if brain.context_of(model).enabled]
    return _where({model.name: "enabled" in model.context for model in watched}, "context.enabled=false")


def _where(own: Mapping[str, bool], override: str) -> tuple[str, ...]:
    """Return a file-level override for models that take the file's setting, and one each for those with their own."""
    of = [f"model.{name}.{override}" if its_own else override for name, its_own in own.items()]
    return tuple(dict.fromkeys(of))


def _first_in_first_out(brain: BrainConfig) -> tuple[str, ...]:
    others = "".join(f", {term}=0.0" for term in brain.memory if term != "recency")
    labelled = [model for model in brain.model if brain.memory_of(model) != MemoryConfig()]
    return tuple(f"model.{model.name}.memory={{recency=1.0{others}}}" for model in labelled)


def _without_aspiration(brain: BrainConfig) -> tuple[str, ...]:
    exploring = [mode for mode in brain.mode if mode.aspiration is not None and mode.exploration > 0]
    return tuple(f"mode.{mode.name}.exploration=0" for mode in exploring)


def _scalar_note(brain: BrainConfig) -> tuple[str, ...]:
    notes = brain.variables()["note"].indices if "note" in brain.channels else None
    return () if notes is None else (f"channels.note={{low=0, high={notes - 1}}}",)


def _smaller_memories(brain: BrainConfig) -> tuple[str, ...]:
    smaller = {model.name: max(1, model.capacity // SMALLER) for model in brain.model}
    return tuple(f"model.{name}.capacity={capacity}" for name, capacity in smaller.items())


def chosen(variants: Sequence[Variant], only: Sequence[str]) -> list[Variant]:
    """Return the variants named by `only`, all when it is empty, with the first always; ConfigError on others."""
    folders = [variant.folder for variant in variants]
    for word in only:
        if word not in folders:
            raise ConfigError(f"--only {word!r}: no such variant; there are {', '.join(folders)}")
    return [variant for variant in variants if not only or variant is variants[0] or variant.folder in only]


def comings_overrides(iterations: int) -> tuple[str, ...]:
    """Return the schedule in which two teachers come in turn, each for so many iterations."""
    phases = []
    for place, teacher in enumerate(COMINGS):
        coming = COMINGS[: place + 1].count(teacher)
        language = ', language="random"' if coming == 1 else ""
        start = place * iterations
        phases.append(f'{{start={start}, name="{teacher}, coming {coming}", teacher="{teacher}"{language}}}')
    return f"experiment.iterations={len(COMINGS) * iterations}", f"teacher.phase=[{', '.join(phases)}]"


def ablate(study: Study, only: Sequence[str] = ()) -> int:
    """Run `mdb study ablation`; return the exit status."""
    need_matplotlib()
    experiment = Experiment.read(study.experiment, study.overrides)
    variants = chosen(ablation_variants(experiment.brain), only)
    changed = [variant for variant in variants if variant is variants[0] or variant.overrides]
    results = _results(study, changed, acceptance_row)
    for variant in changed:
        path = study.out / variant.folder / "acceptance.md"
        path.write_text(acceptance_table(results[variant.name]), encoding="utf-8")
    quantities = ablation_quantities(results)
    parts = ["# What each ingredient brings", _described(study, experiment), ablation_table(quantities)]
    parts.append("What the variants change:\n\n" + "\n".join(map(_change, variants[1:])))
    _report(study.out / "ablation.md", parts, draw_ablation(quantities, study.out / "ablation"))
    return 0


def _change(variant: Variant) -> str:
    overrides = ", ".join(f"`{override}`" for override in variant.overrides)
    return f"- {variant.name}: {overrides or 'left out, for it has nothing to change in this experiment'}"


def compare_comings(study: Study, iterations: int) -> int:
    """Run `mdb study comings`; return the exit status."""
    need_matplotlib()
    scheduled = replace(study, overrides=(*comings_overrides(iterations), *study.overrides))
    experiment = Experiment.read(study.experiment, scheduled.overrides)
    without = _without_long_term(experiment.brain)
    if not without:
        raise ConfigError(f"{study.experiment}: long_term.capacity is 0 for every model; expected a long-term memory")
    results = _results(scheduled, [Variant(LONG_TERM_ON), Variant(LONG_TERM_OFF, without)], comings_row)
    turns = f"Teachers {', '.join(COMINGS)}, {iterations} iterations each, every teacher with a language of its own."
    parts = ["# Teachers who come again", f"{_described(study, experiment)} {turns}", comings_table(results)]
    _report(study.out / "comings.md", parts, draw_comings(results, study.out / "comings"))
    return 0


def _results(study: Study, variants: Sequence[Variant], measure: Callable[[RunRecord], T]) -> dict[str, list[T]]:
    """Run every variant on every seed, seed by seed, so that what an interrupted study has is balanced."""
    jobs = [
        Job(
            study.experiment,
            seed,
            (*study.overrides, *variant.overrides),
            study.out / variant.folder / f"seed{seed}",
            measure,
            reuse=not study.fresh,
        )
        for seed in study.seeds
        for variant in variants
    ]
    measured = run_all(jobs, study.workers)
    return {variant.name: measured[place :: len(variants)] for place, variant in enumerate(variants)}


def _described(study: Study, experiment: Experiment) -> str:
    settings = "".join(f" `--set '{override}'`" for override in study.overrides)
    return (
        f"`{study.experiment.name}`: {experiment.brain.experiment.iterations} iterations in lockstep, "
        f"body {experiment.robot.body}, {seeds_text(study.seeds)}.{settings and ' With'}{settings}"
    )


def _report(path: Path, parts: Sequence[str], figures: Sequence[Path]) -> None:
    text = "\n\n".join(part.rstrip("\n") for part in parts) + "\n"
    path.write_text(text, encoding="utf-8")
    sys.stdout.write(text)
    for file in (path, *figures):
        sys.stderr.write(f"{file}\n")
