"""What can be saved of a damaged memory file: read in ever smaller parts, what cannot be read is left out.

Owns the reading of damaged SQLite files and the making of a new one. Never writes into the damaged one. A model's
short-term memory stays as it was when all of it can be read; otherwise it is filled with the newest pairs there are.
Checkpoints are left behind: evolvers begin with the last current model instead.
"""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar

import msgspec

from mdb_protocol import codec, messages
from mdb_protocol.errors import DamageError, DecodeError, MdbError
from mdb_protocol.messages import Message
from mdb_services.experiment.brain import BrainConfig
from mdb_services.memory.file import PAGE, SCHEMA, Effects, MemoryFile
from mdb_services.memory.model_memory import ModelMemory
from mdb_services.memory.reading import Reader, Row, copy, foreign, held
from mdb_services.shell.facts import facts_of

M = TypeVar("M", bound=Message)

MOST_S = 1.0
BYTES_A_S = 100 * 2**20
"""Processor time that is spent on a file, and bytes of it in each second more; a sound one takes a
quarter of it."""
KINDS: dict[str, tuple[type | UnionType, ...]] = {
    "change": (str, int, int, int | None, float | None),
    "context": (str, int, int, int),
    "seed": (str, int, bytes),
}
"""Tables of short-term memories, and what is in their columns."""


@dataclass
class Salvage:
    """What could be read. `whole` names the models whose short-term memories could be, all of them."""

    pairs: dict[int, tuple[messages.Pair, messages.PairStored]] = field(default_factory=dict)
    long_term: list[messages.LongTermModel] = field(default_factory=list)
    models: list[messages.CurrentModel] = field(default_factory=list)
    whole: list[str] = field(default_factory=list)
    tables: dict[str, list[Row]] = field(default_factory=dict)
    """Rows of the tables of short-term memories, those of the whole ones."""

    @property
    def missing(self) -> int:
        """Pairs that could not be read, before the last that could."""
        return max(self.pairs) + 1 - len(self.pairs) if self.pairs else 0

    @property
    def nothing(self) -> bool:
        """Whether there is nothing that a run could go on with."""
        return not (self.pairs or self.long_term or self.models)

    def words(self) -> str:
        """Return in words how much it is."""
        lost = f" ({self.missing} before the last of them are lost)" if self.missing else ""
        return (
            f"{len(self.pairs)} pairs{lost}, {len(self.long_term)} long-term models, {len(self.models)} current "
            f"models, {len(self.whole)} short-term memories as they were"
        )


def survey(path: Path, config: BrainConfig) -> Salvage:
    """Return what can be read of a memory file; MdbError when there is no such file."""
    found, iterations = Salvage(), config.experiment.iterations
    with _opened(path) as db:
        pairs = "SELECT iteration, payload, stored FROM pair WHERE iteration BETWEEN ? AND ?"
        for iteration, payload, stored in _by_halves(db, pairs, (), 0, iterations):
            pair, answer = _decoded(messages.Pair, payload), _decoded(messages.PairStored, stored)
            if pair is not None and pair.iteration == iteration:
                judged = pair.feedback is not None
                again = messages.PairStored(iteration=iteration, versions={}, judged=judged)
                found.pairs[iteration] = pair, answer or again
        long_term = "SELECT payload FROM long_term WHERE model = ? AND id BETWEEN ? AND ?"
        for section in config.model:
            stored_models = _by_halves(db, long_term, (section.name,), 0, iterations)
            memory = ModelMemory(config, section)
            found.long_term += [m for m in _all_decoded(messages.LongTermModel, stored_models) if memory.knows(m)]
            last = _at_once(db, "SELECT payload FROM model WHERE name = ?", section.name)
            found.models += _all_decoded(messages.CurrentModel, last or [])
            _survey_memory(db, section.name, found)
    return found


def _survey_memory(db: Reader, name: str, found: Salvage) -> None:
    """Take a model's short-term memory, if nothing of it is lost."""
    recalled = _at_once(db, "SELECT id, payload FROM recalled")
    tables = {table: _at_once(db, f"SELECT * FROM {table} WHERE model = ?", name) for table in KINDS}
    if recalled is None or any(not _is_sound(rows, KINDS[table]) for table, rows in tables.items()):
        return
    rows = {table: rows or [] for table, rows in tables.items()}
    versions = {row[1] for row in (*rows["change"], *rows["context"])}
    ids = {row[3] for row in rows["change"]} - {None}
    rows["recalled"] = [row for row in recalled if row[0] in ids and _decoded(messages.Pair, row[1]) is not None]
    known = found.pairs.keys() | {row[0] for row in rows["recalled"]}
    if len(versions) == max(versions, default=0) and ids <= known:
        found.whole.append(name)
        for table, whole in rows.items():
            found.tables.setdefault(table, []).extend(whole)


def _is_sound(rows: list[Row] | None, kinds: tuple[type | UnionType, ...]) -> bool:
    return rows is not None and all(all(map(isinstance, row, kinds)) for row in rows)


def rescue(path: Path, config: BrainConfig, out: Path) -> Salvage:
    """Write what can be read of a memory file into a new one at `out`; MdbError when that is there already."""
    if out.exists():
        raise MdbError(f"{out} is there already; give a new place")
    found = survey(path, config)
    with MemoryFile(out) as file:
        for pair, stored in found.pairs.values():
            file.add(pair, stored, ())
        file.keep_long_term(found.long_term)
        file.take_rows(found.tables)
        _refill(file, config, found)
        for model in found.models:
            version = min(model.version, file.version(model.model))
            file.keep_models([msgspec.structs.replace(model, version=version)])
    return found


def _refill(file: MemoryFile, config: BrainConfig, found: Salvage) -> None:
    """Fill the short-term memories that are not whole with the newest pairs."""
    for section in config.model:
        memory = ModelMemory(config, section)
        if section.name in found.whole:
            continue
        usable = [i for i in sorted(found.pairs) if memory.reads(found.pairs[i][0])]
        for iteration in usable[-section.capacity :]:
            pair, stored = found.pairs[iteration]
            effects: Effects | None = memory.enter(pair, facts_of(pair), count(-1, -1))
            if effects is not None:
                file.add(pair, stored, [effects])


def _at_once(db: Reader, sql: str, *given: object) -> list[Row] | None:
    """Return rows, or None when one of them cannot be read."""
    try:
        return list(db.rows(sql, *given))
    except (sqlite3.Error, DamageError):
        return None


def _by_halves(db: Reader, sql: str, given: Row, low: int, high: int) -> list[Row]:
    """Return what can be read of rows whose key is from `low` to `high`, the last two parameters of `sql`.

    A file that takes too long is left where it is by then.
    """
    if db.spent_s > MOST_S + db.bytes / BYTES_A_S:
        return []
    rows = _at_once(db, sql, *given, low, high)
    if rows is not None or low == high:
        return rows or []
    middle = (low + high) // 2
    return _by_halves(db, sql, given, low, middle) + _by_halves(db, sql, given, middle + 1, high)


@contextmanager
def _opened(path: Path) -> Iterator[Reader]:
    """Open a copy of a damaged file, with a new first page if that is what is damaged, or none of a memory's."""
    if not path.exists():
        raise MdbError(f"no memory file {path}")
    with tempfile.TemporaryDirectory(prefix="mdb-") as folder:
        copied = Path(folder) / path.name
        copy(path, copied)
        with closing(sqlite3.connect(copied, isolation_level=None)) as db:
            if _has_tables(db, reader := _reader(db, path, copied)):
                yield reader
                return
        copy(path, copied)
        _renew_first_page(copied)
        with closing(sqlite3.connect(copied, isolation_level=None)) as db:
            yield _reader(db, path, copied)


def _reader(db: sqlite3.Connection, path: Path, copied: Path) -> Reader:
    reader = Reader(db, path, held(copied))
    db.execute("PRAGMA writable_schema=ON")  # a file that is shorter than it says is read as far as it goes
    return reader


def _has_tables(db: sqlite3.Connection, reader: Reader) -> bool:
    try:
        if foreign(db) is not None:
            return False
        names = {row[0] for row in reader.rows("SELECT name FROM sqlite_schema WHERE type = 'table'")}
        return {"pair", "change", "long_term"} <= names
    except (sqlite3.Error, DamageError):
        return False


def _renew_first_page(path: Path) -> None:
    """Replace the first page, on which header and tables' places are: it is the same in every memory file."""
    fresh = path.with_name("fresh.sqlite")
    with closing(sqlite3.connect(fresh, isolation_level=None)) as db:
        db.execute("PRAGMA journal_mode=WAL")
        db.executescript(SCHEMA)
        db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    first = bytearray(fresh.read_bytes()[:PAGE])
    first[28:32] = bytes(4)  # the number of pages: to be taken from the file, or from its log
    with path.open("r+b") as file:
        file.write(first)


def _decoded(cls: type[M], payload: Any) -> M | None:
    try:
        return codec.decode(cls, payload, codec.encoding_of(cls)) if isinstance(payload, bytes) else None
    except DecodeError:
        return None


def _all_decoded(cls: type[M], rows: list[Row]) -> list[M]:
    return [message for row in rows if (message := _decoded(cls, row[0])) is not None]
