"""What is seen of a run whose processes somebody else runs, Docker Compose say: the progress, and that it is over."""

from __future__ import annotations

import time
from collections.abc import Callable

from mdb_deploy.running.progress import Progress
from mdb_deploy.running.watch import Watch
from mdb_deploy.supervision.unattended import FINISHED_FILE

POLL_S = 0.05
WRITTEN_S = 10.0
"""Bound on waiting for the recorder to finish the log."""
RECORDER = "recorder/log"


def follow(watch: Watch, connect: str, progress: Progress, stop: Callable[[], bool]) -> bool:
    """Show a run until it is finished and its log is whole; False when told to stop before. Closes the watch.

    Raises BusError when no router answers.
    """
    try:
        watch.join(connect)
        with progress:
            while not watch.finished() and not (watch.run / FINISHED_FILE).exists():
                if stop():
                    return False
                watch.show(progress)
                time.sleep(POLL_S)
            deadline = time.monotonic() + WRITTEN_S
            while RECORDER in watch.alive() and time.monotonic() < deadline:
                time.sleep(POLL_S)
            watch.show(progress)
        return True
    finally:
        watch.close()
