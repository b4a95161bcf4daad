"""Runs against the goal: each seed against its own ideal, one criterion a line, every seed shown.

Owns the criteria, what each must reach, and their Markdown. A value that a run does not hold (nan) meets no
criterion. A low prequential error is no criterion: a robot that always does the same wrong thing foresees its
punishment well. It is shown beside obedience, and where the two part is counted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mdb_sim.runs import measures
from mdb_sim.studies.rows import PhaseRow
from mdb_sim.verdicts.quantities import OBEDIENCE, PAIR_ERROR, SHARE, TO_ERROR, TO_OBEDIENCE, Measure
from mdb_sim.verdicts.statistics import estimate, interval, markdown, percent, seeds_text, text, wilson, worst

ALONE_MEAN, ALONE_WORST = 0.97, 0.90
"""What a phase alone must capture of its ideal: on average, and at the least."""
FIRST_MEAN, LATER_MEAN = 0.97, 0.90
"""What a taught phase must capture of its ideal, on average; a later teacher has to be understood first. About what
the brain reached when this was written (seeds 801 to 804: 98.6 and 90.5 %)."""
SOON = 45
"""Iterations after which a second teacher must be obeyed, median: a Gaussian-process bandit needs about 41."""
OBEDIENT_MEAN, OBEDIENT_WORST = 0.98, 0.96

Limit = Literal["mean", "median", "worst"]
Seeds = Mapping[int, Sequence[PhaseRow]]
"""The phases of one run each, by seed."""


@dataclass(frozen=True)
class Criterion:
    """A line of the table: a measure of one phase over the seeds, and what it must reach."""

    measure: Measure
    name: str
    seeds: tuple[int, ...]
    values: tuple[float, ...]
    limits: Mapping[Limit, float] = field(default_factory=dict)
    """What each statistic must reach; none when the line is shown only."""

    def statistic(self, name: Limit) -> float:
        """Return a statistic over the seeds; nan when a seed has no value, or when there is none."""
        if not self.values:
            return math.nan
        if name == "worst":
            return worst(self.values, self.seeds, low_is_good=self.measure.low_is_good)[0]
        return estimate(self.values, name).value

    @property
    def met(self) -> bool:
        """Whether all that must be reached is; so also where nothing must be."""
        sign = -1.0 if self.measure.low_is_good else 1.0
        return all(sign * (self.statistic(name) - limit) >= 0 for name, limit in self.limits.items())

    @property
    def must(self) -> str:
        """What must be reached, in words."""
        sign = "≤" if self.measure.low_is_good else "≥"
        shown = "; ".join(f"{name} {sign} {text(limit, self.measure.shape)}" for name, limit in self.limits.items())
        return shown.replace(".0 %", " %") or "shown only"

    @property
    def cells(self) -> list[str]:
        """The line in the table."""
        shape = self.measure.shape
        mean, median = estimate(self.values, "mean"), estimate(self.values, "median")
        value, seed = worst(self.values, self.seeds, low_is_good=self.measure.low_is_good)
        met = "" if not self.limits else "yes" if self.met else "**no**"
        shown = ["–" if math.isinf(mean.value) else interval(mean, shape), interval(median, shape)]
        return [self.name, self.must, *shown, f"{text(value, shape)} ({seed})", met]


def judge(seeds: Seeds) -> list[Criterion]:
    """Return the criteria for runs with the same phases, with what these seeds reached."""
    if not seeds:
        return []
    numbers = tuple(seeds)

    def of(row: PhaseRow, measure: Measure, words: str, **limits: float) -> Criterion:
        values = tuple(measure.value(seeds[seed][row.phase]) for seed in numbers)
        return Criterion(measure, f"{words}, {row.start}–{row.stop}", numbers, values, limits)  # type: ignore[arg-type]

    phases = next(iter(seeds.values()))
    alone, taught = [row for row in phases if row.alone], [row for row in phases if not row.alone]
    return [
        *(of(row, SHARE, "captures alone, share of ideal", mean=ALONE_MEAN, worst=ALONE_WORST) for row in alone),
        *(of(row, SHARE, "captures taught, share of ideal", mean=FIRST_MEAN) for row in taught[:1]),
        *(of(row, SHARE, "captures taught, share of ideal", mean=LATER_MEAN) for row in taught[1:]),
        *(of(row, TO_OBEDIENCE, "iterations to 90 % obedience", median=SOON) for row in taught[1:]),
        *(of(row, OBEDIENCE, "obedience at the end", mean=OBEDIENT_MEAN, worst=OBEDIENT_WORST) for row in taught),
        *(of(row, TO_ERROR, "iterations to prequential MSE < 10 %") for row in taught),
        *(of(row, PAIR_ERROR, "MSE over all pairs") for row in taught),
    ]


def failures(seeds: Seeds) -> tuple[int, int]:
    """Return how many phases alone are below what the least must be, or unknown, and of how many."""
    shares = [row.share for rows in seeds.values() for row in rows if row.alone]
    return sum(not share >= ALONE_WORST for share in shares), len(shares)


def failure_rate(seeds: Seeds) -> str:
    """Return the failure rate in words, with its interval."""
    count, of = failures(seeds)
    if not of:
        return "No phase alone in these runs."
    bad = [
        f"{seed} ({row.start}–{row.stop}: {text(row.share, percent)})"
        for seed, rows in seeds.items()
        for row in rows
        if row.alone and not row.share >= ALONE_WORST
    ]
    named = f" They are of the seeds {', '.join(bad)}." if bad else ""
    rate = wilson(count, of)
    return (
        f"**Failures**: {count} of {of} phases alone below {ALONE_WORST:.0%} of the ideal, "
        f"{interval(rate, percent)} (Wilson's 95 % interval).{named}"
    ).replace("0% of", "0 % of")


def error_without_obedience(seeds: Seeds) -> str:
    """Return where a low prequential error and obedience part, in words."""
    taught = [row for rows in seeds.values() for row in rows if not row.alone]
    foreseen = [row for row in taught if math.isfinite(row.iterations_to_error)]
    disobedient = [row for row in foreseen if not row.obedience >= measures.OBEDIENT]
    return (
        "A low prequential error does not imply obedience: who always does the same wrong thing foresees his "
        f"punishment well. Here it fell below 10 % in {len(foreseen)} of {len(taught)} taught phases; in "
        f"{len(disobedient)} of these the robot obeyed less than {measures.OBEDIENT:.0%}".replace("0%", "0 %")
        + " of the commands at the end."
    )


def acceptance_table(seeds: Seeds) -> str:
    """Return Markdown: every seed's values, then the criteria, and the failure rate."""
    if not seeds:
        return "No runs.\n"
    parts = [seeds_table(seeds), criteria_table(seeds)]
    return "\n\n".join(parts) + "\n"


def criteria_table(seeds: Seeds) -> str:
    """Return Markdown: the criteria with what was reached, the failure rate, and how error and obedience part."""
    head = ["criterion", "must", "mean [95 %]", "median [95 %]", "worst (seed)", "met"]
    body = {row.body for rows in seeds.values() for row in rows}
    twin = " The ideal is that of the kinematic twin." if body - {"kinematic"} else ""
    return "\n\n".join(
        [
            markdown(head, [criterion.cells for criterion in judge(seeds)]),
            failure_rate(seeds),
            error_without_obedience(seeds),
            f"The ideal: a policy that sees the truth and always faces the object, from where the phase begins, on "
            f"the same placements.{twin} Body: {', '.join(sorted(body))}; {seeds_text(list(seeds))}.",
        ]
    )


def seeds_table(seeds: Seeds) -> str:
    """Return Markdown with a line a seed: what was captured of the ideal, and how each teacher was obeyed."""
    most = max(seeds.values(), key=len)
    taught = [row for row in most if not row.alone]
    head = [
        "seed",
        *(f"captures {row.counted_from}–{row.stop} (ideal)" for row in most),
        *(f"iterations to 90 % obedience, {row.start}–{row.stop}" for row in taught),
        *(f"obedience at the end, {row.start}–{row.stop}" for row in taught),
        *(f"iterations to MSE < 10 %, {row.start}–{row.stop}" for row in taught),
        *(f"MSE over all pairs, {row.start}–{row.stop}" for row in taught),
    ]
    return markdown(head, [_seed_cells(seed, rows, most) for seed, rows in sorted(seeds.items())])


def _seed_cells(seed: int, rows: Sequence[PhaseRow], most: Sequence[PhaseRow]) -> list[str]:
    places = {row.phase: row for row in rows}
    cells = [str(seed)]
    for phase in (row.phase for row in most):
        row = places.get(phase)
        cells.append("–" if row is None else f"{_whole(row.captures)} ({_whole(row.ideal_captures)})")
    for measure in (TO_OBEDIENCE, OBEDIENCE, TO_ERROR, PAIR_ERROR):
        for phase in (row.phase for row in most if not row.alone):
            row = places.get(phase)
            cells.append("–" if row is None else text(measure.value(row), measure.shape))
    return cells


def _whole(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.0f}"
