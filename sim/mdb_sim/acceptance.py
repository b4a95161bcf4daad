"""Runs against the acceptance table (sim/README.md, "Acceptance"): one row a seed, one criterion a line.

Owns the criteria, what each must reach at least and what it should, and the Markdown that shows every seed.
A value that a log does not hold (nan) meets no criterion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mdb_sim import measures
from mdb_sim.measures import Window
from mdb_sim.record import RunRecord

PAPER_OBEDIENCE: tuple[Window, ...] = ((300, 500), (1300, 1500))
PAPER_CAPTURES: tuple[Window, ...] = ((200, 500), (500, 1000), (1000, 1500), (1500, 2000))
"""Windows that the criteria are about: the paper's schedule."""


@dataclass(frozen=True, kw_only=True)
class AcceptanceRow:
    """One seed: a value for each taught phase (first three) or for each phase (captures), in order."""

    run: str
    """Name of the run folder."""
    seed: int
    iterations: int
    below: tuple[float, ...]
    """Iterations until the prequential error is below 10 %."""
    pair_errors: tuple[float, ...]
    """Error over all command-action pairs at the phase's end."""
    obedience: tuple[float, ...]
    captures: tuple[float, ...]
    obedience_windows: tuple[Window, ...]
    capture_windows: tuple[Window, ...]


def acceptance_row(record: RunRecord) -> AcceptanceRow:
    """Return what one run contributes."""
    pair_errors = measures.pair_error(record)
    obedience_windows = tuple(measures.obedience_window(span) for span in record.taught)
    capture_windows = tuple(measures.capture_window(record, span) for span in record.spans)
    return AcceptanceRow(
        run=record.run.name,
        seed=record.seed,
        iterations=record.iterations,
        below=tuple(measures.iterations_below(record, span) for span in record.taught),
        pair_errors=tuple(
            float(pair_errors[span.stop - 1]) if span.stop <= record.iterations else math.nan
            for span in record.taught
        ),
        obedience=tuple(measures.obedience(record, window) for window in obedience_windows),
        captures=tuple(measures.captures(record, window) for window in capture_windows),
        obedience_windows=obedience_windows,
        capture_windows=capture_windows,
    )


def _number(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")


def _percent(value: float) -> str:
    return f"{100 * value:.1f} %"


def _text(value: float, shape: Callable[[float], str]) -> str:
    if math.isnan(value):
        return "–"
    return "never" if math.isinf(value) else shape(value)


@dataclass(frozen=True)
class Bound:
    """What a statistic of each quantity must reach, and should: one limit a quantity."""

    statistic: str
    """"mean", "median" or "worst"."""
    must: tuple[float, ...]
    stretch: tuple[float, ...]


@dataclass(frozen=True)
class Criterion:
    """A line of the acceptance table with what was measured: `samples[quantity][seed]`."""

    name: str
    must: str
    stretch: str
    samples: tuple[tuple[float, ...], ...]
    bounds: tuple[Bound, ...]
    low_is_good: bool = False
    strict: bool = False
    """Whether a limit itself is not good enough."""
    shape: Callable[[float], str] = _number

    def statistic(self, name: str) -> tuple[float, ...]:
        """Return the mean, median or worst over the seeds of each quantity; nan when a seed has no value."""
        statistics: dict[str, Callable[[Sequence[float]], float]] = {
            "mean": lambda values: float(np.mean(values)),
            "median": lambda values: float(np.median(values)),
            "worst": lambda values: float(np.max(values) if self.low_is_good else np.min(values)),
        }
        return tuple(statistics[name](values) if values else math.nan for values in self.samples)

    @property
    def must_met(self) -> bool:
        """Whether all that must be reached is."""
        return all(self._reaches(bound.statistic, bound.must) for bound in self.bounds)

    @property
    def stretch_met(self) -> bool:
        """Whether all that should be reached is."""
        return all(self._reaches(bound.statistic, bound.stretch) for bound in self.bounds)

    def _reaches(self, statistic: str, limits: tuple[float, ...]) -> bool:
        sign = -1.0 if self.low_is_good else 1.0
        gaps = [sign * (v - limit) for v, limit in zip(self.statistic(statistic), limits, strict=True)]
        return all(gap > 0 if self.strict else gap >= 0 for gap in gaps)

    def show(self, statistic: str) -> str:
        """Return a statistic of all quantities as text."""
        return " / ".join(_text(value, self.shape) for value in self.statistic(statistic))


def judge(rows: Iterable[AcceptanceRow]) -> list[Criterion]:
    """Return the criteria of the acceptance table, in their order, with what these seeds reached."""
    rows = list(rows)

    def each(values: Callable[[AcceptanceRow], tuple[float, ...]], *places: int) -> tuple[tuple[float, ...], ...]:
        return tuple(
            tuple(values(row)[place] if place < len(values(row)) else math.nan for row in rows) for place in places
        )

    def captures(
        place: int, what: str, must: float, stretch: float, worst: tuple[float, float] | None = None
    ) -> Criterion:
        bounds = [Bound("mean", (must,), (stretch,))]
        if worst is not None:
            bounds.append(Bound("worst", (worst[0],), (worst[1],)))
        return Criterion(
            f"captures in {what}",
            "; ".join(f"≥ {_number(bound.must[0])}" for bound in bounds),
            "; ".join(f"≥ {_number(bound.stretch[0])}" for bound in bounds),
            each(lambda row: row.captures, place),
            tuple(bounds),
        )

    return [
        Criterion(
            "prequential MSE < 10 % (mean of 40), iterations after the teacher begins: "
            "first / second teacher, median",
            "100 / 200",
            "50 / 80",
            each(lambda row: row.below, 0, 1),
            (Bound("median", (100, 200), (50, 80)),),
            low_is_good=True,
        ),
        Criterion(
            "MSE over all 49 pairs at the end of each teacher's phase, median",
            "< 20 %",
            "< 5 %",
            each(lambda row: row.pair_errors, 0, 1),
            (Bound("median", (0.20, 0.20), (0.05, 0.05)),),
            low_is_good=True,
            strict=True,
            shape=_percent,
        ),
        Criterion(
            "obedience in iterations 300–500 and 1300–1500, mean; worst seed",
            "≥ 90 %; ≥ 80 %",
            "≥ 98 %; ≥ 96 %",
            each(lambda row: row.obedience, 0, 1),
            (Bound("mean", (0.90, 0.90), (0.98, 0.98)), Bound("worst", (0.80, 0.80), (0.96, 0.96))),
            shape=_percent,
        ),
        captures(0, "200–500 with the first teacher, mean (bound 70)", 60, 68),
        captures(1, "500–1000 without teacher, mean; worst (bound 117)", 85, 110, (60, 105)),
        captures(2, "1000–1500 with the second teacher, mean (bound 117)", 85, 105),
        captures(3, "1500–2000 without teacher, mean; worst", 85, 110, (60, 105)),
    ]


def acceptance_table(rows: Iterable[AcceptanceRow]) -> str:
    """Return Markdown: every seed's values, then the criteria with mean, median, worst, and what was met."""
    rows = sorted(rows, key=lambda row: (row.seed, row.run))
    parts = [_seeds(rows), _criteria(judge(rows))]
    if any((row.obedience_windows, row.capture_windows) != (PAPER_OBEDIENCE, PAPER_CAPTURES) for row in rows):
        parts.append("The criteria are meant for the paper's schedule; at least one of these runs has another.")
    return "\n\n".join(parts) + "\n"


def _seeds(rows: Sequence[AcceptanceRow]) -> str:
    if not rows:
        return "No runs."
    most = max(rows, key=lambda row: len(row.capture_windows))
    taught = range(1, len(most.obedience_windows) + 1)
    head = [
        "run",
        "seed",
        "iterations",
        *(f"iterations to MSE < 10 %, teacher {i}" for i in taught),
        *(f"MSE over all pairs, teacher {i}" for i in taught),
        *(f"obedience {a}–{b}" for a, b in most.obedience_windows),
        *(f"captures {a}–{b}" for a, b in most.capture_windows),
    ]
    lines = [_line(head), _line(["---", *["--:"] * (len(head) - 1)])]
    for row in rows:
        cells = [row.run, str(row.seed), str(row.iterations)]
        cells += _cells(row.below, len(taught), _number)
        cells += _cells(row.pair_errors, len(taught), _percent)
        cells += _cells(row.obedience, len(taught), _percent)
        cells += _cells(row.captures, len(most.capture_windows), _number)
        lines.append(_line(cells))
    return "\n".join(lines)


def _cells(values: Sequence[float], count: int, shape: Callable[[float], str]) -> list[str]:
    return [_text(value, shape) for value in [*values, *[math.nan] * count][:count]]


def _criteria(criteria: Iterable[Criterion]) -> str:
    head = ["criterion", "must", "stretch", "mean", "median", "worst", "must met", "stretch met"]
    lines = [_line(head), _line(["---", *["--:"] * 5, "---", "---"])]
    for c in criteria:
        measured = [c.show(statistic) for statistic in ("mean", "median", "worst")]
        met = ["yes" if met else "**no**" for met in (c.must_met, c.stretch_met)]
        lines.append(_line([c.name, c.must, c.stretch, *measured, *met]))
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
