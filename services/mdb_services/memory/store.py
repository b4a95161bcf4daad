"""The memory store: pairs on disk before they are acknowledged, the memories of each model, the last models.

Owns the service around `file` (what is on disk) and `model_memory` (what a pair does). Never evolves.
A pair enters the memory of every model whose inputs and outputs it holds (paper, section 3: without a
teacher the communication model's memory stands still). After a restart everything is as it was acknowledged.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable
from itertools import chain, count
from typing import NamedTuple

import numpy as np
import structlog

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus, Publisher
from mdb_protocol.errors import DecodeError
from mdb_services.experiment.brain import BrainConfig
from mdb_services.mechanism.feedback.praise import LATELY
from mdb_services.mechanism.networks.network import Network
from mdb_services.memory.file import Effects, MemoryFile
from mdb_services.memory.model_memory import ModelMemory
from mdb_services.shell.elsewhere import Elsewhere
from mdb_services.shell.facts import facts_of

log = structlog.get_logger()

ROLE = "memory"
FAR = 100
"""Pairs that may be on their way together and overtake one another."""
KEPT_WITHIN_S = 1.0
"""Models are written with the next pair, for which they were learnt; this long after they came if there is none."""
STEP_S = 0.5
"""After this queries are answered and the heart beats, though pairs wait: many wait for a store that was dead."""
RETRY_S = 1.0
"""How often a disk that takes nothing is tried again."""


class _Waiting(NamedTuple):
    """A pair that waits for its models or for the disk, and since when."""

    pair: messages.Pair
    since_s: float


class MemoryStore:
    """See the module's docstring."""

    role, instance = ROLE, "store"

    def __init__(
        self, bus: Bus, config: BrainConfig, file: MemoryFile, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Take over what the file holds; MdbError when it is damaged or of another experiment."""
        self.bus = bus
        self._file, self._config = file, config
        self._clock, self._patience_s = clock, config.optimizer.lockstep_patience_s
        self._lockstep = config.lockstep
        self._memories: dict[str, ModelMemory] = {}
        self._kept: dict[str, messages.CurrentModel] = {}
        self._unkept: dict[str, messages.CurrentModel] = {}
        """Those that are not on disk yet; `_unkept_s` is when the first of them came."""
        self._unkept_s = 0.0
        self._duplicates = 0
        self._elsewhere = Elsewhere()
        self._waiting: _Waiting | None = None
        self._retry_s = 0.0
        """When to write again after the disk took nothing; 0 while it does."""
        self._unwritten = 0
        self._gave_up = 0
        self._restore()
        if pairs := file.count():
            log.info("memory restored", pairs=pairs, models=sorted(self._kept))
        self._begin()
        self._changes = {name: bus.publisher(keys.MEMORY_CHANGE, model=name) for name in self._memories}
        self._contexts = {name: bus.publisher(keys.CONTEXT, model=name) for name in self._memories}
        self._stored: Publisher = bus.publisher(keys.PAIR_STORED)
        bus.queryable(keys.PROGRESS, self._progress)
        for name in self._memories:
            bus.queryable(keys.RESUME, lambda name=name: self._resume(name), model=name)  # type: ignore[misc]
            bus.queryable(keys.MEMORY_SNAPSHOT, lambda name=name: self._memories[name].snapshot(), model=name)  # type: ignore[misc]
            bus.queryable(keys.KEPT_MODEL, lambda name=name: self._kept.get(name), model=name)  # type: ignore[misc]
        self._checkpoints = [bus.subscriber(keys.CHECKPOINT, model=name) for name in self._memories]
        self._models = bus.subscriber(keys.CURRENT_MODEL)
        self._pairs = bus.subscriber(keys.PAIR)
        self._repeat()

    def _repeat(self) -> None:
        """Publish each memory's last change again: it may be on disk only, if we died in between."""
        for name, publisher in self._changes.items():
            if (change := self._file.last_step(name)) is not None:
                publisher.put(change)

    def _restore(self) -> None:
        """Make the memories as they are on disk; models stay that came and are not there yet."""
        newest = list(self._kept.values())
        self._memories = {section.name: ModelMemory(self._config, section) for section in self._config.model}
        try:
            for memory in self._memories.values():
                memory.restore(self._file)
            for model in (*self._file.models().values(), *newest):
                self._remember(model)
            self._recalled_ids = count(self._file.lowest_recalled() - 1, -1)
        except (sqlite3.Error, DecodeError, TypeError, ValueError) as error:
            raise self._file.unusable(error) from error

    def _begin(self) -> None:
        """Take back models that were brought from another run, before the first pair."""
        for memory in self._memories.values():
            effects = memory.begin(self._recalled_ids)
            if effects is not None:
                self._file.begin(effects)
                log.info("beginning with a model of another run", model=memory.name)

    def step(self) -> bool:
        """Take the newest models, then every pair that has come, or those for which there is time."""
        began_s = self._clock()
        models = list(self._models.some())
        newest = {model.model: model for model in models if self._remember(model)}
        moved = bool(models)
        if newest and not self._unkept:
            self._unkept_s = began_s
        self._unkept |= newest
        if self._unkept and began_s - self._unkept_s > KEPT_WITHIN_S:
            self._written(self._keep_models)
        for inbox in self._checkpoints:
            for checkpoint in inbox.some():
                moved = True
                self._written(lambda checkpoint=checkpoint: self._keep(checkpoint))  # type: ignore[misc]
        for pair in chain([] if self._waiting is None else [self._waiting.pair], self._pairs.some()):
            if not self._could_be(pair):
                continue
            if not self._is_due(pair):
                break
            if not self._written(lambda pair=pair: self._store(pair)):  # type: ignore[misc]
                self._waiting = _Waiting(pair, self._clock())
                break
            self._waiting = None
            moved = True
            if self._clock() - began_s > STEP_S:
                break
        return moved

    def _could_be(self, pair: messages.Pair) -> bool:
        """Whether this brain could have made a pair; what is not of this experiment is refused.

        So is one from far ahead, unless it comes again and again, and no nearer one: then those between are lost.
        """
        iterations = self._config.experiment.iterations
        due = self._file.next_iteration()
        if pair.iteration < iterations and self._config.allows(pair.action, pair.choice):
            if due <= pair.iteration <= due + FAR:
                self._elsewhere.nearer()
            if pair.iteration <= due + FAR or self._elsewhere.believed(pair.iteration, self._clock()):
                return True
        reason = (
            f"pair {pair.iteration} with action {pair.action}, choice {pair.choice}; due is {due} of {iterations}, "
            "and the action is to be one of the experiment's"
        )
        self.bus.refusals.add(keys.PAIR.path, reason)
        return False

    def _written(self, write: Callable[[], None]) -> bool:
        """Write, unless the disk takes nothing: then say so once, and try again only after a while.

        A pair is not acknowledged before it is on disk, so that nothing is lost without a word.
        """
        if self._clock() < self._retry_s:
            return False
        try:
            self._file.check_place()
            write()
        except (sqlite3.OperationalError, OSError) as error:
            if not self._retry_s:
                log.error("cannot write to disk; trying again", every_s=RETRY_S, reason=str(error))
            self._unwritten += 1
            self._retry_s = self._clock() + RETRY_S
            return False
        if self._retry_s:
            log.info("writing to disk again", failures=self._unwritten)
            self._retry_s = 0.0
        return True

    def _keep_models(self) -> None:
        self._file.keep_models(self._unkept.values())
        self._unkept.clear()

    def _keep(self, checkpoint: messages.Checkpoint) -> None:
        """Keep a checkpoint, unless it is of a memory that is not (yet) on disk."""
        memory = self._memories.get(checkpoint.model)
        if memory is not None and checkpoint.version <= memory.stm.version:
            self._file.keep_checkpoint(checkpoint)

    def _resume(self, name: str) -> messages.Resume:
        return messages.Resume(
            model=name,
            checkpoint=self._file.checkpoint(name),
            changes=self._file.steps(name),
            memory=self._memories[name].snapshot(),
        )

    def _progress(self) -> messages.Progress:
        notes, choices, iterations = np.array(self._file.tried(), dtype=np.int64).reshape(-1, 3).T
        window = self._config.optimizer.feedback_window
        newest = self._file.newest(window + LATELY)
        return messages.Progress(
            iteration=self._file.next_iteration(),
            versions={name: memory.stm.version for name, memory in self._memories.items()},
            unjudged=[pair for pair in newest[-window:] if pair.feedback is None],
            judged=[pair for pair in newest if pair.feedback is not None],
            notes=notes,
            choices=choices,
            iterations=iterations,
        )

    def _is_due(self, pair: messages.Pair) -> bool:
        """Whether to store a pair now: its models are there, or it has waited for them long enough."""
        if self._has_models_of(pair):
            return True
        if self._waiting is None:
            self._waiting = _Waiting(pair, self._clock())
        if self._clock() - self._waiting.since_s < self._patience_s:
            return False
        self._gave_up += 1
        log.warning("models did not come in time", iteration=pair.iteration, patience_s=self._patience_s)
        return True

    def _has_models_of(self, pair: messages.Pair) -> bool:
        """Whether the models that a pair is to be held against have come (lockstep: same errors every run).

        They are those that the optimizer acted upon, which had learnt all that was stored. When feedback comes late,
        other pairs have been stored since: then they are those that have learnt these, too.
        """
        if not self._lockstep:
            return True
        have = {name: model.version for name, model in self._kept.items()}
        stored = self._file.stored(pair.iteration)
        late = stored is not None and not stored.judged and pair.feedback is not None
        now = {name: memory.stm.version for name, memory in self._memories.items()}
        awaited = now if late else pair.versions
        return all(have.get(name, 0) >= version for name, version in awaited.items() if name in self._memories)

    def _remember(self, model: messages.CurrentModel) -> bool:
        memory = self._memories.get(model.model)
        if memory is None:
            return False
        try:
            network = Network.from_arrays(model.layers, model.weights)
        except ValueError as error:
            self.bus.refusals.add(keys.CURRENT_MODEL.path, str(error))
            return False
        if (misfit := memory.codebook.misfit(network.sizes)) is not None:
            self.bus.refusals.add(keys.CURRENT_MODEL.path, f"model {model.model}: {misfit}")
            return False
        memory.take(network, model.version)
        self._kept[model.model] = model
        return True

    def _store(self, pair: messages.Pair) -> None:
        stored = self._file.stored(pair.iteration)
        unjudged = self._file.pair(pair.iteration) if stored and not stored.judged else None
        if stored is not None and (unjudged is None or pair.feedback is None):
            self._duplicates += 1
            self._stored.put(stored)
            return
        try:
            effects, stored = self._enter(pair, unjudged)
        except BaseException:  # what is not on disk must not be in memory either
            self._restore()
            raise
        for effect in effects:
            for change in effect.changes:
                self._changes[change.model].put(change)
            for event in effect.events:
                self._contexts[event.model].put(event)
        self._stored.put(stored)

    def _enter(
        self, pair: messages.Pair, unjudged: messages.Pair | None
    ) -> tuple[list[Effects], messages.PairStored]:
        """Put a pair into the memories, while anything is learnt, and on disk.

        `unjudged`: as it is there already, before its feedback came.
        """
        until = self._config.store.learns_until
        learnt = until is None or pair.iteration < until
        memories = [m for m in self._memories.values() if learnt and (unjudged is None or not m.reads(unjudged))]
        facts = facts_of(pair)
        entered = (memory.enter(pair, facts, self._recalled_ids) for memory in memories)
        effects = [effect for effect in entered if effect is not None]
        versions = {name: memory.stm.version for name, memory in self._memories.items()}
        judged = pair.feedback is not None
        stored = messages.PairStored(iteration=pair.iteration, versions=versions, judged=judged)
        self._file.add(pair, stored, effects, self._unkept.values())
        self._unkept.clear()
        return effects, stored

    def values(self) -> dict[str, float]:
        """Pairs on disk, duplicates, waits given up, whether the disk refuses to write, each model's memories and how
        many versions it is behind its memory."""
        counts = {"duplicates": float(self._duplicates), "gave_up.models": float(self._gave_up)}
        counts |= {"unwritten": float(self._unwritten), "disk_refuses": float(self._retry_s > 0)}
        memories = [memory.values() for memory in self._memories.values()]
        have = {name: model.version for name, model in self._kept.items()}
        for name, memory in self._memories.items():
            counts[f"behind.{name}"] = float(max(memory.stm.version - have.get(name, 0), 0))
        return {"pairs": float(self._file.count()), **counts, **{k: v for m in memories for k, v in m.items()}}

    def close(self) -> None:
        """Write the models that are not on disk yet, and close the file."""
        if self._unkept:
            self._written(self._keep_models)
        self._file.close()
