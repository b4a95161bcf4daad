"""Which of the last actions feedback is for when it does not say so: how late its teacher is, found by what fits.

Ours. TAMER (Knox and Stone, 2009) spreads such feedback over a distribution of delays that is given beforehand. Here
it is found out, from nothing but the pairs. There are some hypotheses: each says that the lags, iterations between an
action and its feedback, are evenly spread over some that follow one another, often one alone. Each keeps the feedback
with the pairs that it is for if the hypothesis holds, foresees from what similar pairs got what the next will be, and
is believed the more the better it foresees: a right one puts like to like, a wrong one mixes up what belongs to
different actions.

Possible are the lags of all hypotheses that are not clearly worse than the best. An action is judged when all has
come that may be for it, with feedback of which more than half is for it (`sharing`), or with none. While all lags are
possible, or more than one and little feedback has come, it waits as long as its patience.
Another teacher is taken for as late as the one before, until his own feedback clearly says otherwise.

Pure. Pairs are rows of numbers, one row for each model that learns feedback; what they mean is not known here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.feedback.sharing import Ints, Values, share
from mdb_services.mechanism.networks.network import Floats

SPREADS = 1, 2, 3, 5
"""Over so many lags that follow one another feedback may be spread."""
SHARED = 200
"""Pairs, the newest, among which feedback is shared: of one who seldom judges there would be very many."""
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
FEW = 60
"""Less feedback than this cannot be shared out among several actions with confidence."""
ENOUGH = 0.5
"""An action gets the feedback of which more than this is for it."""
SAME = 0.25
"""Feedback that differs less is the same, where it is asked how much is for an action."""


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
        self._lags, self._count = Lags.up_to(lags), lags
        count = len(self._lags.first)
        self.window: tuple[int, int] | None = None
        """The least and the greatest lag that are possible; None: all are."""
        self._evidence = np.zeros(count)
        self._came = np.zeros(0, np.int64)
        """(n,): before which action the kept feedback came."""
        self._values = np.zeros(0)
        self._places = np.zeros((count, 0), np.int64)
        """(hypotheses, n): the iterations that it is for."""
        self._rows = [np.zeros((count, 0, width), np.float32) for width in widths]
        """For each model (hypotheses, n, w): the rows of these."""
        self._pairs: dict[int, list[Floats]] = {}
        """For each iteration that kept feedback may be for what each model reads of it, (w,)."""
        self._next = 0
        """The first iteration that it is not decided about."""
        self._others = 0
        """How many of the kept feedbacks, the oldest ones, are of the teacher before him."""
        self._alone = False
        """Whether he has turned out to be late in another way than that teacher: then they share nothing."""
        if before is not None:
            self._begin_like(before)

    def _begin_like(self, before: Credit) -> None:
        best, count = int(np.argmax(before._evidence)), len(self._evidence)
        self.window = before.window
        self._came, self._values, self._pairs = before._came, before._values, dict(before._pairs)
        self._others = len(self._values)
        self._places = np.repeat(before._places[best : best + 1], count, axis=0)
        self._rows = [np.repeat(rows[best : best + 1], count, axis=0) for rows in before._rows]

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
        self._keep(now, value, places[chosen], [new[lags.lag[chosen]] for new in rows])
        self._pairs |= {now - 1 - lag: [new[lag] for new in rows] for lag in range(self._count)}
        oldest = int(self._came[0]) - self._count
        self._pairs = {i: pair for i, pair in self._pairs.items() if i >= oldest}
        self._decide()

    def _keep(self, now: int, value: float, places: Ints, rows: Sequence[Floats]) -> None:
        """Keep feedback for the iterations (hypotheses,) with rows (hypotheses, w) for each model."""
        self._others = max(0, self._others - (len(self._values) == KEPT))
        self._came = np.append(self._came, now)[-KEPT:]
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
        """Take as possible the lags of all hypotheses that are not clearly worse than the best.

        These grow fewer and stay, though nothing new may tell them from others, until one without is clearly better.
        """
        lags, evidence = self._lags, self._evidence
        best = evidence.max()
        good = evidence >= best - MARGIN
        first, last = int(lags.first[good].min()), int(lags.last[good].max())
        if self.window is None:
            self.window = (first, last) if last - first + 1 < self._count else None
            return
        within = (lags.first >= self.window[0]) & (lags.last <= self.window[1])
        if best - evidence[within].max() > MARGIN:
            self.window, self._alone = (first, last), True
        elif first >= self.window[0] and last <= self.window[1]:
            self.window = first, last

    def due(self, now: int, patience: int) -> list[tuple[int, float]]:
        """Return iterations with the feedback that is credited to them now, in order, each once at the most."""
        first, last, end = 0, self._count - 1, now - patience
        if self.window is not None:
            first, last = self.window
            much = len(self._values) - (self._others if self._alone else 0) >= FEW
            end = now - (last if first == last or much else patience)
        begin, self._next = self._next, max(self._next, end)
        if not len(self._came) or self._came[-1] - 1 - first < begin or begin >= end:
            return []
        places = self._came[:, None] - 1 - np.arange(first, last + 1)
        his = (np.arange(len(places)) >= self._others)[:, None] & (places >= begin) & (places < end)
        if not his.any():
            return []
        shares = self._shares(places) if last > first else np.ones(places.shape)
        wanted = np.unique(places[his]).tolist()
        return [(i, value) for i in wanted if (value := self._enough(his & (places == i), shares)) is not None]

    def _shares(self, places: Ints) -> Values:
        """Return the shares of the kept feedback in the iterations that it may be for (n, lags)."""
        iterations = np.array(sorted(self._pairs)[-SHARED:])
        rows = [np.stack([self._pairs[i][model] for i in iterations.tolist()]) for model in range(len(self._rows))]
        known = (places >= 0) & np.isin(places, iterations)
        if self._alone:
            known[: self._others] = False
        candidates = np.where(known, np.searchsorted(iterations, places), 0)
        return share(rows, candidates, known, self._values)

    def _enough(self, here: NDArray[np.bool_], shares: Values) -> float | None:
        """Return the feedback of which enough is for one iteration, that of the cases `here` (n, lags)."""
        values, parts = self._values[np.nonzero(here)[0]], shares[here]
        alike = (np.abs(values[:, None] - values) <= SAME) @ parts
        most = int(np.argmax(alike))
        return float(values[most]) if alike[most] > ENOUGH else None


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
