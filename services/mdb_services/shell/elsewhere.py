"""Whose count of iterations is right when robot and optimizer disagree by more than one step.

Owns the rule. A single message is not believed: it may be junk, or from somebody who should be silent. A count is
believed once it was said again and again, without a nearer one in between. Pure: the owner hands in what it hears,
and the time.
"""

from __future__ import annotations

from mdb_protocol.duties import INSISTS_S

BELIEVED_AFTER_S = INSISTS_S
"""So long must the other side insist: a robot and an optimizer that wait both say theirs several times in it."""


class Elsewhere:
    """See the module's docstring."""

    def __init__(self) -> None:
        self._iteration: int | None = None
        self._since_s = 0.0

    def nearer(self) -> None:
        """Something was said that follows from what is known."""
        self._iteration = None

    def believed(self, iteration: int, now_s: float) -> bool:
        """Whether an iteration that is far ahead is to be taken for the truth."""
        if iteration != self._iteration:
            self._iteration, self._since_s = iteration, now_s
        return now_s - self._since_s >= BELIEVED_AFTER_S
