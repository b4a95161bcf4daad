"""What has come and was not taken yet: bounded in number and bytes, so that no flood fills a reader's memory.

Owns the queues behind inboxes and taps, and the mark that wakes their reader. Filled and taken from any thread.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, field
from itertools import count
from queue import Empty, SimpleQueue

from mdb_protocol.messages import Message


@dataclass(slots=True)
class Raw:
    """A sample as it came: full key, payload bytes, encoding string."""

    key: str
    payload: bytes
    encoding: str
    message: Message | None = field(default=None, init=False, compare=False, repr=False)
    """What is in it, once somebody has read it; see `bus.read`."""
    came_ns: int = field(default=0, init=False, compare=False, repr=False)
    """When it came to a tap, in nanoseconds since 1970."""


def size_of(raw: Raw) -> int:
    """Return the bytes of a sample with its key and encoding."""
    return len(raw.payload) + len(raw.key) + len(raw.encoding)


class Wake:
    """Wakes the one who waits; keeps a single mark however much comes, so that it needs no memory."""

    def __init__(self) -> None:
        self._marks: SimpleQueue[None] = SimpleQueue()

    def set(self) -> None:
        """Say that something has come; called from any thread, after it can be taken."""
        if self._marks.empty():
            self._marks.put(None)

    def wait(self, timeout_s: float) -> bool:
        """Wait for a mark, or the bound; return whether there was one."""
        try:
            self._marks.get(timeout=timeout_s)
        except Empty:
            return False
        while not self._marks.empty():
            self._marks.get_nowait()
        return True


class Waiting:
    """Samples in the order in which they came; of too many go the oldest of the path that has most of them.

    So who floods one key drops what is on that key, and nothing of others.
    """

    def __init__(self, most: int, most_bytes: int) -> None:
        """Keep at most so many samples, of so many bytes; one alone may be larger."""
        self._most, self._most_bytes = most, most_bytes
        self._paths: dict[str, deque[tuple[int, int, Raw]]] = {}
        """For each path the samples on it, with number and size; no path without any."""
        self._bytes: dict[str, int] = {}
        self._all_bytes = 0
        self._number = count()
        self._length = 0
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return self._length

    def put(self, raw: Raw, size: int, path: str = "") -> list[str]:
        """Let a sample wait; return the paths of those that went for it."""
        dropped: list[str] = []
        with self._lock:
            waiting = self._paths.get(path)
            if waiting is None:
                waiting = self._paths[path] = deque()
                self._bytes[path] = 0
            waiting.append((next(self._number), size, raw))
            self._bytes[path] += size
            self._all_bytes += size
            self._length += 1
            while self._length > self._most or (self._all_bytes > self._most_bytes and self._length > 1):
                counted = self._length > self._most
                fullest = max(self._paths, key=lambda p: len(self._paths[p]) if counted else self._bytes[p])
                self._pop(fullest)
                dropped.append(fullest)
        return dropped

    def take(self, most: int = 1) -> list[Raw]:
        """Take the oldest samples, in order."""
        if not self._length:  # what comes meanwhile wakes the reader
            return []
        taken: list[Raw] = []
        with self._lock:
            while self._length and len(taken) < most:
                taken.append(self._pop(self._oldest()))
        return taken

    def _oldest(self) -> str:
        if len(self._paths) == 1:
            return next(iter(self._paths))
        return min(self._paths, key=lambda path: self._paths[path][0][0])

    def _pop(self, path: str) -> Raw:
        waiting = self._paths[path]
        _, size, raw = waiting.popleft()
        self._bytes[path] -= size
        self._all_bytes -= size
        self._length -= 1
        if not waiting:
            del self._paths[path], self._bytes[path]
        return raw
