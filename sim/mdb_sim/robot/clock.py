"""The clock of a robot that acts every period, whether an action came or not. Pure: time is handed in."""

from __future__ import annotations

from collections import deque

import numpy as np

KEPT = 1000
"""Ticks over which jitter is told."""


class Clock:
    """When the next period begins, how late the last ones did, and how many were left out."""

    def __init__(self, period_s: float, now_s: float) -> None:
        self._period_s, self.due_s = period_s, now_s
        self._late: deque[float] = deque(maxlen=KEPT)
        self._ticks = self.missed = 0

    def tick(self, now_s: float) -> bool:
        """Whether a period begins now; those that are over by then are left out, and counted."""
        if now_s < self.due_s:
            return False
        self._late.append(now_s - self.due_s)
        behind = int((now_s - self.due_s) / self._period_s)
        self.missed += behind
        self._ticks += 1 + behind
        self.due_s += (1 + behind) * self._period_s
        return True

    def miss(self) -> None:
        """A period in which nothing could be done, for the last action is not over."""
        self.missed += 1

    def values(self) -> dict[str, float]:
        """Return the share of periods that were missed, and by how much they begin late: median, 99th percentile."""
        late = np.array(self._late or [0.0])
        return {
            "periods": float(self._ticks),
            "missed_share": self.missed / max(1, self._ticks),
            "jitter_p50_s": float(np.percentile(late, 50)),
            "jitter_p99_s": float(np.percentile(late, 99)),
        }
