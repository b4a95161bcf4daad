"""Which of the last actions feedback is for when it does not say so: how late its teacher is, found by what fits.

Ours. TAMER (Knox and Stone, 2009) spreads such feedback over a distribution of delays that is given beforehand. Here
it is found out, from nothing but the pairs. There are some hypotheses: each says that the lags, iterations between an
action and its feedback, are evenly spread over some that follow one another, often one alone. Each keeps the feedback
with the pairs that it is for if the hypothesis holds, foresees from what similar pairs got what the next will be, and
is believed the more the better it foresees: a right one puts like to like, a wrong one mixes up what belongs to
different actions.

Feedback waits until a hypothesis is believed, or until its patience is over. Another teacher is taken for as late as
the one before, until his own feedback clearly says otherwise.

Pure. Pairs are rows of numbers, one row for each model that learns feedback; what they mean is not known here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.network import Floats

Values = NDArray[np.float64]
Ints = NDArray[np.int64]

SPREADS = 1, 2, 3, 5
"""Over so many lags that follow one another feedback may be spread."""
KEPT = 100
"""Feedback from which the next is foreseen; the oldest leaves."""
NEIGHBOURS = 3
"""The most similar pairs, whose mean feedback is foreseen."""
FORGETTING = 0.98
"""What feedback counts as evidence after one more: a teacher may become slower."""
VARIANCE = 0.5
"""Of feedback around what is foreseen, in [-1, 1] squared: high, so that one odd feedback is no proof."""
CUT = 1.0
"""Squared errors beyond this count as this: a teacher may err."""
MARGIN = 4.0
"""By how much the logarithm of a likelihood must be above others to be believed, or to take another's place."""


class Lags(NamedTuple):
    """The hypotheses, each some lags `first` to `last`, and their lags one after the other."""

    first: Ints
    """(hypotheses,)"""
    last: Ints
    """(hypotheses,)"""
    hypothesis: Ints
    """(cases,): each hypothesis once for each of its lags, ..."""
    lag: Ints
    """(cases,): ... and that lag."""
    begin: Ints
    """(hypotheses,): its first case."""

    @classmethod
    def up_to(cls, lags: int) -> Lags:
        """Return the hypotheses about lags of 0 to one less than this."""
        windows = [(a, a + spread - 1) for spread in SPREADS for a in range(lags - spread + 1)]
        cases = [(h, lag) for h, (a, b) in enumerate(windows) for lag in range(a, b + 1)]
        first, last = np.array(windows).T
        hypothesis, lag = np.array(cases).T
        return cls(first, last, hypothesis, lag, np.searchsorted(hypothesis, np.arange(len(windows))))


class Credit:
    """The feedback of one teacher who names no iteration: what he said, what waits, and how late he is."""

    def __init__(self, lags: int, widths: Sequence[int], before: Credit | None = None) -> None:
        """Begin with what is known of the teacher before him.

        lags: 0 to one less are told apart; widths: columns of each model's rows.
        """
        self._lags = Lags.up_to(lags)
        count = len(self._lags.first)
        self.believed: int | None = None
        """The hypothesis that holds; None: not known yet."""
        self._evidence = np.zeros(count)
        self._values = np.zeros(0)
        self._places = np.zeros((count, 0), np.int64)
        """(hypotheses, n): the iterations that the kept feedback is for."""
        self._rows = [np.zeros((count, 0, width), np.float32) for width in widths]
        """For each model (hypotheses, n, w): the rows of these."""
        self._waiting: list[tuple[int, float, Ints]] = []
        """What is not credited yet: when it came, what it is, and the iterations (hypotheses,) that it is for."""
        if before is not None:
            best = before.best
            self.believed = best
            self._values = before._values
            self._places = np.repeat(before._places[best : best + 1], count, axis=0)
            self._rows = [np.repeat(rows[best : best + 1], count, axis=0) for rows in before._rows]

    @property
    def best(self) -> int:
        """The hypothesis that holds, or that fits best so far."""
        return int(np.argmax(self._evidence)) if self.believed is None else self.believed

    @property
    def lag(self) -> float:
        """How late he is by that, in iterations."""
        return float(self._lags.first[self.best] + self._lags.last[self.best]) / 2.0

    def hear(self, now: int, rows: Sequence[Floats], value: float) -> None:
        """Take feedback that came before the action of iteration `now`.

        rows: for each model (lags, w), those of iterations now - 1, now - 2, ...; nan where there is none.
        """
        fits = self._fits(rows, value)
        lags = self._lags
        if len(self._values) >= NEIGHBOURS:
            likelihoods = np.logaddexp.reduceat(fits, lags.begin) - np.log(lags.last - lags.first + 1)
            self._evidence = FORGETTING * self._evidence + likelihoods
        places = now - 1 - lags.lag
        taken = (self._places[lags.hypothesis] == places[:, None]).any(axis=1)
        cases = np.split(np.where(taken, -np.inf, fits), lags.begin[1:])
        chosen = lags.begin + np.array([np.argmax(case) for case in cases])
        self._keep(value, places[chosen], [new[lags.lag[chosen]] for new in rows])
        self._waiting.append((now, value, places[chosen]))
        self._decide()

    def _keep(self, value: float, places: Ints, rows: Sequence[Floats]) -> None:
        """Keep feedback for the iterations (hypotheses,) with rows (hypotheses, w) for each model."""
        self._values = np.append(self._values, value)[-KEPT:]
        self._places = np.hstack([self._places, places[:, None]])[:, -KEPT:]
        pairs = zip(self._rows, rows, strict=True)
        self._rows = [np.hstack([kept, new[:, None]])[:, -KEPT:] for kept, new in pairs]

    def _fits(self, rows: Sequence[Floats], value: float) -> Values:
        """Return the logarithm of the likelihood of feedback for each case (cases,): models are witnesses apart."""
        fits = np.zeros(len(self._lags.lag))
        for kept, new in zip(self._rows, rows, strict=True):
            foreseen = _foreseen(kept[self._lags.hypothesis], self._values, new[self._lags.lag])
            fits -= np.minimum(np.square(foreseen - value), CUT) / (2.0 * VARIANCE)
        return fits

    def _decide(self) -> None:
        """Believe in a hypothesis that is clearly better than all that have no lag in common with it.

        It stays until another one is clearly better.
        """
        lags, best = self._lags, int(np.argmax(self._evidence))
        apart = (lags.last < lags.first[best]) | (lags.first > lags.last[best])
        rivals = apart if self.believed is None else np.arange(len(apart)) == self.believed
        if self._evidence[best] - self._evidence[rivals].max(initial=-np.inf) > MARGIN:
            self.believed = best

    def due(self, now: int, patience: int) -> list[tuple[int, float]]:
        """Return iterations with the feedback that is credited to them now, the oldest first.

        All that waits once a hypothesis is believed; before, what has waited for `patience` iterations.
        """
        late = [self.believed is not None or now - came >= patience for came, _, _ in self._waiting]
        due = self._waiting[: sum(late)]
        self._waiting = self._waiting[sum(late) :]
        return [(int(places[self.best]), value) for _, value, places in due if places[self.best] >= 0]


def _foreseen(kept: Floats, values: Values, rows: Floats) -> Values:
    """Return the feedback that is foreseen for rows (cases, w): (cases,).

    It is the mean for the most similar of the pairs kept (cases, n, w) with their values (n,). Of equals the newest
    count. Where nothing can be compared it is the mean of all.
    """
    if not len(values):
        return np.zeros(len(rows))
    gaps = np.square(kept - rows[:, None]).sum(axis=2)[:, ::-1]
    gaps = np.where(np.isnan(gaps), np.inf, gaps)
    nearest = np.argsort(gaps, axis=1, kind="stable")[:, :NEIGHBOURS]
    known = np.isfinite(np.take_along_axis(gaps, nearest, axis=1))
    total = np.where(known, values[::-1][nearest], 0.0).sum(axis=1)
    found: Values = np.where(known.any(axis=1), total / np.maximum(known.sum(axis=1), 1), values.mean())
    return found
