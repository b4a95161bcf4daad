"""Sessions over Eclipse Zenoh: a client's, and the router that carries all that a brain says.

Owns how they are configured; what is said in them is `zenoh_bus`'s.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import zenoh
from zenoh.handlers import Callback

from mdb_protocol import endpoints, limits
from mdb_protocol.bundle import Bundle, why_refused
from mdb_protocol.errors import BusError
from mdb_protocol.probing import EVERY_S, Probe
from mdb_protocol.roles import User

LEASE_MS = 2000
"""A process that stops without a word (frozen, cable pulled) is seen as gone after this."""
RETRY_MS = 50
"""A client that has lost its router tries again after this; the waits grow to four times as long."""
SHORT = {"so_sndbuf": 2**15, "so_rcvbuf": 2**15}
"""Bytes in the system's hands on the way. They cannot be overtaken: what a flood puts there, all else waits for."""
CONTROL, WAITING = "data_high", 16
"""The priority of what we say, which overtakes at each hop what strangers say with Zenoh's usual one, or guests, whom
a router with keys gives that one; and the batches that may wait there before a latest value is dropped.
"""
LEFT_S = 5.0
"""Bound on leaving: in a process of many sessions, closing one was seen never to end. There is none where Zenoh waits
with Python's lock; a service has another bound for that (`Stopper`)."""
THREADS = "ZENOH_RUNTIME"
"""Where Zenoh looks, at a process's first session, for which of its threads does what."""
ROUTER_THREADS = "(rx: (worker_threads: 8))"
"""One that forwards to a reader who takes nothing waits; with Zenoh's two, so do all."""
CLIENT_THREADS = "(rx: (handover: app), app: (worker_threads: 1))"
"""A client has one link. With Zenoh's own threads each sample wakes three, one after the other, for what one does: a
third of what a receive takes. (Not in a router: all its links would wait for the one that waits.)"""
LIBC = ctypes.CDLL(None)
MALLOPT = ((-8, 2), (-3, 2**20), (-1, 2**20))
"""glibc's M_ARENA_MAX, M_MMAP_THRESHOLD and M_TRIM_THRESHOLD, for a router: what large messages and many short-lived
keys took goes back to the system, where it stayed (100 MB after a minute of floods).
"""
ADMIN, ADMIN_S = "@/*/router", 2.0
"""Where a router tells of itself, and the bound on asking it.

Nothing else of its admin space may be asked: of tokens, subscribers and the like it tells while it holds a lock that
the telling needs again. If somebody declares something at that moment, both wait for ever, and soon the whole router
does (Zenoh 1.10; its pull request 2619).
"""
_HERE = threading.local()
QUIC_SAYS = "or it refuses these keys, which cannot be told apart over QUIC"


def open_client(
    connect: str, bundle: Bundle | None, timeout_s: float, give_up: Callable[[], bool] = lambda: False
) -> zenoh.Session:
    """Return a session through a router; BusError when none answers within the bound, or it refuses."""
    retry = {"period_init_ms": RETRY_MS, "period_max_ms": 4 * RETRY_MS, "period_increase_factor": 1.5}
    config = zenoh.Config.from_json5(
        json.dumps(
            {
                "mode": "client",
                "connect": {
                    "endpoints": [connect],
                    "timeout_ms": 1000,
                    "exit_on_failure": True,
                    "retry": retry,
                },
                "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
                "transport": {
                    "shared_memory": {"enabled": False},  # 20 MB for each process that says something large
                    "link": {
                        "tx": {"lease": LEASE_MS, "queue": {"size": {CONTROL: WAITING, "data": WAITING}}},
                        "tcp": SHORT,
                        "tls": SHORT if bundle is None else SHORT | bundle.client_tls(),
                    },
                },
            }
        )
    )
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            return _open(config, CLIENT_THREADS)
        except zenoh.ZError as error:
            reason = None if endpoints.within(connect) else why_refused(endpoints.parse(connect), bundle)
            if reason is not None and bundle is not None:
                raise BusError(f"the router at {connect} cannot be used: {reason}") from error
            if time.monotonic() >= deadline or give_up():
                said = reason or (QUIC_SAYS if connect.startswith("quic/") else _first_line(error))
                raise BusError(
                    f"no router answers at {connect} within {timeout_s:g} s ({said}). 'mdb up' starts a brain with "
                    f"its router, 'mdb run router --listen {connect}' one for several; --connect says where one runs"
                ) from error
            time.sleep(0.05)


def _open(config: zenoh.Config, threads: str) -> zenoh.Session:
    """Open a session with these threads, unless the user or an earlier session has said otherwise.

    The variable is taken away again: a router that is started from a client has threads of its own.
    """
    if THREADS in os.environ:
        return zenoh.open(config)
    os.environ[THREADS] = threads
    try:
        return zenoh.open(config)
    finally:
        os.environ.pop(THREADS, None)


def leave(session: zenoh.Session, declared: Sequence[Any] = ()) -> None:
    """Undeclare these and close the session, or wait for that no longer than `LEFT_S`."""

    def close() -> None:
        for one in declared:
            with suppress(zenoh.ZError):
                one.undeclare()
        with suppress(zenoh.ZError):
            session.close()  # type: ignore[no-untyped-call]

    closing = threading.Thread(target=close, name="leaves", daemon=True)
    try:
        closing.start()
    except RuntimeError:  # no thread is to be had, as when Python ends
        close()
    else:
        closing.join(LEFT_S)


def stay_known() -> None:
    """Let Python keep what it knows of this thread, one of Zenoh's; to be called in a callback.

    Else it maps memory for the thread's frames at each call, and unmaps it in the end, which takes longer than all
    that is done with a sample.
    """
    if not hasattr(_HERE, "known"):
        _HERE.known = True
        ctypes.pythonapi.PyGILState_Ensure()  # never released: the call's own release is then not the last


def ask_router(session: zenoh.Session, key: str, probe: Probe) -> None:
    """Ask who holds a token that nobody has; the router itself answers."""

    def hear(reply: zenoh.Reply) -> None:
        if reply.ok is None:
            probe.fail()

    probe.ask()
    session.liveliness().get(key, Callback(hear, probe.end, indirect=False), timeout=EVERY_S)


class RouterKeys(NamedTuple):
    """What a router with keys shows and enforces: its own bundle, Zenoh's `access_control`, and who is admitted."""

    bundle: Bundle
    access_control: Mapping[str, object]
    users: Sequence[User]


class Router:
    """A Zenoh router in this process (paper: none; ours), with the limits of the key table.

    It has its own threads only when no client was opened in this process before it (`CLIENT_THREADS`).
    The same config file drives `zenohd`, without these limits.
    """

    def __init__(
        self,
        config_file: Path,
        listen: str | None = None,
        *,
        keys: RouterKeys | None = None,
        open_to_everyone: bool = False,
    ) -> None:
        """Start routing; `listen` replaces the file's endpoint, port 0 asks for a free one.

        Raises `BusError` when the file is not a config, the endpoint cannot be had, or it can be reached from beyond
        this machine and there are neither keys nor the plain word that it is `open_to_everyone`.
        """
        endpoints.check(listen or endpoints.USUAL, listens=True)
        _keep_little_memory()
        try:
            config = zenoh.Config.from_file(str(config_file))
            if listen:
                config.insert_json5("listen/endpoints", json.dumps([listen]))
            self.listen, *more = json.loads(config.get_json("listen/endpoints"))
            for endpoint in (self.listen, *more):
                endpoints.check_listen(endpoint, has_keys=keys is not None, open_to_everyone=open_to_everyone)
            if keys is not None:
                config.insert_json5("transport/link/tls", json.dumps(SHORT | keys.bundle.router_tls()))
                config.insert_json5("access_control", json.dumps(keys.access_control))
                config.insert_json5("downsampling", json.dumps(limits.rates(keys.users)))
                config.insert_json5("qos/network", json.dumps(limits.priorities(keys.users)))
            config.insert_json5("low_pass_filter", json.dumps(limits.sizes()))
            self._session = _open(config, ROUTER_THREADS)
        except zenoh.ZError as error:
            where = listen or f"the endpoint in {config_file}"
            raise BusError(
                f"the router cannot start on {where}: {_first_line(error)}. Is the port in use? Choose another "
                "with --listen tcp/127.0.0.1:PORT (port 0: any free one)"
            ) from error

    def endpoint(self) -> str:
        """Return where a client on this machine connects: the first endpoint it listens on, with the real port."""
        for reply in self._session.get(ADMIN, timeout=ADMIN_S):
            if reply.ok is not None:
                locators: list[str] = json.loads(reply.ok.payload.to_bytes())["locators"]
                return self._on_this_machine(locators)
        raise BusError("the router does not say where it listens; is its admin space switched off?")

    def answers(self) -> bool:
        """Whether the router's own threads answer a query; waits `ADMIN_S` at most."""
        return any(reply.ok is not None for reply in self._session.get(ADMIN, timeout=ADMIN_S))

    @staticmethod
    def give_memory_back() -> None:
        """Give what is free of this process back to the system, in 0.14 ms; another C library than glibc keeps it.

        With `MALLOPT` alone the router had grown by 64 MB after 88 floods of guests'; with this too nobody by more
        than 14 after 110.
        """
        if hasattr(LIBC, "malloc_trim"):
            LIBC.malloc_trim(0)

    def _on_this_machine(self, locators: list[str]) -> str:
        """Undo that a router which listens on all addresses names the outer ones only."""
        asked, first = endpoints.parse(self.listen), endpoints.parse(locators[0])
        if asked.host in endpoints.EVERYWHERE:
            return str(asked._replace(port=first.port).for_this_machine())
        return locators[0]

    def close(self) -> None:
        """Stop routing; clients notice at once."""
        leave(self._session)


def _keep_little_memory() -> None:
    """Tell the C library to; another than glibc is left as it is."""
    if sys.platform == "linux" and hasattr(LIBC, "mallopt"):
        for parameter, value in MALLOPT:
            LIBC.mallopt(parameter, value)


def _first_line(error: Exception) -> str:
    """Return what an error says, without where in Zenoh's own code it arose."""
    said = str(error).strip()
    return said.splitlines()[0].partition(" at /")[0][:200] if said else type(error).__name__
