"""Pages of this process's memory that nobody needs: they go back to the system. Linux only.

Who does use such a page again gets from the system what was there: a file's content, or zeros.
"""

from __future__ import annotations

import ctypes
import os
import re
from contextlib import suppress
from pathlib import Path

LIBC = ctypes.CDLL(None)
DONTNEED = 4
"""MADV_DONTNEED of <asm-generic/mman-common.h>."""
UNCHANGED = re.compile(r"^(\w+)-(\w+) r-.p .* /.*\n(?:\w+: .*\n)*?Anonymous: +0 kB", re.MULTILINE)
"""In /proc/self/smaps: where a file is mapped that cannot be written to, and was not (as by the dynamic linker)."""
PRIVATE = re.compile(r"^(\w+)-(\w+) rw-p 0+ 00:00 0 *$", re.MULTILINE)
"""In /proc/self/maps: private memory, of no file; not the C library's heap."""
BLOCK = 2**16
ZEROS = bytes(BLOCK)
LEAST = 2**20
"""So many zeros in a row are given back. Where Python has its objects there are fewer: it gets 1 MB at a time, and
begins to write at the beginning. So it never writes there while we look.
"""


def threads() -> int:
    """Return how many threads this process has, those of libraries included; OSError on other systems."""
    return len(os.listdir("/proc/self/task"))


def let_go_of_files() -> None:
    """Let go of what is in memory of libraries' files: of LLVM, which loads kernels, 70 MB that nobody uses again."""
    with suppress(OSError):
        for begin, end in UNCHANGED.findall(Path("/proc/self/smaps").read_text()):
            _let_go(int(begin, 16), int(end, 16))


def let_go_of_zeros() -> None:
    """Let go of long runs of zeros, while there is one thread: another might write there after we have looked."""
    with suppress(OSError):
        if threads() > 1:
            return
        for begin, end in PRIVATE.findall(Path("/proc/self/maps").read_text()):
            place, last = int(begin, 16), int(end, 16)
            first = place
            while place < last:
                size = min(BLOCK, last - place)
                if ctypes.string_at(place, size) != ZEROS[:size]:
                    _let_go(first, place, LEAST)
                    first = place + size
                place += size
            _let_go(first, place, LEAST)


def _let_go(begin: int, end: int, least: int = 1) -> None:
    if end - begin >= least:
        LIBC.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), DONTNEED)
