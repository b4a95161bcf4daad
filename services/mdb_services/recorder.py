"""The recorder: every message of a run into its run folder, as it came; what is none is counted. Only listens.

Owns `run.mcap`, with the resolved experiment and all versions in its metadata. It is written without chunks
and flushed as it goes, so that what was recorded can be read after a kill. Messages are in it as JSON, each channel
with its schema, so that any reader of MCAP can read them; exactly, see `as_json`. `read_log` is the other half: the
messages of a run, decoded; figures and comparisons use it alone. It also reads the logs of before, in MessagePack.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import IO, NamedTuple

import structlog
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from mdb_protocol import as_json, codec, files, keys
from mdb_protocol.bus import TAPPED, Bus, read, read_as
from mdb_protocol.errors import DamageError, DecodeError, MdbError
from mdb_protocol.keys import Key
from mdb_protocol.messages import Finished, Message
from mdb_protocol.waiting import Raw
from mdb_services import log_records
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_services.shell.place import LOOKED_S, Place

log = structlog.get_logger()

ROLE = "recorder"
PACKAGES = ("multilevel-darwinist-brain", "eclipse-zenoh", "numpy", "numba", "msgpack", "msgspec", "mcap", "pybullet")
LOG_PATTERN = "run*.mcap"
RETRY_S = 1.0
"""How often a disk that takes nothing is tried again."""
LAST_WORD_S = 0.1
"""Who ends a finished run may have heard of it before the recorder does."""
SEGMENTS = 8
"""Parts of a log of which only the newest is kept: the oldest part goes when the newest is full."""
MAX_CHANNELS = 60_000
"""Pairs of key and encoding in one segment, whose format has room for 65535; then the next segment begins."""


STRANGE = 20_000
"""After so many more messages that cannot be read, or are no brain's, than those that can, the rest is left."""


class EmptyLogError(MdbError):
    """A run log of which nothing can be read."""


def versions() -> dict[str, str]:
    """Return what made a run: the versions of Python, protocol, and every package of the project."""
    found = {"python": platform.python_version(), "protocol": str(codec.VERSION), "machine": platform.machine()}
    for package in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found[package] = metadata.version(package)
    return found


class Recorder:
    """See the module's docstring."""

    role, instance = ROLE, "log"

    def __init__(
        self,
        bus: Bus,
        run: Path,
        clock: Callable[[], float] = time.monotonic,
        *,
        keep_bytes: int | None = None,
        gather_s: float = 0.0,
    ) -> None:
        """Begin the next segment of the run's log; a restarted recorder never writes into an old one.

        keep_bytes: of the log only the newest so many are kept, in whole segments, each with its index; None: all.
        gather_s: what comes within so many seconds is written together, which is cheaper.
        """
        self.bus = bus
        self._keep_bytes, self._gather_s = keep_bytes, gather_s
        self._run, self._clock = run, clock
        self._count = self._bytes = self._lost = 0
        self._unflushed = 0
        self._finished = False
        """Whether the last message was that the run is finished."""
        self._file: IO[bytes] | None = None
        self._retry_s = 0.0
        """When to write again after the disk took nothing; 0 while it does."""
        self._try(self._flush)
        self._tap = bus.tap()

    def _begin(self) -> None:
        """Begin a segment; OSError when the disk does not take its head, and then there is none."""
        path = next_segment(self._run)
        self._file = path.open("xb")
        self._place = Place(path, LOOKED_S)
        try:
            self._writer = Writer(self._file, use_chunking=False)
            self._writer.start(profile="mdb", library=f"mdb protocol {codec.VERSION}")
            self._writer.add_metadata("versions", versions())
            experiment = self._run / EXPERIMENT_FILE
            if experiment.exists():
                text = experiment.read_text(encoding="utf-8")
                self._writer.add_metadata("experiment", {EXPERIMENT_FILE: text})
            self._file.flush()
        except OSError:
            path.unlink()
            raise
        self._channels = Channels(self._writer)

    def _end(self) -> None:
        assert self._file is not None
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()

    def step(self) -> bool:
        """Write what has come."""
        moved = False
        if self._gather_s and len(self._tap.waiting):
            time.sleep(self._gather_s)
        for raw in self._tap.some():
            if (message := self._read(raw)) is not None:
                self._try(lambda raw=raw, message=message: self._write(raw, message))  # type: ignore[misc]
            moved = True
        if self._unflushed:  # a kill then costs what came in this step, or not yet, and nothing more
            self._try(self._flush)
        return moved

    def _read(self, raw: Raw) -> Message | None:
        """Return the message if it belongs in the log; junk, which would fill the disk, does not."""
        row = keys.find(self.bus.brain, raw.key)
        if row is None:
            self.bus.refusals.add(TAPPED, f"sample on {raw.key[:200]!r}, which is none of the brain's keys")
            return None
        try:
            return read(row, self.bus.brain, raw) if row.recorded else None
        except DecodeError as error:
            self.bus.refusals.add(row.path, str(error))
            return None

    def _try(self, write: Callable[[], None]) -> None:
        """Write, unless the disk takes nothing: then say so once, count what is lost, later begin a new segment."""
        if self._clock() < self._retry_s:
            self._lost += 1
            return
        try:
            if self._file is None:
                self._begin()
            write()
        except OSError as error:
            if not self._retry_s:
                log.error("cannot write the run log; until it can, what is said is not recorded", reason=str(error))
            self._lost += max(self._unflushed, 1)
            self._count -= self._unflushed
            self._unflushed = 0
            self._retry_s = self._clock() + RETRY_S
            self._leave()
            return
        if self._retry_s:
            log.info("recording again", lost=self._lost)
            self._retry_s = 0.0

    def _leave(self) -> None:
        """Leave a segment as it is."""
        if self._file is not None:
            with suppress(OSError):  # it tries once more to write what it has
                self._file.close()
        self._file = None

    def _flush(self) -> None:
        assert self._file is not None
        self._file.flush()
        self._place.check()
        self._unflushed = 0

    def _write(self, raw: Raw, message: Message) -> None:
        if self._channels.full_for(raw.key, raw.encoding) or self._is_long():
            self._end()
            self._begin()
            self._forget()
        known = raw.encoding == codec.encoding_of(type(message))  # a later version may say more
        text = as_json.encode(message, None if known else raw.payload)
        self._unflushed += 1
        self._finished = isinstance(message, Finished)
        channel = self._channels.of(raw.key, type(message), raw.encoding)
        self._writer.add_message(channel, raw.came_ns, text, raw.came_ns, sequence=self._count)
        self._count += 1
        self._bytes += len(text)

    def _is_long(self) -> bool:
        """Whether the segment is as long as it may be, where not all of the log is kept."""
        assert self._file is not None
        return self._keep_bytes is not None and self._file.tell() >= self._keep_bytes // SEGMENTS

    def _forget(self) -> None:
        """Remove the oldest segments beyond what is kept; there is room for the new one."""
        if self._keep_bytes is None:
            return
        *old, _ = segments_of(self._run)
        sizes = {path: path.stat().st_size for path in old}
        for path in old:
            if sum(sizes.values()) <= self._keep_bytes - self._keep_bytes // SEGMENTS:
                return
            path.unlink()
            del sizes[path]

    def values(self) -> dict[str, float]:
        """Messages and their bytes written, messages that the disk did not take, and whether it takes none now."""
        counts = {"messages": float(self._count), "bytes": float(self._bytes), "lost": float(self._lost)}
        return counts | {"disk_refuses": float(self._retry_s > 0)}

    def close(self) -> None:
        """Write what is still there and finish the file. Before the last word has come, it may be on its way yet."""
        while self.step():
            pass
        until_s = time.monotonic() + LAST_WORD_S
        while not self._finished and (left_s := until_s - time.monotonic()) > 0 and self.bus.wait(left_s):
            self.step()
        if self._file is not None:
            self._try(self._end)


class Channels:
    """The channels of a log file: one for each key and each encoding that messages on it had on the network."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[type[Message], int] = {}
        self._channels: dict[tuple[str, str], int] = {}

    def full_for(self, key: str, encoding: str) -> bool:
        """Whether there is no room for another channel, which these would need."""
        return len(self._channels) >= MAX_CHANNELS and (key, encoding) not in self._channels

    def of(self, key: str, message: type[Message], encoding: str) -> int:
        """Return the channel's number; it is begun when it is new."""
        if (key, encoding) not in self._channels:
            if message not in self._schemas:
                schema = as_json.schema_of(message)
                number = self._writer.register_schema(message.__name__, SchemaEncoding.JSONSchema, schema)
                self._schemas[message] = number
            self._channels[key, encoding] = self._writer.register_channel(
                key, MessageEncoding.JSON, self._schemas[message], {"encoding": encoding}
            )
        return self._channels[key, encoding]


class Recorded(NamedTuple):
    """One message of a run log: its row of the key table, the full key, the message, when it was recorded."""

    row: Key
    key: str
    message: Message
    time_s: float


def next_segment(run: Path) -> Path:
    """Return the path of the next log file of a run: run.mcap, run-1.mcap, ..."""
    there = [path.stem.partition("-")[2] for path in run.glob(LOG_PATTERN)]
    newest = max((int(number or 0) for number in there if number.isdecimal() or not number), default=None)
    return run / ("run.mcap" if newest is None else f"run-{newest + 1}.mcap")


def read_log(run: Path, brain: str | None = None) -> Iterator[Recorded]:
    """Yield the messages of all segments of a run in the order recorded; what does not decode is left out.

    brain: those of this one alone. Reads logs that a kill cut short, and never more at a time than one message.
    Raises MdbError when the folder holds no log, or in the end when there was no such message in it.
    """
    segments = segments_of(run)
    if not segments:
        raise MdbError(f"no run log ({LOG_PATTERN}) in {run}; give the folder that 'mdb up' named at its end")
    empty, reasons = True, dict[Path, str]()
    for segment in segments:
        for recorded in _read_segment(segment, brain, reasons):
            empty = False
            yield recorded
    if empty:
        whose = "" if brain is None else f" of brain {brain}"
        why = next(iter(reasons.values()), "it is empty, or another's")
        raise EmptyLogError(f"no message{whose} can be read of the run log in {run}: {why}")
    for path, reason in reasons.items():
        log.info("log ends early", path=str(path), reason=reason)


def segments_of(run: Path) -> list[Path]:
    """Return the files of a run's log, the oldest first."""
    return sorted(run.glob(LOG_PATTERN), key=lambda path: (len(path.name), path.name))


def _read_segment(path: Path, brain: str | None, reasons: dict[Path, str]) -> Iterator[Recorded]:
    """Yield the messages of a segment; why it ends early, if it does, is added to `reasons`."""
    rows: dict[str, tuple[str, Key | None]] = {}
    strange = 0
    with files.opened(path, None) as file:
        try:
            for topic, encoding, metadata_, sample in log_records.messages_of(file):
                if topic not in rows:
                    of_brain = topic.partition("/")[2].partition("/")[0]
                    known = brain in (None, of_brain)
                    rows[topic] = of_brain, keys.find(of_brain, topic) if known else None
                of_brain, row = rows[topic]
                if strange > STRANGE:
                    raise DamageError("most of its messages are none of this brain's")
                strange += 1
                if row is None:
                    continue
                decode = as_json.decode if encoding == MessageEncoding.JSON else codec.decode
                raw = Raw(topic, sample.data, metadata_.get("encoding", ""))
                try:
                    yield Recorded(row, raw.key, read_as(decode, row, of_brain, raw), sample.log_time / 1e9)
                except DecodeError:
                    continue
                strange -= 2
        except log_records.DAMAGE as error:
            reasons[path] = str(error) or type(error).__name__
