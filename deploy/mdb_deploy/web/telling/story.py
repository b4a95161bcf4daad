"""A run as it goes on, in parts: of each browser those are told that are new for it.

INTERFACE (this is the first commit; the bodies follow).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

from mdb_protocol.keys import Key
from mdb_protocol.messages import Message
from mdb_sim.runs.experiment import Experiment


class Story:
    """Takes every message of a run and tells its parts as plain JSON values. Used by one thread.

    Parts: scene, perception, picture, phase, control, alive, finished, trouble, thought, beliefs, induced, contexts,
    shelf, teachers, lessons, timing; and, one for each model, `models/NAME` and `memory/NAME`.
    """

    def __init__(self, experiment: Experiment, clock: Callable[[], float] | None = time.monotonic) -> None:
        """`clock`: seconds, to tell that the brain waits, and to renew large parts not too often; None: neither."""

    def take(self, key: Key | str, message: Message) -> None:
        """Keep what a message says. Never raises for what is not of this experiment: that is passed over.

        Also taken: PICTURE, MEMORY_SNAPSHOT and KEPT_MODEL (answers to the server's questions, when it comes late).
        """

    def alive(self, tokens: Iterable[str]) -> None:
        """Say who is alive: tokens as ROLE/INSTANCE."""

    def trouble(self, words: str | None) -> None:
        """Say what is wrong with the run, as the server knows it (the router is gone); None: nothing."""

    @property
    def versions(self) -> dict[str, int]:
        """Of each part the number of times that it was another; parts that are not known yet are left out."""
        return {}

    def part(self, name: str) -> Any:
        """Return one part, as in the frame `now`; computed when asked for, and only when it has changed."""

    @property
    def rows_count(self) -> int:
        """Rows so far, those that are no longer kept too: the place of the next row."""
        return 0

    def rows(self, since: int, most: int = 4000) -> dict[str, Any]:
        """Return at most `most` rows from place `since` on, as in the frame; `from` is higher where old ones left."""
        return {}

    def parts(self, seen: dict[str, int]) -> dict[str, Any]:
        """Return the frame `now` without `is`: all parts that are new for a reader, and its rows; {} when none is.

        `seen` is what this reader has (begin with {}); it is brought up to date here. Rows that have changed (feedback
        that came late) come again: a page puts what it gets in the place of what it has from `rows.from` on. A frame
        has a bounded number of rows; the next call gives the next ones.
        """
        return {}
