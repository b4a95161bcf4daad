"""One process at a time writes a memory file: the lock beside it, which ends with its process."""

from __future__ import annotations

import fcntl
import time
from pathlib import Path
from typing import BinaryIO

from mdb_protocol import files
from mdb_protocol.errors import MdbError, TakenError

HOLD_S = 1.0
"""How long a file is waited for that another process has; one that is killed is gone sooner."""
LOCK_ENDING = "-lock"
"""Of the name of the file beside a memory file that its writer holds."""


def unopened(path: Path, error: Exception) -> MdbError:
    """Return the error that says what may be wrong when a file cannot be opened."""
    return MdbError(
        f"{path} cannot be opened: {error}. Is the disk full, or the folder not yours, or gone? If it is in the way, "
        "move it away to start with an empty memory"
    )


def hold(path: Path) -> BinaryIO:
    """Hold a memory file until what is returned is closed, or this process dies, however it does.

    One that another process has is waited for as long as one that is being killed may take to be gone.
    """
    deadline = time.monotonic() + HOLD_S
    try:
        lock = files.lock_file(path.with_name(f"{path.name}{LOCK_ENDING}"))
    except OSError as error:
        raise unopened(path, error) from error
    while True:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() < deadline:
                time.sleep(HOLD_S / 20)
                continue
            lock.close()
            raise TakenError(
                f"another process writes {path}: a brain that runs. Stop it first, with Ctrl-C in its 'mdb up'; "
                f"'mdb up --resume {path.parent}' goes on afterwards"
            ) from None
        return lock
