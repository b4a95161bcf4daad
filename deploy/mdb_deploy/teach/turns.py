"""Whose turn it is: what the teacher can do now, until when the brain waits for it, and whether to ask it to wait.

Owns the times of the scene that is shown. Pure: no bus, no clock.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from mdb_deploy.teach.view import Exchange, Turn, View

AGAIN_S = 1.0
"""So often a teacher who wants to be waited for says so (ours); the brain waits for its patience each time."""
MOST_S = 600.0
"""For one scene he says it for so long at most, and the brain waits no longer either."""


class Patience(NamedTuple):
    """Seconds that the brain waits for a note and for feedback, as the experiment file says."""

    command_s: float
    feedback_s: float


class Turns:
    """See the module's docstring. Times are seconds of one clock, the caller's."""

    def __init__(self, teacher: str, patience: Patience | None) -> None:
        """Without `patience` it is not known until when the brain waits."""
        self._teacher, self._patience = teacher, patience
        self._seen_s = -math.inf
        self._judged_s: float | None = None
        self._asked_s = -math.inf

    def see(self, now_s: float) -> None:
        """A new scene is shown."""
        self._seen_s, self._judged_s, self._asked_s = now_s, None, -math.inf

    def judge(self, now_s: float) -> None:
        """The last action is judged."""
        self._judged_s = now_s

    def turn(self, view: View, last: Exchange, this: Exchange) -> Turn:
        """Return what can be done now. `last` and `this`: the action that led to the view's scene, and the next."""
        iteration = view.scene.iteration if view.scene is not None else 0
        if view.finished:
            return Turn("over", iteration)
        if view.scene is None or view.paused:
            return Turn("watch", iteration)
        judges = last.note is not None and last.feedback is None
        if this.spoke:
            return Turn("judge" if judges else "watch", iteration)  # he is not waited for: he said "not now"
        return Turn("both" if judges else "play", iteration, self._until_s(view, last))

    def _until_s(self, view: View, last: Exchange) -> float | None:
        """Return when the brain acts without a note of this teacher; None: it waits, or that is not known."""
        holder = view.report.holder if view.report is not None else None
        if self._patience is None or view.waits or holder not in (None, self._teacher):
            return None
        if last.note is None:
            return self._seen_s + self._patience.command_s
        until_s = self._seen_s + self._patience.feedback_s
        return (until_s if self._judged_s is None else min(self._judged_s, until_s)) + self._patience.command_s

    def asks(self, view: View, now_s: float) -> bool:
        """Return whether it is time to ask the brain to wait; it is taken as done."""
        due = view.waits and view.turn.kind in ("play", "both")
        if not due or now_s - self._asked_s < AGAIN_S or now_s - self._seen_s >= MOST_S:
            return False
        self._asked_s = now_s
        return True
