"""What a teacher wants of a machine that is to bring something to a place: that it comes nearer."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence


class Nearer:
    """Wants one thing: that what is left to the place becomes less, by a step at a time.

    What counts is where it will soon be if it goes on as it moved: else who comes fast to the place flies past it.
    """

    commands = ("nearer",)
    order = (0,)

    def __init__(
        self,
        left: Sequence[str] = ("dx", "dy"),
        *,
        step: float = 0.03,
        close: float = 0.01,
        tolerance: float = 0.05,
        ahead: float = 2.5,
    ) -> None:
        """left: the scene's numbers for what is left to the place, one an axis, in one unit, as all that follows.

        step: so much less should be left after an action; close: less than this need not be. tolerance: where so much
        too much is left it is worth 0, with twice as much -1. ahead: so many actions on, at the speed of the last.
        """
        self.needs = tuple(left)
        self._step, self._close, self._tolerance, self._ahead = step, close, tolerance, ahead

    def want(self, scene: Mapping[str, float]) -> int:
        """See `Policy.want`."""
        del scene
        return 0

    def judge(self, before: Mapping[str, float], after: Mapping[str, float], event: str, wanted: int) -> float:
        """See `Policy.judge`."""
        del event, wanted
        soon = [after[name] + self._ahead * (after[name] - before[name]) for name in self.needs]
        allowed = max(self._close, math.hypot(*(before[name] for name in self.needs)) - self._step)
        return max(-1.0, min(1.0, 1.0 - (math.hypot(*soon) - allowed) / self._tolerance))

    def expected(self, wanted: int, action: Mapping[str, float]) -> None:
        """See `Policy.expected`: that depends on where it is."""
        del wanted, action
