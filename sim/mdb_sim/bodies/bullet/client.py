"""A physics client of PyBullet's without a window, which has 35 MB; 20 of them are zeros that it may never use.

Those go back to the system, which gives zeros again to who reads them. That is done only while the process has one
thread, for another might write there after we have looked. So who is to have threads gets a client ready before.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
from contextlib import suppress
from pathlib import Path

import pybullet

LIBC = ctypes.CDLL(None)
DONTNEED = 4
"""MADV_DONTNEED of <asm-generic/mman-common.h>."""
MAPPED = re.compile(r"^(\w+)-(\w+) rw-p 0+ 00:00 0 *$", re.MULTILINE)
"""In /proc/self/maps: private memory, of no file; not the C library's heap."""
BLOCK = 2**16
ZEROS = bytes(BLOCK)
LEAST = 2**20
"""So many zeros in a row are given back. Where Python has its objects there are fewer: it gets 1 MB at a time, and
begins to write at the beginning. So it never writes there while we look.
"""
_ready: list[int] = []


def get_ready() -> None:
    """Make the client that the next `connect` gives, now."""
    if not _ready:
        _ready.append(_connected())


def connect() -> int:
    """Return a client, below 0 when there is none to be had."""
    return _ready.pop() if _ready else _connected()


def _connected() -> int:
    client: int = pybullet.connect(pybullet.DIRECT)
    if sys.platform == "linux":
        with suppress(OSError):
            if len(os.listdir("/proc/self/task")) == 1:
                _give_back_zeros()
    return client


def _give_back_zeros() -> None:
    for begin, end in MAPPED.findall(Path("/proc/self/maps").read_text()):
        place, last = int(begin, 16), int(end, 16)
        zeros = 0
        while place < last:
            size = min(BLOCK, last - place)
            if ctypes.string_at(place, size) == ZEROS[:size]:
                zeros += size
            else:
                _give_back(place - zeros, zeros)
                zeros = 0
            place += size
        _give_back(place - zeros, zeros)


def _give_back(place: int, size: int) -> None:
    if size >= LEAST:
        LIBC.madvise(ctypes.c_void_p(place), ctypes.c_size_t(size), DONTNEED)
