"""Memory files and exported models that nobody's brain has written."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import msgpack
import numpy as np

from mdb_protocol import codec, messages
from mdb_services.memory.file import SCHEMA, MemoryFile

ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n) SELECT"
ROWS = 300


def sql(*statements: str) -> Callable[[Path], None]:
    """A memory's tables, and then this."""

    def make(path: Path) -> None:
        with closing(sqlite3.connect(path, isolation_level=None)) as db:
            db.executescript(SCHEMA)
            for statement in statements:
                db.execute(statement)

    return make


def _pages_in_a_ring(path: Path) -> None:
    """A page of the long-term memory that names itself as its children, so that its rows never end."""
    sql()(path)
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        rows = [("a", i, b"x" * 900) for i in range(ROWS)]
        db.executemany("INSERT INTO long_term VALUES (?, ?, ?)", rows)
        (root,) = db.execute("SELECT rootpage FROM sqlite_schema WHERE name = 'long_term'").fetchone()
        (size,) = db.execute("PRAGMA page_size").fetchone()
    content = bytearray(path.read_bytes())
    start = (root - 1) * size
    children = int.from_bytes(content[start + 3 : start + 5], "big")
    # all children are the first: a file of some pages that holds its rows again and again
    first = None
    for i in range(children):
        at = start + int.from_bytes(content[start + 12 + 2 * i : start + 14 + 2 * i], "big")
        first = first or content[at : at + 4]
        content[at : at + 4] = root.to_bytes(4, "big") if i % 2 else first
    path.write_bytes(content)


def _a_log_that_is_a_pipe(path: Path) -> None:
    sql()(path)
    import os

    os.mkfifo(path.with_name(f"{path.name}-wal"))


def _tables_without_end(path: Path) -> None:
    """More tables than SQLite can put in order soon."""
    sql("CREATE TABLE t (a)")(path)
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        (root,) = db.execute("SELECT rootpage FROM sqlite_schema WHERE name = 't'").fetchone()
        db.execute("PRAGMA writable_schema=ON")
        db.execute("BEGIN")
        rows = ((f"u{i}", root, f"CREATE TABLE u{i}(a)") for i in range(100_000))
        db.executemany("INSERT INTO sqlite_schema VALUES ('table', ?1, ?1, ?2, ?3)", rows)
        db.execute("COMMIT")


def _models_without_end(path: Path) -> None:
    sql()(path)
    payload = msgpack.packb(plain_model())
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.execute("BEGIN")
        db.executemany("INSERT INTO long_term VALUES ('object', ?, ?)", ((i, payload) for i in range(50_000)))
        db.execute("COMMIT")


def _cut(path: Path) -> None:
    sql("INSERT INTO recalled VALUES (1, zeroblob(100000))")(path)
    path.write_bytes(path.read_bytes()[:20_000])


def _foreign(path: Path) -> None:
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.execute("CREATE TABLE songs (name TEXT)")


INPUTS: dict[str, Callable[[Path], object]] = {
    "its models are an endless view": sql(
        "DROP TABLE long_term", f"CREATE VIEW long_term AS {ENDLESS} 'a' AS model, i AS id, x'00' AS payload FROM n"
    ),
    "all its tables are endless views": sql(
        "DROP TABLE pair", "DROP TABLE long_term", "DROP TABLE model", "DROP TABLE change",
        f"CREATE VIEW pair AS {ENDLESS} i AS iteration, x'00' AS payload, x'00' AS stored FROM n",
        f"CREATE VIEW long_term AS {ENDLESS} 'a' AS model, i AS id, x'00' AS payload FROM n",
        f"CREATE VIEW model AS {ENDLESS} 'a' AS name, x'00' AS payload FROM n",
        f"CREATE VIEW change AS {ENDLESS} 'a' AS model, i AS version FROM n",
    ),
    "a view of its models that grows without end": sql(
        "DROP TABLE long_term",
        f"CREATE VIEW LONG_TERM AS {ENDLESS} 'a' AS model, i AS id, randomblob(1000000) AS payload FROM n",
    ),
    "columns that are calculated": sql(
        "DROP TABLE long_term",
        "CREATE TABLE long_term (model TEXT, id INTEGER, payload AS (zeroblob(1000000000)))",
        "INSERT INTO long_term VALUES ('a', 1)",
    ),
    "a trigger": sql(
        "CREATE TRIGGER more AFTER INSERT ON pair BEGIN INSERT INTO recalled VALUES (NULL, randomblob(1000000)); END"
    ),
    "pages that name one another": _pages_in_a_ring,
    "one value of 40 MB": sql("INSERT INTO long_term VALUES ('object', 1, zeroblob(40000000))"),
    "models that are words": sql("INSERT INTO long_term VALUES ('object', 1, 'a word')"),
    "texts that are no text": sql("INSERT INTO long_term VALUES ('object', 1, CAST(x'ffff' AS TEXT))"),
    "30 MB that are put in order": sql(
        "DROP TABLE long_term",
        "CREATE TABLE long_term (model TEXT, id INTEGER, payload BLOB)",
        "INSERT INTO long_term VALUES ('object', 1, zeroblob(31000000)), ('object', 2, x'00')",
    ),
    "100000 tables": _tables_without_end,
    "a write-ahead log that is a pipe": _a_log_that_is_a_pipe,
    "cut within a page": _cut,
    "another program's tables": _foreign,
}  # fmt: skip


def plain_model(**fields: Any) -> dict[str, Any]:
    """A stored model as its fields, with whatever a stranger writes into them."""
    weights = codec.encode(messages.ModelWeights(layers=[1, 1, 1], weights=np.zeros(4, np.float32)))
    whole = {"id": 1, "model": "object", "reads": {}, "error": 0.0, "pairs": [], **msgpack.unpackb(weights)}
    return whole | fields


def array(dtype: str, shape: list[int], raw: bytes) -> msgpack.ExtType:
    return msgpack.ExtType(codec.ARRAY_EXT, msgpack.packb([dtype, shape, raw]))


STRANGE: dict[str, dict[str, Any]] = {
    "layers [0, 0]": {"layers": [0, 0], "weights": array("<f4", [0], b"")},
    "layers [0, 0, 0]": {"layers": [0, 0, 0], "weights": array("<f4", [0], b"")},
    "no layers": {"layers": [], "weights": array("<f4", [0], b"")},
    "layers below zero": {"layers": [-1, 2, 1], "weights": array("<f4", [3], bytes(12))},
    "layers of 4096 units": {"layers": [4096, 4096, 4096], "weights": array("<f4", [4], bytes(16))},
    "layers without end": {"layers": [2**62, 2**62, 1], "weights": array("<f4", [4], bytes(16))},
    "weights that are no number": {"weights": array("<f4", [4], b"\xff" * 16)},
    "weights of a shape without end": {"weights": array("<f4", [0, 2**63], b"")},
    "weights of a great shape and nothing": {"weights": array("<f4", [0, 2**40], b"")},
    "a list in the place of weights": {"weights": [0.0] * 4},
    "an error that is infinite": {"error": float("inf")},
}
"""Fields of a stored model."""


def _in_memory(fields: dict[str, Any]) -> Callable[[Path], object]:
    def make(path: Path) -> None:
        MemoryFile(path).close()
        path.with_name(f"{path.name}-lock").unlink()
        with closing(sqlite3.connect(path, isolation_level=None)) as db:
            row = ("object", 1, msgpack.packb(plain_model(**fields)))
            db.execute("INSERT INTO long_term VALUES (?, ?, ?)", row)

    return make


def _exported(content: Any) -> Callable[[Path], object]:
    head = codec.encoding_of(messages.LongTermFile).encode() + b"\n"
    payload = content if isinstance(content, bytes) else msgpack.packb(content)
    return lambda path: path.write_bytes(head + payload)


MODELS: dict[str, Callable[[Path], object]] = {"50000 models": _models_without_end} | {
    name: _in_memory(fields) for name, fields in STRANGE.items()
}
EXPORTS: dict[str, Callable[[Path], object]] = {
    **{name: _exported({"models": [plain_model(**fields)]}) for name, fields in STRANGE.items()},
    "a million lists": _exported(b"\x81\xa6models" + b"\xdc\x27\x10" + (b"\xdc\x03\xe8" + b"\x90" * 1000) * 10_000),
    "lists in lists": _exported(b"\x81\xa6models" + b"\x91" * 100_000),
    "a list of 4 thousand million": _exported(b"\x81\xa6models\xdd\xff\xff\xff\xff"),
    "a word of 4 GB": _exported(b"\x81\xa6models\xdb\xff\xff\xff\xff"),
    "ends at once": _exported(b""),
    "a network that reads something else": _exported({"models": [plain_model(reads={"x": "scalar"})]}),
    "of another version": lambda path: path.write_bytes(b"application/msgpack;mdb=9;LongTermFile\n\x81"),
}
WELL_FORMED = frozenset({"a network that reads something else"})
