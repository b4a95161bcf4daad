"""Memory files read, and never written: of a run that goes on, of another user, on a disk that takes nothing, of
anybody who sends one.

Owns how SQLite is kept from writing, and within bounds. An SQLite file is a program, too: views and triggers in it
are run by who asks for a table, its pages can name one another for ever. So the tables must be tables, no statement
may take longer than `MOST_S` of processor time, and no more may come out of a file than is in it.
"""

from __future__ import annotations

import sqlite3
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from mdb_protocol import codec, files
from mdb_protocol.errors import DamageError

Row = tuple[Any, ...]

TABLES = ("pair", "recalled", "change", "context", "seed", "model", "checkpoint", "step", "long_term")
"""What a memory file consists of; what else somebody has put into one is not looked at."""

MOST_FILE = 2 * 2**30
"""Bytes of a memory file, or of its write-ahead log; 10^5 iterations of the paper's experiment have 0.2 GB."""
MOST_VALUE = codec.MAX_BYTES + 2**20
"""Bytes of one value, or of one row: a message and its names."""
MOST_S = 1.0
"""Processor time of one statement."""
TABLES_S = 0.25
"""Processor time to find out which tables there are."""
LOOKS = 10_000
"""Instructions of SQLite between two looks at the clock."""
ROW_BYTES = 4
"""The least that a row takes of a file, whatever is in it."""
SALT = 32
"""Bytes of the head of a write-ahead log. It is another one once the log begins anew."""
COPIES = 20
"""So often a file is copied while its run goes on, until the log has not begun anew meanwhile."""


class Reader:
    """A memory file that is open for reading; closed by who opened it, see `opened`."""

    def __init__(self, db: sqlite3.Connection, path: Path, bytes_: int) -> None:
        self._db, self._path = db, path
        self.bytes = bytes_
        """Of the file with its write-ahead log."""
        self._until_s = time.process_time() + TABLES_S
        self.spent_s = 0.0
        """Processor time of all statements."""
        guard(db)
        db.set_progress_handler(lambda: time.process_time() > self._until_s, LOOKS)

    def rows(self, sql: str, *given: object) -> Iterator[Row]:
        """Yield the rows of a query; DamageError when it takes too long, or there is more than the file has room for.

        sqlite3.Error when SQLite cannot read it.
        """
        left = self.bytes
        began_s = time.process_time()
        self._until_s = began_s + MOST_S
        try:
            for row in self._db.execute(sql, given):
                left -= ROW_BYTES + sum(len(value) for value in row if isinstance(value, str | bytes))
                if left < 0:
                    raise self._damaged("more comes out of it than is in it")
                given_s = time.process_time()
                yield row
                used_s = time.process_time() - given_s  # by its reader, which is no time of the statement
                began_s, self._until_s = began_s + used_s, self._until_s + used_s
        except sqlite3.OperationalError as error:
            if code_of(error) == sqlite3.SQLITE_INTERRUPT:
                raise self._damaged(f"reading takes longer than {MOST_S:g} s of processor time") from error
            raise
        except sqlite3.DataError as error:  # longer than `MOST_VALUE`
            raise self._damaged(error) from error
        finally:
            self.spent_s += time.process_time() - began_s

    def _damaged(self, reason: object) -> DamageError:
        return DamageError(f"{self._path} is not a memory of a brain, or is damaged: {reason}")


def code_of(error: sqlite3.Error) -> int:
    """Return SQLite's word for an error; that of damage for what Python itself refuses, as a text that is none."""
    code: int = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT)
    return code & 0xFF


def guard(db: sqlite3.Connection) -> None:
    """Let a database's own text run nothing, and no value be larger than any of ours."""
    db.execute("PRAGMA trusted_schema=OFF")
    db.execute("PRAGMA cell_size_check=ON")
    db.execute("PRAGMA mmap_size=0")
    db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_VALUE)
    db.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)


def foreign(db: sqlite3.Connection) -> str | None:
    """Return what of a database would be run when it is read or written to: a view or virtual table in the place of
    a table, columns that are calculated, a trigger; or None.

    sqlite3.Error when the file cannot be read.
    """
    for kind, name, sql in db.execute("SELECT type, lower(name), coalesce(sql, '') FROM sqlite_schema"):
        if kind == "trigger":
            return f"it has a trigger, {name!r}, which no memory has"
        if name not in TABLES:
            continue
        if kind != "table" or sql[:14].upper() == "CREATE VIRTUAL":
            return f"{name!r} in it is a {'virtual table' if kind == 'table' else kind}; expected a table"
        hidden = db.execute("SELECT name FROM pragma_table_xinfo(?) WHERE hidden", (name,)).fetchone()
        if hidden is not None:
            return f"{hidden[0]!r} in its table {name!r} is calculated; expected a column"
    return None


@contextmanager
def bounded(db: sqlite3.Connection, most_s: float) -> Iterator[None]:
    """Interrupt what a database is asked within, when it takes more processor time than that."""
    until_s = time.process_time() + most_s
    db.set_progress_handler(lambda: time.process_time() > until_s, LOOKS)
    try:
        yield
    finally:
        db.set_progress_handler(None, 0)


@contextmanager
def opened(path: Path) -> Iterator[Reader]:
    """Open a memory file for reading, as it is now; nothing beside it is made or touched.

    Where its newest is still in its write-ahead log, that is of a run that goes on or was killed, a copy is read.
    Raises DamageError for what is no memory file, OSError when it cannot be read.
    """
    with files.opened(path, MOST_FILE), tempfile.TemporaryDirectory(prefix="mdb-") as folder:
        if _head(log_of(path)):
            copied = Path(folder) / "memory"
            copy(path, copied)
            db, bytes_ = sqlite3.connect(copied, isolation_level=None), held(copied)
        else:
            where = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
            db, bytes_ = sqlite3.connect(where, uri=True, isolation_level=None), held(path)
        with closing(db):
            try:
                reader = Reader(db, path, bytes_)
                reason = foreign(db)
            except sqlite3.Error as error:
                why = "too many tables" if code_of(error) == sqlite3.SQLITE_INTERRUPT else error
                raise DamageError(f"{path} is not a memory of a brain, or is damaged: {why}") from error
            if reason is not None:
                raise DamageError(f"{path} is not a memory of a brain: {reason}")
            yield reader


def held(path: Path) -> int:
    """Return how many bytes a memory file has with its write-ahead log."""
    return sum(part.stat().st_size for part in (path, log_of(path)) if part.is_file())


def log_of(path: Path) -> Path:
    """Return where the write-ahead log of a memory file is, if it has one."""
    return path.with_name(f"{path.name}-wal")


def copy(path: Path, to: Path) -> None:
    """Copy a memory file with its write-ahead log as they are at one moment, also while the run goes on.

    What is written into the file meanwhile is in the log as well, unless that has begun anew: then again. A file that
    is always busy is taken as it comes; what does not fit together shows when it is read.
    """
    for _ in range(COPIES):
        before = _head(log_of(path))
        for old in (to, log_of(to)):
            old.unlink(missing_ok=True)
        files.copy(path, to, MOST_FILE)
        if before:
            files.copy(log_of(path), log_of(to), MOST_FILE)
        if _head(log_of(path)) == before:
            return


def _head(log: Path) -> bytes:
    """Return the head of a write-ahead log; nothing when there is none, or nothing in it."""
    try:
        with files.opened(log, MOST_FILE) as file:
            return file.read(SALT)
    except FileNotFoundError:
        return b""
