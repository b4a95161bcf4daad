"""A teaching session in a thread of its own, so that no screen and no page ever waits for Zenoh."""

from __future__ import annotations

import threading

from mdb_deploy.teach.session import TeachingSession
from mdb_services.shell.service import run

STOP_S = 3.0
"""Bound on the session's own end."""


class SessionThread:
    """Runs a session until told to stop; the thread owns the session's bus and closes it."""

    def __init__(self, session: TeachingSession) -> None:
        self.session = session
        self.failure: Exception | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="teaching", daemon=True)

    def start(self) -> None:
        """Begin to be present."""
        self._thread.start()

    def _run(self) -> None:
        try:
            run(self.session, self._stop.is_set)
        except Exception as error:
            self.failure = error

    @property
    def running(self) -> bool:
        """Whether the session goes on."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Leave; returns when presence has ended, or after `STOP_S`."""
        self._stop.set()
        self.session.bus.poke()
        if self._thread.is_alive():
            self._thread.join(STOP_S)
