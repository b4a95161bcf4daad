"""The heartbeat: how a process proves to its supervisor that the loop which does its work goes on.

Owns both ends of a pipe, whose number the child finds in its environment. Each beat is a line, the seconds within
which the next one comes: so whoever is about to do something long says so before. The loop itself beats, no thread
beside it, and a beat never waits and never fails: a pipe needs no disk, and when the supervisor is frozen beats are
dropped. Silence is counted in the supervisor's own turns: after a sleep of the whole machine nobody looks dead.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, MutableMapping
from contextlib import suppress

VARIABLE = "MDB_HEARTBEAT"
"""Holds the number of the pipe's end that is written to."""
BEAT_S = 0.2
"""So often the same is said again."""
SILENT_S = 2.5
"""Who is silent for longer hangs, unless something else was said."""
START_S = 30.0
"""Between the first sign of life and the loop: imports, a router, the predecessor's tokens, a body."""
COMPILE_S = 90.0
"""The same when kernels may have to be compiled."""
CLOSE_S = 10.0
"""The end: a body that comes to rest, a log that is finished, a session that takes its leave of a router."""
TURN_S = 0.5
"""No turn of the supervisor counts for more: what is beyond it was sleep, or a machine with no time for anybody."""
READY = "ready"
READ_BYTES = 65536
"""As much as a pipe holds."""


class Heart:
    """The end of the one who beats; without a supervisor it beats for nobody."""

    def __init__(self, pipe: int | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._pipe, self._clock = pipe, clock
        self._said_s = self._beaten_s = 0.0
        if pipe is not None:
            os.set_blocking(pipe, False)

    @classmethod
    def inherited(cls, environment: MutableMapping[str, str] = os.environ) -> Heart:
        """Return the heart of this process; the variable is taken away, for children of its own are not meant."""
        said = environment.pop(VARIABLE, "")
        return cls(int(said) if said.isdecimal() else None)

    @property
    def is_felt(self) -> bool:
        """Whether there is a supervisor."""
        return self._pipe is not None

    def ready(self) -> None:
        """Say that it is ready, and beat."""
        self._write(f"{READY} {SILENT_S:.3f}\n")

    def beat(self, next_s: float = SILENT_S) -> None:
        """Say that all goes on, and within how many seconds it is said again; 0 keeps silent."""
        now_s = self._clock()
        if self._pipe is None or not next_s or (next_s == self._said_s and now_s - self._beaten_s < BEAT_S):
            return
        self._said_s, self._beaten_s = next_s, now_s
        self._write(f"{next_s:.3f}\n")

    def _write(self, line: str) -> None:
        if self._pipe is not None:
            with suppress(OSError):  # full, for the supervisor is frozen; or broken, for it is gone
                os.write(self._pipe, line.encode())


class Pulse:
    """The supervisor's end: how long a process has been silent. One that never beats is not supervised."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Make the pipe; OSError when no descriptor is left."""
        self._clock = clock
        self._pipe, self.child_pipe = os.pipe()
        os.set_blocking(self._pipe, False)
        self.silent_s = 0.0
        self.ready = False
        """Whether it has said that it is ready."""
        self._limit_s: float | None = None
        self._felt_s = clock()

    def environment(self) -> dict[str, str]:
        """Return what tells the child where to beat; it must inherit `child_pipe`."""
        return {VARIABLE: str(self.child_pipe)}

    def child_has_it(self) -> None:
        """Close the child's end, once the child has it."""
        if self.child_pipe >= 0:
            os.close(self.child_pipe)
            self.child_pipe = -1

    def feel(self) -> None:
        """Take in the beats since the last call."""
        now_s = self._clock()
        passed_s, self._felt_s = min(now_s - self._felt_s, TURN_S), now_s
        if (beats := self._beats()).endswith(b"\n"):
            self.silent_s, self._limit_s = 0.0, float(beats.split()[-1])
            self.ready = self.ready or READY.encode() in beats
        else:
            self.silent_s += passed_s

    def _beats(self) -> bytes:
        try:
            return os.read(self._pipe, READ_BYTES)
        except BlockingIOError:
            return b""

    def hangs(self, patience: float = 1.0) -> bool:
        """Whether it has been silent for longer than it said, times `patience`."""
        return self._limit_s is not None and self.silent_s > self._limit_s * patience

    def close(self) -> None:
        """Close what is open of the pipe."""
        self.child_has_it()
        if self._pipe >= 0:
            os.close(self._pipe)
            self._pipe = -1
