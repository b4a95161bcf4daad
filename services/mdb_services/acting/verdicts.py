"""What feedback comes to for each pair: when it comes, late, without an iteration, measured by the best of late.

Owns the pairs that may still be judged. Pure: the optimizer hands in what came and sends what comes of it.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from mdb_protocol import messages
from mdb_services.acting.teachers import Teachers
from mdb_services.acting.unnamed import Unnamed
from mdb_services.experiment.brain import BrainConfig
from mdb_services.mechanism.feedback.praise import Praise


class Verdicts:
    """See the module's docstring."""

    def __init__(self, config: BrainConfig, teachers: Teachers) -> None:
        """`teachers` keeps what each has said for the iterations that were named."""
        self._teachers = teachers
        self._unnamed = Unnamed(config)
        self._praise = Praise(config.optimizer.praise_window)
        self._window = config.optimizer.feedback_window
        self._unjudged: dict[int, messages.Pair] = {}
        """The pairs within `feedback_window` that have no feedback yet."""

    def go_on(self, progress: messages.Progress) -> None:
        """Take the newest pairs from the memory store."""
        self._unjudged = {pair.iteration: pair for pair in progress.unjudged}
        for pair in progress.judged:
            if pair.feedback is not None:
                self._praise.take(pair.iteration, pair.feedback, pair.judges)
        for pair in progress.unjudged:
            self._unnamed.remember(pair)

    def hear(self, feedback: messages.Feedback, *, began: bool) -> None:
        """Keep feedback. What names no iteration waits for the next action: by then all said before has come.

        Before we `began` it is for what we do not know of.
        """
        self._teachers.judge(feedback)
        if feedback.iteration is None and began:
            self._unnamed.hear(feedback)

    def judged(self, pair: messages.Pair) -> messages.Pair:
        """Return a pair with what its teachers think of it, and the best praise of late, if they think something."""
        value, judges = self._teachers.verdict(pair.iteration, pair.teacher)
        if value is None:
            return pair
        self._praise.take(pair.iteration, value, judges)
        best = self._praise.best(pair.iteration)
        return msgspec.structs.replace(pair, feedback=value, judges=judges, best=best)

    def late(self, now: int) -> Iterator[messages.Pair]:
        """Yield the pairs before iteration `now` whose feedback has come since, with it.

        Ask before an action and after its command, not when it comes: in lockstep that is the same moment every run.
        """
        for iteration, feedback in self._unnamed.credited(now):
            self._teachers.credit(iteration, feedback)
        spoken_of = self._teachers.spoken_of
        for iteration in [iteration for iteration in self._unjudged if iteration in spoken_of]:
            with_feedback = self.judged(self._unjudged[iteration])
            if with_feedback.feedback is not None:
                del self._unjudged[iteration]
                yield with_feedback

    def remember(self, pair: messages.Pair, now: int) -> None:
        """Keep a pair as long as feedback may still come for it; `now` is the iteration after it."""
        if pair.feedback is None:
            self._unjudged[pair.iteration] = pair
        self._unnamed.remember(pair)
        oldest = now - self._window
        for iteration in [iteration for iteration in self._unjudged if iteration < oldest]:
            del self._unjudged[iteration]
        self._praise.forget(oldest)
        self._teachers.forget(before=now, feedback_before=oldest)

    def values(self) -> dict[str, float]:
        """How late teachers are who name no iteration."""
        return self._unnamed.values()
