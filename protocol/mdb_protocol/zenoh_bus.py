"""The bus over Eclipse Zenoh. All that a brain says goes through it, and through a router (`zenoh_sessions`).

Callbacks run on Zenoh's threads and only hand raw samples to an inbox; queries are answered by the service's own
thread in `serve`. Reliable and latched keys use Zenoh's advanced publishers (a cache that late joiners and recovery
read); latest-value keys drop under congestion unless the bus is `lossless`. What the brain itself writes is read by
Zenoh's advanced subscribers; what guests write, and a tap, by a `Follower`, whose memory is bounded.

Zenoh's recovery cannot tell who missed samples from who came late: from a reliable publisher who said nothing new
before his next heartbeat, a late joiner gets all of the cache. So a reader must expect older messages at first.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import count
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import zenoh
from zenoh import ext
from zenoh.handlers import Callback

from mdb_protocol import codec, endpoints, following, keys
from mdb_protocol.bundle import Bundle
from mdb_protocol.bus import Bus, Inbox, Publisher, Tap, pack, read
from mdb_protocol.errors import BusError, DecodeError, QueryError, UnheardError
from mdb_protocol.following import Follower, Manner, Origin, Wanted
from mdb_protocol.keys import ALIVE, CLAIM, ROOT, Delivery, Key
from mdb_protocol.messages import Message
from mdb_protocol.probing import EVERY_S, Probe
from mdb_protocol.waiting import Raw
from mdb_protocol.zenoh_sessions import Router, ask_router, leave, open_client, stay_known

__all__ = ["Router", "ZenohBus"]

RELIABLE_CACHE = 256
"""Samples a reliable publisher keeps for readers that missed some."""
HEARTBEAT_S = 0.25
"""How often a reliable publisher says how far it is, so that a lost last sample is noticed; always, not only when it
has sent something since: said while the router is dead, nobody would hear it."""
ASKED_KEPT = 1024
"""Queries on one row that wait to be answered; who asks then gets no answer."""
SERVED_AT_ONCE, SERVED_EVERY_S = 16, 0.1
"""Queries on one row answered before the service does its own work again, and how soon more than these: who asks
without end waits. Told at once that there is no answer, he would ask again."""
TOKENS_S = 2.0


class ZenohBus(Bus):
    """A service's access to the keys of one brain through a Zenoh router."""

    def __init__(
        self,
        brain: str,
        connect: str = endpoints.USUAL,
        *,
        credentials: Path | None = None,
        connect_timeout_s: float = 5.0,
        give_up: Callable[[], bool] = lambda: False,
        lossless: bool = False,
    ) -> None:
        """Join the router at `connect`; BusError when none answers within the bound, or it refuses.

        `credentials` is a bundle of `mdb keys`, or a key folder, of which the brain's own is taken: what a router
        at `tls/...` or `quic/...` wants to see. When `give_up` gives true, the bound is over. `lossless` makes
        latest-value publishers wait instead of dropping (lockstep runs).
        """
        endpoints.check(connect)
        super().__init__(brain)
        self._lossless = lossless
        self._connect = connect
        self._bundle = Bundle.shown_to(connect, credentials, brain)
        self._session = open_client(connect, self._bundle, connect_timeout_s, give_up)
        self._declared: list[Any] = []
        self._asked: dict[Key, SimpleQueue[tuple[Callable[[], Message | None], zenoh.Query]]] = {}
        self._serves_again_s = 0.0
        self._probe = Probe()
        self._alive: set[str] | None = None
        self._gone: set[str] = set()
        self._alive_lock = threading.Lock()
        self._followers: list[Follower] = []
        self._missed, self._closing = threading.Event(), threading.Event()
        self._recovery = threading.Thread(target=self._recover, name="recovery", daemon=True)
        self._recovery.start()

    def publisher(self, row: Key, **parameters: str) -> Publisher:
        """See `Bus.publisher`."""
        key = row.at(self.brain, **parameters)
        if row.message is None or "*" in key:
            raise BusError(f"cannot publish on {key}: it is not a concrete key with a payload")
        self._check_writes(row, key)
        drops = row.delivery is Delivery.LATEST and not self._lossless
        publisher = ext.declare_advanced_publisher(
            self._session,
            key,
            encoding=codec.encoding_of(row.message),
            congestion_control=zenoh.CongestionControl.DROP if drops else zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.DATA_HIGH,  # `zenoh_sessions.CONTROL`
            cache=ext.CacheConfig(1 if row.delivery is Delivery.LATEST else RELIABLE_CACHE),
            sample_miss_detection=_heartbeat(row),
            publisher_detection=not row.guests_write,  # of guests it is heard by their heartbeats
        )
        self._declared.append(publisher)
        return _Publisher(row, publisher)

    def subscriber(self, row: Key, **parameters: str) -> Inbox:
        """See `Bus.subscriber`."""
        inbox, key = self._new_inbox(row), row.at(self.brain, **parameters)
        history = row.history if row.delivery in (Delivery.LATEST, Delivery.LATCHED) else 0
        if row.guests_write:
            self._follow(key, inbox.put, lambda _: Manner(history, whole=True), history)
        else:
            self._subscribe(key, inbox.put, history)
        return inbox

    def tap(self) -> Tap:
        """See `Bus.tap`."""
        tap = self._new_tap()
        self._follow(f"{ROOT}/{self.brain}/**", tap.put, partial(_tapped, self.brain), RELIABLE_CACHE)
        return tap

    def _subscribe(self, key: str, put: Callable[[Raw], None], history: int) -> None:
        """Hand samples to `put`, and at first the last `history` ones that each publisher has."""
        refusals = self.refusals

        def hand_over(sample: zenoh.Sample) -> None:
            stay_known()
            refusals.pause()
            if sample.kind == zenoh.SampleKind.PUT:
                put(_raw(sample))

        subscriber = ext.declare_advanced_subscriber(
            self._session,
            key,
            Callback(hand_over, indirect=False),
            history=ext.HistoryConfig(detect_late_publishers=True, max_samples=history) if history else None,
            recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        )
        self._declared.append(subscriber)

    def _follow(self, key: str, put: Callable[[Raw], None], manner: Callable[[str], Manner], history: int) -> None:
        """Do as `_subscribe`, keeping no more than a follower does, whoever writes.

        What callbacks hold must not lead back to this bus: the last one to let go of it would be a thread of Zenoh's,
        in which a session can never be closed.
        """
        follower, refusals = Follower(put, manner, self._missed.set), self.refusals

        def hand_over(sample: zenoh.Sample) -> None:
            stay_known()
            refusals.pause()
            if sample.kind == zenoh.SampleKind.PUT:
                follower.hear(_raw(sample), _origin(sample))

        def heartbeat(sample: zenoh.Sample) -> None:
            if len(number := sample.payload.to_bytes()) == following.NUMBER_BYTES:
                follower.heartbeat(str(sample.key_expr), int.from_bytes(number, "little"))

        for expression, callback in ((key, hand_over), (f"{key}/@adv/pub/**", heartbeat)):
            self._declared.append(self._session.declare_subscriber(expression, Callback(callback, indirect=False)))
        self._followers.append(follower)
        if history:
            self._ask_past(follower, Wanted(f"{key}/@adv/**?_max={history}", following.ALL_PAST, lambda: None))

    def _recover(self) -> None:
        """Ask for what followers miss, and whether the router gives us anything; in a thread, for asking may wait."""
        while not self._closing.is_set():
            self._missed.wait(
                following.RECOVERY_S if any(follower.missing() for follower in self._followers) else EVERY_S
            )
            self._missed.clear()
            if self._probe.is_due():
                if self.connected():
                    ask_router(self._session, f"{ROOT}/{self.brain}/nobody", self._probe)
                else:
                    self._probe.rest()
            for follower in list(self._followers):
                for wanted in follower.wanted():
                    self._ask_past(follower, wanted)

    def _ask_past(self, follower: Follower, wanted: Wanted) -> None:
        came = count()

        def hear(reply: zenoh.Reply) -> None:
            if (sample := reply.ok) is not None and next(came) < wanted.most:
                follower.hear(_raw(sample), _origin(sample), past=True)

        try:
            self._session.get(
                wanted.selector,
                Callback(hear, wanted.done, indirect=False),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                accept_replies=zenoh.ReplyKeyExpr.ANY,
                timeout=following.ANSWERED_S,
            )
        except zenoh.ZError:
            wanted.done()

    def queryable(self, row: Key, handler: Callable[[], Message | None], **parameters: str) -> None:
        """See `Bus.queryable`; the handler runs in `serve`, on the service's own thread."""

        asked = self._asked.setdefault(row, SimpleQueue())

        def hand_over(query: zenoh.Query) -> None:
            if asked.qsize() >= ASKED_KEPT:
                self.refusals.drop(row.path, f"{ASKED_KEPT} queries wait; one more is not answered")
                query.drop()  # type: ignore[no-untyped-call]
                return
            asked.put((handler, query))
            self._wake.set()

        key = row.at(self.brain, **parameters)
        queryable = self._session.declare_queryable(key, Callback(hand_over, indirect=False), complete=True)
        self._declared.append(queryable)

    def serve(self) -> None:
        """See `Bus.serve`."""
        if (now_s := time.monotonic()) < self._serves_again_s:
            return
        for row, asked in self._asked.items():
            if asked.qsize() > SERVED_AT_ONCE:
                self._serves_again_s = now_s + SERVED_EVERY_S
            for _ in range(min(asked.qsize(), SERVED_AT_ONCE)):
                self._answer(row, *asked.get_nowait())

    def _answer(self, row: Key, handler: Callable[[], Message | None], query: zenoh.Query) -> None:
        with query, suppress(zenoh.ZError):
            try:
                reply = handler()
            except Exception as error:
                query.reply_err(f"{type(error).__name__}: {error}".encode())
                return
            if reply is not None:
                encoding = codec.encoding_of(type(reply))
                query.reply(self._reply_key(row, query.key_expr, reply), codec.encode(reply), encoding=encoding)

    def _reply_key(self, row: Key, asked: zenoh.KeyExpr, reply: Message) -> str:
        if "*" not in str(asked):
            return str(asked)
        return row.at(self.brain, **{name: str(getattr(reply, name)) for name in row.parameters})

    def query(self, row: Key, timeout_s: float, **parameters: str) -> list[Any]:
        """See `Bus.query`."""
        key = row.at(self.brain, **parameters)
        answers = []
        for reply in self._session.get(
            key,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
        ):
            if reply.ok is None:
                said = reply.err.payload.to_bytes().decode(errors="replace") if reply.err else "nothing"
                raise QueryError(f"{key}: answered with an error within {timeout_s} s: {said}")
            sample = reply.ok
            try:
                raw = Raw(str(sample.key_expr), sample.payload.to_bytes(), str(sample.encoding))
                answers.append(read(row, self.brain, raw))
            except DecodeError as error:
                self.refusals.add(row.path, str(error))
        return answers

    def put(self, raw: Raw) -> None:
        """Put bytes as they are: for trials of what readers refuse."""
        block = zenoh.CongestionControl.BLOCK
        control = zenoh.Priority.DATA_HIGH  # in order with what publishers say
        self._session.put(raw.key, raw.payload, encoding=raw.encoding, congestion_control=block, priority=control)

    def connected(self) -> bool:
        """Whether there is a router at the other end now; a session that has lost it comes back by itself."""
        return bool(self._session.info.routers_zid())

    def check_heard(self) -> None:
        """See `Bus.check_heard`."""
        if self._probe.unheard:
            raise UnheardError(f"the router at {self._connect} is there and does not answer any more")

    def token(self, role: str, instance: str) -> Callable[[], None]:
        """See `Bus.token`."""
        return self._say_alive(ALIVE, ALIVE.at(self.brain, role=role, instance=instance))

    def claim(self, role: str, instance: str, holder: str) -> Callable[[], None]:
        """See `Bus.claim`."""
        return self._say_alive(CLAIM, CLAIM.at(self.brain, role=role, instance=instance, holder=holder))

    def _say_alive(self, row: Key, key: str) -> Callable[[], None]:
        """Declare a token; return what withdraws it."""
        self._check_writes(row, key)
        token = self._session.liveliness().declare_token(key)
        self._declared.append(token)

        def withdraw() -> None:
            if token in self._declared:
                self._declared.remove(token)
                token.undeclare()  # type: ignore[no-untyped-call]

        return withdraw

    def holders(self, role: str, instance: str) -> frozenset[str]:
        """See `Bus.holders`."""
        found = self._tokens(CLAIM.at(self.brain, role=role, instance=instance))
        return frozenset(claim["holder"] for key in found if (claim := CLAIM.match(self.brain, key)))

    def _tokens(self, pattern: str) -> list[str]:
        """Ask the router for tokens; before it answers it has taken in what we and others have declared."""
        replies = self._session.liveliness().get(pattern, timeout=TOKENS_S)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    def _check_writes(self, row: Key, key: str) -> None:
        if self._bundle is not None and self._bundle.user is not None:
            self._bundle.user.check_writes(row, key)

    def admitted(self, role: str, instance: str, timeout_s: float) -> bool:
        """See `Bus.admitted`; asks through a session of its own, for this one sees its token even when denied."""
        deadline = time.monotonic() + timeout_s
        key = ALIVE.at(self.brain, role=role, instance=instance)
        with open_client(self._connect, self._bundle, timeout_s) as other:
            while not any(reply.ok for reply in other.liveliness().get(key, timeout=timeout_s)):
                if time.monotonic() >= deadline:
                    return False
                time.sleep(0.05)
        return True

    def brains(self) -> list[str]:
        """Return the names of all brains of which anybody is alive at this router; with keys only one's own."""
        return keys.brains_of(self._tokens(keys.ALIVE_ANYWHERE))

    def alive(self) -> frozenset[str]:
        """See `Bus.alive`; the first call asks and from then on follows the changes."""
        if self._alive is None:
            self._alive = set()
            key = ALIVE.at(self.brain)
            on_token = Callback(self._on_token, indirect=False)
            self._declared.append(self._session.liveliness().declare_subscriber(key, on_token, history=True))
            found = {name for token in self._tokens(key) if (name := self._alive_name(token)) is not None}
            with self._alive_lock:  # of who was heard to be gone meanwhile the answer may be older
                self._alive |= found - self._gone
        with self._alive_lock:
            return frozenset(self._alive)

    def _on_token(self, sample: zenoh.Sample) -> None:
        name = self._alive_name(str(sample.key_expr))
        if name is None or self._alive is None:
            return
        with self._alive_lock:
            here, away = self._alive, self._gone
            come, gone = (here, away) if sample.kind == zenoh.SampleKind.PUT else (away, here)
            come.add(name)
            gone.discard(name)
        self._wake.set()

    def close(self) -> None:
        """See `Bus.close`."""
        self._closing.set()
        self._missed.set()
        self._recovery.join(following.ANSWERED_S)
        self._followers.clear()
        leave(self._session, self._declared[::-1])
        self._declared.clear()


def _tapped(brain: str, key: str) -> Manner:
    """Return how a tap reads a key: of a latest value what was missed is not missed."""
    row = keys.find(brain, key)
    return Manner(RELIABLE_CACHE, whole=row is not None and row.delivery is not Delivery.LATEST)


def _raw(sample: zenoh.Sample) -> Raw:
    return Raw(str(sample.key_expr), sample.payload.to_bytes(), str(sample.encoding))


def _origin(sample: zenoh.Sample) -> Origin | None:
    """Return which sample it is; None of a plain publisher's, which are not numbered."""
    info = sample.source_info
    return None if info is None else Origin(str(info.source_id.zid), info.source_id.eid, info.source_sn)


def _heartbeat(row: Key) -> ext.MissDetectionConfig:
    """Return how readers notice that they miss the last sample; of a latest value the next one is as good."""
    if row.delivery is Delivery.LATEST:
        return ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=HEARTBEAT_S)
    return ext.MissDetectionConfig(heartbeat=HEARTBEAT_S, sporadic_heartbeat=None)


class _Publisher:
    def __init__(self, row: Key, publisher: ext.AdvancedPublisher) -> None:
        self._row, self._publisher = row, publisher

    def put(self, message: Message) -> None:
        try:
            self._publisher.put(pack(self._row, message))
        except zenoh.ZError as error:
            raise BusError(f"cannot publish on {self._publisher.key_expr}: {error}") from error
