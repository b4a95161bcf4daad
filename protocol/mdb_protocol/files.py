"""Files that others wrote: opened to be read and nothing else, within bounds. Every file that was not made by the
process that reads it is opened here.

A pipe would be waited for and a device would never end, so neither is opened; what is too large is refused before
anything of it is read.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from mdb_protocol.errors import DamageError

MOST_BYTES = 64 * 2**20
"""Bound on a file that is read as a whole, unless its reader says another."""
PART = 2**20
"""Bytes that are copied at a time."""
KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
"""What a path can name that is no file, as `stat` tells them apart."""


@contextmanager
def opened(path: Path, most: int | None = MOST_BYTES) -> Iterator[BinaryIO]:
    """Open a file for reading; `most`: of so many bytes at the most, None for one that is read piece by piece.

    Raises OSError when it cannot be read, DamageError when it is no ordinary file, or too large.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    except ValueError as error:  # no path at all: it holds a zero
        raise DamageError(f"{path} is not the name of a file: {error}") from error
    except OSError as error:
        if error.errno in (errno.ENXIO, errno.ENODEV):  # a socket, or a device without its driver
            raise DamageError(f"{path} is no ordinary file, and is not opened; expected a file") from error
        raise
    found = os.fstat(descriptor)
    if (kind := stat.S_IFMT(found.st_mode)) != stat.S_IFREG:
        os.close(descriptor)
        raise DamageError(f"{path} is {KINDS.get(kind, 'no ordinary file')}, and is not read; expected a file")
    with os.fdopen(descriptor, "rb") as file:
        if most is not None and found.st_size > most:
            raise DamageError(f"{path} has {size(found.st_size)}; at most {size(most)} are read")
        yield file


def lock_file(path: Path) -> BinaryIO:
    """Open a file to be locked, and make it if it is not there; its content is left as it is.

    Raises OSError when it cannot be made or is a link, DamageError when it is no ordinary file.
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_NONBLOCK | os.O_NOCTTY | os.O_NOFOLLOW | os.O_CLOEXEC
    descriptor = os.open(path, flags, 0o666)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise DamageError(f"{path} is no ordinary file; expected one to be locked: move it away")
    return os.fdopen(descriptor, "r+b")


def content(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the whole content of a file; raises as `opened` does."""
    with opened(path, most) as file:
        found = file.read(most + 1)
    if len(found) > most:  # it grew, or does not say how large it is, as the files of /proc
        raise DamageError(f"{path} has more than {size(most)}, which are read at the most")
    return found


def copy(path: Path, to: Path, most: int | None = None) -> None:
    """Copy a file's content up to its first hole, behind which nobody has written; raises as `opened` does."""
    with opened(path, most) as file, to.open("xb") as copied:
        left = _until_hole(file)
        while left > 0 and (part := file.read(min(left, PART))):
            left -= len(part)
            copied.write(part)


def _until_hole(file: BinaryIO) -> int:
    end = os.fstat(file.fileno()).st_size
    try:
        hole = os.lseek(file.fileno(), 0, os.SEEK_HOLE) if end else 0
    except OSError:  # this file system knows of no holes
        hole = end
    os.lseek(file.fileno(), 0, os.SEEK_SET)
    return hole


def size(count: int) -> str:
    """Return a number of bytes in words."""
    for unit, bytes_ in (("GB", 2**30), ("MB", 2**20), ("kB", 2**10)):
        if count >= bytes_:
            return f"{count / bytes_:.4g} {unit}"
    return f"{count} bytes"
