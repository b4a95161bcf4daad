"""Run logs that no recorder has written."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from mdb_protocol import as_json, codec, messages

BRAIN = "pioneer"
GIGABYTE = 2**30


def _record(opcode: int, content: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(content) if length is None else length) + content


def _words(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def _chunk(packed: bytes, kind: str, says: int) -> bytes:
    head = struct.pack("<QQQI", 0, 0, says, 0) + _words(kind) + struct.pack("<Q", len(packed))
    return _record(Opcode.CHUNK, head + packed)


def _raw(*records: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(MCAP0_MAGIC + b"".join(records))


def _zstd_zeros(count: int) -> bytes:
    packer = zstandard.ZstdCompressor(level=3).compressobj(size=count)
    return b"".join(packer.compress(bytes(2**20)) for _ in range(count // 2**20)) + packer.flush()


def _lz4_zeros(count: int) -> bytes:
    packer = lz4.frame.LZ4FrameCompressor()
    parts = [packer.begin()] + [packer.compress(bytes(2**20)) for _ in range(count // 2**20)]
    return b"".join([*parts, packer.flush()])


def _zstd_bomb(path: Path) -> None:
    _raw(_chunk(_zstd_zeros(GIGABYTE), "zstd", GIGABYTE))(path)


def _lz4_bomb(path: Path) -> None:
    _raw(_chunk(_lz4_zeros(GIGABYTE), "lz4", GIGABYTE))(path)


def _many_bombs(path: Path) -> None:
    """Each chunk as large as is let through, full of records that mean nothing."""
    nothing = _record(0x80, bytes(1000)) * (20 * 2**20 // 1009)
    packed = zstandard.ZstdCompressor().compress(nothing)
    _raw(*[_chunk(packed, "zstd", len(nothing))] * 200)(path)


def _zeros_behind_the_head(path: Path) -> None:
    _raw()(path)
    with path.open("r+b") as file:
        file.truncate(8 * GIGABYTE)


def written(
    say: Callable[[Callable[[str, messages.Message], None]], None],
    compression: CompressionType = CompressionType.NONE,
) -> Callable[[Path], object]:
    """A log as a recorder writes it, of these messages."""

    def make(path: Path) -> None:
        with path.open("wb") as file:
            writer = Writer(file, compression=compression)
            writer.start()
            channels: dict[str, int] = {}

            def put(key: str, message: messages.Message) -> None:
                kind = type(message)
                if key not in channels:
                    schema = writer.register_schema(kind.__name__, "jsonschema", b"{}")
                    channels[key] = writer.register_channel(
                        key, "json", schema, {"encoding": codec.encoding_of(kind)}
                    )
                writer.add_message(channels[key], 1, as_json.encode(message), 1)

            say(put)
            writer.finish()

    return make


def _scene(iteration: int, **numbers: float) -> messages.Scene:
    return messages.Scene(
        iteration=iteration, episode=0, successes=0, event="none", action=None, before=None, reached=numbers, now={}
    )


def _report(iteration: int) -> messages.IterationReport:
    return messages.IterationReport(
        iteration=iteration, mode="a", action={}, explored=False, predicted=None, note=None, feedback=None,
        event="none", prequential={}, versions={},
    )  # fmt: skip


def _junk(path: Path) -> None:
    """300 000 messages of a key of ours, of which none is one."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start()
        schema = writer.register_schema("Pair", "jsonschema", b"{}")
        channel = writer.register_channel(
            f"mdb/{BRAIN}/pair", "json", schema, {"encoding": codec.encoding_of(messages.Pair)}
        )
        for _ in range(300_000):
            writer.add_message(channel, 1, b"{}", 1)
        writer.finish()


def _other_names(path: Path) -> None:
    """Each scene has numbers of its own names."""

    def say(put: Callable[[str, messages.Message], None]) -> None:
        for i in range(80):
            put(f"mdb/{BRAIN}/scene", _scene(i, **{f"n{i}x{j}": 1.0 for j in range(200)}))
            put(f"mdb/{BRAIN}/iteration", _report(i))

    written(say, CompressionType.ZSTD)(path)


def _told_without_end(path: Path) -> None:
    """10 GB of channels, in some 10 MB."""
    names = _words("encoding") + _words("y" * 100_000)
    parts = [
        struct.pack("<HH", i, 0) + _words(str(i)) + _words("json") + struct.pack("<I", len(names)) + names
        for i in range(200)
    ]
    inner = b"".join(_record(Opcode.CHANNEL, part) for part in parts)
    packed = zstandard.ZstdCompressor().compress(inner)
    room = _record(0x80, bytes(10 * 2**20))
    _raw(room, *[_chunk(packed, "zstd", len(inner))] * 500)(path)


def _nothing_in_millions(path: Path) -> None:
    nothing = _record(0x80, b"") * 2_000_000
    packed = zstandard.ZstdCompressor().compress(nothing)
    _raw(_record(0x80, bytes(4 * 2**20)), *[_chunk(packed, "zstd", len(nothing))] * 5)(path)


def _chunks_in_chunks(path: Path) -> None:
    inner = _record(0x80, bytes(1000))
    for _ in range(50):
        inner = _chunk(zstandard.ZstdCompressor().compress(inner), "zstd", len(inner))
    _raw(inner)(path)


INPUTS: dict[str, Callable[[Path], object]] = {
    "a gigabyte in 32 kB, zstd": _zstd_bomb,
    "a gigabyte, lz4": _lz4_bomb,
    "200 chunks that unpack to 4 GB": _many_bombs,
    "a chunk that says it unpacks to 16 EB": _raw(_chunk(_zstd_zeros(2**20), "zstd", 2**64 - 1)),
    "a chunk that is not what it says": _raw(_chunk(b"nothing", "zstd", 100)),
    "a chunk packed in an unknown way": _raw(_chunk(b"nothing", "\x1b[2J", 100)),
    "8 GB of nothing behind its head": _zeros_behind_the_head,
    "a record of 16 EB": _raw(_record(Opcode.MESSAGE, b"", 2**64 - 1)),
    "an attachment of 16 EB": _raw(_record(Opcode.ATTACHMENT, b"", 2**64 - 1)),
    "metadata of 8 GB": _raw(_record(Opcode.METADATA, b"", 8 * GIGABYTE)),
    "a message of no channel": _raw(_record(Opcode.MESSAGE, struct.pack("<HIQQ", 7, 0, 0, 0))),
    "a channel whose names are cut": _raw(_record(Opcode.CHANNEL, struct.pack("<HHI", 1, 0, 2**31))),
    "a head and nothing more": _raw(),
    "300000 messages that are none": _junk,
    "channels of 10 GB": _told_without_end,
    "ten million records of nothing": _nothing_in_millions,
    "chunks in chunks": _chunks_in_chunks,
    "another brain's": written(lambda put: put("mdb/other/iteration", _report(1))),
    "another program's": written(lambda put: put("/camera/image", _report(1))),
    "an iteration of 9e15": written(lambda put: put(f"mdb/{BRAIN}/iteration", _report(2**53))),
    "an iteration long after the end": written(lambda put: put(f"mdb/{BRAIN}/iteration", _report(10_000_000))),
    "a message each of other names": _other_names,
}
WELL_FORMED = frozenset({"a message each of other names"})
