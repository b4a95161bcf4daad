"""Where each message of a run log lies, by what it is and its iteration: read once, then only what is asked for.

Owns the index. Of messages that came twice the first counts. Bounded: iterations beyond `MOST_ITERATIONS`, and what
is packed beyond `MOST_KEPT` bytes, are left out, and `shortened` says so.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO, NamedTuple

import msgspec
from mcap.opcode import Opcode
from mcap.well_known import MessageEncoding

from mdb_protocol import as_json, codec, files, keys
from mdb_protocol import messages as m
from mdb_protocol.bus import read_as
from mdb_protocol.errors import DecodeError, MdbError
from mdb_protocol.keys import Key
from mdb_protocol.waiting import Raw
from mdb_services import log_records
from mdb_services.recorder import LOG_PATTERN, STRANGE, segments_of

MOST_ITERATIONS = 30_000
"""Iterations that are looked at, the first."""
MOST_KEPT = 2**28
"""Bytes of messages in packed logs, which cannot be read again one by one."""
HEAD = struct.Struct("<BQ")
"""Of a record: what it is, and its length."""
BEFORE = 22
"""Bytes of a message's record before its content: channel, number, two times."""

ITERATED = (m.Action, m.Perception, m.Scene, m.IterationReport, m.Timing)
"""Of these the first of each iteration is found again."""


class Place(NamedTuple):
    """Where a message lies: in which channel, and its bytes, or where they are in a segment."""

    channel: int
    segment: int
    start: int
    length: int
    data: bytes | None = None


class _Head(msgspec.Struct):
    """What the index needs of a message."""

    iteration: int = 0
    version: int = 0
    feedback: float | None = None


class Channel(NamedTuple):
    """What all messages of a channel have in common."""

    row: Key
    key: str
    json: bool
    encoding: str


class LogIndex:
    """See the module's docstring. Reads the log's files as long as it is open."""

    def __init__(self, run: Path, brain: str, on_whole: Callable[[m.Message, Place | None, int], None]) -> None:
        """Read all segments once. MdbError says what is missing, or that nothing can be read.

        on_whole: takes each message that is wanted whole, in order, with its place and the newest iteration before
        it: phases, lessons, changes of context and of memories, what an operator said, the end.
        """
        segments = segments_of(run)
        if not segments:
            raise MdbError(f"no run log ({LOG_PATTERN}) in {run}; give the folder of a run")
        self._brain, self._on_whole = brain, on_whole
        self._opened = ExitStack()
        self._files: list[BinaryIO] = []
        self._channels: list[Channel] = []
        self._numbers: dict[tuple[str, str, str], int | None] = {}
        self._places: dict[type, dict[int, Place]] = {kind: {} for kind in ITERATED}
        self._models: dict[str, dict[int, Place]] = {}
        self.judged: dict[int, Place] = {}
        """The first pair with feedback of each iteration."""
        self.newest = 0
        """The newest iteration so far."""
        self.shortened = ""
        """What was left out, in words."""
        self._kept = self._count = 0
        reason = ""
        try:
            for path in segments:
                reason = self._index(path) or reason
        except BaseException:
            self.close()
            raise
        if not self._count:
            self.close()
            why = reason or "it is empty, or another's"
            raise MdbError(f"no message of brain {brain} can be read of the run log in {run}: {why}")
        self.damage = reason
        """Why a segment ends early, "" when none does."""

    def close(self) -> None:
        """Close the files."""
        self._opened.close()

    def iterations(self, kind: type[m.Message]) -> list[int]:
        """Return the iterations of which there is a message of a kind, in order."""
        return sorted(self._places[kind])

    def get(self, kind: type[m.Message], iteration: int) -> m.Message | None:
        """Return the message of a kind and iteration; None: there is none, or it is damaged."""
        return self.read(self._places[kind].get(iteration))

    def model(self, name: str, version: int) -> m.CurrentModel | None:
        """Return a current model; None: that version is not in the log, or it is damaged."""
        found = self.read(self._models.get(name, {}).get(version))
        return found if isinstance(found, m.CurrentModel) else None

    def newest_model(self, name: str) -> int:
        """Return the newest version of a model; 0: there is none."""
        return max(self._models.get(name, {}), default=0)

    def pair(self, iteration: int) -> m.Pair | None:
        """Return the pair of an iteration that has feedback."""
        found = self.read(self.judged.get(iteration))
        return found if isinstance(found, m.Pair) else None

    # ---- reading once ----

    def _index(self, path: Path) -> str:
        """Index a segment; return why it ends early, "" if it does not."""
        strange = 0
        try:
            file = self._opened.enter_context(files.opened(path, None))
            self._files.append(file)
            for topic, encoding, metadata, sample in log_records.messages_of(file):
                number = self._channel(topic, encoding, metadata.get("encoding", ""))
                if strange > STRANGE:
                    return "most of its messages are none of this brain's"
                strange += 1
                if number is not None and self._take(number, file, sample.data):
                    strange -= 2
        except log_records.DAMAGE as error:
            return str(error) or type(error).__name__
        return ""

    def _channel(self, topic: str, encoding: str, sent: str) -> int | None:
        """Return the number of a channel; None: it is not this brain's, or its messages are not needed."""
        name = topic, encoding, sent
        if name not in self._numbers:
            row = keys.find(self._brain, topic)
            self._numbers[name] = None
            if row is not None and row.message in NEEDED:
                self._numbers[name] = len(self._channels)
                self._channels.append(Channel(row, topic, encoding == MessageEncoding.JSON, sent))
        return self._numbers[name]

    def _take(self, number: int, file: BinaryIO, data: bytes) -> bool:
        """Index a message; return whether it is one."""
        channel = self._channels[number]
        kind = channel.row.message
        if kind in WHOLE:
            message = self._decode(channel, data)
            if message is not None:
                self._count += 1
                kept = self._place(number, file, data) if kind is m.MemoryChange else None
                self._on_whole(message, kept, self.newest)
            return message is not None
        try:
            head = (_JSON if channel.json else _PACKED).decode(data)
        except (msgspec.DecodeError, RecursionError):
            return False
        self._count += 1
        if not 0 <= head.iteration <= MOST_ITERATIONS:
            self.shortened = f"This log is long: its first {MOST_ITERATIONS} iterations are shown."
            return True
        if kind is m.CurrentModel:
            places, at = self._models.setdefault(channel.key.rpartition("/")[2], {}), head.version
        elif kind is m.Pair:
            places, at = self.judged, head.iteration
            if head.feedback is None:
                return True
        else:
            assert kind is not None
            places, at = self._places[kind], head.iteration
            self.newest = max(self.newest, at)
        if at not in places and (place := self._place(number, file, data)) is not None:
            places[at] = place
        return True

    def _place(self, number: int, file: BinaryIO, data: bytes) -> Place | None:
        """Return where a message lies that was read just now; None: it is packed, and there is no more room."""
        segment, start = len(self._files) - 1, file.tell() - len(data)
        before = os.pread(file.fileno(), HEAD.size, max(start - BEFORE - HEAD.size, 0))
        if before == HEAD.pack(Opcode.MESSAGE, BEFORE + len(data)):
            return Place(number, segment, start, len(data))
        self._kept += len(data)
        if self._kept > MOST_KEPT:
            self.shortened = "This log is packed, and too long to be shown whole: 'mcap decompress' unpacks it."
            return None
        return Place(number, segment, 0, 0, data)

    # ---- what is asked for ----

    def read(self, place: Place | None) -> m.Message | None:
        """Return the message at a place; None: there is none, or it is damaged."""
        if place is None:
            return None
        data = place.data
        if data is None:
            data = os.pread(self._files[place.segment].fileno(), place.length, place.start)
        return self._decode(self._channels[place.channel], data)

    def _decode(self, channel: Channel, data: bytes) -> m.Message | None:
        decode = as_json.decode if channel.json else codec.decode
        try:
            return read_as(decode, channel.row, self._brain, Raw(channel.key, data, channel.encoding))
        except DecodeError:
            return None


WHOLE = (m.Phase, m.Lesson, m.ContextEvent, m.MemoryChange, m.Control, m.Change, m.Finished)
NEEDED = (*WHOLE, *ITERATED, m.CurrentModel, m.Pair)
_JSON = msgspec.json.Decoder(_Head)
_PACKED = msgspec.msgpack.Decoder(_Head)
