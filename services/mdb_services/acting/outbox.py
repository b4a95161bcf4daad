"""Pairs that are sent until they are stored.

Owns the pairs without acknowledgement, and when each was sent last.
"""

from __future__ import annotations

from itertools import islice

from mdb_protocol import messages
from mdb_protocol.bus import Publisher

UNSTORED = 100
"""Pairs without acknowledgement with which the robot still acts, unless the file says `when_full = "act"`."""
KEPT_UNSTORED = 10_000
"""Pairs that are kept for a memory store that does not come back; beyond it the oldest is lost, and counted."""
RESENT_AT_ONCE = 100
"""Pairs without acknowledgement that are sent again together, the oldest first."""


class Outbox:
    """See the module's docstring."""

    def __init__(self, pairs: Publisher, resend_s: float) -> None:
        """What is not acknowledged is sent again after `resend_s`."""
        self._pairs, self._resend_s = pairs, resend_s
        self._waiting: dict[int, tuple[messages.Pair, float]] = {}
        self.lost = 0

    def __len__(self) -> int:
        """Pairs without acknowledgement."""
        return len(self._waiting)

    def iterations(self) -> list[int]:
        """Return those of the pairs without acknowledgement."""
        return sorted(self._waiting)

    def send(self, pair: messages.Pair, now: float) -> None:
        """Send a pair, or once more one that has feedback now."""
        self._waiting[pair.iteration] = pair, now
        if len(self._waiting) > KEPT_UNSTORED:
            del self._waiting[next(iter(self._waiting))]
            self.lost += 1
        self._pairs.put(pair)

    def acknowledge(self, stored: messages.PairStored) -> bool:
        """Take a pair for stored, unless it is what it was before its feedback came; False: nothing was awaited."""
        sent = self._waiting.get(stored.iteration)
        if sent is None:  # it was said again
            return False
        if stored.judged or sent[0].feedback is None:
            del self._waiting[stored.iteration]
        return True

    def resend(self, now: float) -> None:
        """Send again what has waited long."""
        for iteration, (pair, sent_s) in list(islice(self._waiting.items(), RESENT_AT_ONCE)):
            if now - sent_s >= self._resend_s:
                self._waiting[iteration] = pair, now
                self._pairs.put(pair)
