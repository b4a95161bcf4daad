"""What it takes a teacher who comes again: the stays of a teacher, and the criterion that returns are judged by.

What is measured of a stay is in `measures`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mdb_sim.runs import measures
from mdb_sim.runs.record import Doubles
from mdb_sim.studies.rows import PhaseRow
from mdb_sim.verdicts.quantities import Quantity, Runs, quantity_table
from mdb_sim.verdicts.statistics import Shape, markdown, number, ratio, text

TENTH = 0.1
"""Share of the first coming's iterations in which a teacher who comes again should be obeyed."""


@dataclass(frozen=True, eq=False)
class Coming:
    """One stay of a teacher: what it took until its commands were obeyed."""

    teacher: str
    iterations: float
    """Until obedience: `measures.iterations_to_obedience`."""
    disobeyed: float
    """Of its first commands: `measures.disobeyed_at_first`."""
    recent: Doubles
    """Share obeyed of the last commands, or of those that there were, by the coming's iterations (n,)."""


@dataclass(frozen=True, eq=False)
class ComingsRow:
    """One run: the stays of its teachers in order."""

    seed: int
    random_iterations: int
    """Iterations of forced exploration at the beginning, in which a command is obeyed by chance only."""
    comings: tuple[Coming, ...]


def comings_row(rows: Sequence[PhaseRow]) -> ComingsRow:
    """Return what one run contributes: each of its taught phases is a coming."""
    comings = tuple(
        Coming(
            teacher=str(row.teacher),
            iterations=row.iterations_to_obedience,
            disobeyed=row.disobeyed_at_first,
            recent=measures.mean_of_last(np.where(row.obeyed < 0, np.nan, row.obeyed), measures.RECENT),
        )
        for row in rows
        if not row.alone
    )
    return ComingsRow(rows[0].seed, rows[0].random_iterations, comings)


def comings_of(runs: Runs) -> dict[str, list[ComingsRow]]:
    """Return the comings of every run, by variant."""
    return {variant: [comings_row(rows) for rows in seeds.values()] for variant, seeds in runs.items()}


def ratio_of(value: float, first: float) -> float:
    """Return value over first; nan where the first was 0, or never came to it."""
    return value / first if 0 < first < math.inf else math.nan


def own_firsts(teachers: Sequence[str]) -> dict[int, int]:
    """Return for each coming of a teacher who has come before the place of that teacher's first."""
    return {i: teachers.index(teacher) for i, teacher in enumerate(teachers) if teachers.index(teacher) < i}


@dataclass(frozen=True)
class Returns:
    """Whether every return took at most a tenth, seed by seed."""

    ratios: Mapping[int, float]
    """The largest ratio of any return to its first coming, by seed; nan where there is none."""

    @property
    def met(self) -> dict[int, bool]:
        """Whether it is met, by seed."""
        return {seed: worst <= TENTH for seed, worst in self.ratios.items()}

    @property
    def worst(self) -> tuple[float, int]:
        """The largest ratio over the seeds and its seed; nan first, for it may hide anything."""
        seed = max(self.ratios, key=lambda seed: (math.isnan(self.ratios[seed]), self.ratios[seed]))
        return self.ratios[seed], seed


def criterion(rows: Sequence[ComingsRow], *, own: bool, window: bool = True) -> Returns:
    """Judge the returns by the very first coming, or (`own`) by the first coming of the same teacher.

    Without `window` a coming counts only until the window in which it is obeyed begins, not until it is full.
    """

    def iterations(coming: Coming) -> float:
        return coming.iterations if window else coming.iterations - measures.RECENT

    ratios = {}
    for row in rows:
        firsts = own_firsts([coming.teacher for coming in row.comings])
        found = [
            ratio_of(iterations(row.comings[i]), iterations(row.comings[first if own else 0]))
            for i, first in firsts.items()
        ]
        ratios[row.seed] = float(np.max(found)) if found else math.nan  # np.max: nan if any is
    return Returns(ratios)


def comings_quantities(results: Mapping[str, Sequence[ComingsRow]]) -> dict[str, list[Quantity]]:
    """Return, by what they are, the measures of each coming and the ratios between comings."""
    reference = next(iter(results.values()))
    seeds = tuple(row.seed for row in reference)
    teachers = [coming.teacher for coming in reference[0].comings]
    firsts = own_firsts(teachers)

    def of(name: str, shape: Shape, value: Callable[[ComingsRow], float]) -> Quantity:
        values = {variant: tuple(value(row) for row in rows) for variant, rows in results.items()}
        return Quantity(name=name, seeds=seeds, values=values, statistic="median", low_is_good=True, shape=shape)

    def iterations(i: int) -> Callable[[ComingsRow], float]:
        return lambda row: row.comings[i].iterations

    def disobeyed(i: int) -> Callable[[ComingsRow], float]:
        return lambda row: row.comings[i].disobeyed

    def over(i: int, first: int) -> Callable[[ComingsRow], float]:
        return lambda row: ratio_of(row.comings[i].iterations, row.comings[first].iterations)

    pairs = dict.fromkeys([*((i, 0) for i in firsts), *firsts.items()])
    names = [f"{i + 1} ({teacher})" for i, teacher in enumerate(teachers)]
    return {
        "iterations": [of(name, number, iterations(i)) for i, name in enumerate(names)],
        "disobeyed": [of(name, number, disobeyed(i)) for i, name in enumerate(names)],
        "ratios": [of(f"{names[i]} : {names[first]}", ratio, over(i, first)) for i, first in pairs],
    }


def comings_table(results: Mapping[str, Sequence[ComingsRow]]) -> str:
    """Return Markdown: the criterion, every seed and coming, then the comings with their intervals."""
    found = comings_quantities(results)
    window, share = measures.RECENT, f"{measures.OBEDIENT:.0%}".replace("%", " %")
    random = max(row.random_iterations for rows in results.values() for row in rows)
    parts = [
        f"Criterion: every return takes at most {TENTH:g} of the iterations that the first coming took until {share} "
        f"of the last {window} commands were obeyed. A whole window is "
        f"{window} commands, so no coming takes less, and a tenth can be reached only where the first took "
        f"{window / TENTH:.0f} or more; below, the same counted until the window begins."
        + (f" The first coming begins with {random} iterations of forced exploration." if random else ""),
        _criterion_table(results),
        "### Every seed",
        _seeds_table(results, found),
        "### Iterations until obedience",
        quantity_table(found["iterations"], "coming"),
        f"### Commands not obeyed among the first {window} of a coming",
        quantity_table(found["disobeyed"], "coming"),
    ]
    if found["ratios"]:
        parts += ["### Iterations of a return : iterations of a first coming", quantity_table(found["ratios"], "")]
    parts.append(
        "Intervals: percentile bootstrap over the seeds; differences: of each seed with itself. “never”: not in "
        "the whole coming; it counts as more than any number. “–”: no ratio, the first coming never came to it."
    )
    return "\n\n".join(parts) + "\n"


def _criterion_table(results: Mapping[str, Sequence[ComingsRow]]) -> str:
    head = ["criterion", "met, to the first coming", "worst ratio (seed)"]
    head += ["met, to that teacher's own first coming", "worst ratio (seed)"]
    rows = []
    for window in (True, False):
        for variant, of in results.items():
            cells = [variant if window else f"{variant}, counted until the window begins"]
            for own in (False, True):
                judged = criterion(of, own=own, window=window)
                worst, seed = judged.worst
                cells += [f"{sum(judged.met.values())} of {len(of)}", f"{text(worst, ratio)} ({seed})"]
            rows.append(cells)
    return markdown(head, rows)


def _seeds_table(results: Mapping[str, Sequence[ComingsRow]], found: Mapping[str, Sequence[Quantity]]) -> str:
    iterations, disobeyed, ratios = found["iterations"], found["disobeyed"], found["ratios"]
    head = ["seed", "variant", *(f"coming {quantity.name}" for quantity in iterations)]
    head += [quantity.name for quantity in ratios]
    head += ["met, to the first", "met, to its own first", f"not obeyed of the first {measures.RECENT}"]
    judged = {variant: [criterion(rows, own=own).met for own in (False, True)] for variant, rows in results.items()}
    rows = []
    for place, seed in enumerate(iterations[0].seeds):
        for variant in results:
            cells = [str(seed), variant]
            cells += [text(q.values[variant][place], q.shape) for q in (*iterations, *ratios)]
            cells += ["yes" if met[seed] else "**no**" for met in judged[variant]]
            cells.append(", ".join(text(q.values[variant][place], q.shape) for q in disobeyed))
            rows.append(cells)
    return markdown(head, rows)
