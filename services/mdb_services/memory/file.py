"""The memory store's file: pairs, what each did to the memories, the last models, the long-term memory.

Owns `memory.sqlite` of a run (SQLite, write-ahead log). Decides nothing: `model_memory` does.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Self

from mdb_protocol import codec, files, messages
from mdb_protocol.errors import DamageError, DecodeError, MdbError
from mdb_services.memory.lock import hold, unopened
from mdb_services.memory.reading import bounded, code_of, foreign, guard, held, log_of
from mdb_services.shell.place import Place

SCHEMA = """
CREATE TABLE IF NOT EXISTS pair (
    iteration INTEGER PRIMARY KEY, payload BLOB NOT NULL, stored BLOB NOT NULL, note INTEGER, choice INTEGER
);
CREATE TABLE IF NOT EXISTS recalled (id INTEGER PRIMARY KEY, payload BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS change (
    model TEXT, version INTEGER, slot INTEGER, pair INTEGER, entry_error REAL, PRIMARY KEY (model, version, slot)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS context (
    model TEXT, version INTEGER, first INTEGER NOT NULL, known INTEGER NOT NULL, PRIMARY KEY (model, version)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS seed (
    model TEXT, place INTEGER, payload BLOB NOT NULL, PRIMARY KEY (model, place)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS model (name TEXT PRIMARY KEY, payload BLOB NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS checkpoint (model TEXT PRIMARY KEY, payload BLOB NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS step (
    model TEXT, version INTEGER, payload BLOB NOT NULL, PRIMARY KEY (model, version)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS long_term (
    model TEXT, id INTEGER, payload BLOB NOT NULL, PRIMARY KEY (model, id)
) WITHOUT ROWID;
"""

BESIDE = ("-wal", "-journal", "-shm")
"""Endings of the files beside it that SQLite opens."""
PAGE = 4096
"""Bytes of SQLite's pages, unless it is told otherwise."""
DAMAGE = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR, sqlite3.SQLITE_INTERRUPT)
"""What SQLite says of a file that is damaged, or is another database, or is looked at for too long; the rest is the
disk or the system."""
CHECK_S, CHECKED_A_S = 1.0, 20 * 2**20
"""Processor time to look at a file, and bytes of it in each second more; a sound one takes a tenth of it."""
STEPS_KEPT = 1000
"""Changes of a memory that are kept for an evolver that makes no checkpoint."""


class Entry(NamedTuple):
    """A slot of a short-term memory on disk: which pair is in it, since which version, the error on it then."""

    slot: int
    id: int
    pair: messages.Pair
    version: int
    error: float


class Context(NamedTuple):
    """A context began at `version`, its first pair at `first`; `known`: with a model that fitted."""

    version: int
    first: int
    known: bool


@dataclass
class Effects:
    """What one pair did to one model's memories: everything that has to be on disk with it."""

    changes: list[messages.MemoryChange] = field(default_factory=list)
    entry_error: float | None = None
    """The current model's error on the pair; None when there was no model."""
    recalled: dict[int, messages.Pair] = field(default_factory=dict)
    context: Context | None = None
    long_term: list[messages.LongTermModel] = field(default_factory=list)
    """Models to be stored, or stored anew."""
    forgotten: list[int] = field(default_factory=list)
    events: list[messages.ContextEvent] = field(default_factory=list)


class MemoryFile:
    """See the module's docstring."""

    def __init__(self, path: Path, *, power_safe: bool = False) -> None:
        """Open or create, to write; DamageError when the file cannot be used, as far as SQLite can tell.

        One process at a time has it: MdbError when another does. To look into it there is `reading`.

        What was written survives the death of this process; with `power_safe` (SQLite's synchronous mode FULL instead
        of NORMAL) also a loss of power, for a disk's round trip a pair.
        """
        self._path = path
        self._lock = hold(path)
        try:
            self._open(power_safe=power_safe)
        except BaseException:
            self._lock.close()
            raise

    def _open(self, *, power_safe: bool) -> None:
        path = self._path
        self._check_length()
        try:
            self._db = sqlite3.connect(path, isolation_level=None)
            guard(self._db)
            with bounded(self._db, CHECK_S + held(path) / CHECKED_A_S):
                if (reason := foreign(self._db)) is not None:
                    raise self.unusable(reason)
                (found,) = self._db.execute("PRAGMA quick_check(1)").fetchone()
            if found != "ok":
                raise self.unusable(str(found).replace("\n", " "))
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute(f"PRAGMA synchronous={'FULL' if power_safe else 'NORMAL'}")
            self._db.executescript(SCHEMA)
            columns = {row[1] for row in self._db.execute("PRAGMA table_info(pair)")}
            (following,) = self._db.execute("SELECT coalesce(max(iteration) + 1, 0) FROM pair").fetchone()
            self._next = int(following)
        except sqlite3.Error as error:
            if code_of(error) in DAMAGE:
                raise self.unusable(error) from error
            raise unopened(path, error) from error
        if "choice" not in columns:
            self._db.close()
            raise MdbError(
                f"{path} was written by a version of this project that spoke version 1 of the protocol, whose pairs "
                "cannot be read any more. Move it away to start with an empty memory"
            )
        self._place = Place(path)

    def check_place(self) -> None:
        """Raise OSError when the file is not where it was: what is written now, nobody would find."""
        self._place.check()

    def _check_length(self) -> None:
        """DamageError for what is no file, or what SQLite mends in silence: a log beside an empty file, and so on."""
        log = log_of(self._path)
        for path in (self._path, *(self._path.with_name(f"{self._path.name}{end}") for end in BESIDE)):
            try:
                with files.opened(path, None):
                    pass
            except FileNotFoundError:
                continue
            except DamageError as error:
                raise self.unusable(error) from error
        bytes_, logged = (path.stat().st_size if path.is_file() else 0 for path in (self._path, log))
        if logged and not bytes_:
            raise self.unusable("it is empty, but its write-ahead log is not")
        if bytes_ % PAGE and not logged:
            raise self.unusable(f"it ends within a page, after {bytes_} bytes")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def unusable(self, reason: object) -> DamageError:
        """Return the error that says what is wrong with the file and what to do."""
        return DamageError(
            f"{self._path} cannot be used as the memory's database: {reason}. 'mdb rescue {self._path.parent} --out "
            "NEW' makes a run with all that can be read; or move it away to start with an empty memory"
        )

    def take_rows(self, tables: Mapping[str, list[tuple[Any, ...]]]) -> None:
        """Take rows of short-term memories that were read of another file, by table."""
        with self._transaction():
            for table, rows in tables.items():
                if rows:
                    places = ", ".join("?" * len(rows[0]))
                    self._db.executemany(f"INSERT OR REPLACE INTO {table} VALUES ({places})", rows)

    def add(
        self,
        pair: messages.Pair,
        stored: messages.PairStored,
        effects: Iterable[Effects],
        models: Iterable[messages.CurrentModel] = (),
    ) -> None:
        """Write a pair with its acknowledgement and all that it did, and models to be kept, in one transaction.

        It takes the place of the same pair without feedback.
        """
        with self._transaction():
            row = (pair.iteration, codec.encode(pair), codec.encode(stored), pair.note, pair.choice)
            self._db.execute("INSERT OR REPLACE INTO pair VALUES (?, ?, ?, ?, ?)", row)
            for effect in effects:
                self._write(effect)
            self._keep(models)
        self._next = max(self._next, pair.iteration + 1)

    def begin(self, effects: Effects) -> None:
        """Write what a memory begins with, before any pair."""
        with self._transaction():
            self._write(effects)

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._db.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._db.execute("COMMIT")
        except BaseException:
            if self._db.in_transaction:  # a full disk has ended it already
                self._db.execute("ROLLBACK")
            raise

    def _write(self, effect: Effects) -> None:
        if effect.recalled:
            recalled = [(id, codec.encode(pair)) for id, pair in effect.recalled.items()]
            self._db.executemany("INSERT INTO recalled VALUES (?, ?)", recalled)
        for change in effect.changes:
            written = zip(change.slots.tolist(), change.pairs.tolist(), strict=True)
            rows = [*written, *((slot, None) for slot in change.freed.tolist())]
            error = effect.entry_error if change is effect.changes[0] else None
            self._db.executemany(
                "INSERT INTO change VALUES (?, ?, ?, ?, ?)",
                [(change.model, change.version, slot, pair, error) for slot, pair in rows],
            )
            step = (change.model, change.version, codec.encode(change))
            self._db.execute("INSERT INTO step VALUES (?, ?, ?)", step)
            if change.version > STEPS_KEPT:
                self._db.execute(
                    "DELETE FROM step WHERE model = ? AND version <= ?", (change.model, change.version - STEPS_KEPT)
                )
            if effect.context is not None and change.version == effect.context.version:
                self._db.execute("INSERT INTO context VALUES (?, ?, ?, ?)", (change.model, *effect.context))
                seeds = [(change.model, place, codec.encode(seed)) for place, seed in enumerate(change.seeds)]
                self._db.execute("DELETE FROM seed WHERE model = ?", (change.model,))
                self._db.executemany("INSERT INTO seed VALUES (?, ?, ?)", seeds)
        if effect.long_term:
            self.keep_long_term(effect.long_term)
        for id in effect.forgotten:
            self._db.execute("DELETE FROM long_term WHERE model = ? AND id = ?", (effect.changes[0].model, id))

    def stored(self, iteration: int) -> messages.PairStored | None:
        """Return the acknowledgement of a pair that is on disk, or None."""
        if iteration >= self._next:
            return None
        row = self._db.execute("SELECT stored FROM pair WHERE iteration = ?", (iteration,)).fetchone()
        encoding = codec.encoding_of(messages.PairStored)
        return codec.decode(messages.PairStored, row[0], encoding) if row else None

    def pair(self, iteration: int) -> messages.Pair | None:
        """Return a pair that is on disk, or None."""
        row = self._db.execute("SELECT payload FROM pair WHERE iteration = ?", (iteration,)).fetchone()
        return codec.decode(messages.Pair, row[0], codec.encoding_of(messages.Pair)) if row else None

    def newest(self, count: int) -> list[messages.Pair]:
        """Return the newest pairs, in order."""
        rows = self._db.execute("SELECT payload FROM pair ORDER BY iteration DESC LIMIT ?", (count,)).fetchall()
        encoding = codec.encoding_of(messages.Pair)
        return [codec.decode(messages.Pair, payload, encoding) for (payload,) in reversed(rows)]

    def next_iteration(self) -> int:
        """Return the iteration after that of the last pair; 0 without one."""
        return self._next

    def tried(self) -> list[tuple[int, int, int]]:
        """Return (note or -1, choice, iteration) of the last time that a choice was taken under a note."""
        return self._db.execute(
            "SELECT coalesce(note, -1), choice, max(iteration) FROM pair WHERE choice IS NOT NULL "
            "GROUP BY note, choice"
        ).fetchall()

    def keep_checkpoint(self, checkpoint: messages.Checkpoint) -> None:
        """Keep an evolver's last checkpoint, and of the changes only those after it."""
        with self._transaction():
            row = (checkpoint.model, codec.encode(checkpoint))
            self._db.execute("INSERT OR REPLACE INTO checkpoint VALUES (?, ?)", row)
            self._db.execute(
                "DELETE FROM step WHERE model = ? AND version <= ?", (checkpoint.model, checkpoint.version)
            )

    def checkpoint(self, model: str) -> messages.Checkpoint | None:
        """Return an evolver's last checkpoint, or None."""
        row = self._db.execute("SELECT payload FROM checkpoint WHERE model = ?", (model,)).fetchone()
        encoding = codec.encoding_of(messages.Checkpoint)
        return codec.decode(messages.Checkpoint, row[0], encoding) if row else None

    def steps(self, model: str) -> list[messages.MemoryChange]:
        """Return the changes of a model's memory since its checkpoint, in order, as far back as they are kept."""
        rows = self._db.execute("SELECT payload FROM step WHERE model = ? ORDER BY version", (model,))
        encoding = codec.encoding_of(messages.MemoryChange)
        return [codec.decode(messages.MemoryChange, payload, encoding) for (payload,) in rows]

    def last_step(self, model: str) -> messages.MemoryChange | None:
        """Return the last change of a model's memory, or None when none is kept."""
        row = self._db.execute(
            "SELECT payload FROM step WHERE model = ? ORDER BY version DESC LIMIT 1", (model,)
        ).fetchone()
        encoding = codec.encoding_of(messages.MemoryChange)
        return codec.decode(messages.MemoryChange, row[0], encoding) if row else None

    def count(self) -> int:
        """Return how many pairs are on disk."""
        return int(self._db.execute("SELECT count(*) FROM pair").fetchone()[0])

    def lowest_recalled(self) -> int:
        """Return the lowest id of a recalled pair; 0 when there is none. They count down from -1."""
        return int(self._db.execute("SELECT coalesce(min(id), 0) FROM recalled").fetchone()[0])

    def version(self, model: str) -> int:
        """Return the version of a model's short-term memory."""
        row = self._db.execute(
            "SELECT max(coalesce((SELECT max(version) FROM change WHERE model = ?1), 0), "
            "coalesce((SELECT max(version) FROM context WHERE model = ?1), 0))",
            (model,),
        ).fetchone()
        return int(row[0])

    def entries(self, model: str) -> list[Entry]:
        """Return what a model's memory holds: the newest pair of each slot, by slot."""
        rows = self._db.execute(
            "SELECT slot, newest.pair, coalesce(pair.payload, recalled.payload), version, entry_error FROM "
            "(SELECT slot, pair, max(version) AS version, entry_error FROM change WHERE model = ? GROUP BY slot) "
            "AS newest LEFT JOIN pair ON newest.pair = iteration LEFT JOIN recalled ON newest.pair = id "
            "WHERE newest.pair IS NOT NULL ORDER BY slot",
            (model,),
        )
        encoding = codec.encoding_of(messages.Pair)
        found = []
        for slot, id, payload, version, error in rows:
            if payload is None:
                raise DecodeError(f"pair {id} in the memory of {model} is missing")
            found.append(Entry(slot, id, codec.decode(messages.Pair, payload, encoding), version, error or 0.0))
        return found

    def context(self, model: str) -> Context | None:
        """Return the last beginning of a context, or None when it is still the first."""
        row = self._db.execute(
            "SELECT version, first, known FROM context WHERE model = ? ORDER BY version DESC LIMIT 1", (model,)
        ).fetchone()
        return Context(row[0], row[1], bool(row[2])) if row else None

    def seeds(self, model: str) -> list[messages.ModelWeights]:
        """Return the networks that were recalled when the present context began, the best first."""
        rows = self._db.execute("SELECT payload FROM seed WHERE model = ? ORDER BY place", (model,))
        encoding = codec.encoding_of(messages.ModelWeights)
        return [codec.decode(messages.ModelWeights, payload, encoding) for (payload,) in rows]

    def errors(self, model: str, after: int) -> list[tuple[int, float]]:
        """Return (version, error on the pair before it was learnt) of the inserts after a version, in order."""
        rows = self._db.execute(
            "SELECT version, entry_error FROM change WHERE model = ? AND version > ? AND entry_error IS NOT NULL "
            "ORDER BY version",
            (model, after),
        )
        return [(int(version), float(error)) for version, error in rows]

    def keep_models(self, models: Iterable[messages.CurrentModel]) -> None:
        """Keep the last current model of each name."""
        with self._transaction():
            self._keep(models)

    def _keep(self, models: Iterable[messages.CurrentModel]) -> None:
        rows = [(model.model, codec.encode(model)) for model in models]
        self._db.executemany("INSERT OR REPLACE INTO model VALUES (?, ?)", rows)

    def models(self) -> dict[str, messages.CurrentModel]:
        """Return the kept models by name."""
        encoding = codec.encoding_of(messages.CurrentModel)
        rows = self._db.execute("SELECT name, payload FROM model")
        return {name: codec.decode(messages.CurrentModel, payload, encoding) for name, payload in rows}

    def keep_long_term(self, models: Iterable[messages.LongTermModel]) -> None:
        """Store models in the long-term memory, in the place of those with the same model's name and id."""
        rows = [(model.model, model.id, codec.encode(model)) for model in models]
        self._db.executemany("INSERT OR REPLACE INTO long_term VALUES (?, ?, ?)", rows)

    def long_term(self, model: str | None = None) -> list[messages.LongTermModel]:
        """Return the long-term memory, of one model or of all, by model and id."""
        encoding = codec.encoding_of(messages.LongTermModel)
        rows = self._db.execute("SELECT model, payload FROM long_term ORDER BY model, id").fetchall()
        return [
            codec.decode(messages.LongTermModel, payload, encoding) for name, payload in rows if model in (None, name)
        ]

    def close(self) -> None:
        """Close the file."""
        self._db.close()
        self._lock.close()
