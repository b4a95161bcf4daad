"""What browsers are to be sent: the newest of each part of a story, encoded once for all of them.

Owns what each browser has had. One thread tells the story and makes frames; browsers come and go in another. A
browser that has not taken its last frame gets no new one: when it has, the next frame holds the newest of whatever it
missed. So nothing queues, however slow it is.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import msgspec
import structlog

log = structlog.get_logger()

ROWS = "rows"


class Tale(Protocol):
    """What is told: `mdb_deploy.web.telling.story.Story`, or `Waiting` before there is one."""

    @property
    def versions(self) -> dict[str, int]:
        """Of each part the number of times that it was another; NAME, or NAME/OF for each of several."""

    def part(self, name: str) -> Any:
        """Return the newest of a part."""

    def new_rows(self, seen: dict[str, int]) -> dict[str, Any] | None:
        """Return the rows that are new for a reader who has seen so much, which is brought up to date; or None."""


class Waiting:
    """What is told before there is a brain: why there is none."""

    def __init__(self) -> None:
        self.versions: dict[str, int] = {}
        self._words: str | None = None

    def trouble(self, words: str | None) -> None:
        """Say what is waited for."""
        if words != self._words or not self.versions:
            self._words = words
            self.versions = {"trouble": self.versions.get("trouble", 0) + 1}

    def part(self, name: str) -> str | None:  # noqa: ARG002 - there is only one
        """Return the words."""
        return self._words

    def new_rows(self, seen: dict[str, int]) -> None:
        """There are no rows."""


class Browser(Protocol):
    """Who takes frames; called in the thread that makes them."""

    @property
    def rights(self) -> dict[str, bool]:
        """What it may do."""

    def give(self, frames: list[str]) -> None:
        """Send these, in order; then `Fan.has_taken` is called."""


@dataclass
class _Seat:
    """What a browser has had."""

    browser: Browser
    ready: bool = True
    hello: int = 0
    versions: dict[str, int] = field(default_factory=dict)
    rows: dict[str, int] = field(default_factory=dict)
    """What it has had of the rows, as `Tale.new_rows` counts it."""


class Fan:
    """See the module's docstring."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seats: dict[Browser, _Seat] = {}
        self._hello: dict[str, Any] = {}
        self._hellos = 0
        self._tale: Tale = Waiting()
        self._texts: dict[str, tuple[int, str]] = {}
        self._failed: set[str] = set()
        self.needs = False
        """Whether a browser has come, or has taken its frame, since the last frames were made."""
        self.on_need: Callable[[], None] = lambda: None
        """Called from any thread when a browser has come, has gone, or has taken its frame."""

    @property
    def watched(self) -> bool:
        """Whether a browser is there."""
        return bool(self._seats)

    @property
    def count(self) -> int:
        """How many browsers are there."""
        return len(self._seats)

    def add(self, browser: Browser) -> None:
        """A browser has come; from any thread."""
        with self._lock:
            self._seats[browser] = _Seat(browser)
            self.needs = True
        self.on_need()

    def remove(self, browser: Browser) -> None:
        """A browser has gone; from any thread."""
        with self._lock:
            self._seats.pop(browser, None)
        self.on_need()

    def has_taken(self, browser: Browser) -> None:
        """A browser has taken its last frame; from any thread."""
        with self._lock:
            seat = self._seats.get(browser)
            if seat is not None:
                seat.ready = self.needs = True
        self.on_need()

    def begin(self, hello: dict[str, Any], tale: Tale) -> None:
        """Tell of another brain or run from now on."""
        self._hello, self._tale, self._texts = hello, tale, {}
        self._hellos += 1

    def send(self) -> bool:
        """Give each browser that can take it a frame of what it lacks; return whether there was one.

        To be called now and then, by the one thread that tells the story.
        """
        with self._lock:
            seats = [seat for seat in self._seats.values() if seat.ready]
            self.needs = False
        rows: dict[str, tuple[str, dict[str, int]]] = {}
        sent, versions = False, self._tale.versions if seats else {}
        for seat in seats:
            if frames := self._frames(seat, versions, rows):
                seat.ready = False
                seat.browser.give(frames)
                sent = True
        return sent

    def _frames(
        self, seat: _Seat, versions: dict[str, int], rows: dict[str, tuple[str, dict[str, int]]]
    ) -> list[str]:
        """Return the frames that a browser lacks: `hello` if it is another brain or run, and `now`."""
        frames = []
        if seat.hello != self._hellos:
            seat.hello, seat.versions, seat.rows = self._hellos, {}, {}
            frames.append(_json({**self._hello, "is": "hello", "rights": seat.browser.rights}))
        told, by_name = ['"is":"now"'], dict[str, list[str]]()
        for name, version in versions.items():
            if seat.versions.get(name) == version:
                continue
            seat.versions[name] = version
            group, slash, of = name.partition("/")
            text = self._text(name, version)
            if slash:
                by_name.setdefault(group, []).append(f"{_json(of)}:{text}")
            else:
                told.append(f"{_json(name)}:{text}")
        told += [f"{_json(group)}:{{{','.join(parts)}}}" for group, parts in by_name.items()]
        if text := self._rows(seat, rows):
            told.append(f'"{ROWS}":{text}')
        if len(told) > 1:
            frames.append(f"{{{','.join(told)}}}")
        return frames

    def _text(self, name: str, version: int) -> str:
        """Return a part as JSON; it is made once for all browsers."""
        if (kept := self._texts.get(name)) is not None and kept[0] == version:
            return kept[1]
        try:
            text = _json(self._tale.part(name))
        except Exception:  # one part's mistake must not keep the others from those who watch
            if name not in self._failed:
                log.exception("a part of the page cannot be told", part=name)
                self._failed.add(name)
            text = "null"
        self._texts[name] = (version, text)
        return text

    def _rows(self, seat: _Seat, rows: dict[str, tuple[str, dict[str, int]]]) -> str:
        """Return the rows that a browser lacks; those who lack the same share the text."""
        place = str(sorted(seat.rows.items()))
        if place not in rows:
            seen = dict(seat.rows)
            found = self._tale.new_rows(seen)
            rows[place] = ("" if found is None else _json(found), seen)
        text, seat.rows = rows[place][0], dict(rows[place][1])
        return text


def _json(value: Any) -> str:
    return msgspec.json.encode(value).decode()
