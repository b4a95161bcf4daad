"""The bus: how a service publishes, subscribes, asks and is seen, whatever carries the bytes.

Owns the contract and the inbox that both implementations (`zenoh_bus`, `memory_bus`) share: decoding,
counting what is refused, keeping only the newest of a latest-value key. A service works in one thread:
callbacks of a transport only hand raw samples to an inbox; `wait` returns when something has come.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, Protocol, TypeVar

import structlog

from mdb_protocol import codec
from mdb_protocol.errors import BusError, DecodeError
from mdb_protocol.keys import ALIVE, Delivery, Key, find
from mdb_protocol.messages import Message
from mdb_protocol.waiting import Raw, Waiting, Wake, size_of

log = structlog.get_logger()

M = TypeVar("M", bound=Message)

LATEST_KEPT = 64
"""Samples a latest-value inbox keeps, so that junk behind a good value does not hide it."""
RELIABLE_KEPT = 65_536
"""Samples a reliable inbox, or a tap, keeps; beyond it the oldest is dropped and counted."""
KEPT_BYTES = 2**25
"""Bytes of samples that any of them keeps."""
GUESTS_KEPT = 4096
GUESTS_BYTES = 2**23
"""The same of an inbox for what guests write."""
AT_ONCE = 256
"""Messages of one inbox that are taken, or refused, before all else gets its turn."""
LOGGED_REFUSALS = 3
"""Refused messages logged in words for each key; of the rest one every `LOG_EVERY_S`, with the count."""
LOG_EVERY_S = 60.0
LOGGED_LETTERS = 300
MARGIN_BYTES = 1024
"""Kept free for key and encoding, of the most that a reader takes at once."""
REFUSED_S, MOST_OWED_S = 0.0002, 0.02
"""For each message that is refused, or dropped for want of room, the transport takes in nothing for so long, so that
a flood goes at a pace that leaves the processor to others: its sender waits. At most so long at a time."""
TAPPED = "**"
"""Stands for keys that no brain has, in counts of what a tap dropped or refused."""


class Publisher(Protocol):
    """Puts messages on one key."""

    def put(self, message: Any) -> None:
        """Send a message of the key's type; never blocks on a slow reader of a latest-value key."""


class Refusals:
    """Counts by key what was refused, and what was dropped for want of room; says in the log a few of each."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.counts: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        self._clock = clock
        self._quiet_until_s: dict[tuple[str, str], float] = {}
        self._owed_s = 0.0
        self._lock = threading.Lock()

    def add(self, path: str, reason: str) -> None:
        """Count one refusal on `path`."""
        self._add(self.counts, path, "message refused", reason)

    def drop(self, path: str, reason: str) -> None:
        """Count one message on `path` for which there was no room."""
        self._add(self.dropped, path, "message dropped", reason)

    def pause(self) -> None:
        """Wait as long as refused messages have brought; called by the transport before it hands over more."""
        if self._owed_s:
            owed_s, self._owed_s = self._owed_s, 0.0
            time.sleep(min(owed_s, MOST_OWED_S))

    def _add(self, counter: Counter[str], path: str, what: str, reason: str) -> None:
        with self._lock:
            self._owed_s += REFUSED_S
            counter[path] += 1
            count, now = counter[path], self._clock()
            if count > LOGGED_REFUSALS and now < self._quiet_until_s[path, what]:
                return
            self._quiet_until_s[path, what] = now + LOG_EVERY_S
        log.warning(what, key=path, reason=reason[:LOGGED_LETTERS], count=count)


class Reader(ABC):
    """What waits for one who reads it: what inboxes and taps have in common."""

    def __init__(self, refusals: Refusals, wake: Wake, waiting: Waiting) -> None:
        self._refusals, self._wake = refusals, wake
        self.waiting = waiting
        self.taken = 0
        """Samples taken so far, refused ones included."""

    @abstractmethod
    def take(self) -> Any:
        """Return the next that is waiting, or None."""

    def some(self) -> Iterator[Any]:
        """Yield what can be taken, but of a flood only the first; `Bus.wait` then returns at once."""
        for _ in range(AT_ONCE):
            taken = self.take()
            if taken is None:
                return
            yield taken
        self._wake.set()


class Inbox(Reader):
    """What came for one subscription and has not been taken yet; filled from any thread."""

    def __init__(self, row: Key, brain: str, refusals: Refusals, wake: Wake) -> None:
        self._row, self._brain = row, brain
        self._latest = row.delivery is Delivery.LATEST
        most = LATEST_KEPT if self._latest else GUESTS_KEPT if row.guests_write else RELIABLE_KEPT
        super().__init__(refusals, wake, Waiting(most, GUESTS_BYTES if row.guests_write else KEPT_BYTES))

    def put(self, raw: Raw) -> None:
        """Hand over a sample; called by the transport."""
        if (size := size_of(raw)) > self._row.most_bytes:
            self._refusals.add(self._row.path, f"sample of {size} bytes; at most {self._row.most_bytes} are read")
            return
        for _ in self.waiting.put(raw, size):
            if not self._latest:
                self._refusals.drop(self._row.path, "too many messages wait; oldest dropped")
        self._wake.set()

    def take(self, fits: Callable[[Any], bool] = lambda _: True) -> Any:
        """Return the next valid message (latest-value keys: the newest, dropping older), or None.

        Of a latest-value key the newest that `fits` comes first, so that what is none of its writer's hides nothing.
        Also None after many that were not valid; `Bus.wait` then returns at once.
        """
        refused = 0
        while waiting := self._next():
            self.taken += len(waiting)
            newest: Message | None = None
            for raw in reversed(waiting):
                if (message := self._read(raw)) is not None:
                    if fits(message):
                        return message
                    newest = newest or message
            if newest is not None:
                return newest
            refused += len(waiting)
            if refused >= AT_ONCE:
                self._wake.set()
                return None
        return None

    def _next(self) -> list[Raw]:
        """Take the oldest sample, or all of a latest-value key: what comes now stays."""
        return self.waiting.take(LATEST_KEPT if self._latest else 1)

    def _read(self, raw: Raw) -> Message | None:
        try:
            return read(self._row, self._brain, raw)
        except DecodeError as error:
            self._refusals.add(self._row.path, str(error))
            return None


class Tap(Reader):
    """Every sample of a brain as it came, undecoded: for recorders."""

    def __init__(self, brain: str, refusals: Refusals, wake: Wake) -> None:
        super().__init__(refusals, wake, Waiting(RELIABLE_KEPT, KEPT_BYTES))
        self._brain = brain

    def put(self, raw: Raw) -> None:
        """Hand over a sample; called by the transport."""
        row, raw.came_ns = find(self._brain, raw.key), time.time_ns()
        path = row.path if row is not None else TAPPED
        size = size_of(raw)
        if row is not None and size > row.most_bytes:
            self._refusals.add(path, f"sample of {size} bytes; at most {row.most_bytes} are read")
            return
        for dropped in self.waiting.put(raw, size, path):
            self._refusals.drop(dropped, "too many messages wait; oldest dropped")
        self._wake.set()

    def take(self) -> Raw | None:
        """Return the next sample, or None."""
        taken = self.waiting.take()
        self.taken += len(taken)
        return taken[0] if taken else None


def pack(row: Key, message: Message) -> bytes:
    """Return the payload of a message on a key; BusError when nobody would read so much."""
    payload = codec.encode(message)
    if len(payload) > row.most_bytes - MARGIN_BYTES:
        raise BusError(f"{row.path}: {len(payload)} bytes; readers take {row.most_bytes - MARGIN_BYTES} at most")
    return payload


def read(row: Key, brain: str, raw: Raw) -> Message:
    """Decode a sample of its key's row; DecodeError when it is not the row's message or not its writer's.

    A message that names its teacher or model must lie on the key of that teacher or model. Whoever reads the same
    sample next gets the same message; what was refused is refused anew.
    """
    if raw.message is None:
        if row.message is not None and (size := size_of(raw)) > row.most_bytes:
            raise DecodeError(f"sample of {size} bytes; at most {row.most_bytes} are read")
        raw.message = read_as(codec.decode, row, brain, raw)
    return raw.message


def read_as(decode: Callable[[type[Message], bytes, str], Message], row: Key, brain: str, raw: Raw) -> Message:
    """Do as `read` with a sample of any size, in the form that `decode` reads."""
    if row.message is None:
        raise DecodeError(f"key {row.path} carries no payload")
    parameters = row.match(brain, raw.key)
    if parameters is None:
        raise DecodeError(f"sample on {raw.key!r}; expected a concrete key of {row.path!r}")
    message = decode(row.message, raw.payload, raw.encoding)
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
        self._readers: list[Reader] = []

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
    def token(self, role: str, instance: str) -> Callable[[], None]:
        """Declare this service alive, and so ready; until `close`, or what is returned is called."""

    @abstractmethod
    def claim(self, role: str, instance: str, holder: str) -> Callable[[], None]:
        """Say that `holder` is, or wants to be, this service; until `close`, or what is returned is called."""

    @abstractmethod
    def holders(self, role: str, instance: str) -> frozenset[str]:
        """Ask anew who claims to be this service; every claim made before this call is among them."""

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

    def taken(self) -> int:
        """Return how many messages were taken so far."""
        return sum(reader.taken for reader in self._readers)

    def queued(self) -> int:
        """Return how many messages wait to be taken."""
        return sum(len(reader.waiting) for reader in self._readers)

    def _new_inbox(self, row: Key) -> Inbox:
        inbox = Inbox(row, self.brain, self.refusals, self._wake)
        self._readers.append(inbox)
        return inbox

    def _new_tap(self) -> Tap:
        tap = Tap(self.brain, self.refusals, self._wake)
        self._readers.append(tap)
        return tap

    def serve(self) -> None:  # noqa: B027 - a transport that answers at once has nothing to do here
        """Answer the queries that have come; called by the service's own loop."""

    def wait(self, timeout_s: float) -> bool:
        """Wait until something came since the last `wait`, or the bound; return whether it did."""
        return self._wake.wait(timeout_s)

    def check_heard(self) -> None:  # noqa: B027 - only where there is a router can it fail
        """Raise UnheardError when the router gives us nothing any more; to be called now and then."""

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
