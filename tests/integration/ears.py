"""Someone who hears all that is said in a brain under test, with the time when it came."""

from __future__ import annotations

import os
import signal
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, TypeVar

from mdb_protocol import keys
from mdb_protocol.bus import Bus, read
from mdb_protocol.errors import DecodeError, UnheardError
from mdb_protocol.messages import Message
from mdb_services.experiment.run_folder import MEMORY_FILE

M = TypeVar("M", bound=Message)


class Heard(NamedTuple):
    """A message, and when it came, by the clock that the processes of this machine share."""

    at_s: float
    key: str
    message: Message


class Ears:
    """Hears everything on a bus; junk is left out."""

    def __init__(self, bus: Bus, again: Callable[[], Bus] | None = None) -> None:
        """`again`: joins once more when the router gives this bus nothing any more, as who is supervised is started
        again then (`mdb_protocol.probing`); without it UnheardError is raised."""
        self.bus = bus
        self.heard: list[Heard] = []
        self._tap, self._again = bus.tap(), again

    def listen(self, seconds: float) -> list[Heard]:
        """Listen so long; return what came in it."""
        first, until_s = len(self.heard), time.monotonic() + seconds
        while (left_s := until_s - time.monotonic()) > 0:
            self.bus.wait(min(left_s, 0.05))
            self._check()
            self._take()
        return self.heard[first:]

    def _check(self) -> None:
        try:
            self.bus.check_heard()
        except UnheardError:
            if self._again is None:
                raise
            self.bus.close()
            self.bus = self._again()
            self._tap = self.bus.tap()

    def _take(self) -> None:
        while (raw := self._tap.take()) is not None:
            row = keys.find(self.bus.brain, raw.key)
            if row is not None and row.message is not None:
                with suppress(DecodeError):
                    self.heard.append(Heard(time.monotonic(), raw.key, read(row, self.bus.brain, raw)))


def of(heard: list[Heard], kind: type[M]) -> list[M]:
    """Return the messages of one kind."""
    return [h.message for h in heard if isinstance(h.message, kind)]


def longest_gap_s(heard: list[Heard], kind: type[M], began_s: float, ended_s: float) -> float:
    """Return the longest time in which no message of a kind came, in a span of time."""
    times = [began_s, *(h.at_s for h in heard if isinstance(h.message, kind)), ended_s]
    inside = [t for t in times if began_s <= t <= ended_s]
    return max(after - before for before, after in pairwise(inside))


@contextmanager
def frozen(*pids: int) -> Iterator[None]:
    """Freeze processes meanwhile."""
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in pids:
            os.kill(pid, signal.SIGCONT)


def stored_iterations(run: Path) -> list[int]:
    """Return the iterations of the pairs on disk, in order."""
    with sqlite3.connect(f"file:{run / MEMORY_FILE}?mode=ro", uri=True) as db:
        return [row[0] for row in db.execute("SELECT iteration FROM pair ORDER BY iteration")]
