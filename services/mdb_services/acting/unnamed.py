"""Feedback that names no iteration: who said it, which pairs it may be for, and to which it is credited in the end.

Owns what `mechanism.feedback.credit` needs of each teacher, and hands it rows. After the optimizer's death it begins
anew: how late each teacher is has to be found out again, and the feedback that waited for it is lost.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mdb_protocol import messages
from mdb_services.acting.teachers import KEPT_TEACHERS
from mdb_services.experiment.brain import BrainConfig
from mdb_services.mechanism.feedback.credit import Credit
from mdb_services.mechanism.networks.encoding import Codebook, Facts
from mdb_services.mechanism.networks.network import Floats
from mdb_services.shell.facts import facts_of

KNOWN_TEACHERS = 8
"""Teachers of whom it is known how late they are; beyond it the one who was silent longest is forgotten."""


class Unnamed:
    """See the module's docstring."""

    def __init__(self, config: BrainConfig) -> None:
        variables = config.variables()
        models = [model for model in config.model if "feedback" in model.outputs]
        self._books = [Codebook(variables, m.inputs, m.outputs) for m in models if "feedback" not in m.inputs]
        self._lags = min(config.optimizer.most_late + 1, config.optimizer.feedback_window)
        self._patience = config.optimizer.feedback_window - self._lags
        self._pairs: dict[int, messages.Pair] = {}
        """The last pairs, by iteration."""
        self._said: dict[str, list[float]] = {}
        """What each teacher has said since the last action."""
        self._credits: dict[str, Credit] = {}
        """Of each teacher; who spoke last is last."""
        self._asked = -1
        """The iteration for which the last feedback was taken in."""

    def remember(self, pair: messages.Pair) -> None:
        """Keep a pair as long as feedback may be for it."""
        self._pairs = {i: kept for i, kept in self._pairs.items() if i > pair.iteration - self._lags}
        self._pairs[pair.iteration] = pair

    def hear(self, feedback: messages.Feedback) -> None:
        """Keep what a teacher says of some action of late; "not now" is nothing."""
        if feedback.value is not None and (feedback.teacher in self._said or len(self._said) < KEPT_TEACHERS):
            said = self._said.setdefault(feedback.teacher, [])
            if len(said) <= self._lags:
                said.append(feedback.value)

    def credited(self, now: int) -> Iterable[tuple[int, messages.Feedback]]:
        """Yield the feedback that is credited before the action of iteration `now`, with its iteration.

        It is taken in once an iteration; asked again, only what has fallen due is told. More feedback of one teacher
        than there are actions it can be for, as after a network that was cut, is left out.
        """
        if now != self._asked:
            self._asked = now
            self._take_in(now)
        for teacher, credit in self._credits.items():
            for iteration, value in credit.due(now, self._patience):
                yield iteration, messages.Feedback(teacher=teacher, value=value)

    def _take_in(self, now: int) -> None:
        """Hand on what each teacher has said, in the order of their names: the same however it came."""
        said, self._said = self._said, {}
        rows = self._rows_before(now) if said else []
        for teacher in sorted(said):
            if len(said[teacher]) <= self._lags:
                credit = self._credit_of(teacher)
                for value in said[teacher]:
                    credit.hear(now, rows, value)

    def _credit_of(self, teacher: str) -> Credit:
        credit = self._credits.pop(teacher, None)
        if credit is None:
            newest = next(reversed(self._credits.values()), None)
            credit = Credit(self._lags, [book.width for book in self._books], newest)
        self._credits[teacher] = credit
        if len(self._credits) > KNOWN_TEACHERS:
            del self._credits[next(iter(self._credits))]
        return credit

    def _rows_before(self, now: int) -> list[Floats]:
        """Return for each model (lags, w): what it reads of the pairs before iteration `now`, the newest first."""
        pairs = [self._pairs.get(now - 1 - lag) for lag in range(self._lags)]
        facts: list[Facts] = [{} if pair is None else facts_of(pair) for pair in pairs]
        return [np.stack([_row(book, book.input_rows(known)) for known in facts]) for book in self._books]

    def values(self) -> dict[str, float]:
        """How many iterations late each teacher is, at the least and at the most, where it is known."""
        known = {name: credit.window for name, credit in self._credits.items() if credit.window is not None}
        least = {f"late_least.{name}": float(window[0]) for name, window in known.items()}
        return least | {f"late_most.{name}": float(window[1]) for name, window in known.items()}


def _row(book: Codebook, rows: Floats | None) -> Floats:
    """Return the only row (w,), nan where a variable was not there."""
    return np.full(book.width, np.nan, np.float32) if rows is None else rows[0]
