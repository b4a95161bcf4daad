"""Studies over many seeds: what each ingredient brings, and what it takes a teacher who comes again.

Owns what is compared, the statistics (medians, means and their bootstrap intervals, always drawn in the same
way) and the Markdown. What is measured of one run is in `measures` and `acceptance`, how it looks in
`study_figures`. A value is inf where what is measured never happened and nan where a log does not hold it;
neither is left out of a statistic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

from mdb_sim import measures
from mdb_sim.acceptance import AcceptanceRow
from mdb_sim.record import Floats, RunRecord

T = TypeVar("T")
Statistic = Literal["mean", "median"]
Shape = Callable[[float], str]

RESAMPLES = 10_000
"""Bootstrap samples of the seeds."""
ENDS = (2.5, 97.5)
"""Percentiles at the ends of a 95 % interval."""
FEWEST = 6
"""Seeds below which no difference is called clear: five of five fall on one side by chance in 6 % of cases."""
TENTH = 0.1
"""Share of the first coming's iterations in which a teacher who comes again should be obeyed."""


@dataclass(frozen=True)
class Estimate:
    """A statistic over the seeds and both ends of its 95 % bootstrap interval; nan: there is none."""

    value: float
    low: float = math.nan
    high: float = math.nan

    @property
    def clear(self) -> bool:
        """Whether the interval lies on one side of 0."""
        return self.low > 0 or self.high < 0


def estimate(values: Sequence[float] | Floats, statistic: Statistic) -> Estimate:
    """Return the statistic of one value a seed with its percentile bootstrap interval.

    One seed has no interval. A nan among the values makes all of it nan, an inf makes the mean inf; the median
    takes it for what it is, more than any number.
    """
    seeds = np.asarray(values, dtype=np.float64)
    if not len(seeds) or np.isnan(seeds).any():
        return Estimate(math.nan)
    rng = np.random.Generator(np.random.Philox(key=0))
    samples = _each(statistic, seeds[rng.integers(len(seeds), size=(RESAMPLES, len(seeds)))])
    value = float(_each(statistic, seeds[None])[0])
    if len(seeds) == 1:
        return Estimate(value)
    # Not interpolated: between a number and inf there is nothing.
    low, high = np.percentile(samples, ENDS, method="inverted_cdf")
    return Estimate(value, float(low), float(high))


def _each(statistic: Statistic, samples: Floats) -> Floats:
    """Return the statistic of each row of samples (n, seeds): (n,)."""
    with np.errstate(invalid="ignore"):
        if statistic == "mean":
            return np.asarray(samples.mean(axis=1), dtype=np.float64)
        # Between -inf and inf, as many sooner as later, lies no difference.
        return np.nan_to_num(np.median(samples, axis=1), nan=0.0, posinf=np.inf, neginf=-np.inf)


def differences(values: Sequence[float], to: Sequence[float]) -> list[float]:
    """Return value minus value seed by seed; where neither ever happened there is no difference."""
    return [0.0 if a == b else a - b for a, b in zip(values, to, strict=True)]


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
        sign = 1.0 if self.low_is_good else -1.0

        def badness(place: int) -> tuple[bool, float]:
            value = self.values[variant][place]
            return math.isnan(value), 0.0 if math.isnan(value) else sign * value

        place = max(range(len(self.seeds)), key=badness)
        return self.values[variant][place], self.seeds[place]

    def never(self, variant: str) -> int:
        """Return for how many seeds it never happened."""
        return sum(math.isinf(value) for value in self.values[variant])


def number(value: float) -> str:
    """Return at most one decimal."""
    return f"{value:.1f}".removesuffix(".0")


def percent(value: float) -> str:
    """Return a share in percent."""
    return f"{100 * value:.1f} %"


def ratio(value: float) -> str:
    """Return three decimals."""
    return f"{value:.3f}"


def text(value: float, shape: Shape) -> str:
    """Return a value as text, also the one that was never reached, and the one that there is not."""
    if math.isnan(value):
        return "–"
    return "never" if math.isinf(value) else shape(value)


def _interval(found: Estimate, shape: Shape) -> str:
    if math.isnan(found.low) or math.isinf(found.low):
        return text(found.value, shape)
    return f"{text(found.value, shape)} [{text(found.low, shape)}, {text(found.high, shape)}]"


def _signed(found: Estimate, shape: Shape) -> str:
    def signed(value: float) -> str:
        if math.isinf(value):
            return "+∞" if value > 0 else "-∞"
        return "–" if math.isnan(value) else f"{'+' if value > 0 else ''}{shape(value)}"

    interval = "" if math.isnan(found.low) else f" [{signed(found.low)}, {signed(found.high)}]"
    return f"{signed(found.value)}{interval}"


def line(cells: Iterable[str]) -> str:
    """Return one line of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join([line(head), line(["---", *["--:"] * (len(head) - 1)]), *map(line, rows)])


def seeds_text(seeds: Sequence[int]) -> str:
    """Return "seeds 11 to 20" of seeds in a row, else all of them."""
    if len(seeds) > 2 and list(seeds) == list(range(seeds[0], seeds[-1] + 1)):
        return f"seeds {seeds[0]} to {seeds[-1]}"
    return f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))}"


# ---- what each ingredient brings ----


def ablation_quantities(results: Mapping[str, Sequence[AcceptanceRow]]) -> list[Quantity]:
    """Return the measures of the acceptance table, of runs of the same seeds and phases under each variant."""
    reference = next(iter(results.values()))
    seeds = tuple(row.seed for row in reference)
    for name, rows in results.items():
        if tuple(row.seed for row in rows) != seeds:
            raise ValueError(f"{name}: expected runs of the seeds {seeds}, those of the first variant, in that order")
    windows, captured = reference[0].obedience_windows, reference[0].capture_windows

    def of(name: str, shown: _Shown, place: int) -> Quantity:
        values = {variant: tuple(shown.values(row)[place] for row in rows) for variant, rows in results.items()}
        return Quantity(
            name=name,
            seeds=seeds,
            values=values,
            statistic=shown.statistic,
            shape=shown.shape,
            low_is_good=shown.low_is_good,
        )

    taught = range(len(windows))
    return [
        *(of(f"iterations to MSE < 10 %, teacher {i + 1}", BELOW, i) for i in taught),
        *(of(f"MSE over all pairs, teacher {i + 1}", PAIR_ERRORS, i) for i in taught),
        *(of(f"obedience {a}–{b}", OBEDIENCE, i) for i, (a, b) in enumerate(windows)),
        *(of(f"captures {a}–{b}", CAPTURES, i) for i, (a, b) in enumerate(captured)),
    ]


@dataclass(frozen=True)
class _Shown:
    """How a measure of the acceptance table is shown."""

    values: Callable[[AcceptanceRow], tuple[float, ...]]
    statistic: Statistic
    shape: Shape
    low_is_good: bool = False


BELOW = _Shown(lambda row: row.below, "median", number, low_is_good=True)
PAIR_ERRORS = _Shown(lambda row: row.pair_errors, "median", percent, low_is_good=True)
OBEDIENCE = _Shown(lambda row: row.obedience, "mean", percent)
CAPTURES = _Shown(lambda row: row.captures, "mean", number)


def ablation_table(quantities: Sequence[Quantity]) -> str:
    """Return Markdown: what matters in one table, then each measure with its intervals and its worst seed."""
    reference, seeds = quantities[0].reference, quantities[0].seeds
    variants = list(quantities[0].values)
    summary = [[variant, *(_short(quantity, variant) for quantity in quantities)] for variant in variants]
    head = ["variant", *(f"{quantity.name}, {quantity.statistic}" for quantity in quantities)]
    comparisons = (len(variants) - 1) * len(quantities)
    explained = (
        f"**Better**, **worse**: the 95 % interval of the paired difference to “{reference}”, on the same seeds, "
        f"holds no 0. Of {comparisons} comparisons, about {number(0.05 * comparisons)} would be so by chance alone."
        if len(seeds) >= FEWEST
        else f"With fewer than {FEWEST} seeds no difference is called clear."
    )
    parts = [_table(head, summary), explained]
    for quantity in quantities:
        parts += [f"### {quantity.name}", _quantity_table([quantity], "variant")]
    parts.append(
        "Intervals: percentile bootstrap over the seeds. Differences: of each seed with itself "
        f"under “{reference}”, their median or mean as named; of shares, in percentage points. “never” counts as "
        "more than any number; there is no mean of it."
    )
    return "\n\n".join(parts) + "\n"


def _short(quantity: Quantity, variant: str) -> str:
    verdict = quantity.verdict(variant)
    value = text(quantity.estimate(variant).value, quantity.shape)
    return f"{value} **{verdict}**" if verdict else value


def _quantity_table(quantities: Sequence[Quantity], what: str) -> str:
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
    return _table(head, rows)


def _cells(quantity: Quantity, variant: str, *, never: bool) -> list[str]:
    worst, seed = quantity.worst(variant)
    count, verdict = quantity.never(variant), quantity.verdict(variant)
    difference = "" if variant == quantity.reference else _signed(quantity.difference(variant), quantity.shape)
    return [
        "–" if count else _interval(quantity.estimate(variant, "mean"), quantity.shape),
        _interval(quantity.estimate(variant, "median"), quantity.shape),
        f"{text(worst, quantity.shape)} ({seed})",
        *([f"{count} of {len(quantity.seeds)}"] if never else []),
        f"{difference} **{verdict}**" if verdict else difference,
    ]


# ---- teachers who come again ----


@dataclass(frozen=True, eq=False)
class Coming:
    """One stay of a teacher: what it took until its commands were obeyed."""

    teacher: str
    iterations: float
    """Until obedience: `measures.iterations_to_obedience`."""
    disobeyed: float
    """Of its first commands: `measures.disobeyed_at_first`."""
    recent: Floats
    """Share obeyed of the last commands, or of those that there were, by the coming's iterations (n,)."""


@dataclass(frozen=True, eq=False)
class ComingsRow:
    """One run: the stays of its teachers in order."""

    seed: int
    random_iterations: int
    """Iterations of forced exploration at the beginning, in which a command is obeyed by chance only."""
    comings: tuple[Coming, ...]


def comings_row(record: RunRecord) -> ComingsRow:
    """Return what one run contributes: each of its taught phases is a coming."""
    comings = tuple(
        Coming(
            teacher=str(span.teacher),
            iterations=measures.iterations_to_obedience(record, span),
            disobeyed=measures.disobeyed_at_first(record, span),
            recent=measures.recent_obedience(record, span),
        )
        for span in record.taught
    )
    return ComingsRow(record.seed, record.random_iterations, comings)


def ratio_of(value: float, first: float) -> float:
    """Return value over first; nan where the first never came to it, for anything is less than never, or was 0."""
    return value / first if 0 < first < math.inf else math.nan


def own_firsts(teachers: Sequence[str]) -> dict[int, int]:
    """Return for each coming of a teacher who has come before the place of that teacher's first."""
    return {i: teachers.index(teacher) for i, teacher in enumerate(teachers) if teachers.index(teacher) < i}


@dataclass(frozen=True)
class Criterion:
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


def criterion(rows: Sequence[ComingsRow], *, own: bool, window: bool = True) -> Criterion:
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
    return Criterion(ratios)


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
        _quantity_table(found["iterations"], "coming"),
        f"### Commands not obeyed among the first {window} of a coming",
        _quantity_table(found["disobeyed"], "coming"),
    ]
    if found["ratios"]:
        parts += ["### Iterations of a return : iterations of a first coming", _quantity_table(found["ratios"], "")]
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
    return _table(head, rows)


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
    return _table(head, rows)
