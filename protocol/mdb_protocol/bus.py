"""The bus: how a service publishes, subscribes, asks and is seen, whatever carries the bytes.

Owns the contract and the inbox that both implementations (`zenoh_bus`, `memory_bus`) share: decoding,
counting what is refused, keeping only the newest of a latest-value key. A service works in one thread:
callbacks of a transport only hand raw samples to an inbox; `wait` returns when something has come.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, Protocol, TypeVar

import structlog

from mdb_protocol import codec
from mdb_protocol.errors import DecodeError
from mdb_protocol.keys import ALIVE, Delivery, Key
from mdb_protocol.messages import Message

log = structlog.get_logger()

M = TypeVar("M", bound=Message)

LATEST_KEPT = 16
"""Raw samples a latest-value inbox keeps, so that junk behind a good value does not hide it."""
RELIABLE_KEPT = 65_536
"""Raw samples a reliable inbox keeps; beyond it the oldest is dropped and counted."""
LOGGED_REFUSALS = 3
"""Refused messages logged in words for each key; the rest is only counted."""


class Raw(NamedTuple):
    """A sample as it came: full key, payload bytes, encoding string."""

    key: str
    payload: bytes
    encoding: str


class Publisher(Protocol):
    """Puts messages on one key."""

    def put(self, message: Any) -> None:
        """Send a message of the key's type; never blocks on a slow reader of a latest-value key."""


class Refusals:
    """Counts what was refused or dropped, by key; says the first few of each in the log."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._lock = threading.Lock()

    def add(self, path: str, reason: str) -> None:
        """Count one refusal on `path`."""
        with self._lock:
            self.counts[path] += 1
            count = self.counts[path]
        if count <= LOGGED_REFUSALS:
            log.warning("message refused", key=path, reason=reason, count=count)


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


class Inbox:
    """What came for one subscription and has not been taken yet; filled from any thread."""

    def __init__(self, row: Key, brain: str, refusals: Refusals, wake: Wake) -> None:
        self._row, self._brain, self._refusals, self._wake = row, brain, refusals, wake
        self._latest = row.delivery is Delivery.LATEST
        self._raw: deque[Raw] = deque(maxlen=LATEST_KEPT if self._latest else RELIABLE_KEPT)
        self._lock = threading.Lock()

    def put(self, raw: Raw) -> None:
        """Hand over a sample; called by the transport."""
        if not self._latest and len(self._raw) == RELIABLE_KEPT:
            self._refusals.add(self._row.path, f"inbox full: {RELIABLE_KEPT} messages wait; oldest dropped")
        with self._lock:
            self._raw.append(raw)
        self._wake.set()

    def take(self) -> Any:
        """Return the next valid message (latest-value keys: the newest, dropping older), or None."""
        while waiting := self._next():
            for raw in waiting:
                if (message := self._read(raw)) is not None:
                    return message
        return None

    def _next(self) -> list[Raw]:
        """Take the oldest sample, or all of a latest-value key, newest first: what comes now stays."""
        with self._lock:
            if not self._latest:
                return [self._raw.popleft()] if self._raw else []
            waiting = list(reversed(self._raw))
            self._raw.clear()
            return waiting

    def _read(self, raw: Raw) -> Message | None:
        try:
            return read(self._row, self._brain, raw)
        except DecodeError as error:
            self._refusals.add(self._row.path, str(error))
            return None


class Tap:
    """Every sample of a brain as it came, undecoded: for recorders."""

    def __init__(self, wake: Wake) -> None:
        self._raw: deque[Raw] = deque()
        self._wake = wake

    def put(self, raw: Raw) -> None:
        """Hand over a sample; called by the transport."""
        self._raw.append(raw)
        self._wake.set()

    def take(self) -> Raw | None:
        """Return the next sample, or None."""
        return self._raw.popleft() if self._raw else None


def read(row: Key, brain: str, raw: Raw) -> Message:
    """Decode a sample of a key row; DecodeError when it is not the row's message or not its writer's.

    A message that names its teacher or model must lie on the key of that teacher or model.
    """
    if row.message is None:
        raise DecodeError(f"key {row.path} carries no payload")
    parameters = row.match(brain, raw.key)
    if parameters is None:
        raise DecodeError(f"sample on {raw.key!r}; expected a concrete key of {row.path!r}")
    message = codec.decode(row.message, raw.payload, raw.encoding)
    for name, value in parameters.items():
        said = getattr(message, name, value)
        if said != value:
            raise DecodeError(f"message says {name} {said!r}, but its key says {value!r}")
    return message


class Bus(ABC):
    """One service's access to the keys of one brain; see `keys` for what each key promises."""

    def __init__(self, brain: str) -> None:
        self.brain = brain
        self.refusals = Refusals()
        self._wake = Wake()

    @abstractmethod
    def publisher(self, row: Key, **parameters: str) -> Publisher:
        """Return a publisher on a concrete key; its delivery is the row's."""

    @abstractmethod
    def subscriber(self, row: Key, **parameters: str) -> Inbox:
        """Return an inbox for a key; a parameter left out matches any."""

    @abstractmethod
    def tap(self) -> Tap:
        """Return every sample that anyone puts on a key of this brain, and what is kept of the last ones."""

    @abstractmethod
    def queryable(self, row: Key, handler: Callable[[], Message | None], **parameters: str) -> None:
        """Answer queries on a concrete key by what `handler` returns (None: no answer)."""

    @abstractmethod
    def query(self, row: Key, timeout_s: float, **parameters: str) -> list[Any]:
        """Return all valid answers that came within the bound; a parameter left out asks all.

        Raises `QueryError` when an answer is an error or does not come in time.
        """

    @abstractmethod
    def token(self, role: str, instance: str) -> None:
        """Declare this service alive, and so ready; until `close`."""

    @abstractmethod
    def alive(self) -> frozenset[str]:
        """Return "role/instance" of all that are alive; changes wake `wait`."""

    @abstractmethod
    def admitted(self, role: str, instance: str, timeout_s: float) -> bool:
        """Whether others see this bus's token within the bound; if not, the router takes nothing from it.

        A router with keys drops without a word what it denies, so a teacher asks this once, after `token`. Raises
        `BusError` when the router is gone.
        """

    @abstractmethod
    def close(self) -> None:
        """Withdraw everything this bus declared. May be called twice."""

    def serve(self) -> None:  # noqa: B027 - a transport that answers at once has nothing to do here
        """Answer the queries that have come; called by the service's own loop."""

    def wait(self, timeout_s: float) -> bool:
        """Wait until something came since the last `wait`, or the bound; return whether it did."""
        return self._wake.wait(timeout_s)

    def poke(self) -> None:
        """Wake this bus's `wait`, from any thread: something other than a message is to be done."""
        self._wake.set()

    def _alive_name(self, key: str) -> str | None:
        found = ALIVE.match(self.brain, key)
        return f"{found['role']}/{found['instance']}" if found else None

    def __enter__(self) -> Bus:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
