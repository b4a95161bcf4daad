"""The run folder as `mdb up` watches it: what is said when it is gone or read-only, and when it is back."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import structlog

from mdb_services.acting.outbox import UNSTORED
from mdb_services.shell.place import Place

log = structlog.get_logger()

LOOK_S = 1.0
CONSEQUENCES = {
    "stop": f'the robot stops after {UNSTORED} pairs that cannot be stored ([store] when_full = "stop")',
    "act": 'the robot goes on, and nothing is stored ([store] when_full = "act")',
}


class RunFolder:
    """See the module's docstring."""

    def __init__(self, path: Path, when_full: str, clock: Callable[[], float] = time.monotonic) -> None:
        """`path` is there; `when_full`: what the experiment's file says of a disk that takes nothing."""
        self.path, self._clock = path, clock
        self._place, self._consequence = Place(path), CONSEQUENCES[when_full]
        self._looked_s = clock()
        self.trouble = ""
        """What is wrong with it now."""

    def look(self) -> None:
        """Look now and then, and say what has changed."""
        if self._clock() - self._looked_s < LOOK_S:
            return
        self._looked_s, before = self._clock(), self.trouble
        self.trouble = self._trouble()
        if self.trouble and not before:
            log.error("the run folder is lost", folder=str(self.path), reason=self.trouble, then=self._consequence)
        elif before and not self.trouble:
            log.info("the run folder is back", folder=str(self.path))

    def _trouble(self) -> str:
        try:
            self._place.check()
        except OSError as error:
            return error.strerror or str(error)
        return ""
