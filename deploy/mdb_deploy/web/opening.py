"""Where the page is opened, and for whom: options, port, certificate, tokens.

Imports little: `mdb up` asks it before anything is started.
"""

from __future__ import annotations

import socket
import ssl
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from mdb_deploy.web.guard import LOOPBACK, OF_ROLE, Guard, Rights, Site, tokens_in, tokens_of
from mdb_protocol.bundle import Bundle
from mdb_protocol.endpoints import EVERYWHERE, Endpoint
from mdb_protocol.errors import ConfigError
from mdb_protocol.roles import Role

PORT, PORTS_TRIED = 8787, 50
"""The port, if none is said; when it is taken the next ones are tried."""
SOCKET_VARIABLE = "MDB_WEB_SOCKET"
"""Holds the number of the socket that `mdb up` listens with, if it has started this process."""
BACKLOG = 256
MAY = {
    Role.BRAIN: OF_ROLE,
    Role.OPERATOR: {"viewer": OF_ROLE["viewer"], "operator": Rights(teach=False, operate=True)},
    Role.VIEWER: {"viewer": OF_ROLE["viewer"]},
}
"""The links of a page with a bundle, by the bundle's role: nobody may do more there than the bundle may."""
PACKAGES = ("starlette", "uvicorn", "websockets")
WRITE_BYTES = 2**17
"""Waiting to be sent on one connection, here and in the system each, before its sender waits: what waits gets old."""


@dataclass(frozen=True)
class Place:
    """What the command line says of the brain; None: it is to be found."""

    connect: str | None = None
    run: Path | None = None
    experiment: Path | None = None
    brain: str | None = None
    keys: Path | None = None


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


def check_packages() -> None:
    """Raise ModuleNotFoundError when this machine lacks what serves the page."""
    for name in PACKAGES:
        if find_spec(name) is None:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches what listens there."""
    return bool(host) and Endpoint("tcp", host, 0).is_loopback()


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
    hosts = {*LOOPBACK, options.host.lower()} - {*EVERYWHERE, ""}
    if keys is None:
        return Guard(Site(options.host, port), frozenset(hosts))
    if keys.is_dir():
        from mdb_deploy.keys.credentials import KeyFolder

        named = KeyFolder(keys).hosts()
        hosts |= {host.lower() for host in named}
        anywhere = options.host in EVERYWHERE
        known_as = next((host for host in reversed(named) if host not in LOOPBACK), None) if anywhere else None
        return Guard(Site(options.host, port, encrypted=True), frozenset(hosts), tokens_in(keys), known_as)
    bundle = Bundle.read(keys)
    may = MAY.get(bundle.user.role if bundle.user is not None else Role.VIEWER, MAY[Role.VIEWER])
    return Guard(Site(options.host, port), frozenset(hosts), tokens_of(bundle.key, may), of_role=may)


def certificate_of(options: WebOptions) -> ssl.SSLContext | None:
    """Return what makes the page's connections encrypted, with a key folder; None without one."""
    keys = options.place.keys
    if keys is None or not keys.is_dir():
        return None
    from mdb_deploy.keys.credentials import KeyFolder

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.load_cert_chain(KeyFolder(keys).page_certificate(options.host))
    return context
