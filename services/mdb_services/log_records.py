"""The messages of an MCAP file, one at a time, whoever wrote it: no record, chunk or file can fill the memory.

Owns the walk from record to record and its bounds; what is in a record the mcap package reads. That package's own
readers load attachments, unpack chunks to whatever size comes out, and follow zeros to the end of a sparse file.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Iterator
from itertools import count
from typing import BinaryIO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message
from mcap.writer import MCAP0_MAGIC

from mdb_protocol.errors import DamageError
from mdb_protocol.files import size

MOST_RECORD = 24 * 2**20
"""Bytes of a record that is read: the largest message as JSON, and a little more."""
MOST_CHUNK = 24 * 2**20
"""Bytes that a chunk may unpack to; the tools of MCAP make chunks of 1 to 4 MB."""
MOST_UNPACKED = 50
"""So many times the size of the file is unpacked of it, and no more; a run log packs to a seventh."""
MOST_CHANNELS = 8 * 2**20
"""Bytes of all that a file says of its channels; a run log has 10 kB."""
MOST_PASSED = 1_000_000
"""Records of a file that are passed over; a recorder writes some for each chunk."""
DAMAGE = (
    DamageError, McapError, EOFError, OSError, struct.error, ValueError, LookupError, OverflowError, MemoryError,
    RuntimeError, zlib.error, zstandard.ZstdError,
)  # fmt: skip
"""What a cut or damaged file, or one that is none, can raise."""


class Sample(NamedTuple):
    """A message: its channel's topic, encoding and metadata, and the record."""

    topic: str
    encoding: str
    metadata: dict[str, str]
    message: Message


def messages_of(file: BinaryIO) -> Iterator[Sample]:
    """Yield the messages of an MCAP file in order; one of `DAMAGE` where it ends before its end."""
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise DamageError("it is no MCAP file")
    channels: dict[int, Channel] = {}
    told = 0
    left = MOST_UNPACKED * max(os.fstat(file.fileno()).st_size, MOST_CHUNK // MOST_UNPACKED)
    passed = count()
    for opcode, content in _records(file, passed):
        if opcode == Opcode.CHUNK:
            unpacked = _unpacked(Chunk.read(ReadDataStream(io.BytesIO(content))))
            left -= len(unpacked)
            if left < 0:
                raise DamageError(f"its chunks unpack to more than {MOST_UNPACKED} times its size")
            parts = _records(io.BytesIO(unpacked), passed)
        else:
            parts = iter([(opcode, content)])
        for inner, part in parts:
            told += len(part) if inner == Opcode.CHANNEL else 0
            if told > MOST_CHANNELS:
                raise DamageError(f"what it says of its channels is more than {size(MOST_CHANNELS)}")
            yield from _message(inner, part, channels)
        if opcode == Opcode.FOOTER:
            return


def _records(file: BinaryIO, passed: Iterator[int]) -> Iterator[tuple[int, bytes]]:
    """Yield the records that matter, each with its content; the others are passed over unread."""
    while len(head := file.read(9)) == 9:
        opcode, length = struct.unpack("<BQ", head)
        if opcode == 0:
            raise DamageError("there are zeros where a record should begin")
        if opcode not in (Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.FOOTER):
            file.seek(length, os.SEEK_CUR)
            if next(passed) > MOST_PASSED:
                raise DamageError(f"more than {MOST_PASSED} of its records mean nothing")
            continue
        if length > MOST_RECORD:
            raise DamageError(f"a record of {size(length)}; at most {size(MOST_RECORD)} are read")
        content = file.read(length)
        if len(content) < length:
            raise EOFError("it ends within a record")
        yield opcode, content
    if head:
        raise EOFError("it ends within a record")


def _message(opcode: int, content: bytes, channels: dict[int, Channel]) -> Iterator[Sample]:
    """Yield the message of a record, if it is one; remember a channel."""
    stream = ReadDataStream(io.BytesIO(content))
    if opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        channels[channel.id] = channel
    elif opcode == Opcode.MESSAGE:
        message = Message.read(stream, len(content))
        of = channels[message.channel_id]
        yield Sample(of.topic, of.message_encoding, of.metadata, message)


def _unpacked(chunk: Chunk) -> bytes:
    """Return what is in a chunk; DamageError when that is too much, whatever its head says."""
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor(max_window_size=MOST_CHUNK).stream_reader(chunk.data) as reader:
            found = reader.read(MOST_CHUNK + 1)
    elif chunk.compression == "lz4":
        found = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=MOST_CHUNK + 1)
    elif chunk.compression == "":
        found = chunk.data
    else:
        raise DamageError(f"a chunk is packed by {chunk.compression[:20]!r}; expected zstd or lz4")
    if len(found) > MOST_CHUNK:
        raise DamageError(f"a chunk unpacks to more than {size(MOST_CHUNK)}")
    return found
