"""The shell around every service: one thread that waits, answers queries, steps, and stops when told.

A service is a plain class: its bus comes from outside, `step()` does what has come and returns, `values()`
are its own figures for the status queryable. The same class runs here over Zenoh, one to a process, and
side by side over the in-memory bus (`run_inline`).
"""

from __future__ import annotations

import faulthandler
import os
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import FrameType
from typing import Protocol, runtime_checkable

import structlog

from mdb_protocol import keys
from mdb_protocol.bus import Bus
from mdb_protocol.errors import UnheardError
from mdb_protocol.messages import Status
from mdb_services.shell.heartbeat import CLOSE_S, SILENT_S, Heart

log = structlog.get_logger()

WAIT_S = 0.1
"""Longest sleep of the loop: how late a stop or a timeout may be noticed."""
SWITCH_S = 0.0005
"""A step gives way to the transport's threads this often: with Python's 0.005 they take in 200 samples a second."""
STDERR = 2
"""By its number, which is there whatever Python has of it."""
METER_TICK_S = 1.0
METER_MARKS = 5
FAILURES_IN_A_ROW = 5
"""A step that fails this often one after the other ends the process: its supervisor starts it afresh."""


class Service(Protocol):
    """What every service of the brain is."""

    role: str
    instance: str
    bus: Bus

    def step(self) -> bool:
        """Do what can be done now, without waiting; return whether anything was done."""

    def values(self) -> dict[str, float]:
        """Return figures for the status queryable."""

    def close(self) -> None:
        """Free what the service holds; the bus is closed by its owner."""


class Stopper:
    """Remembers that SIGTERM or SIGINT came, or that the parent process is gone."""

    def __init__(self, parent: int | None = None, *, bound_s: float | None = None) -> None:
        """Stop with the parent process of this id, if one is given; it may be gone before we have asked for ours.

        `bound_s`: from when it is first said that it is time, the process has so long to close; then it is left as it
        is, and where it was is told on stderr. Of 45 robots without a supervisor one needed that.
        """
        self._told = False
        self._parent = parent
        self._bound_s = bound_s

    def install(self) -> None:
        """Take over the signals; the handler only sets a flag, so it can never block."""
        signal.signal(signal.SIGTERM, self._on_signal)
        signal.signal(signal.SIGINT, self._on_signal)

    def _on_signal(self, _signum: int, _frame: FrameType | None) -> None:
        self._told = True

    def __call__(self) -> bool:
        """Return whether to stop."""
        stop = self._told or (self._parent is not None and os.getppid() != self._parent)
        if stop and self._bound_s is not None:
            # Its watch needs no lock of Python's: Zenoh may hold that while it waits for a thread that wants it.
            faulthandler.dump_traceback_later(self._bound_s, exit=True, file=STDERR)
            self._bound_s = None
        return stop


@runtime_checkable
class Timed(Protocol):
    """A service that has something to do at times of its own."""

    def due_in_s(self) -> float:
        """Return in how many seconds its next step is due, whatever comes."""


@runtime_checkable
class Bounded(Protocol):
    """A service whose step may take longer than `heartbeat.SILENT_S`, or that works elsewhere than in its step."""

    def next_s(self) -> float:
        """Return within how many seconds its next step is over; 0 when it does not go on, and is to be ended."""


class Meter:
    """Things a second over the last few seconds, from a count that only grows."""

    def __init__(self, count: Callable[[], int], clock: Callable[[], float] = time.monotonic) -> None:
        self._count, self._clock = count, clock
        self._marks = deque([(clock(), count())], maxlen=METER_MARKS)

    def tick(self) -> None:
        """Look at the count; to be called now and then."""
        now = self._clock()
        if now - self._marks[-1][0] >= METER_TICK_S:
            self._marks.append((now, self._count()))

    def rate_hz(self) -> float:
        """Return how much the count has grown a second."""
        began, first = self._marks[0]
        passed_s = self._clock() - began
        return (self._count() - first) / passed_s if passed_s > 0 else 0.0


def memory_bytes() -> int:
    """Return what this process has in memory; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def announce(service: Service, folder: Path | None = None) -> Meter:
    """Answer status queries and declare the liveliness token, last: it means ready. `folder`: the run's.

    The meter that is returned wants to be ticked.
    """
    started = time.monotonic()
    meter = Meter(service.bus.taken)

    def status() -> Status:
        return Status(
            role=service.role,
            instance=service.instance,
            pid=os.getpid(),
            uptime_s=time.monotonic() - started,
            values=service.values(),
            refused=dict(service.bus.refusals.counts),
            dropped=dict(service.bus.refusals.dropped),
            rate_hz=meter.rate_hz(),
            queued=service.bus.queued(),
            memory_bytes=memory_bytes(),
            host=socket.gethostname(),
            run=str(folder or ""),
        )

    service.bus.queryable(keys.STATUS, status, role=service.role, instance=service.instance)
    service.bus.token(service.role, service.instance)
    return meter


def run(service: Service, stop: Callable[[], bool], folder: Path | None = None, heart: Heart | None = None) -> None:
    """Run a service in this thread until told to stop; a failing step is logged and tried again.

    `folder` is the run's, for those who ask. `heart` beats at each turn.

    Raises UnheardError when the router gives it nothing any more.
    Re-raises the error when steps fail `FAILURES_IN_A_ROW` times, so that the supervisor restarts it.
    """
    failures = 0
    heart = heart or Heart()
    # Asked once: to look whether it has what a protocol wants takes longer than many a step.
    due_in_s = service.due_in_s if isinstance(service, Timed) else lambda: WAIT_S
    next_s = service.next_s if isinstance(service, Bounded) else lambda: SILENT_S
    sys.setswitchinterval(SWITCH_S)
    try:
        meter = announce(service, folder)
        heart.ready()
        log.info("ready", role=service.role, instance=service.instance)
        while not stop():
            service.bus.wait(min(WAIT_S, due_in_s()))
            try:
                _turn(service, meter, heart, next_s)
                while service.step() and not stop():
                    _turn(service, meter, heart, next_s)
                failures = 0
            except UnheardError:
                raise
            except Exception:
                failures += 1
                log.exception("step failed", role=service.role, failures=failures)
                if failures >= FAILURES_IN_A_ROW:
                    raise
    finally:
        heart.beat(CLOSE_S)
        close([service])
        log.info("stopped", role=service.role, instance=service.instance)


def _turn(service: Service, meter: Meter, heart: Heart, next_s: Callable[[], float]) -> None:
    """Do what belongs before each step."""
    service.bus.serve()
    service.bus.check_heard()
    meter.tick()
    heart.beat(next_s())


def run_inline(services: Sequence[Service], stop: Callable[[], bool]) -> None:
    """Step all services of a brain in turn, in this thread, until `stop`; an error of any ends all."""
    try:
        for service in services:
            announce(service)
        while not stop():
            moved = [service.step() for service in services]
            if not any(moved):
                time.sleep(0.001)
    finally:
        close(services)


def close(services: Sequence[Service]) -> None:
    """Close services and their buses, in order; one that fails does not keep the others from it."""
    with ExitStack() as stack:  # the last that is pushed is called first
        for service in reversed(services):
            stack.callback(service.bus.close)
            stack.callback(service.close)
