"""The bus inside one process: the same contract as Zenoh's, for `--inline` runs and for tests.

Messages are encoded and decoded as on the wire, so nothing of the writer's is shared by accident. A sample is
decoded once, by the first who reads it, and all its readers share that message: it is frozen and its arrays are
read-only, and nobody may change its lists and dicts.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from mdb_protocol import codec
from mdb_protocol.bus import Bus, Inbox, Publisher, Tap, pack, read
from mdb_protocol.errors import BusError, DecodeError, QueryError
from mdb_protocol.keys import ALIVE, CLAIM, Delivery, Key
from mdb_protocol.messages import Message
from mdb_protocol.waiting import Raw

KEEPS_LAST = (Delivery.LATEST, Delivery.LATCHED)


class _Subscription(NamedTuple):
    owner: MemoryBus
    row: Key
    parameters: dict[str, str]
    inbox: Inbox

    def wants(self, key: str) -> bool:
        found = self.row.match(self.owner.brain, key)
        return found is not None and all(found[name] == value for name, value in self.parameters.items())


class Fabric:
    """What the buses of one process share: the place of a router."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.subscriptions: list[_Subscription] = []
        self.taps: list[tuple[MemoryBus, Tap]] = []
        self.last: dict[str, tuple[MemoryBus, deque[Raw]]] = {}
        self.queryables: dict[str, tuple[MemoryBus, Callable[[], Message | None]]] = {}
        self.tokens: dict[str, MemoryBus] = {}
        self.buses: list[MemoryBus] = []
        self._routes: dict[str, list[Inbox]] = {}

    def put(self, owner: MemoryBus, row: Key, raw: Raw) -> None:
        """Hand a sample to everyone who wants it."""
        with self.lock:
            if row.delivery in KEEPS_LAST:
                keeper, _ = self.last.get(raw.key, (None, None))
                if keeper is not owner:
                    self.last[raw.key] = owner, deque(maxlen=row.history)
                self.last[raw.key][1].append(raw)
            if raw.key not in self._routes:
                self._routes[raw.key] = [s.inbox for s in self.subscriptions if s.wants(raw.key)]
            for inbox in self._routes[raw.key]:
                inbox.put(raw)
            for tapper, tap in self.taps:
                if tapper.brain == owner.brain:
                    tap.put(raw)

    def changed(self) -> None:
        """Forget the routes and wake all: somebody came or went."""
        self._routes.clear()
        for bus in self.buses:
            bus.poke()


class _Publisher:
    def __init__(self, bus: MemoryBus, row: Key, key: str) -> None:
        if row.message is None or "*" in key:
            raise BusError(f"cannot publish on {key}: it is not a concrete key with a payload")
        self._bus, self._row, self._key = bus, row, key
        self._encoding = codec.encoding_of(row.message)

    def put(self, message: Message) -> None:
        self._bus.check_open()
        self._bus.fabric.put(self._bus, self._row, Raw(self._key, pack(self._row, message), self._encoding))


class MemoryBus(Bus):
    """A service's access to a `Fabric`."""

    def __init__(self, fabric: Fabric, brain: str) -> None:
        super().__init__(brain)
        self.fabric = fabric
        self._open = True
        with fabric.lock:
            fabric.buses.append(self)

    def publisher(self, row: Key, **parameters: str) -> Publisher:
        """See `Bus.publisher`."""
        return _Publisher(self, row, row.at(self.brain, **parameters))

    def subscriber(self, row: Key, **parameters: str) -> Inbox:
        """See `Bus.subscriber`."""
        row.at(self.brain, **parameters)
        inbox = self._new_inbox(row)
        subscription = _Subscription(self, row, parameters, inbox)
        with self.fabric.lock:
            self.fabric.subscriptions.append(subscription)
            self.fabric.changed()
            for key, (_, kept) in self.fabric.last.items():
                if subscription.wants(key):
                    for raw in kept:
                        inbox.put(raw)
        return inbox

    def feed(self, raw: Raw) -> bool:
        """Hand a sample to this bus alone, as if somebody had put it; return whether it reads that key."""
        with self.fabric.lock:
            inboxes = [s.inbox for s in self.fabric.subscriptions if s.owner is self and s.wants(raw.key)]
        for inbox in inboxes:
            inbox.put(raw)
        return bool(inboxes)

    def tap(self) -> Tap:
        """See `Bus.tap`."""
        tap = self._new_tap()
        with self.fabric.lock:
            self.fabric.taps.append((self, tap))
            for owner, kept in self.fabric.last.values():
                if owner.brain == self.brain:
                    for raw in kept:
                        tap.put(raw)
        return tap

    def queryable(self, row: Key, handler: Callable[[], Message | None], **parameters: str) -> None:
        """See `Bus.queryable`."""
        with self.fabric.lock:
            self.fabric.queryables[row.at(self.brain, **parameters)] = (self, handler)

    def query(self, row: Key, timeout_s: float, **parameters: str) -> list[Message]:  # noqa: ARG002
        """See `Bus.query`; handlers are called at once, so the bound is never reached."""
        assert row.message is not None
        with self.fabric.lock:
            asked = [
                (key, handler)
                for key, (_, handler) in self.fabric.queryables.items()
                if (found := row.match(self.brain, key)) is not None
                and all(found[name] == value for name, value in parameters.items())
            ]
        answers = []
        for key, handler in asked:
            try:
                reply = handler()
            except Exception as error:
                raise QueryError(f"{key}: the queryable failed: {error}") from error
            if reply is not None:
                raw = Raw(key, codec.encode(reply), codec.encoding_of(type(reply)))
                try:
                    answers.append(read(row, self.brain, raw))
                except DecodeError as error:
                    self.refusals.add(row.path, str(error))
        return answers

    def token(self, role: str, instance: str) -> Callable[[], None]:
        """See `Bus.token`."""
        key = ALIVE.at(self.brain, role=role, instance=instance)
        with self.fabric.lock:
            self.fabric.tokens[key] = self
            self.fabric.changed()
        return lambda: self._withdraw(key)

    def claim(self, role: str, instance: str, holder: str) -> Callable[[], None]:
        """See `Bus.claim`."""
        key = CLAIM.at(self.brain, role=role, instance=instance, holder=holder)
        with self.fabric.lock:
            self.fabric.tokens[key] = self
        return lambda: self._withdraw(key)

    def _withdraw(self, key: str) -> None:
        with self.fabric.lock:
            self.fabric.tokens.pop(key, None)
            self.fabric.changed()

    def holders(self, role: str, instance: str) -> frozenset[str]:
        """See `Bus.holders`."""
        wanted = {"role": role, "instance": instance}
        with self.fabric.lock:
            found = [CLAIM.match(self.brain, key) for key in self.fabric.tokens]
        return frozenset(claim["holder"] for claim in found if claim and claim.items() >= wanted.items())

    def alive(self) -> frozenset[str]:
        """See `Bus.alive`."""
        with self.fabric.lock:
            names = [self._alive_name(key) for key in self.fabric.tokens]
        return frozenset(name for name in names if name)

    def admitted(self, role: str, instance: str, timeout_s: float) -> bool:  # noqa: ARG002
        """See `Bus.admitted`; nobody is denied here."""
        return f"{role}/{instance}" in self.alive()

    def close(self) -> None:
        """See `Bus.close`."""
        with self.fabric.lock:
            self._open = False
            fabric = self.fabric
            fabric.subscriptions = [s for s in fabric.subscriptions if s.owner is not self]
            fabric.taps = [t for t in fabric.taps if t[0] is not self]
            fabric.last = {k: v for k, v in fabric.last.items() if v[0] is not self}
            fabric.queryables = {k: v for k, v in fabric.queryables.items() if v[0] is not self}
            fabric.tokens = {k: v for k, v in fabric.tokens.items() if v is not self}
            fabric.buses = [b for b in fabric.buses if b is not self]
            fabric.changed()

    def check_open(self) -> None:
        """Raise BusError when this bus was closed."""
        if not self._open:
            raise BusError("the bus is closed; open a new one")
