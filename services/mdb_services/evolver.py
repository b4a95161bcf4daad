"""An evolver: one population for one model, a few generations for each version of its short-term memory.

Owns the population of one world or satisfaction model; publishes its best as the current model. Never acts.
Now and then it gives the memory store a checkpoint, all from which it goes on: a restarted evolver takes that and
the changes of its memory since. In lockstep it then is, value by value, the one that died.
"""

from __future__ import annotations

import time
from collections import deque
from itertools import pairwise

import numpy as np
import structlog

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus
from mdb_protocol.codec import MAX_BYTES
from mdb_protocol.errors import ConfigError, QueryError
from mdb_services.experiment.brain import BrainConfig
from mdb_services.mechanism.evolution import native
from mdb_services.mechanism.learners import Best, Learner, make_learner
from mdb_services.mechanism.memories.stm import Change, MemoryMirror, VersionGapError
from mdb_services.mechanism.networks.encoding import Codebook
from mdb_services.mechanism.networks.network import Floats, Network, Shape
from mdb_services.shell.heartbeat import COMPILE_S, SILENT_S
from mdb_services.shell.snapshot import snapshot_of

log = structlog.get_logger()

ROLE = "evolver"
QUERY_S = 2.0
"""Bound on asking the memory store; without an answer the next step asks again."""
SLOWER = 20.0
"""A version may take so many times longer to learn than any before it: a fuller memory, a busier machine."""


def _learner_of(config: BrainConfig, model: str, shape: Shape) -> Learner:
    section = config.model_named(model)
    name, settings = config.learner_of(section)
    try:
        return make_learner(name, shape, settings, config.experiment.seed, f"{ROLE}/{model}", members=section.members)
    except ModuleNotFoundError as error:
        raise ConfigError(str(error)) from error


class Evolver:
    """See the module's docstring; `step` does at most one version's generations."""

    role = ROLE

    def __init__(self, bus: Bus, config: BrainConfig, model: str) -> None:
        """Build the evolver of the model named `model`; ConfigError when the file has none of that name."""
        section = config.model_named(model)
        codebook = Codebook(config.variables(), section.inputs, section.outputs)
        self.bus, self.instance = bus, model
        shape = Shape(codebook.width, section.hidden, codebook.output_width)
        self._learner = _learner_of(config, model, shape)
        native.load()  # so that no first memory version waits for a compiler
        self._lockstep = config.lockstep
        self._tells_support = config.is_supported(model)
        self._mirror = MemoryMirror(section.capacity, shape.inputs, shape.outputs)
        self._learnt_version = 0
        self._generations = 0
        self._error = 0.0
        self._step_s = self._longest_s = 0.0
        self._joined = False
        self._ahead = 0
        """The version of a change that did not follow, for which the memory store is asked; 0 when there is none."""
        self._missed: deque[messages.MemoryChange] = deque()
        self._every = config.evolver.checkpoint_every
        self._kept_version = 0
        self._checkpoints = bus.publisher(keys.CHECKPOINT, model=model)
        self._publisher = bus.publisher(keys.CURRENT_MODEL, model=model)
        self._changes = bus.subscriber(keys.MEMORY_CHANGE, model=model)

    def step(self) -> bool:
        """Follow the memory; when it has a version not learnt yet, learn it and publish the best."""
        if not self._joined:
            self._joined = self._join()
            return self._joined
        moved = False
        while (change := self._next()) is not None:
            moved = True
            self._follow(change)
            if self._lockstep and self._mirror.version > self._learnt_version:
                break  # every version gets its own generations
        if self._mirror.version > self._learnt_version:
            self._learn()
            moved = True
        return moved

    def _next(self) -> messages.MemoryChange | None:
        """Return the next change: first what was missed, then what comes."""
        if self._missed:
            return self._missed.popleft()
        change: messages.MemoryChange | None = self._changes.take()
        return change

    def _join(self) -> bool:
        """Go on from what the memory store has: the last checkpoint and the changes since, or the memory as it is."""
        try:
            answers: list[messages.Resume] = self.bus.query(keys.RESUME, QUERY_S, model=self.instance)
            if not answers:
                return False
            if self._ahead > answers[0].memory.version:
                reason = f"change to version {self._ahead}; the memory has {answers[0].memory.version}"
                self.bus.refusals.add(keys.MEMORY_CHANGE.path, reason)
            elif self._ahead:
                log.info("missed a change; took the whole memory", model=self.instance, version=self._ahead)
            self._ahead = 0
            self._resume(answers[0])
        except (QueryError, ValueError) as error:
            self.bus.refusals.add(keys.RESUME.path, f"no usable memory; asking again: {error}")
            return False
        return True

    def _resume(self, resume: messages.Resume) -> None:
        restored = not self._mirror.version and resume.checkpoint is not None and self._restore(resume.checkpoint)
        self._missed.clear()
        changes = [change for change in resume.changes if change.version > self._mirror.version]
        versions = [self._mirror.version, *(change.version for change in changes)]
        if all(b == a + 1 for a, b in pairwise(versions)) and versions[-1] == resume.memory.version:
            self._missed.extend(changes)
        else:
            self._load(resume.memory)
            self._recall(resume.memory.seeds)
        if restored and self._mirror.version == self._learnt_version and len(self._mirror) and not self._missed:
            inputs, targets, _ = self._mirror.arrays()  # it may have died before anybody heard the last model
            self._show(self._learner.learn(inputs, targets, version=self._learnt_version, generations=0), inputs)
        fresh = not self._generations and resume.memory.version > 0
        if fresh and not self._lockstep:  # in lockstep every version is learnt again
            for kept in self.bus.query(keys.KEPT_MODEL, QUERY_S, model=self.instance):
                self._seed(kept)

    def _restore(self, checkpoint: messages.Checkpoint) -> bool:
        """Take over population, memory and counts; what does not fit is left, and all begins anew."""
        try:
            self._learner.restore(checkpoint.state)
            self._load(checkpoint.memory)
        except ValueError as error:
            self.bus.refusals.add(keys.RESUME.path, f"beginning without the checkpoint: {error}")
            return False
        self._generations = checkpoint.generation
        self._learnt_version = self._kept_version = checkpoint.version
        log.info("going on from the checkpoint", model=self.instance, version=checkpoint.version)
        return True

    def _seed(self, kept: messages.CurrentModel) -> None:
        """Begin with the model that was kept."""
        try:
            self._learner.seed([Network.from_arrays(kept.layers, kept.weights)])
        except ValueError as error:
            self.bus.refusals.add(keys.KEPT_MODEL.path, f"beginning anew: {error}")
            return
        self._generations = kept.generation
        log.info("seeded with the kept model", model=self.instance, version=kept.version)

    def _recall(self, seeds: list[messages.ModelWeights]) -> None:
        """Put networks from the long-term memory into the population: the context has changed."""
        for seed in seeds:
            try:
                self._learner.seed([Network.from_arrays(seed.layers, seed.weights)])
            except ValueError as error:
                self.bus.refusals.add(keys.MEMORY_CHANGE.path, f"left out a recalled network: {error}")

    def _load(self, snapshot: messages.MemorySnapshot) -> None:
        self._mirror.restore(
            {
                "slots": snapshot.slots,
                "inputs": snapshot.inputs,
                "targets": snapshot.targets,
                "ids": snapshot.pairs,
                "version": np.array(snapshot.version),
            }
        )

    def _follow(self, change: messages.MemoryChange) -> None:
        if change.version <= self._mirror.version:
            return
        try:
            slots, ids, evicted, freed = (
                tuple(array.tolist()) for array in (change.slots, change.pairs, change.evicted, change.freed)
            )
            self._mirror.apply(Change(change.version, slots, ids, evicted, freed), change.inputs, change.targets)
            self._recall(change.seeds)
        except VersionGapError:
            self._ahead = change.version
            self._joined = False
        except ValueError as error:
            self.bus.refusals.add(keys.MEMORY_CHANGE.path, f"asking for the whole memory: {error}")
            self._joined = False

    def _learn(self) -> None:
        started = time.perf_counter()
        inputs, targets, _ = self._mirror.arrays()
        if not len(inputs):  # nothing to learn from, and no error to publish
            self._learnt_version = self._mirror.version
            return
        best = self._learner.learn(inputs, targets, version=self._mirror.version)
        self._generations += self._learner.generations
        self._learnt_version = self._mirror.version
        if not self._missed:  # of what was missed the newest will do
            self._show(best, inputs)
        if self._learnt_version - self._kept_version >= self._every:
            self._keep()
        self._step_s = time.perf_counter() - started
        self._longest_s = max(self._longest_s, self._step_s)

    def _show(self, best: Best, inputs: Floats) -> None:
        """Publish the best network as the current model, with the inputs (n, inputs) that support it if asked for."""
        self._error = best.error
        layers, weights = best.network.to_arrays()
        self._publisher.put(
            messages.CurrentModel(
                model=self.instance,
                version=self._learnt_version,
                generation=self._generations,
                layers=layers,
                weights=np.ascontiguousarray(weights, np.float32),
                error=best.error,
                support=inputs if self._tells_support else None,
            )
        )

    def _keep(self) -> None:
        """Give the memory store a checkpoint, if it can be sent."""
        self._kept_version = self._learnt_version
        state = self._learner.state()
        if sum(array.nbytes for array in state.values()) > MAX_BYTES / 2:
            self.bus.refusals.add(keys.CHECKPOINT.path, "the learner's state is too large to be kept")
            return
        memory = snapshot_of(self.instance, self._mirror)
        self._checkpoints.put(
            messages.Checkpoint(
                model=self.instance,
                version=memory.version,
                generation=self._generations,
                state=state,
                memory=memory,
            )
        )

    def next_s(self) -> float:
        """See `Bounded`: the memory store is asked, or a version is learnt; the first shows how long that takes."""
        if not self._joined:
            return 2 * QUERY_S + SILENT_S
        first = not self._longest_s and (self._missed or self.bus.queued())
        return COMPILE_S if first else max(SILENT_S, SLOWER * self._longest_s)

    def values(self) -> dict[str, float]:
        """Version learnt and behind, generations, error over the memory, duration of the last learning."""
        return {
            "version": float(self._learnt_version),
            "behind": float(self._mirror.version - self._learnt_version),
            "generation": float(self._generations),
            "error": self._error,
            "learn_s": self._step_s,
        }

    def close(self) -> None:
        """Nothing to free."""
