"""Which of the last actions feedback is for when it does not say so: how late its teacher is, found by what fits.

Ours. TAMER (Knox and Stone, 2009) spreads such feedback over a distribution of delays that is given beforehand. Here
it is learnt how late a teacher is, from nothing but the pairs: for each lag, that is, iterations between an action and
its feedback, the feedback is foreseen from that which came for similar pairs if all of it was so late. The right lag
foresees well, wrong ones mix up what belongs to different actions.

Feedback waits until one lag clearly fits best, or until its patience is over: then it is credited to what fits best so
far. Another teacher is taken for as late as the one before, until his own feedback says clearly otherwise. What was
learnt with that one's lag helps to tell.

Pure. Pairs are rows of numbers, one row for each model that learns feedback; what they mean is not known here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.network import Floats

Values = NDArray[np.float64]

KEPT = 100
"""Feedback from which the next is foreseen; the oldest leaves."""
NEIGHBOURS = 3
"""The most similar pairs, whose mean feedback is foreseen."""
FORGETTING = 0.98
"""What an error counts after one more feedback: a teacher may become slower."""
VARIANCE = 0.25
"""Of feedback that cannot be foreseen though the lag is right, in [-1, 1] squared: so one odd feedback is no proof."""
MARGIN = 4.0
"""By how much the logarithm of a lag's likelihood must be above all others to be believed, or to take over."""


@dataclass
class Fit:
    """How well each lag explains one teacher's feedback; arrays over lags have shape (lags,)."""

    rows: list[Floats]
    """For each model (n, lags, w): the pairs that the kept feedback is for if it is so late; nan where is none."""
    values: Values
    """(n,): the kept feedback, the oldest first."""
    errors: Values
    """(models, lags): squared errors, forgotten by and by."""
    count: float = 0.0
    """How many they are."""

    @classmethod
    def nothing(cls, lags: int, widths: Sequence[int]) -> Fit:
        """Return the fit of no feedback at all."""
        rows = [np.zeros((0, lags, width), np.float32) for width in widths]
        return cls(rows, np.zeros(0), np.zeros((len(widths), lags)))

    def of_another(self, lag: int) -> Fit:
        """Return a beginning for another teacher: what was learnt with this one's lag, which tells nothing of his."""
        rows = [np.repeat(kept[:, lag : lag + 1], kept.shape[1], axis=1) for kept in self.rows]
        return Fit(rows, self.values.copy(), np.zeros_like(self.errors))

    @property
    def lags(self) -> int:
        """How many lags are told apart: 0 to one less."""
        return int(self.errors.shape[1])

    def learn(self, rows: Sequence[Floats], value: float) -> None:
        """Take in feedback with the pairs that it may be for: for each model (lags, w)."""
        errors = [
            np.square(_foreseen(kept, self.values, new) - value) for kept, new in zip(self.rows, rows, strict=True)
        ]
        if len(self.values) >= NEIGHBOURS:
            self.errors = FORGETTING * self.errors + np.minimum(errors, 1.0)
            self.count = FORGETTING * self.count + 1.0
        self.rows = [np.concatenate([kept, new[None]])[-KEPT:] for kept, new in zip(self.rows, rows, strict=True)]
        self.values = np.append(self.values, value)[-KEPT:]

    def evidence(self) -> Values:
        """Return the logarithm of each lag's likelihood, but for a constant: models as independent witnesses."""
        if not self.count:
            return np.zeros(self.lags)
        found: Values = -0.5 * self.count * np.log(self.errors / self.count + VARIANCE).sum(axis=0)
        return found


def _foreseen(kept: Floats, values: Values, rows: Floats) -> Values:
    """Return the feedback that is foreseen for rows (lags, w), one a lag: (lags,).

    It is the mean for the most similar of the pairs kept (n, lags, w) with their values (n,). Of equals the newest count. Where nothing can be compared it is the mean of all.
    """
    if not len(values):
        return np.zeros(len(rows))
    gaps = np.square(kept - rows).sum(axis=2)[::-1]
    gaps = np.where(np.isnan(gaps), np.inf, gaps)
    nearest = np.argsort(gaps, axis=0, kind="stable")[:NEIGHBOURS]
    known = np.isfinite(np.take_along_axis(gaps, nearest, axis=0))
    total = np.where(known, values[::-1][nearest], 0.0).sum(axis=0)
    found: Values = np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), values.mean())
    return found


class Credit:
    """The feedback of one teacher who names no iteration: what waits, and how late he is."""

    def __init__(self, fit: Fit, favoured: int | None = None) -> None:
        """favoured: the lag of the teacher before him."""
        self.lag = favoured
        """How late he is, in iterations; None: not known yet."""
        self._fit = fit
        self._waiting: list[tuple[int, float]] = []

    def another(self) -> Credit:
        """Return the beginning of another teacher's, who comes after this one."""
        best = self._best()
        return Credit(self._fit.of_another(best), best)

    def hear(self, now: int, rows: Sequence[Floats], value: float) -> None:
        """Take feedback that came before the action of iteration `now`.

        rows: for each model (lags, w), those of iterations now - 1, now - 2, ...; nan where there is none.
        """
        self._fit.learn(rows, value)
        self._waiting.append((now, value))

    def due(self, now: int, patience: int) -> list[tuple[int, float]]:
        """Return iterations with the feedback that is credited to them now, the oldest first.

        All that waits once the lag is known; before, what has waited for `patience` iterations.
        """
        self._decide()
        late = len(self._waiting) if self.lag is not None else sum(now - at >= patience for at, _ in self._waiting)
        best = self.lag if self.lag is not None else self._best()
        due, self._waiting = self._waiting[:late], self._waiting[late:]
        return [(at - 1 - best, value) for at, value in due if at > best]

    def _best(self) -> int:
        return int(np.argmax(self._fit.evidence())) if self.lag is None else self.lag

    def _decide(self) -> None:
        """Believe in a lag, or in another one, when it is clearly better than all others, or than that."""
        evidence = self._fit.evidence()
        best = int(np.argmax(evidence))
        others = np.delete(evidence, best).max(initial=-np.inf) if self.lag is None else evidence[self.lag]
        if evidence[best] - others > MARGIN:
            self.lag = best
