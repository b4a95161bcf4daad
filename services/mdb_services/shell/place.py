"""Whether what is held open is still where others will look for it, and may be written there.

A file that was deleted or moved away can be written to its end without an error, and then nobody finds it.
"""

from __future__ import annotations

import errno
import math
import os
import time
from pathlib import Path

LOOKED_S = 0.2
"""So long a look counts for those who write often, and of whom a little may be lost with the file itself."""


class Place:
    """A file or folder that is there now."""

    def __init__(self, path: Path, every_s: float = 0.0) -> None:
        """Note what is at `path`; OSError when nothing is. every_s: how long a look at it counts."""
        self._path, self._every_s, self._looked_s = os.fspath(path), every_s, -math.inf
        self._folder = path if path.is_dir() else path.parent
        self._was = self._identity()

    def _identity(self) -> tuple[int, int]:
        found = os.stat(self._path)
        return found.st_dev, found.st_ino

    def check(self) -> None:
        """Raise OSError when it is gone, something else is in its place, or its folder takes no files."""
        if self._every_s and time.monotonic() - self._looked_s < self._every_s:
            return
        try:
            same = self._identity() == self._was
        except OSError as error:
            raise OSError(error.errno, "gone: deleted or moved away", self._path) from error
        if not same:
            raise OSError(errno.ESTALE, "gone; something else is in its place", self._path)
        if not os.access(self._folder, os.W_OK):
            raise OSError(errno.EROFS, "read-only", str(self._folder))
        self._looked_s = time.monotonic()
