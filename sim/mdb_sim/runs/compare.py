"""What was recorded against what is said now: key by key, value by value, in order.

Owns what counts as the same. What was sent again counts once, and the time at which something was shown does not
count. What is said after the last that is in the log is no difference: the recorder may have been stopped first.
Where messages may have been lost (`gaps`), values are matched by their iteration, and those that have no counterpart
are counted only.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any

import msgspec

from mdb_protocol import codec, messages
from mdb_protocol.messages import Message

Compare = Callable[[Message, Message], str | None]
"""Says what is different in the second message, or None."""

SHOWN_CHARACTERS = 200
"""Of a value that differs."""
ABSENT = "absent"


def difference(recorded: Any, replayed: Any, tolerance: float = 0.0, path: str = "") -> str | None:
    """Return where two plain values differ, with both, or None.

    Floats may by `tolerance`, absolute below 1 and relative above; all else may not.
    """
    for step, one, other in _parts(recorded, replayed):
        found = difference(one, other, tolerance, f"{path}{step}")
        if found is not None:
            return found
    if isinstance(recorded, dict | list) and isinstance(replayed, type(recorded)):
        return None
    floats = isinstance(recorded, float) and isinstance(replayed, float)
    if recorded == replayed or (floats and math.isclose(recorded, replayed, rel_tol=tolerance, abs_tol=tolerance)):
        return None
    log, now = (value if value is ABSENT else repr(value)[:SHOWN_CHARACTERS] for value in (recorded, replayed))
    return f"{path.lstrip('.')} is {log} in the log, {now} in the replay"


def _parts(recorded: Any, replayed: Any) -> list[tuple[str, Any, Any]]:
    """Return the parts of two dicts or two lists, side by side, each with its place."""
    if isinstance(recorded, dict) and isinstance(replayed, dict):
        names = list(recorded | replayed)
        return [(f".{name}", recorded.get(name, ABSENT), replayed.get(name, ABSENT)) for name in names]
    if isinstance(recorded, list) and isinstance(replayed, list):
        both = zip_longest(recorded, replayed, fillvalue=ABSENT)
        return [(f"[{place}]", *values) for place, values in enumerate(both)]
    return []


def within(tolerance: float) -> Compare:
    """Return a comparison in which floats may differ so much; see `difference`."""
    return lambda recorded, replayed: difference(codec.to_plain(recorded), codec.to_plain(replayed), tolerance)


EXACTLY = within(0.0)


def timeless(message: Message) -> Message:
    """Return a message without the time at which it was shown, which differs from run to run."""
    if isinstance(message, messages.Perception):
        done = None if message.done is None else msgspec.structs.replace(message.done, stamp=0.0)
        return msgspec.structs.replace(message, stamp=0.0, done=done)
    return msgspec.structs.replace(message, stamp=0.0) if isinstance(message, messages.Action) else message


@dataclass
class _Waiting:
    """The values of one key that wait for their counterparts; the replayed ones numbered through all keys."""

    compared: int = 0
    recorded: deque[Message] = field(default_factory=deque)
    replayed: deque[tuple[Message, int]] = field(default_factory=deque)


class Comparison:
    """See the module's docstring; `difference` is the first one, in words. `said`: values that are said now."""

    def __init__(self, compare: Compare, *, gaps: bool = False) -> None:
        self.compared = self.unmatched = 0
        self.difference: str | None = None
        self._compare, self._gaps = compare, gaps
        self.said = self._last_matched = 0
        self._waiting: defaultdict[tuple[str, int], _Waiting] = defaultdict(_Waiting)
        self._seen: set[tuple[str, str, bytes]] = set()

    def record(self, key: str, message: Message) -> None:
        """Take the next value of the log."""
        if self._is_new("recorded", key, message):
            waiting = self._of(key, message)
            waiting.recorded.append(timeless(message))
            self._match(key, waiting)

    def say(self, key: str, message: Message) -> None:
        """Take the next value that is said now."""
        if self._is_new("replayed", key, message):
            waiting = self._of(key, message)
            self.said += 1
            waiting.replayed.append((timeless(message), self.said))
            self._match(key, waiting)

    def _of(self, key: str, message: Message) -> _Waiting:
        return self._waiting[key, getattr(message, "iteration", 0) if self._gaps else 0]

    def _is_new(self, where: str, key: str, message: Message) -> bool:
        mark = where, key, codec.encode(timeless(message))
        known = mark in self._seen
        self._seen.add(mark)
        return not known

    def _match(self, key: str, waiting: _Waiting) -> None:
        if not (waiting.recorded and waiting.replayed):
            return
        self.compared += 1
        waiting.compared += 1
        recorded, (replayed, number) = waiting.recorded.popleft(), waiting.replayed.popleft()
        self._last_matched = max(self._last_matched, number)
        found = self._compare(recorded, replayed)
        if found is not None:
            self._differs(f"{_place(key, waiting.compared, recorded)}: {found}")

    def end(self) -> None:
        """See what has no counterpart."""
        for (key, _), waiting in self._waiting.items():
            number = waiting.compared + 1
            if self._gaps:
                self.unmatched += len(waiting.recorded) + len(waiting.replayed)
            elif waiting.recorded:
                self._differs(f"{_place(key, number, waiting.recorded[0])}: in the log, not in the replay")
            elif waiting.replayed and waiting.replayed[0][1] < self._last_matched:
                self._differs(f"{_place(key, number, waiting.replayed[0][0])}: in the replay, not in the log")

    def _differs(self, words: str) -> None:
        self.difference = self.difference or words


def _place(key: str, number: int, message: Message) -> str:
    """Say which value of which key: "pair, value 3 (iteration 2)"."""
    below = key.split("/", 2)[2]
    counts = [f"{name} {getattr(message, name)}" for name in ("iteration", "version") if hasattr(message, name)]
    return f"{below}, value {number} ({', '.join(counts)})" if counts else f"{below}, value {number}"
