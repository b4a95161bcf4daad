"""How much a praise is worth: measured by the best praise of late (ours).

Praise fades, as people's does once a robot does well; and a teacher who compares with how well it does of late
praises less and less. What is done right is then as right as before. So models learn praise as a share of the best
that was given of late. Punishment stays as it is: a robot that is never praised must not be content with it.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

LATELY = 200
"""Iterations after which a judgement no longer counts as of late: who comes back after that praises anew."""
FULL = 1.0
"""The best that a teacher can say."""
FAINT = 0.02
"""Praise counts at most as if the best of late had been this: what is fainter is hardly praise."""


def worth(feedback: float, best: float) -> float:
    """Return feedback, -1 to 1, with praise measured by the best of late."""
    return feedback if feedback <= 0 else min(1.0, feedback / max(best, FAINT))


class Praise:
    """The feedback of late, and of whom. Until the same have judged often enough, full praise is the measure."""

    def __init__(self, window: int) -> None:
        """Look for the best among so many judged iterations; 0: full praise is always the measure."""
        self._window = window
        self._given: dict[int, tuple[float, frozenset[str]]] = {}

    def take(self, iteration: int, feedback: float, judges: Iterable[str]) -> None:
        """Keep the feedback for an iteration."""
        self._given[iteration] = feedback, frozenset(judges)

    def best(self, iteration: int) -> float:
        """Return the best of late up to an iteration whose feedback was taken: what its judges gave in a row.

        It is full praise until they have judged as often as the window is long, within `LATELY` iterations.
        """
        judges = self._given[iteration][1]
        given = (self._given[i] for i in range(iteration, iteration - LATELY, -1) if i in self._given)
        newest = list(islice(given, self._window))
        enough = 0 < len(newest) == self._window and all(of == judges for _, of in newest)
        return max(feedback for feedback, _ in newest) if enough else FULL

    def forget(self, oldest: int) -> None:
        """Forget what no longer counts for an iteration from `oldest` on."""
        for i in [i for i in self._given if i <= oldest - LATELY]:
            del self._given[i]
