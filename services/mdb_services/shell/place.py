"""Whether what is held open is still where others will look for it, and may be written there.

A file that was deleted or moved away can be written to its end without an error, and then nobody finds it.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path


class Place:
    """A file or folder that is there now."""

    def __init__(self, path: Path) -> None:
        """Note what is at `path`; OSError when nothing is."""
        self._path = os.fspath(path)
        self._folder = path if path.is_dir() else path.parent
        self._was = self._identity()

    def _identity(self) -> tuple[int, int]:
        found = os.stat(self._path)
        return found.st_dev, found.st_ino

    def check(self) -> None:
        """Raise OSError when it is gone, something else is in its place, or its folder takes no files."""
        try:
            same = self._identity() == self._was
        except OSError as error:
            raise OSError(error.errno, "gone: deleted or moved away", self._path) from error
        if not same:
            raise OSError(errno.ESTALE, "gone; something else is in its place", self._path)
        if not os.access(self._folder, os.W_OK):
            raise OSError(errno.EROFS, "read-only", str(self._folder))
