"""Junk for every key of a brain: what nobody should send, in all kinds, and how much of it cannot be read.

What could be read and is not refused by those who read it would be a message of a wrong writer, which is for access
control to keep out; so the messages that junk is made from are old ones, or of iterations that never were.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from typing import Any, NamedTuple

import msgpack
import numpy as np

from mdb_protocol import codec, keys, messages
from mdb_protocol.bus import TAPPED, read
from mdb_protocol.errors import DecodeError
from mdb_protocol.keys import Delivery, Key
from mdb_protocol.messages import Message
from mdb_protocol.waiting import Raw

NAMES = {"teacher": "anna", "model": "object", "role": "robot", "instance": "body", "holder": "somebody"}
FAR = 10**9
NONE, ONE = np.zeros(0, np.int64), np.zeros(1, np.int64)
ROW = np.zeros((1, 1), np.float32)
PLACE = {"x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0, "object_x_m": 1.0, "object_y_m": 0.0}
TURN = {"turn": -20.0}
"""The choice 1 of the paper's experiment."""
READING = {"distance": 1.0, "angle": 0.5}
DRAWING = messages.Drawing(
    shapes=[messages.Shape(kind="disc", points=[(0.0, 0.0)], radius=0.1)], box=(-1.0, -1.0, 1.0, 1.0)
)
SNAPSHOT = messages.MemorySnapshot(model="object", version=FAR, slots=ONE, pairs=ONE, inputs=ROW, targets=ROW)
MODEL = messages.CurrentModel(
    model="object", version=1, generation=1, layers=[1, 1], weights=np.zeros(2, np.float32), error=0.5
)
PAIR = messages.Pair(
    iteration=0, before=READING, note=1, action=TURN, choice=1, after=READING, feedback=1.0, versions={"object": 1}
)
GIVEN: tuple[Message, ...] = (
    messages.Perception(iteration=0, event="none", outcome=READING, reading=READING),
    messages.Action(iteration=0, action=TURN, choice=1, valid_for_s=1.0),
    messages.Scene(
        iteration=0, episode=0, successes=0, event="none", action=TURN, before=PLACE, reached=PLACE, now=PLACE
    ),
    messages.Picture(iteration=0, drawing=DRAWING, image=np.zeros((2, 2, 3), np.uint8)),
    messages.Command(teacher="anna", iteration=FAR, note=1),
    messages.Feedback(teacher="anna", iteration=FAR, value=0.5),
    messages.AudioFrame(teacher="anna", iteration=0, rate_hz=16_000, samples=np.zeros(100, np.int16)),
    messages.Phase(iteration=0, name="junk"),
    messages.Lesson(teacher="anna", iteration=0, commands=["junk"], notes=[0]),
    messages.Change(settings={"junk": 1.0}),
    messages.Control(iteration=0),
    PAIR,
    messages.PairStored(iteration=FAR, versions={"object": FAR}),
    messages.MemoryChange(
        model="object", version=1, slots=ONE, pairs=ONE, inputs=ROW, targets=ROW, freed=NONE, evicted=NONE
    ),
    SNAPSHOT,
    messages.ContextEvent(model="object", iteration=0, kind="known"),
    MODEL,
    messages.Checkpoint(model="object", version=FAR, generation=1, state={"a": ROW}, memory=SNAPSHOT),
    messages.Resume(model="object", checkpoint=None, changes=[], memory=SNAPSHOT),
    messages.Progress(
        iteration=0,
        versions={},
        unjudged=[PAIR],
        notes=ONE,
        choices=ONE,
        iterations=ONE,
        judged=[PAIR],
    ),
    messages.IterationReport(
        iteration=0, mode="junk", action=TURN, choice=1, explored=False, predicted=0.5, note=1, feedback=0.5,
        event="none", prequential={"junk": 0.5}, versions={},
    ),
    messages.Timing(iteration=0, perception_to_action_s=0.1, cycle_s=0.1),
    messages.Finished(iterations=1),
    messages.Status(role="robot", instance="body", pid=1, uptime_s=1.0, values={"a": 1.0}, refused={}),
)  # fmt: skip
OF = {type(message): message for message in GIVEN}

Kind = Callable[["Maker", Key], Raw]


class Maker:
    """Makes junk, the same for a seed; knows how much of each key cannot be read."""

    def __init__(self, brain: str, seed: int, *, heavy_every: int = 1) -> None:
        """`heavy_every`: of the kinds that are large, only each so-manieth turn has one."""
        self.brain = brain
        self._heavy_every = heavy_every
        self.unreadable: Counter[str] = Counter()
        self.rng = np.random.default_rng(seed)

    def stream(self) -> Iterator[Raw]:
        """Yield junk without end: each key in turn, and of each all kinds in turn."""
        for turn in count():
            kind = KINDS[turn % len(KINDS)]
            if kind in HEAVY and turn // len(KINDS) % self._heavy_every:
                continue
            for row in keys.KEYS:
                raw = kind(self, row)
                if self.is_harmless(row, raw):
                    yield raw

    def is_harmless(self, row: Key, raw: Raw) -> bool:
        """Count what cannot be read; of what can, leave out what only its own writer may say."""
        found = keys.find(self.brain, raw.key)
        if found is not None and len(raw.payload) > found.most_bytes:
            return True  # the router drops it
        try:
            if found is not None:
                read(found, self.brain, raw)
                return row not in (keys.FINISHED, keys.ALIVE, keys.CONTROL)
        except DecodeError:
            pass
        self.unreadable[found.path if found is not None else TAPPED] += 1
        return True

    def key(self, row: Key) -> str:
        return row.at(self.brain, **{name: NAMES[name] for name in row.parameters})

    def encoding(self, row: Key) -> str:
        return codec.encoding_of(row.message) if row.message is not None else "application/msgpack"

    def payload(self, row: Key) -> bytes:
        return codec.encode(OF[row.message]) if row.message is not None else b"\x80"

    def raw(self, row: Key, payload: bytes) -> Raw:
        return Raw(self.key(row), payload, self.encoding(row))

    def changed(self, row: Key, change: Callable[[str, Any], Any]) -> Raw:
        """A message of which `change` has made something else of a field."""
        plain = msgpack.unpackb(self.payload(row))
        fields = sorted(plain)
        field = fields[self.rng.integers(len(fields))] if fields else "nothing"
        return self.raw(row, msgpack.packb(plain | {field: change(field, plain.get(field))}))

    def one_of(self, *values: Any) -> Any:
        return values[self.rng.integers(len(values))]


def random_bytes(maker: Maker, row: Key) -> Raw:
    return maker.raw(row, maker.rng.bytes(int(maker.rng.integers(1, 300))))


def nothing(maker: Maker, row: Key) -> Raw:
    return maker.raw(row, b"")


def truncated(maker: Maker, row: Key) -> Raw:
    payload = maker.payload(row)
    return maker.raw(row, payload[: maker.rng.integers(len(payload))])


def too_long(maker: Maker, row: Key) -> Raw:
    return maker.raw(row, maker.payload(row) + maker.rng.bytes(3))


def flipped(maker: Maker, row: Key) -> Raw:
    payload = bytearray(maker.payload(row))
    payload[maker.rng.integers(len(payload))] ^= 1 << int(maker.rng.integers(8))
    return maker.raw(row, bytes(payload))


def another_version(maker: Maker, row: Key) -> Raw:
    other = maker.one_of("mdb=1", f"mdb={codec.VERSION + 1}", f"mdb={codec.VERSION}.")
    encoding = maker.encoding(row).replace(f"mdb={codec.VERSION}", other)
    return replace(maker.raw(row, maker.payload(row)), encoding=encoding)


def another_encoding(maker: Maker, row: Key) -> Raw:
    encoding = maker.one_of(
        "", "text/plain", f"application/msgpack;mdb={codec.VERSION};Stranger", "x" * 255
    )  # Zenoh sends no longer ones
    return replace(maker.raw(row, maker.payload(row)), encoding=encoding)


def another_type(maker: Maker, row: Key) -> Raw:
    value = maker.one_of(None, True, -1, "text", b"bytes", [1, [2]], {"a": {"b": 1}}, 2**64 - 1, 0.5)
    return maker.changed(row, lambda _, __: value)


def not_finite(maker: Maker, row: Key) -> Raw:
    bad = maker.one_of(math.nan, math.inf, -math.inf, 1e300)
    return maker.changed(row, lambda _, old: dict.fromkeys(old, bad) if isinstance(old, dict) else bad)


def out_of_range(maker: Maker, row: Key) -> Raw:
    return maker.changed(row, lambda _, __: maker.one_of(-1, 127, 1023, 1024, 2**31, 2**53, 2**53 + 1, -(2**63)))


def never_was(maker: Maker, row: Key) -> Raw:
    plain = msgpack.unpackb(maker.payload(row))
    for field in plain.keys() & {"iteration", "version", "generation"}:
        plain[field] = maker.one_of(FAR, 2**53, 2**40)
    return maker.raw(row, msgpack.packb(plain))


def old(maker: Maker, row: Key) -> Raw:
    plain = msgpack.unpackb(maker.payload(row))
    for field in plain.keys() & {"iteration", "version"}:
        plain[field] = int(maker.rng.integers(3))
    return maker.raw(row, msgpack.packb(plain))


def on_many_keys(maker: Maker, row: Key) -> Raw:
    key = maker.one_of(
        f"mdb/{maker.brain}/**", row.at(maker.brain), f"mdb/*/{row.path}".replace("{", "").replace("}", "")
    )
    return Raw(key, maker.payload(row), maker.encoding(row))


def on_no_key(maker: Maker, row: Key) -> Raw:
    return Raw(f"mdb/{maker.brain}/no/such/{maker.rng.integers(10**6)}", maker.payload(row), maker.encoding(row))


def in_anothers_name(maker: Maker, row: Key) -> Raw:
    return maker.changed(row, lambda field, value: "bert" if field in NAMES else value)


def deep(maker: Maker, row: Key) -> Raw:
    return maker.raw(row, maker.one_of(b"\x91" * 60_000, b"\xdc\x27\x10" * 20_000, b"\x81\xa1a" * 20_000))


def wide(maker: Maker, row: Key) -> Raw:
    return maker.raw(row, b"\xdc\x27\x10" + b"\x90" * 10_000 + maker.payload(row))


def larger_than_its_key(maker: Maker, row: Key) -> Raw:
    return maker.raw(row, bytes(min(row.most_bytes, 2**18 + 1)))  # with its key it is; more the router drops


KINDS: tuple[Kind, ...] = (
    random_bytes, nothing, truncated, too_long, flipped, another_version, another_encoding, another_type, not_finite,
    out_of_range, never_was, old, on_many_keys, on_no_key, in_anothers_name, deep, wide, random_bytes, flipped,
    another_type, larger_than_its_key,
)  # fmt: skip


HEAVY = (deep, wide, larger_than_its_key)


class Reads(NamedTuple):
    """Who in a brain reads a key one message after the other, so that he counts what he refuses."""

    role: str
    instance: str
    row: Key


READERS = (
    *(Reads("optimizer", "action", row) for row in (keys.COMMAND, keys.HEARD, keys.FEEDBACK, keys.PAIR_STORED)),
    Reads("optimizer", "action", keys.CURRENT_MODEL),
    Reads("memory", "store", keys.PAIR),
    Reads("memory", "store", keys.CURRENT_MODEL),
    Reads("evolver", "object", keys.MEMORY_CHANGE),
    Reads("robot", "body", keys.CONTROL),
    Reads("teacher", "script", keys.CONTROL),
)
LATEST_READERS = (
    Reads("robot", "body", keys.ACTION),
    Reads("optimizer", "action", keys.PERCEPTION),
    Reads("teacher", "script", keys.SCENE),
    Reads("memory", "store", keys.CHECKPOINT),
)
assert all(reads.row.delivery is Delivery.LATEST for reads in LATEST_READERS)
