"""What comes on a key, in each publisher's order, with what was missed; keeps no more than so much of anything.

Zenoh's own recovery keeps what comes behind a gap for as long as somebody does not answer, so whoever may write a key
could fill its readers' memory. So keys that guests write, and a tap, are read by plain subscribers and by this. It
understands Zenoh's advanced publishers: each sample has its source and number, a heartbeat on `KEY/@adv/pub/...` says
the number of the last one, and a query there gives what the publisher still has. Owns the counting; sends nothing.
"""

from __future__ import annotations

import re
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

from mdb_protocol.waiting import Raw, size_of

ASKED_AT_ONCE = 256
"""Samples of one publisher that are asked for together; of a longer gap only the newest are."""
ASKED_EVERY_S = 0.5
"""A publisher is asked again no sooner, whatever he says he has."""
ANSWERED_S = 1.0
"""Who has not answered by then is taken to have nothing: what waits behind the gap goes on."""
RECOVERY_S = 0.05
"""How often is looked for what can be asked again, while something is missing."""
ALL_PAST = 2**14
"""Samples taken of all publishers together when a subscription begins."""
NUMBER_BYTES = 4
"""What a heartbeat is: the number of the last sample."""
HELD = 256
"""Samples of one publisher that wait behind a gap."""
HELD_BYTES = 2**23
"""Bytes of all samples that wait behind gaps; with more, the one that comes goes on without what is missing."""
KEYS = 1024
"""Keys whose publishers are known; the one that was quiet for longest is forgotten."""
SOURCES = 4
"""Publishers known of one key, whose only writer comes back now and then as another."""
HEARTBEAT = re.compile(r"(?P<key>.+)/@adv/pub/(?P<zid>[0-9a-f]{1,32})/(?P<eid>[0-9]{1,10})/.+")


class Origin(NamedTuple):
    """Which sample of which publisher: the ids of its session and of itself, and the sample's number."""

    zid: str
    eid: int
    number: int


class Manner(NamedTuple):
    """How a key is read: how many of the last samples of a new publisher; whether what is missed is waited for."""

    history: int
    whole: bool


class Wanted(NamedTuple):
    """What is to be asked, how many samples are expected, and what to call when all have come or their time is up."""

    selector: str
    most: int
    done: Callable[[], None]


@dataclass
class _Source:
    due: int
    """The number of the next sample to hand over."""
    last: int = -1
    """The highest number known of."""
    held: dict[int, Raw] = field(default_factory=dict)
    asked: bool = False
    asked_s: float = float("-inf")


class Follower:
    """See the module's docstring; called from any thread."""

    def __init__(
        self,
        put: Callable[[Raw], None],
        manner: Callable[[str], Manner],
        wake: Callable[[], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`manner` of a full key; `wake` is called when something is wanted."""
        self._put, self._manner, self._wake, self._clock = put, manner, wake, clock
        self._keys: OrderedDict[str, OrderedDict[tuple[str, int], _Source]] = OrderedDict()
        self._gaps: dict[tuple[str, str, int], _Source] = {}
        self._held_bytes = 0
        self._lock = threading.Lock()

    def hear(self, raw: Raw, origin: Origin | None, *, past: bool = False) -> None:
        """Hand over a sample, now or when those before it have come; a second time never.

        `past`: it was asked for, and so is the oldest that a publisher not met yet has.
        """
        if origin is None:
            self._put(raw)
            return
        with self._lock:
            manner = self._manner(raw.key)
            source = self._source(
                raw.key, origin, origin.number if past else origin.number + 1 - max(manner.history, 1)
            )
            source.last = max(source.last, origin.number)
            if origin.number == source.due and not source.held:  # as nearly all do
                source.due += 1
                self._put(raw)
                return
            if origin.number < source.due or origin.number in source.held:
                return
            if not manner.whole:
                source.due = origin.number
            source.held[origin.number] = raw
            self._held_bytes += size_of(raw)
            self._go_on(source)
            if len(source.held) > HELD or self._held_bytes > HELD_BYTES:
                self._skip_to(source, max(source.held, default=-1) + 1)
            if source.held:
                self._want(raw.key, origin, source)

    def heartbeat(self, key: str, number: int) -> None:
        """Learn what the last sample of a publisher is; `key` is the heartbeat's."""
        found = HEARTBEAT.fullmatch(key)
        if found is None:
            return
        origin, manner = Origin(found["zid"], int(found["eid"]), number), self._manner(found["key"])
        with self._lock:
            source = self._source(found["key"], origin, number + 1 - manner.history)
            source.last = max(source.last, number)
            if manner.whole and source.last >= source.due:
                self._want(found["key"], origin, source)

    def wanted(self) -> list[Wanted]:
        """Return what is to be asked now, once; empty also while answers may come yet."""
        with self._lock:
            self._gaps = {at: source for at, source in self._gaps.items() if source.last >= source.due}
            return [self._ask(at, source) for at, source in self._gaps.items() if self._may_ask(source)]

    def missing(self) -> bool:
        """Whether something is to be asked, now or later."""
        return bool(self._gaps)

    def _may_ask(self, source: _Source) -> bool:
        return not source.asked and self._clock() - source.asked_s >= ASKED_EVERY_S

    def _ask(self, at: tuple[str, str, int], source: _Source) -> Wanted:
        source.asked, source.asked_s = True, self._clock()
        self._skip_to(source, source.last + 1 - ASKED_AT_ONCE)
        (key, zid, eid), first, last = at, source.due, source.last
        selector = f"{key}/@adv/pub/{zid}/{eid}/_?_sn={first}..{last}"
        return Wanted(selector, last + 1 - first, partial(self._answered, source, last))

    def _answered(self, source: _Source, last: int) -> None:
        """What is still missing up to the one that was asked for last will not come."""
        with self._lock:
            source.asked = False
            self._skip_to(source, last + 1)
        self._wake()

    def _source(self, key: str, origin: Origin, due: int) -> _Source:
        """Return a publisher; of one not met yet the sample `due` is the first to hand over."""
        sources = self._keys.setdefault(key, OrderedDict())
        self._keys.move_to_end(key)
        name = origin.zid, origin.eid
        source = sources.setdefault(name, _Source(due=max(due, 0)))
        sources.move_to_end(name)
        if len(sources) > SOURCES:
            self._forget(key, *sources.popitem(last=False))
        if len(self._keys) > KEYS:
            gone, forgotten = self._keys.popitem(last=False)
            for other, known in forgotten.items():
                self._forget(gone, other, known)
        return source

    def _forget(self, key: str, name: tuple[str, int], source: _Source) -> None:
        self._skip_to(source, max(source.held, default=-1) + 1)
        self._gaps.pop((key, *name), None)

    def _want(self, key: str, origin: Origin, source: _Source) -> None:
        self._gaps[key, origin.zid, origin.eid] = source
        self._wake()

    def _go_on(self, source: _Source) -> None:
        """Hand over what has no gap before it."""
        while (raw := source.held.pop(source.due, None)) is not None:
            self._held_bytes -= size_of(raw)
            source.due += 1
            self._put(raw)

    def _skip_to(self, source: _Source, number: int) -> None:
        """Hand over what is held below a number, then what follows without a gap."""
        for below in sorted(n for n in source.held if n < number):
            source.due = max(source.due, below)
            self._go_on(source)
        source.due = max(source.due, number)
        self._go_on(source)
