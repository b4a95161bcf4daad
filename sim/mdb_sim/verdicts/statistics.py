"""Statistics over seeds, always drawn in the same way: medians, means, their bootstrap intervals, rates.

A value is inf where what is measured never happened and nan where a log does not hold it; neither is left out
of a statistic. Owns also how such values are written.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mdb_sim.runs.record import Doubles

Statistic = Literal["mean", "median"]
Shape = Callable[[float], str]

RESAMPLES = 10_000
"""Bootstrap samples of the seeds."""
ENDS = (2.5, 97.5)
"""Percentiles at the ends of a 95 % interval."""
FEWEST = 6
"""Seeds below which no difference is called clear: five of five fall on one side by chance in 6 % of cases."""


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


def estimate(values: Sequence[float] | Doubles, statistic: Statistic) -> Estimate:
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


def _each(statistic: Statistic, samples: Doubles) -> Doubles:
    """Return the statistic of each row of samples (n, seeds): (n,)."""
    with np.errstate(invalid="ignore"):
        if statistic == "mean":
            return np.asarray(samples.mean(axis=1), dtype=np.float64)
        # Between -inf and inf, as many sooner as later, lies no difference.
        return np.nan_to_num(np.median(samples, axis=1), nan=0.0, posinf=np.inf, neginf=-np.inf)


def differences(values: Sequence[float], to: Sequence[float]) -> list[float]:
    """Return value minus value seed by seed; where neither ever happened there is no difference."""
    return [0.0 if a == b else a - b for a, b in zip(values, to, strict=True)]


NORMAL_975 = 1.959964
"""The normal distribution's 97.5 % point."""


def wilson(count: int, of: int) -> Estimate:
    """Return a rate with Wilson's 95 % interval: right also where the count is 0. nan of nothing."""
    if of == 0:
        return Estimate(math.nan)
    rate, z = count / of, NORMAL_975
    middle = (rate + z * z / (2 * of)) / (1 + z * z / of)
    half = z / (1 + z * z / of) * math.sqrt(rate * (1 - rate) / of + z * z / (4 * of * of))
    return Estimate(rate, max(0.0, middle - half), min(1.0, middle + half))


def worst(values: Sequence[float], seeds: Sequence[int], *, low_is_good: bool = False) -> tuple[float, int]:
    """Return the worst value and its seed; nan first, for it may hide anything."""
    sign = 1.0 if low_is_good else -1.0
    badness = [(math.isnan(value), 0.0 if math.isnan(value) else sign * value) for value in values]
    place = max(range(len(values)), key=badness.__getitem__)
    return values[place], seeds[place]


def number(value: float) -> str:
    """Return at most one decimal."""
    return f"{round(value, 1) + 0.0:.1f}".removesuffix(".0")  # never -0


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


def interval(found: Estimate, shape: Shape) -> str:
    """Return a value with its interval, where it has one."""
    if math.isnan(found.low) or math.isinf(found.low):
        return text(found.value, shape)
    return f"{text(found.value, shape)} [{text(found.low, shape)}, {text(found.high, shape)}]"


def signed(found: Estimate, shape: Shape) -> str:
    """Return a difference with its sign and its interval."""

    def one(value: float) -> str:
        if math.isinf(value):
            return "+∞" if value > 0 else "-∞"
        return "–" if math.isnan(value) else f"{'+' if value > 0 else ''}{shape(value)}"

    ends = "" if math.isnan(found.low) else f" [{one(found.low)}, {one(found.high)}]"
    return f"{one(found.value)}{ends}"


def line(cells: Iterable[str]) -> str:
    """Return one line of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table, numbers to the right."""
    return "\n".join([line(head), line(["---", *["--:"] * (len(head) - 1)]), *map(line, rows)])


def seeds_text(seeds: Sequence[int]) -> str:
    """Return "seeds 11 to 20" of seeds in a row, else all of them."""
    if len(seeds) > 2 and list(seeds) == list(range(seeds[0], seeds[-1] + 1)):
        return f"seeds {seeds[0]} to {seeds[-1]}"
    return f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))}"
