"""What the statements of the paper come to in numbers, from the results of studies.

Owns the measures behind the last column of the table in `paper`: of the study `reproduction`, with graded reward
unless said, and of others where named.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from mdb_sim.studies import tables
from mdb_sim.studies.results import Result
from mdb_sim.studies.rows import PhaseRow
from mdb_sim.verdicts.comings import comings_of
from mdb_sim.verdicts.quantities import OBEDIENCE, TO_OBEDIENCE, Measure, Runs, all_runs_of, capture_rate, runs_of
from mdb_sim.verdicts.statistics import Shape, Statistic, estimate, interval, number, percent, text

Found = Mapping[str, Sequence[Result]]
"""Results by study."""
Seeds = Mapping[int, Sequence[PhaseRow]]
"""The phases of one run each, by seed."""
Measured = Callable[[Found], str]

MAIN = "reproduction"
GRADED, BINARY = "graded reward", "binary reward"
NOT_YET = "not measured yet"
PAPER_PHASES = 4
"""Taught, alone, taught by another, alone."""


def _runs(found: Found, study: str, of: Callable[[Iterable[Result]], Runs] = runs_of) -> Runs | None:
    results = found.get(study)
    if not results:
        return None
    body = results[0].label.body
    return of(result for result in results if result.label.body == body)


def in_reproduction(told: Callable[[Seeds], str], variant: str = GRADED) -> Measured:
    """Return what is told of a variant's runs in the reproduction: of all its seeds, whatever the others have."""

    def measured(found: Found) -> str:
        runs = _runs(found, MAIN, all_runs_of)
        if runs is None or not runs.get(variant):
            return NOT_YET
        if any(len(rows) != PAPER_PHASES for rows in runs[variant].values()):
            return "not of the paper's schedule"
        return told(runs[variant])

    return measured


def over_seeds(measure: Measure, phase: int) -> Callable[[Seeds], str]:
    """Return what tells a measure of one phase over the seeds."""

    def told(seeds: Seeds) -> str:
        rows = [rows[phase] for rows in seeds.values()]
        return _spread([measure.value(row) for row in rows], seeds, measure.statistic, measure.shape)

    return told


def _spread(values: Sequence[float], seeds: Seeds, statistic: Statistic, shape: Shape) -> str:
    return f"{statistic} {interval(estimate(values, statistic), shape)} ({len(seeds)} seeds)"


def two_phases(measure: Measure, words: tuple[str, str], phases: tuple[int, int]) -> Callable[[Seeds], str]:
    """Return what tells a measure of two phases, each under its word."""
    return lambda seeds: "; ".join(
        f"{word}: {over_seeds(measure, phase)(seeds)}" for word, phase in zip(words, phases, strict=True)
    )


def later_is_better(seeds: Seeds) -> str:
    """Tell the errors of the first teacher's first and last commands."""

    def part(row: PhaseRow, part: slice) -> float:
        errors = row.prequential_curve[np.isfinite(row.prequential_curve)][part]
        return float(errors.mean()) if len(errors) else math.nan

    first = [part(rows[0], slice(None, 100)) for rows in seeds.values()]
    last = [part(rows[0], slice(-100, None)) for rows in seeds.values()]
    return (
        f"prequential MSE of the first teacher's first 100 commands {interval(estimate(first, 'mean'), percent)}, of "
        f"the last 100 {interval(estimate(last, 'mean'), percent)} ({len(seeds)} seeds)"
    )


def relearning(seeds: Seeds) -> str:
    """Tell how soon the error falls with the first teacher and with the second."""
    from_zero = [rows[0].iterations_to_error for rows in seeds.values()]
    again = [rows[2].iterations_to_error for rows in seeds.values()]
    first, second = estimate(from_zero, "median").value, estimate(again, "median").value
    return (
        f"iterations to 10 %, medians: first teacher {text(first, number)}, second {text(second, number)} "
        f"({len(seeds)} seeds)"
    )


def slope(seeds: Seeds) -> str:
    """Tell by how much the captures an iteration change when the first teacher has gone."""
    changes = []
    for rows in seeds.values():
        taught, alone = (capture_rate(rows[phase]) for phase in (0, 1))
        changes.append(alone / taught - 1 if taught > 0 else math.nan)
    return _spread(changes, seeds, "mean", percent)


def slopes(found: Found) -> str:
    """Tell the slopes with both rewards."""
    graded, binary = in_reproduction(slope)(found), in_reproduction(slope, BINARY)(found)
    return (
        f"captures an iteration, first phase alone against the phase taught before: graded {graded}; binary {binary}"
    )


def gap(seeds: Seeds) -> str:
    """Tell how long there is no capture when the second teacher has come."""

    def first(row: PhaseRow) -> float:
        done = np.flatnonzero(row.captured)
        return float(done[0] + 1) if len(done) else math.inf

    second, alone = [first(rows[2]) for rows in seeds.values()], [first(rows[1]) for rows in seeds.values()]
    return (
        f"iterations to the first capture: second teacher {_spread(second, seeds, 'median', number)}, "
        f"alone before {text(estimate(alone, 'median').value, number)}"
    )


def second_teacher(seeds: Seeds) -> str:
    """Tell how well and how soon the second teacher is obeyed."""
    return f"obedience {over_seeds(OBEDIENCE, 2)(seeds)}; to 90 %: {over_seeds(TO_OBEDIENCE, 2)(seeds)}"


def random_part(seeds: Seeds) -> str:
    """Tell the captures during forced exploration."""
    counts = [float(rows[0].captured[: rows[0].counted_from].sum()) for rows in seeds.values()]
    until = next(iter(seeds.values()))[0].counted_from
    return f"captures by chance in 0–{until}: {_spread(counts, seeds, 'mean', number)}"


def movements(seeds: Seeds) -> str:
    """Tell how many movements a capture takes."""

    def mean(alone: bool) -> list[float]:
        return [
            float(np.mean([step for row in rows if row.alone == alone for step in row.capture_steps] or [math.nan]))
            for rows in seeds.values()
        ]

    return (
        f"movements to a capture: taught {interval(estimate(mean(False), 'mean'), number)}, "
        f"alone {interval(estimate(mean(True), 'mean'), number)} ({len(seeds)} seeds)"
    )


def returns(found: Found) -> str:
    """Tell how soon a teacher who returns is obeyed, with long-term memory and without."""
    runs = _runs(found, "memory")
    if runs is None:
        return f"{NOT_YET} (`mdb study memory`)"
    told = []
    for variant, rows in comings_of(runs).items():
        if variant in (tables.LONG_TERM_ON, tables.LONG_TERM_OFF) and rows and len(rows[0].comings) > 2:
            median = estimate([row.comings[2].iterations for row in rows], "median").value
            told.append(f"{variant} {text(median, number)}")
    return f"iterations to 90 % obedience when the first teacher returns, medians: {', '.join(told)}"
