"""Floods by guests: a stranger's process that says as much as it can on the keys that its certificate allows.

`python -m tests.integration.floods ENDPOINT PEM KIND SECONDS` is that process; it prints how much it has said.
"""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import numpy as np
import zenoh

from mdb_protocol import codec, keys, messages
from mdb_protocol.bundle import Bundle
from mdb_protocol.keys import Key
from mdb_protocol.messages import Message
from mdb_protocol.roles import Role, User
from mdb_protocol.zenoh_sessions import open_client

BLOCK = zenoh.CongestionControl.BLOCK
FAR = 10**6
LARGE = bytes(30_000_000)
WAITING = 1000
"""Queries of one who asks for all that wait for an answer at the same time."""

Say = Callable[[], object]


def own(user: User) -> tuple[Key, str, Message]:
    """Return a row that a user writes, his key of it, and a message for it."""
    if user.role is Role.TEACHER:
        command = messages.Command(teacher=user.name, iteration=FAR, note=0)
        return keys.COMMAND, keys.COMMAND.at(user.brain, teacher=user.name), command
    if user.role is Role.OPERATOR:
        return keys.CONTROL, keys.CONTROL.at(user.brain), messages.Control(iteration=0)
    status = messages.Status(role=user.role.value, instance=user.name, pid=1, uptime_s=1.0, values={}, refused={})
    return keys.STATUS, keys.STATUS.at(user.brain, role=user.role.value, instance=user.name), status


@contextmanager
def notes(session: zenoh.Session, user: User) -> Iterator[Say]:
    """Small messages that can be read."""
    _, key, message = own(user)
    publisher = session.declare_publisher(key, encoding=codec.encoding_of(type(message)), congestion_control=BLOCK)
    payload = codec.encode(message)
    yield lambda: publisher.put(payload)


@contextmanager
def sound(session: zenoh.Session, user: User) -> Iterator[Say]:
    """The largest frames of sound that can be read."""
    frame = messages.AudioFrame(teacher=user.name, iteration=0, rate_hz=48_000, samples=np.zeros(40_000, np.int16))
    key, payload = keys.AUDIO.at(user.brain, teacher=user.name), codec.encode(frame)
    publisher = session.declare_publisher(key, encoding=codec.encoding_of(type(frame)), congestion_control=BLOCK)
    yield lambda: publisher.put(payload)


@contextmanager
def large(session: zenoh.Session, user: User) -> Iterator[Say]:
    """Payloads that are far beyond what the key takes."""
    _, key, message = own(user)
    publisher = session.declare_publisher(key, encoding=codec.encoding_of(type(message)), congestion_control=BLOCK)
    yield lambda: publisher.put(LARGE)


@contextmanager
def silence(session: zenoh.Session, key: str) -> Iterator[Callable[[], str]]:
    """A queryable on what recovers a key's samples that never answers; yields publishers' keys that do not exist."""
    held: list[zenoh.Query] = []
    silent = session.declare_queryable(f"{key}/@adv/**", zenoh.handlers.Callback(held.append, indirect=False))
    zid, number = session.info.zid(), count(1)
    yield lambda: f"{key}/@adv/pub/{zid}/{next(number) % 2**16 + 10}/_"
    silent.undeclare()


@contextmanager
def gaps(session: zenoh.Session, user: User) -> Iterator[Say]:
    """Samples with gaps in their source's sequence, and a queryable on what recovers them that never answers."""
    row, key, message = own(user)
    publisher = session.declare_publisher(key, encoding=codec.encoding_of(type(message)), congestion_control=BLOCK)
    payload, number = codec.encode(message).ljust(row.most_bytes - 2000, b"\x00"), count(0, 2)
    with silence(session, key):
        yield lambda: publisher.put(payload, source_info=zenoh.SourceInfo(publisher.id, next(number)))


@contextmanager
def heartbeats(session: zenoh.Session, user: User) -> Iterator[Say]:
    """Heartbeats of publishers that do not exist, each ahead of what was said."""
    _, key, _ = own(user)
    with silence(session, key) as publisher:
        yield lambda: session.put(
            publisher(), zenoh.ext.z_serialize(zenoh.ext.UInt32(random.randrange(2**31))), congestion_control=BLOCK
        )


@contextmanager
def tokens(session: zenoh.Session, user: User) -> Iterator[Say]:
    """Publishers that come and go, whose past nobody gives."""
    _, key, _ = own(user)
    with silence(session, key) as publisher:
        yield lambda: session.liveliness().declare_token(publisher()).undeclare()


@contextmanager
def questions(session: zenoh.Session, user: User) -> Iterator[Say]:
    """Questions to all services, asked faster than they are answered."""
    key = keys.STATUS.at(user.brain)
    asked = [0]

    def say() -> None:
        while asked[0] > WAITING:
            time.sleep(0.001)
        asked[0] += 1

        def answered() -> None:
            asked[0] -= 1

        handler = zenoh.handlers.Callback(lambda _: None, answered, indirect=False)
        session.get(key, handler, timeout=2.0, target=zenoh.QueryTarget.ALL)

    yield say


@contextmanager
def nothing(_session: zenoh.Session, _user: User) -> Iterator[Say]:
    """No traffic at all, but as busy: what a flood takes of the processor by itself."""
    yield lambda: sum(range(1000))


KINDS = {of.__name__: of for of in (notes, sound, large, gaps, heartbeats, tokens, questions, nothing)}


def main(endpoint: str, pem: str, kind: str, seconds: str) -> None:
    """Flood for so long; a router that closes the link is joined again."""
    bundle = Bundle.read(Path(pem))
    assert bundle.user is not None
    ends, sent, links = time.monotonic() + float(seconds), 0, 0
    while time.monotonic() < ends:
        links += 1
        with open_client(endpoint, bundle, 10.0) as session, KINDS[kind](session, bundle.user) as say:
            while time.monotonic() < ends:
                say()
                sent += 1
    sys.stdout.write(f"{sent}\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
