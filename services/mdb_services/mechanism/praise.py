"""How much a praise is worth: measured by the best praise of late (ours).

Praise fades, as people's does once a robot does well; and a teacher who compares with how well it does of late
praises less and less. What is done right is then as right as before. So models learn praise as a share of the best
that was given of late. Punishment stays as it is: a robot that is never praised must not be content with it.
"""

from __future__ import annotations

from collections.abc import Mapping

LONG_AGO = 10_000
"""Iterations after which a judgement is forgotten, however few there were since."""
FAINT = 0.02
"""Praise counts at most as if the best of late had been this: what is fainter is hardly praise."""


def worth(feedback: float, best: float) -> float:
    """Return feedback, -1 to 1, with praise measured by the best of late."""
    return feedback if feedback <= 0 else min(1.0, feedback / max(best, FAINT))


class Praise:
    """The feedback of late. Until there is enough of it, full praise counts as given before."""

    def __init__(self, window: int) -> None:
        """Look for the best among so many judged iterations; 0: full praise always counts as the best."""
        self._window = window
        self._given: dict[int, float] = {}

    def best(self, iteration: int, feedback: float) -> float:
        """Take the feedback for an iteration; return the best of late up to that iteration, this one included."""
        self._given[iteration] = feedback
        before = self._last([i for i in self._given if iteration - LONG_AGO < i <= iteration])
        full = [1.0] if len(before) < max(self._window, 1) else []
        return max([*full, *(self._given[i] for i in before)])

    def forget(self, oldest: int) -> None:
        """Forget what no longer counts for an iteration from `oldest` on."""
        before = self._last([i for i in self._given if oldest - LONG_AGO < i < oldest])
        kept = {*before, *(i for i in self._given if i >= oldest)}
        self._given = {i: given for i, given in self._given.items() if i in kept}

    def _last(self, iterations: list[int]) -> list[int]:
        return sorted(iterations)[-self._window :] if self._window else []

    def restore(self, given: Mapping[int, float]) -> None:
        """Go on from the feedback of late, by iteration."""
        self._given = dict(given)
