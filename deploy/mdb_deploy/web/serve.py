"""The console as a process: its port, its certificate, its loop, and how it ends.

Serves the page first and looks for the brain then: the page is there before the router is. The heart beats as long as
both threads go on, the one that serves and the one that hears the brain.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import socket
import ssl
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog
import uvicorn
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from mdb_deploy.web.guard import LOOPBACK, TOKEN_BYTES, Guard, Site, tokens_in
from mdb_deploy.web.live.bridge import NICE, Bridge
from mdb_deploy.web.live.fan import Fan
from mdb_deploy.web.live.finding import Place
from mdb_deploy.web.server import Console
from mdb_protocol.bundle import Bundle
from mdb_protocol.errors import ConfigError
from mdb_protocol.roles import Role
from mdb_services.shell.heartbeat import CLOSE_S, START_S, Heart

log = structlog.get_logger()

PORT, PORTS_TRIED = 8787, 50
"""The port, if none is said; when it is taken the next ones are tried."""
BACKLOG = 256
MOST_CONNECTIONS = 256
WRITE_BYTES = 2**17
"""Waiting to be sent on one connection, here and in the system each, before its sender waits: what waits gets old."""
RESET = struct.pack("ii", 1, 0)
"""Of SO_LINGER: close at once, and drop what was not taken."""
MESSAGE_BYTES = 2**17
"""Largest message that a browser may send: one second of sound."""
PING_S = 20.0
"""So often a browser is asked whether it lives, and so long it may take to answer."""
CLOSING_S = 1
LOOK_S = 0.05


@dataclass(frozen=True)
class WebOptions:
    """What the command line says of the console."""

    place: Place
    host: str = "127.0.0.1"
    port: int | None = None
    """None: the usual one, or the first of the next ones that is free."""
    runs: Path | None = None
    """Where past runs are."""
    instance: str = "console"
    open_to_everyone: bool = False
    """Listen beyond this machine without keys: in a container, whose port is for this machine alone."""


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


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches what listens there."""
    return host in LOOPBACK or host.startswith("127.")


def check(options: WebOptions) -> None:
    """Raise ConfigError when the page may not be served there, or with these keys."""
    keys = options.place.keys
    if keys is None and not is_loopback(options.host) and not options.open_to_everyone:
        raise ConfigError(
            f"the page at {options.host} could be used by everyone there: listen at 127.0.0.1, or give the key "
            "folder with --keys ('mdb keys init' makes one)"
        )
    if keys is not None and keys.is_file():
        user = Bundle.read(keys).user
        if user is None or user.role is Role.TEACHER or not is_loopback(options.host):
            raise ConfigError(
                f"{keys} is the bundle of {user or 'nobody who is named'}; the page needs the key folder, or, to be "
                "seen from this machine alone, the bundle of a viewer or an operator"
            )


def bind(host: str, port: int | None) -> socket.socket:
    """Return a socket that listens; ConfigError when that cannot be. Without a port the next free one is taken."""
    last: OSError | None = None
    for tried in range(PORT, PORT + PORTS_TRIED) if port is None else (port,):
        try:
            family, kind, proto, _, address = socket.getaddrinfo(
                host or None, tried, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )[0]
            listening = socket.socket(family, kind, proto)
        except (OSError, UnicodeError) as error:
            raise ConfigError(f"the page cannot be served at {host}: {error}") from error
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WRITE_BYTES)  # its connections have it, too
            listening.bind(address)
            listening.listen(BACKLOG)
        except OSError as error:
            listening.close()
            last = error
            continue
        return listening
    ports = f"ports {PORT} to {PORT + PORTS_TRIED - 1}" if port is None else f"port {port}"
    why = last.strerror if last is not None else "none is free"
    raise ConfigError(
        f"the page cannot be served at {host}, {ports}: {why}; give another with --web-port or --listen"
    )


def guard_of(options: WebOptions, port: int) -> Guard:
    """Return who may use the page at this port; the tokens are made if there are none."""
    keys = options.place.keys
    hosts = {*LOOPBACK, options.host.lower()} - {"0.0.0.0", "::", ""}
    if keys is None:
        return Guard(Site(options.host, port), frozenset(hosts))
    if keys.is_dir():
        from mdb_deploy.keys.credentials import KeyFolder

        named = KeyFolder(keys).hosts()
        hosts |= {host.lower() for host in named}
        anywhere = options.host in ("0.0.0.0", "::")
        known_as = next((host for host in reversed(named) if host not in LOOPBACK), None) if anywhere else None
        return Guard(Site(options.host, port, encrypted=True), frozenset(hosts), tokens_in(keys), known_as)
    user = Bundle.read(keys).user
    roles = ("viewer", "operator") if user is not None and user.role is Role.OPERATOR else ("viewer",)
    tokens = {role: secrets.token_urlsafe(TOKEN_BYTES) for role in roles}
    return Guard(Site(options.host, port), frozenset(hosts), tokens)


def _certificate(options: WebOptions) -> ssl.SSLContext | None:
    keys = options.place.keys
    if keys is None or not keys.is_dir():
        return None
    from mdb_deploy.keys.credentials import KeyFolder

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.load_cert_chain(KeyFolder(keys).page_certificate(options.host))
    return context


def serve(
    options: WebOptions,
    stop: Callable[[], bool],
    heart: Heart,
    on_open: Callable[[Guard], None] = lambda _: None,
) -> None:
    """Serve the page until told to stop; ConfigError when it cannot be. `on_open`: called once it can be opened."""
    check(options)
    listening = bind(options.host, options.port)
    with listening:
        guard = guard_of(options, listening.getsockname()[1])
        context = _certificate(options)
        fan = Fan()
        bridge = Bridge(options.place, options.instance, fan)
        console = Console(guard, fan, bridge, options.runs, options.place.keys)
        server = Server(_config(console, context))
        asyncio.run(_Serving(server, console, bridge, stop, heart).run(listening, lambda: on_open(guard)))


def _config(console: Console, context: ssl.SSLContext | None) -> uvicorn.Config:
    settings: dict[str, Any] = {}
    if context is not None:
        settings = {"ssl_context_factory": lambda *_: context}
    return uvicorn.Config(
        console.app,
        loop="none",
        http="h11",
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

    server: Server
    console: Console
    bridge: Bridge
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
            self.bridge.start()
            os.nice(NICE)  # now, so that the page is there soon, however busy the machine is as a brain starts
            self.heart.ready()
            telling = asyncio.create_task(self.console.tell())
            while not (self.stop() or serving.done()):
                if self.bridge.beats.goes_on() and not telling.done():
                    self.heart.beat()
                await asyncio.sleep(LOOK_S)
            telling.cancel()
        finally:
            self.heart.beat(CLOSE_S)
            await self.console.close()
            self.server.should_exit = True
            await asyncio.to_thread(self.bridge.stop)
            await serving
