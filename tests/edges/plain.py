"""Inputs that stand in the place of any file, experiment files, and results of studies."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np

SPARSE = 8 * 2**30


def pipe(path: Path) -> None:
    os.mkfifo(path)


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def folder(path: Path) -> None:
    path.mkdir()


def loop(path: Path) -> None:
    path.symlink_to(path)


def socket_file(path: Path) -> None:
    here = os.getcwd()
    os.chdir(path.parent)  # its name must be short
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(path.name)
    finally:
        os.chdir(here)


def empty(path: Path) -> None:
    path.touch()


def text(path: Path) -> None:
    path.write_text("\x1b[31mnot what you think\n" * 1000)


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(SPARSE)


def noise(path: Path) -> None:
    path.write_bytes(np.random.default_rng(7).bytes(100_000))


def _toml(content: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(content)


EXPERIMENTS: dict[str, Callable[[Path], object]] = {
    "a key of 50000 names": _toml(".".join("a" * 50_000) + " = 1\n"),
    "a table of 50000 names": _toml("[" + ".".join("a" * 50_000) + "]\n"),
    "a key of 20000 names in a table in a line": _toml("a = {" + ".".join("a" * 20_000) + " = 1}\n"),
    "lists in lists": _toml("a = " + "[" * 50_000),
    "a number of 100000 digits": _toml("a = " + "9" * 100_000 + "\n"),
    "a megabyte and more": _toml("# \n" * 500_000),
    "200000 settings": _toml("".join(f"a{i} = 1\n" for i in range(200_000))),
    "ends within a word": _toml('[experiment]\nname = "pap'),
    "a section that is a number": _toml("experiment = 7\n"),
    "a list of sections that are numbers": _toml("model = [1, 2]\n"),
    "iterations without end": _toml('[experiment]\nname = "a"\niterations = 1000000000000\n'),
    "not UTF-8": lambda path: path.write_bytes(b'[experiment]\nname = "\xff\xfe"\n'),
}


def _parquet(columns: dict[str, list[object]], metadata: dict[bytes, bytes]) -> Callable[[Path], object]:
    def make(path: Path) -> None:
        import pyarrow as pa
        from pyarrow import parquet

        parquet.write_table(pa.table(columns).replace_schema_metadata(metadata), path, compression="zstd")

    return make


LABEL = (
    b'{"study": "memory", "variant": "a", "order": 0, "seed": 1, "body": "kinematic", "fingerprint": "x", '
    b'"code": "y", "overrides": []}'
)


def _lying(path: Path) -> None:
    """A column of 300 MB in 10 kB, of which the file says that it unpacks to a byte."""
    from pyarrow import parquet

    _parquet({"a": [bytes(300_000_000)]}, {b"mdb": LABEL})(path)
    with parquet.ParquetFile(path) as file:
        said = _number(file.metadata.row_group(0).total_byte_size)
    one = bytes([0x82, *[0x80] * (len(said) - 2), 0])  # as long, so that all else stays where it is
    content = path.read_bytes()
    start = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    assert said in content[start:]
    path.write_bytes(content[:start] + content[start:].replace(said, one))


def _number(value: int) -> bytes:
    """Return a number as Parquet's footer has it: doubled, in parts of seven bits."""
    left, parts = 2 * value, []
    while left > 0x7F:
        parts.append(left & 0x7F | 0x80)
        left >>= 7
    return bytes([*parts, left])


RESULTS: dict[str, Callable[[Path], object]] = {
    "Parquet of somebody else": _parquet({"a": [1, 2, 3]}, {}),
    "a label and no phases": _parquet({"a": []}, {b"mdb": LABEL}),
    "columns of somebody else": _parquet({"a": [1, 2, 3]}, {b"mdb": LABEL}),
    "a label that is a list": _parquet({"a": [1]}, {b"mdb": b"[1]"}),
    "a column of 300 MB that says it is a byte": _lying,
    "ten million rows": _parquet({"a": [7] * 10_000_000}, {b"mdb": LABEL}),
}
