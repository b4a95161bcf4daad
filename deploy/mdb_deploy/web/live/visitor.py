"""One browser: a WebSocket, what waits to be sent on it, and the orders that come.

Owns the bounds. At most one set of frames waits besides the newest word on the lesson and a few answers; a browser
that takes nothing for a minute is cut off. What it sends is read one message after the other, no faster than it may:
more waits in its own network buffers.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

import msgspec
import structlog
from starlette.websockets import WebSocket, WebSocketDisconnect

from mdb_deploy.web.guard import Rights
from mdb_deploy.web.live.fan import Fan
from mdb_protocol.words import shown

log = structlog.get_logger()

TAKES_S = 60.0
"""A browser that takes nothing for so long is cut off."""
ORDERS_HZ, ORDERS_AT_ONCE = 40.0, 80
"""Orders and pieces of sound that are read a second, and so many at once before that counts."""
ANSWERS_KEPT = 32
"""Answers that wait to be sent before the next order is read."""


class Visitor:
    """See the module's docstring."""

    def __init__(self, socket: WebSocket, rights: Rights, browser: str, fan: Fan) -> None:
        """`socket` is accepted already; `browser`: by what the same browser is known when it comes again."""
        self._socket, self._fan = socket, fan
        self.browser = browser
        self.may = rights
        self._loop = asyncio.get_running_loop()
        self._frames: deque[str] = deque()
        self._answers: deque[str] = deque()
        self._you: str | None = None
        self._fan_waits = False
        self._new, self._sent = asyncio.Event(), asyncio.Event()
        self._budget, self._counted_s = float(ORDERS_AT_ONCE), time.monotonic()
        self.gone = False

    @property
    def rights(self) -> dict[str, bool]:
        """See `Browser.rights`."""
        return self.may._asdict()

    def give(self, frames: list[str]) -> None:
        """See `Browser.give`; from any thread."""
        with suppress(RuntimeError):  # the loop is closed: all ends
            self._loop.call_soon_threadsafe(self._take, frames)

    def _take(self, frames: list[str]) -> None:
        self._frames.extend(frames)
        self._fan_waits = True
        self._new.set()

    def tell(self, you: dict[str, Any]) -> None:
        """Send the newest word on its lesson; one that waits is replaced."""
        self._you = msgspec.json.encode(you).decode()
        self._new.set()

    def answer(self, to: str, words: str, *, ok: bool, **more: Any) -> None:
        """Say what became of an order."""
        said = {"is": "said", "ok": ok, "words": shown(words, 1000), "to": to, **more}
        self._answers.append(msgspec.json.encode(said).decode())
        self._new.set()

    async def stay(self, on_text: Callable[[str], Awaitable[None]], on_sound: Callable[[bytes], None]) -> None:
        """Send and listen until the browser goes, or is cut off."""
        self._fan.add(self)
        speaking = asyncio.create_task(self._speak())
        listening = asyncio.create_task(self._listen(on_text, on_sound))
        try:
            await asyncio.wait({speaking, listening}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self.gone = True
            self._fan.remove(self)
            for task in (speaking, listening):
                task.cancel()
            for ended in await asyncio.gather(speaking, listening, return_exceptions=True):
                if isinstance(ended, Exception) and not isinstance(ended, WebSocketDisconnect | RuntimeError):
                    log.error("a browser's connection failed", exc_info=ended)

    async def _speak(self) -> None:
        while True:
            await self._new.wait()
            self._new.clear()
            while (text := self._next()) is not None:
                try:
                    await asyncio.wait_for(self._socket.send_text(text), TAKES_S)
                except TimeoutError:
                    self._cut_off()
                    return
                self._sent.set()
            if self._fan_waits:
                self._fan_waits = False
                self._fan.has_taken(self)

    def _next(self) -> str | None:
        """Return what is sent next: answers, the word on the lesson, frames."""
        if self._answers:
            return self._answers.popleft()
        if self._you is not None:
            you, self._you = self._you, None
            return you
        return self._frames.popleft() if self._frames else None

    def _cut_off(self) -> None:
        """Drop the connection with what it holds: one that takes nothing cannot be told that it ends."""
        abort: Callable[[], None] | None = self._socket.scope.get("state", {}).get("abort")
        if abort is not None:
            abort()

    async def _listen(self, on_text: Callable[[str], Awaitable[None]], on_sound: Callable[[bytes], None]) -> None:
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            await self._keep_pace()
            if (text := message.get("text")) is not None:
                await on_text(text)
            elif (sound := message.get("bytes")) is not None:
                on_sound(sound)

    async def _keep_pace(self) -> None:
        """Wait as long as what has come was too much, or its answers are not taken."""
        now_s = time.monotonic()
        self._budget = min(ORDERS_AT_ONCE, self._budget + (now_s - self._counted_s) * ORDERS_HZ) - 1.0
        self._counted_s = now_s
        if self._budget < 0:
            await asyncio.sleep(-self._budget / ORDERS_HZ)
        while len(self._answers) >= ANSWERS_KEPT:
            self._sent.clear()
            await self._sent.wait()
