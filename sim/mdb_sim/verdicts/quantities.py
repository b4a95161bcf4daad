"""Measures of the phases of runs, compared between variants on the same seeds.

Owns `Quantity`, the comparison, its tables, and which measures of a phase are compared.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from mdb_sim.studies.results import Result
from mdb_sim.studies.rows import PhaseRow
from mdb_sim.verdicts.statistics import (
    FEWEST,
    Estimate,
    Shape,
    Statistic,
    differences,
    estimate,
    interval,
    markdown,
    number,
    percent,
    signed,
    text,
    worst,
)

Runs = Mapping[str, Mapping[int, tuple[PhaseRow, ...]]]
"""The phases of each run, by variant and seed."""


def runs_of(results: Iterable[Result]) -> Runs:
    """Return runs by variant and seed, variants in their study's order, all with the seeds that all of them have."""
    found = all_runs_of(results)
    common = set.intersection(*(set(seeds) for seeds in found.values())) if found else set[int]()
    return {variant: {s: rows for s, rows in seeds.items() if s in common} for variant, seeds in found.items()}


def all_runs_of(results: Iterable[Result]) -> Runs:
    """Return runs by variant and seed, variants in their study's order, each with all its own seeds."""
    found: dict[str, dict[int, tuple[PhaseRow, ...]]] = {}
    for result in sorted(results, key=lambda result: (result.label.order, result.label.seed)):
        found.setdefault(result.label.variant, {})[result.label.seed] = result.rows
    return found


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One measure under every variant, the first of which is what the others are compared with."""

    name: str
    seeds: tuple[int, ...]
    values: Mapping[str, tuple[float, ...]]
    """A value a seed, by variant."""
    statistic: Statistic
    """What is shown first: the acceptance table's."""
    low_is_good: bool = False
    shape: Shape

    @property
    def reference(self) -> str:
        """The variant that the others are compared with."""
        return next(iter(self.values))

    def estimate(self, variant: str, statistic: Statistic | None = None) -> Estimate:
        """Return a variant's statistic with its interval."""
        return estimate(self.values[variant], statistic or self.statistic)

    def difference(self, variant: str) -> Estimate:
        """Return the statistic of the seeds' own differences to the first variant, with its interval."""
        return estimate(differences(self.values[variant], self.values[self.reference]), self.statistic)

    def verdict(self, variant: str) -> Literal["", "better", "worse"]:
        """Return how the variant differs from the first, or "" where the seeds leave that open."""
        difference = self.difference(variant)
        if variant == self.reference or len(self.seeds) < FEWEST or not difference.clear:
            return ""
        return "better" if (difference.high < 0) == self.low_is_good else "worse"

    def worst(self, variant: str) -> tuple[float, int]:
        """Return the worst value and its seed; nan first, for it may hide anything."""
        return worst(self.values[variant], self.seeds, low_is_good=self.low_is_good)

    def never(self, variant: str) -> int:
        """Return for how many seeds it never happened."""
        return sum(math.isinf(value) for value in self.values[variant])


# ---- which measures of a phase are compared ----


@dataclass(frozen=True)
class Measure:
    """A measure of a phase: what is compared of it, and how."""

    name: str
    value: Callable[[PhaseRow], float]
    statistic: Statistic
    shape: Shape
    low_is_good: bool = False


TO_OBEDIENCE = Measure(
    "iterations to 90 % obedience", lambda row: row.iterations_to_obedience, "median", number, low_is_good=True
)
TO_ERROR = Measure(
    "iterations to MSE < 10 %", lambda row: row.iterations_to_error, "median", number, low_is_good=True
)
PAIR_ERROR = Measure("MSE over all pairs", lambda row: row.pair_error, "median", percent, low_is_good=True)
OBEDIENCE = Measure("obedience", lambda row: row.obedience, "mean", percent)
SHARE = Measure("captures, share of ideal", lambda row: row.share, "mean", percent)
TAUGHT = (TO_OBEDIENCE, TO_ERROR, PAIR_ERROR, OBEDIENCE)
"""Measures of phases in which somebody teaches."""


def quantity(runs: Runs, measure: Measure, phase: int, name: str | None = None) -> Quantity:
    """Return a measure of one phase under every variant."""
    return pooled(runs, measure, [phase], name or f"{measure.name}, {phase_name(runs, phase)}")


def pooled(runs: Runs, measure: Measure, phases: Sequence[int], name: str) -> Quantity:
    """Return the mean of a measure over some phases of each run, under every variant."""
    seeds = tuple(next(iter(runs.values())))
    values = {
        variant: tuple(_mean([measure.value(rows[seed][phase]) for phase in phases]) for seed in seeds)
        for variant, rows in runs.items()
    }
    return Quantity(
        name=name,
        seeds=seeds,
        values=values,
        statistic=measure.statistic,
        low_is_good=measure.low_is_good,
        shape=measure.shape,
    )


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else math.nan


def phases_of(runs: Runs) -> tuple[PhaseRow, ...]:
    """Return the phases of a run, as they are in all of them."""
    return next(iter(next(iter(runs.values())).values()))


def phase_name(runs: Runs, phase: int) -> str:
    """Return what a phase is called in a table."""
    row = phases_of(runs)[phase]
    return f"{row.name} ({row.start}–{row.stop})"


def capture_rate(row: PhaseRow) -> float:
    """Return the captures an iteration once a teacher is obeyed: in the last two thirds of what is counted."""
    counted = row.captured[row.counted_from - row.start :]
    settled = counted[len(counted) // 3 :]
    return float(settled.mean()) if len(settled) else math.nan


def all_quantities(runs: Runs) -> list[Quantity]:
    """Return every measure of every phase that has it."""
    phases = phases_of(runs)
    taught = [row.phase for row in phases if not row.alone]
    found = [quantity(runs, measure, phase) for measure in TAUGHT for phase in taught]
    return found + [quantity(runs, SHARE, row.phase) for row in phases]


def main_quantities(runs: Runs) -> list[Quantity]:
    """Return what matters most: how soon and how well the last teacher is obeyed, and all captures."""
    phases = phases_of(runs)
    taught = [row.phase for row in phases if not row.alone]
    found = [quantity(runs, measure, taught[-1]) for measure in TAUGHT] if taught else []
    return found + [quantity(runs, SHARE, row.phase) for row in phases]


def figure_quantities(runs: Runs) -> list[Quantity]:
    """Return what a figure of variants shows: the last teacher's obedience, and captures taught by him and alone."""
    taught = [row.phase for row in phases_of(runs) if not row.alone]
    alone = [row.phase for row in phases_of(runs) if row.alone]
    found = [quantity(runs, measure, taught[-1]) for measure in (TO_OBEDIENCE, OBEDIENCE, SHARE)] if taught else []
    return found + ([pooled(runs, SHARE, alone, f"{SHARE.name}, alone, all phases")] if alone else [])


# ---- tables ----


def spread(quantity: Quantity, variant: str) -> str:
    """Return a statistic with interval, and below it the worst value with its seed."""
    value, seed = quantity.worst(variant)
    verdict = quantity.verdict(variant)
    told = interval(quantity.estimate(variant), quantity.shape) + (f" **{verdict}**" if verdict else "")
    return f"{told}<br>worst {text(value, quantity.shape)} ({seed})"


FEW = 3
"""Up to so many variants stand side by side, a column each; more of them below each other."""


def summary(quantities: Sequence[Quantity], what: str = "variant") -> str:
    """Return a table of all measures under all variants, each with interval and worst seed."""
    variants = list(quantities[0].values)
    if len(variants) <= FEW:
        lines = [[f"{q.name}, {q.statistic}", *(spread(q, variant) for variant in variants)] for q in quantities]
        return "\n\n".join([markdown(["", *variants], lines), explained(quantities)])
    head = [what, *(f"{quantity.name}, {quantity.statistic}" for quantity in quantities)]
    rows = [[variant, *(spread(quantity, variant) for quantity in quantities)] for variant in variants]
    return "\n\n".join([markdown(head, rows), explained(quantities)])


def explained(quantities: Sequence[Quantity]) -> str:
    """Return what brackets and bold words of a table mean."""
    reference, seeds = quantities[0].reference, quantities[0].seeds
    brackets = "In brackets: 95 % bootstrap interval over the seeds; after the worst value its seed."
    comparisons = (len(quantities[0].values) - 1) * len(quantities)
    if not comparisons:
        return brackets
    if len(seeds) < FEWEST:
        return f"{brackets} With fewer than {FEWEST} seeds no difference is called clear."
    return (
        f"{brackets} **Better**, **worse**: the interval of the paired difference to “{reference}”, on the same "
        f"seeds, holds no 0. Of {comparisons} comparisons, about {number(0.05 * comparisons)} would be so by chance."
    )


def quantity_table(quantities: Sequence[Quantity], what: str) -> str:
    """Return a table of several quantities under each variant; `what` heads the first column."""
    reference, statistic = quantities[0].reference, quantities[0].statistic
    happens = any(quantity.never(variant) for quantity in quantities for variant in quantity.values)
    head = [what, "mean [95 %]", "median [95 %]", "worst (seed)", *(["never"] if happens else [])]
    head.append(f"{statistic} difference to {reference} [95 %]")
    rows = []
    for quantity in quantities:
        for variant in quantity.values:
            name = variant if len(quantities) == 1 else f"{quantity.name}, {variant}"
            rows.append([name, *_cells(quantity, variant, never=happens)])
    return markdown(head, rows)


def _cells(quantity: Quantity, variant: str, *, never: bool) -> list[str]:
    value, seed = quantity.worst(variant)
    count, verdict = quantity.never(variant), quantity.verdict(variant)
    difference = "" if variant == quantity.reference else signed(quantity.difference(variant), quantity.shape)
    return [
        "–" if count else interval(quantity.estimate(variant, "mean"), quantity.shape),
        interval(quantity.estimate(variant, "median"), quantity.shape),
        f"{text(value, quantity.shape)} ({seed})",
        *([f"{count} of {len(quantity.seeds)}"] if never else []),
        f"{difference} **{verdict}**" if verdict else difference,
    ]
