"""Whether a router that we are connected to still gives us what is ours.

Zenoh 1.10 closes the link of a reader who is too slow. When that happens several times at once and the reader comes
back meanwhile, router and reader have a connection over which nothing comes any more, and nobody says so. So a bus
asks its router something that is always answered, now and then. Owns the counting; called from any thread.
"""

from __future__ import annotations

import time
from collections.abc import Callable

EVERY_S = 2.0
"""How often the router is asked, and the bound on an answer."""
MISSED = 3
"""So many questions without an answer, one after the other, are a router that gives us nothing."""


class Probe:
    """See the module's docstring."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._asked_s = clock()
        self._open = self._failed = False
        self._missed = 0

    @property
    def unheard(self) -> bool:
        """Whether the router gives us nothing."""
        return self._missed >= MISSED

    def is_due(self) -> bool:
        """Whether it is time to ask again; a question whose end is never told counts as one without an answer."""
        if self._clock() - self._asked_s < (2 * EVERY_S if self._open else EVERY_S):
            return False
        if self._open:
            self._missed += 1
        return True

    def ask(self) -> None:
        """Say that a question is asked now."""
        self._asked_s, self._open, self._failed = self._clock(), True, False

    def rest(self) -> None:
        """Say that there is nobody to ask: who is gone is not silent."""
        self._asked_s, self._open, self._missed = self._clock(), False, 0

    def fail(self) -> None:
        """Say that the question was not answered in time."""
        self._failed = True

    def end(self) -> None:
        """Say that nothing more comes to the question."""
        self._open = False
        self._missed = self._missed + 1 if self._failed else 0
