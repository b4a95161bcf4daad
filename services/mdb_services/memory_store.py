"""The memory store: pairs on disk before they are acknowledged, one short-term memory a model, last models.

Owns `memory.sqlite` of a run (write-ahead log) and decides what each short-term memory keeps. Never evolves.
A pair enters the memory of every model whose inputs and outputs it holds (paper, section 3: without a
teacher the communication model's memory stands still). After a restart everything is as it was acknowledged.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import structlog

from mdb_protocol import codec, keys, messages
from mdb_protocol.bus import Bus, Publisher
from mdb_protocol.errors import DecodeError, MdbError
from mdb_services.config import BrainConfig, ModelSection
from mdb_services.mechanism.encoding import Codebook, gather
from mdb_services.mechanism.network import Network
from mdb_services.mechanism.stm import ShortTermMemory

log = structlog.get_logger()

ROLE = "memory"

SCHEMA = """
CREATE TABLE IF NOT EXISTS pair (iteration INTEGER PRIMARY KEY, payload BLOB NOT NULL, stored BLOB NOT NULL);
CREATE TABLE IF NOT EXISTS change (
    model TEXT, version INTEGER, pair INTEGER, entry_error REAL, slot INTEGER, PRIMARY KEY (model, version)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS model (name TEXT PRIMARY KEY, payload BLOB NOT NULL) WITHOUT ROWID;
"""


class Entry(NamedTuple):
    """A slot of a short-term memory on disk: the pair in it, since which version, the model's error on it then."""

    slot: int
    pair: messages.Pair
    version: int
    error: float


class PairFile:
    """The SQLite file: pairs, what each did to the memories, and the last current models."""

    def __init__(self, path: Path) -> None:
        """Open or create; MdbError when the file is not a usable database."""
        self._path = path
        try:
            self._db = sqlite3.connect(path, isolation_level=None)
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute("PRAGMA synchronous=NORMAL")
            self._db.executescript(SCHEMA)
        except sqlite3.Error as error:
            raise self.unusable(error) from error

    def unusable(self, error: Exception) -> MdbError:
        """Return the error that says what is wrong with the file and what to do."""
        return MdbError(
            f"{self._path} cannot be used as the memory's database: {error}. Move it away to start with an empty "
            "memory, or give another run folder"
        )

    def add(
        self,
        pair: messages.Pair,
        stored: messages.PairStored,
        changes: list[messages.MemoryChange],
        errors: list[float],
    ) -> None:
        """Write a pair with its acknowledgement and changes in one transaction."""
        self._db.execute("BEGIN IMMEDIATE")
        try:
            row = (pair.iteration, codec.encode(pair), codec.encode(stored))
            self._db.execute("INSERT INTO pair VALUES (?, ?, ?)", row)
            self._db.executemany(
                "INSERT INTO change VALUES (?, ?, ?, ?, ?)",
                [(c.model, c.version, c.pair, e, c.slot) for c, e in zip(changes, errors, strict=True)],
            )
            self._db.execute("COMMIT")
        except BaseException:
            if self._db.in_transaction:  # a full disk has ended it already
                self._db.execute("ROLLBACK")
            raise

    def stored(self, iteration: int) -> messages.PairStored | None:
        """Return the acknowledgement of a pair that is on disk, or None."""
        row = self._db.execute("SELECT stored FROM pair WHERE iteration = ?", (iteration,)).fetchone()
        encoding = codec.encoding_of(messages.PairStored)
        return codec.decode(messages.PairStored, row[0], encoding) if row else None

    def count(self) -> int:
        """Return how many pairs are on disk."""
        return int(self._db.execute("SELECT count(*) FROM pair").fetchone()[0])

    def entries(self, model: str) -> list[Entry]:
        """Return what a model's memory holds: the newest pair of each slot, by slot."""
        rows = self._db.execute(
            "SELECT slot, payload, max(version), entry_error FROM change JOIN pair ON change.pair = pair.iteration "
            "WHERE model = ? GROUP BY slot ORDER BY slot",
            (model,),
        )
        encoding = codec.encoding_of(messages.Pair)
        return [
            Entry(slot, codec.decode(messages.Pair, payload, encoding), version, error)
            for slot, payload, version, error in rows
        ]

    def keep_model(self, model: messages.CurrentModel) -> None:
        """Keep the last current model of a name."""
        self._db.execute("INSERT OR REPLACE INTO model VALUES (?, ?)", (model.model, codec.encode(model)))

    def models(self) -> dict[str, messages.CurrentModel]:
        """Return the kept models by name."""
        encoding = codec.encoding_of(messages.CurrentModel)
        rows = self._db.execute("SELECT name, payload FROM model")
        return {name: codec.decode(messages.CurrentModel, payload, encoding) for name, payload in rows}

    def close(self) -> None:
        """Close the file."""
        self._db.close()


class ModelMemory:
    """The short-term memory of one model, with the codebook that makes its rows."""

    def __init__(self, config: BrainConfig, section: ModelSection) -> None:
        self.name = section.name
        self.codebook = Codebook(config.variables(), section.inputs, section.outputs)
        self._rule = config.memory_of(section)
        self.stm = ShortTermMemory(section.capacity, self.codebook.width, len(section.outputs), self._rule)
        self.network: Network | None = None

    def restore(self, entries: list[Entry]) -> None:
        """Take over what was on disk; ValueError when it is not of a memory like this one."""
        if not entries:
            return
        rows = [self._rows(entry.pair) for entry in entries]
        known = [row for row in rows if row is not None]
        if len(known) < len(rows) or [entry.slot for entry in entries] != list(range(len(entries))):
            raise ValueError(f"its pairs do not fit model {self.name}: they are of another experiment")
        versions = np.array([entry.version for entry in entries])
        self.stm.restore(
            {
                "inputs": np.concatenate([inputs for inputs, _ in known]),
                "targets": np.concatenate([targets for _, targets in known]),
                "ids": np.array([entry.pair.iteration for entry in entries]),
                "orders": versions,
                "entry_errors": np.array([entry.error for entry in entries]),
                "version": versions.max(),
            }
        )

    def _rows(self, pair: messages.Pair) -> tuple[np.ndarray, np.ndarray] | None:
        facts = gather(
            before=pair.before, after=pair.after, note=pair.note, action=pair.action, feedback=pair.feedback
        )
        inputs, targets = self.codebook.input_rows(facts), self.codebook.target_rows(facts)
        return None if inputs is None or targets is None else (inputs, targets)

    def enter(self, pair: messages.Pair) -> tuple[messages.MemoryChange, float] | None:
        """Insert a pair; return the change and the model's error on it, None when it lacks a variable."""
        rows = self._rows(pair)
        if rows is None:
            return None
        inputs, targets = rows
        error = self._errors(inputs, targets)[0]
        errors_now = self._errors(*self.stm.arrays()[:2]) if self._rule.current_error else None
        change = self.stm.insert(pair.iteration, inputs[0], targets[0], float(error), errors_now)
        if change is None:
            return None
        message = messages.MemoryChange(
            model=self.name,
            version=change.version,
            slot=change.slot,
            pair=change.id,
            evicted=change.evicted_id,
            inputs=inputs[0],
            targets=targets[0],
        )
        return message, float(error)

    def _errors(self, inputs: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Return the current model's mean squared error on each row (n,); 0 without a model."""
        if self.network is None or not len(inputs):
            return np.zeros(len(inputs), np.float32)
        errors: np.ndarray = np.square(self.network.predict(inputs) - targets).mean(axis=1)
        return errors

    def snapshot(self) -> messages.MemorySnapshot:
        """Return the whole memory as a message."""
        inputs, targets, ids = self.stm.arrays()
        pairs = np.ascontiguousarray(ids, dtype=np.int64)
        return messages.MemorySnapshot(
            model=self.name, version=self.stm.version, pairs=pairs, inputs=inputs, targets=targets
        )


class MemoryStore:
    """See the module's docstring."""

    role, instance = ROLE, "store"

    def __init__(
        self, bus: Bus, config: BrainConfig, file: PairFile, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Take over what the file holds; MdbError when it is damaged or of another experiment."""
        self.bus = bus
        self._file = file
        self._clock, self._patience_s = clock, config.optimizer.lockstep_patience_s
        self._lockstep = config.lockstep
        self._memories = {section.name: ModelMemory(config, section) for section in config.model}
        self._kept: dict[str, messages.CurrentModel] = {}
        self._duplicates = 0
        self._waiting: messages.Pair | None = None
        self._waiting_since_s = 0.0
        self._gave_up = 0
        self._restore()
        self._changes = {name: bus.publisher(keys.MEMORY_CHANGE, model=name) for name in self._memories}
        self._stored: Publisher = bus.publisher(keys.PAIR_STORED)
        for name, memory in self._memories.items():
            bus.queryable(keys.MEMORY_SNAPSHOT, memory.snapshot, model=name)
            bus.queryable(keys.KEPT_MODEL, lambda name=name: self._kept.get(name), model=name)  # type: ignore[misc]
        self._models = bus.subscriber(keys.CURRENT_MODEL)
        self._pairs = bus.subscriber(keys.PAIR)

    def _restore(self) -> None:
        try:
            for name, memory in self._memories.items():
                memory.restore(self._file.entries(name))
            for model in self._file.models().values():
                self._remember(model)
            count = self._file.count()
        except (sqlite3.Error, DecodeError, ValueError) as error:
            raise self._file.unusable(error) from error
        if count:
            log.info("memory restored", pairs=count, models=sorted(self._kept))

    def step(self) -> bool:
        """Take the newest models, then every pair that has come."""
        moved = False
        while (model := self._models.take()) is not None:
            moved = True
            if model.model in self._memories and self._remember(model):
                self._file.keep_model(model)
        while (pair := self._waiting or self._pairs.take()) is not None:
            if not self._is_due(pair):
                break
            self._waiting = None
            self._store(pair)
            moved = True
        return moved

    def _is_due(self, pair: messages.Pair) -> bool:
        """Whether to store a pair now: its models are there, or it has waited for them long enough."""
        if self._has_models_of(pair):
            return True
        if self._waiting is None:
            self._waiting, self._waiting_since_s = pair, self._clock()
        if self._clock() - self._waiting_since_s < self._patience_s:
            return False
        self._gave_up += 1
        log.warning("waited in vain for the models of a pair", iteration=pair.iteration, patience_s=self._patience_s)
        return True

    def _has_models_of(self, pair: messages.Pair) -> bool:
        """Whether the models that the optimizer acted upon have come (lockstep: same errors every run)."""
        if not self._lockstep:
            return True
        have = {name: model.version for name, model in self._kept.items()}
        return all(have.get(name, 0) >= version for name, version in pair.versions.items() if name in self._memories)

    def _remember(self, model: messages.CurrentModel) -> bool:
        memory = self._memories.get(model.model)
        if memory is None:
            return False
        try:
            network = Network.from_arrays(model.layers, model.weights)
        except ValueError as error:
            self.bus.refusals.add(keys.CURRENT_MODEL.path, str(error))
            return False
        if (network.sizes[0], network.sizes[-1]) != (memory.codebook.width, len(memory.codebook.outputs)):
            self.bus.refusals.add(keys.CURRENT_MODEL.path, f"model {model.model} has layers {model.layers}")
            return False
        memory.network = network
        self._kept[model.model] = model
        return True

    def _store(self, pair: messages.Pair) -> None:
        stored = self._file.stored(pair.iteration)
        if stored is not None:
            self._duplicates += 1
            self._stored.put(stored)
            return
        states = {name: memory.stm.state() for name, memory in self._memories.items()}
        try:
            changes, stored = self._enter(pair)
        except BaseException:  # what is not on disk must not be in memory either
            for name, state in states.items():
                self._memories[name].stm.restore(state)
            raise
        for change in changes:
            self._changes[change.model].put(change)
        self._stored.put(stored)

    def _enter(self, pair: messages.Pair) -> tuple[list[messages.MemoryChange], messages.PairStored]:
        """Put a pair into the memories and on disk."""
        entered = [done for memory in self._memories.values() if (done := memory.enter(pair)) is not None]
        changes, errors = [change for change, _ in entered], [error for _, error in entered]
        versions = {name: memory.stm.version for name, memory in self._memories.items()}
        stored = messages.PairStored(iteration=pair.iteration, versions=versions)
        self._file.add(pair, stored, changes, errors)
        return changes, stored

    def values(self) -> dict[str, float]:
        """Pairs on disk, duplicates refused, waits given up, and each memory's version."""
        versions = {f"version.{name}": float(memory.stm.version) for name, memory in self._memories.items()}
        counts = {"duplicates": float(self._duplicates), "gave_up.models": float(self._gave_up)}
        return {"pairs": float(self._file.count()), **counts, **versions}

    def close(self) -> None:
        """Close the file."""
        self._file.close()
