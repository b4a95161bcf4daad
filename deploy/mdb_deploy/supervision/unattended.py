"""A service without `mdb up` around it, as in a container: ended when it hangs, and by itself once the run is over.

Owns the small process that starts the service, feels its pulse and passes signals on, and a file that it touches as
long as the service is ready and goes on: `deploy/health` looks at it. It does not start it again:
whoever started this does, Docker say, for it ends with a status that is not 0.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import structlog

from mdb_protocol import keys
from mdb_protocol.bus import Bus
from mdb_services.shell.heartbeat import Pulse

log = structlog.get_logger()

FEEL_S = 0.1
HUNG = 1
FINISHED_FILE = "finished"
LOOK_S = 0.5
"""So often that file is looked for."""
BEATS_VARIABLE = "MDB_BEATS"
"""Holds the path of that file; none without it."""
UNATTENDED, UNTIL_FINISHED = "--unattended", "--until-finished"


def run_unattended(words: Sequence[str]) -> int:
    """Run `mdb` with these words in a process of its own until it ends or hangs; return its exit status."""
    pulse = Pulse()
    inside = [UNTIL_FINISHED if word == UNATTENDED else word for word in words]
    command = [sys.executable, "-m", "mdb_deploy.cli", *inside, f"--with-parent={os.getpid()}"]
    child = subprocess.Popen(command, env=os.environ | pulse.environment(), pass_fds=(pulse.child_pipe,))
    pulse.child_has_it()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda told, _: child.send_signal(told))
    while True:
        try:
            status = child.wait(FEEL_S)
            return status if status >= 0 else 128 - status
        except subprocess.TimeoutExpired:
            pulse.feel()
        if pulse.ready and not pulse.silent_s and (path := os.environ.get(BEATS_VARIABLE)):
            with suppress(OSError):
                Path(path).touch()
        if pulse.hangs():
            log.error("it hung and was ended", silent_s=round(pulse.silent_s, 1), process=child.pid)
            child.kill()
            child.wait()
            return HUNG


def or_finished(stop: Callable[[], bool], bus: Bus, run: Path) -> Callable[[], bool]:
    """Return a function that says to stop when `stop` does, or once the brain's run is finished.

    Who hears of it writes it into the run folder, for those who are cut off at that moment, or dead.
    """
    inbox, seen, look_s = bus.subscriber(keys.FINISHED), False, 0.0

    def told() -> bool:
        nonlocal seen, look_s
        if not seen and inbox.take() is not None:
            seen = True
            with suppress(OSError):
                (run / FINISHED_FILE).touch()
        if not seen and time.monotonic() >= look_s:
            look_s, seen = time.monotonic() + LOOK_S, (run / FINISHED_FILE).exists()
        return seen or stop()

    return told
