"""Compiled code on disk. Nothing depends on it: what cannot be kept, or read again, is compiled."""

import fcntl
import os
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

WAIT_S = 60.0
"""Bound on waiting for another process that compiles, before compiling, too."""
LOOK_S = 0.05

_BESIDE = Path(__file__).parent / "__pycache__"
_HOME = "~/.cache/multilevel-darwinist-brain"
_SUM = 4
"""Bytes before the code, which tell whether it is whole."""


class Kept:
    """Code under a name, which tells from what it was made; in the first of several folders that can be had.

    They are that of the variable NUMBA_CACHE_DIR, or else one beside this file, where Python keeps such things, and
    one at home.
    """

    def __init__(self, name: str) -> None:
        """Take the name of a file; nothing is looked for yet."""
        chosen = os.environ.get("NUMBA_CACHE_DIR")
        self.places: list[Path] = []
        for folder in [Path(chosen)] if chosen else [_BESIDE, Path(_HOME)]:
            with suppress(RuntimeError):  # there is no home
                self.places.append(folder.expanduser() / name)

    def read(self) -> bytes | None:
        """Return the code if it is there, and whole: LLVM would end the process on anything else."""
        for place in self.places:
            with suppress(OSError):
                kept = place.read_bytes()
                if len(kept) > _SUM and kept[:_SUM] == _sum(kept[_SUM:]):
                    return kept[_SUM:]
        return None

    def write(self, code: bytes) -> None:
        """Keep the code where that can be; whoever reads meanwhile finds all of it or nothing."""
        for place in self.places:
            own = place.with_suffix(f".{os.getpid()}")
            try:
                place.parent.mkdir(parents=True, exist_ok=True)
                own.write_bytes(_sum(code) + code)
                own.replace(place)
            except OSError:
                with suppress(OSError):
                    own.unlink()
            else:
                return

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Wait while another process does the same, where a file can tell it: several at once take longer."""
        lock = None
        for place in self.places:
            with suppress(OSError):
                place.parent.mkdir(parents=True, exist_ok=True)
                lock = place.with_suffix(".lock").open("wb")
                break
        if lock is None:
            yield
            return
        with lock:
            until_s = time.monotonic() + WAIT_S
            while time.monotonic() < until_s and not _locked(lock.fileno()):
                time.sleep(LOOK_S)
            yield


def _locked(file: int) -> bool:
    """Return whether there is nothing more to wait for: nobody else has the lock, or there are no locks here."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def _sum(code: bytes) -> bytes:
    return zlib.crc32(code).to_bytes(_SUM, "little")
