"""Carries out actions on a course: in a thread of its own, so that the service can answer meanwhile, or without.

Owns that one action is carried out at a time, that it takes no less than it should, and that it can be interrupted.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import suppress

from mdb_sim.robot.course import Course, Step

CLOSE_S = 2.0
"""Bound on waiting for an interrupted action, at the end."""


class Acting:
    """See the module's docstring."""

    def __init__(
        self,
        course: Course,
        *,
        least_s: float = 0.0,
        threaded: bool = False,
        woken: Callable[[], None] = lambda: None,
    ) -> None:
        """`woken` is called, from that thread, when an action is over."""
        self._course, self._least_s, self._woken = course, least_s, woken
        self._granted_s = least_s
        """The longest least time while the present action goes on."""
        self._executor = ThreadPoolExecutor(1, "acting") if threaded else None
        self._future: Future[Step] | None = None
        self._interrupted = False
        self._called = threading.Event()
        """Set when an action that only waits for its least time is to look whether it is over."""
        self.counted = True
        """Whether the action is a new one, not the last one held."""
        self.took_s = 0.0
        """How long the body took for the last action."""
        self._began_s = 0.0

    @property
    def busy(self) -> bool:
        """Whether an action was begun whose outcome was not taken yet."""
        return self._future is not None

    def busy_s(self) -> float:
        """Return for how long an action is being carried out, beyond the time that it takes at least."""
        return time.perf_counter() - self._began_s - self._granted_s if self.busy else 0.0

    @property
    def least_s(self) -> float:
        """How long an action takes at least, in seconds; it holds for the one that goes on, too."""
        return self._least_s

    @least_s.setter
    def least_s(self, least_s: float) -> None:
        if least_s != self._least_s:
            self._least_s, self._granted_s = least_s, max(least_s, self._granted_s)
            self._called.set()

    def begin(self, values: Mapping[str, float], *, counted: bool = True) -> None:
        """Begin an action; without `counted` it is the last one, held."""
        self._interrupted = False
        self._called.clear()
        self._granted_s = self._least_s
        self.counted, self._began_s = counted, time.perf_counter()
        if self._executor is not None:
            self._future = self._executor.submit(self._act, values, counted)
            self._future.add_done_callback(lambda _: self._woken())
            return
        self._future = Future()
        try:
            self._future.set_result(self._act(values, counted))
        except Exception as error:
            self._future.set_exception(error)

    def _act(self, values: Mapping[str, float], counted: bool) -> Step:
        began_s = time.perf_counter()
        step = self._course.act(values) if counted else self._course.hold(values)
        self.took_s = time.perf_counter() - began_s
        while (left_s := began_s + self._least_s - time.perf_counter()) > 0.0 and not self._interrupted:
            self._called.wait(left_s)
            self._called.clear()
        return step

    def outcome(self) -> Step | None:
        """Return what an action led to, once; None while it goes on. BodyError when the body could not do it."""
        if self._future is None or not self._future.done():
            return None
        future, self._future = self._future, None
        return future.result()

    def halt(self) -> None:
        """Bring the body to rest; an action that is being carried out is over soon."""
        self._interrupted = True
        self._called.set()
        self._course.body.halt()

    def close(self) -> None:
        """Bring the body to rest, wait for the action that is being carried out, bounded, and free the body."""
        self.halt()
        if self._executor is not None:
            self._executor.shutdown(wait=False, cancel_futures=True)
            if self._future is not None:
                with suppress(CancelledError, TimeoutError):
                    self._future.exception(CLOSE_S)
        self._course.body.close()
