"""The console as a process: its port, its certificate, its loop, and how it ends.

Serves the page first and looks for the brain then: the page is there before the router is. The heart beats as long as
both threads go on, the one that serves and the one that hears the brain.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import ssl
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import structlog
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from mdb_deploy.web.guard import Guard
from mdb_deploy.web.live.fan import Fan
from mdb_deploy.web.opening import SOCKET_VARIABLE, WRITE_BYTES, WebOptions, bind, certificate_of, check, guard_of
from mdb_deploy.web.server import Console
from mdb_services.shell.heartbeat import CLOSE_S, START_S, Heart

if TYPE_CHECKING:
    from mdb_deploy.web.live.bridge import Bridge

log = structlog.get_logger()

MOST_CONNECTIONS = 256
RESET = struct.pack("ii", 1, 0)
"""Of SO_LINGER: close at once, and drop what was not taken."""
MESSAGE_BYTES = 2**17
"""Largest message that a browser may send: one second of sound."""
PING_S = 20.0
"""So often a browser is asked whether it lives, and so long it may take to answer."""
REQUEST_S = 10.0
"""A connection on which no whole request has come for so long is closed."""
CLOSING_S = 1
NICE = 5
"""Showing gives way to acting when both want the same core, as learning does."""
LOOK_S = 0.05


class Requests(H11Protocol):
    """Uvicorn's HTTP, with a bound on how long a connection may be held without a whole request."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See to it that a request comes."""
        assert isinstance(transport, asyncio.Transport)
        super().connection_made(transport)
        self._served: object = None
        self._idle_s = self.loop.time()
        self._look()

    def _look(self) -> None:
        if self.transport.is_closing() or self not in self.connections:  # closed, or a WebSocket's from now on
            return
        if self.cycle is not None and (self.cycle is not self._served or not self.cycle.response_complete):
            self._served, self._idle_s = self.cycle, self.loop.time()
        if self.loop.time() - self._idle_s > REQUEST_S:
            self.transport.abort()
        else:
            self.loop.call_later(REQUEST_S / 4, self._look)


class Sockets(WebSocketsSansIOProtocol):
    """Uvicorn's WebSockets, with a bound on what waits to be sent, and a way to cut off who takes nothing."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Set the bound, and hand the way to cut it off to the application, in its scope's state."""
        assert isinstance(transport, asyncio.Transport)
        transport.set_write_buffer_limits(high=WRITE_BYTES)
        self.app_state = {**self.app_state, "abort": self.cut_off}
        super().connection_made(transport)

    def cut_off(self) -> None:
        """Drop the connection with what it holds, which the system would otherwise keep for who does not take it."""
        if (link := self.transport.get_extra_info("socket")) is not None:
            with contextlib.suppress(OSError):
                link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        self.transport.abort()

    def keepalive_timeout(self) -> None:
        """Drop what is not taken as well: otherwise the connection would wait for it."""
        super().keepalive_timeout()
        self.cut_off()


class Server(uvicorn.Server):
    """Uvicorn without signals: this process has a way of its own to be stopped."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave the signals as they are."""
        yield


def serve(
    options: WebOptions,
    stop: Callable[[], bool],
    heart: Heart,
    on_open: Callable[[Guard], None] = lambda _: None,
) -> None:
    """Serve the page until told to stop; ConfigError when it cannot be. `on_open`: called once it can be opened."""
    check(options)
    given = os.environ.pop(SOCKET_VARIABLE, "")  # by `mdb up`, which keeps the port while this process is dead
    with socket.socket(fileno=int(given)) if given else bind(options.host, options.port) as listening:
        guard = guard_of(options, listening.getsockname()[1])
        context = certificate_of(options)
        fan = Fan()
        console = Console(guard, fan, options.runs)
        serving = _Serving(options, Server(_config(console, context)), console, fan, stop, heart)
        asyncio.run(serving.run(listening, lambda: on_open(guard)))


def _config(console: Console, context: ssl.SSLContext | None) -> uvicorn.Config:
    settings: dict[str, Any] = {}
    if context is not None:
        settings = {"ssl_context_factory": lambda *_: context}
    return uvicorn.Config(
        console.app,
        loop="none",
        http=Requests,
        ws=Sockets,
        ws_max_size=MESSAGE_BYTES,
        ws_ping_interval=PING_S,
        ws_ping_timeout=PING_S,
        ws_per_message_deflate=False,
        interface="asgi3",
        lifespan="off",
        log_config=None,
        access_log=False,
        proxy_headers=False,
        server_header=False,
        limit_concurrency=MOST_CONNECTIONS,
        timeout_graceful_shutdown=CLOSING_S,
        **settings,
    )


@dataclass(frozen=True)
class _Serving:
    """A server, and all that goes on beside it."""

    options: WebOptions
    server: Server
    console: Console
    fan: Fan
    stop: Callable[[], bool]
    heart: Heart

    async def run(self, listening: socket.socket, on_open: Callable[[], None]) -> None:
        """Serve until told to stop."""
        serving = asyncio.create_task(self.server.serve(sockets=[listening]))
        try:
            while not (self.server.started or serving.done()):
                self.heart.beat(START_S)
                await asyncio.sleep(0.005)
            on_open()
            log.info("the page can be opened", at=self.console.guard.site.address())
            self.heart.ready()
            await self._go_on(serving)
        finally:
            self.heart.beat(CLOSE_S)
            await self.console.close()
            self.server.should_exit = True
            await serving

    async def _go_on(self, serving: asyncio.Task[None]) -> None:
        """Look for the brain, which the page did not have to wait for, and go on until told to stop."""
        bridge = await asyncio.to_thread(self._bridge)
        bridge.start()
        os.nice(NICE)  # from now on: before, a brain that starts beside it would keep the page from being there soon
        telling = asyncio.create_task(self.console.tell())
        try:
            while not (self.stop() or serving.done()):
                if bridge.beats.goes_on() and not telling.done():
                    self.heart.beat()
                await asyncio.sleep(LOOK_S)
        finally:
            self.heart.beat(CLOSE_S)
            telling.cancel()
            await self.console.leave()
            await asyncio.to_thread(bridge.stop)

    def _bridge(self) -> Bridge:
        """Make what joins the brain; only now is imported what that needs."""
        from mdb_deploy.web.live.bridge import Bridge
        from mdb_deploy.web.live.guests import Guests

        bridge = Bridge(self.options.place, self.options.instance, self.fan)
        self.console.attach(bridge, Guests(self.options.place.keys), self.options.place.keys)
        return bridge
