"""The memories of one model: its short-term memory, its long-term memory, and what makes them change.

Owns the rules of what a pair does: which row it is, which pair leaves, whether the context has changed, which
models are stored and recalled. Pure: the owner writes `Effects` to disk and publishes them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import msgspec
import numpy as np

from mdb_protocol import messages
from mdb_services.experiment.brain import BrainConfig
from mdb_services.experiment.sections import ModelSection
from mdb_services.mechanism.memories.context import ContextDetector
from mdb_services.mechanism.memories.ltm import LongTermMemory, Stability, Stored, Trial, sample_of
from mdb_services.mechanism.memories.stm import Change, MemoryConfig, ShortTermMemory
from mdb_services.mechanism.networks.encoding import Codebook, Facts
from mdb_services.mechanism.networks.network import Floats, Network
from mdb_services.memory.file import Context, Effects, MemoryFile
from mdb_services.shell.facts import facts_of
from mdb_services.shell.snapshot import snapshot_of

Rows = tuple[Floats, Floats]
NOISY = 0.2
"""The usual error at which unlike outcomes of like pairs are taken for a teacher's mistakes: then they do not make
pairs unlike, and the older one leaves. Below it they count the more the smaller it is (ours)."""
GRADES = 8
"""How much they count has so many grades: only where it changes are all distances in a memory measured anew."""

Kind = Literal["changed", "known", "stored", "recalled"]


class ModelMemory:
    """See the module's docstring."""

    def __init__(self, config: BrainConfig, section: ModelSection) -> None:
        self.name = section.name
        self.codebook = Codebook(config.variables(), section.inputs, section.outputs)
        self.network: Network | None = None
        self._reads = config.reads(section)
        self._experiment = config.experiment
        self._relevance = config.memory_of(section)
        self._graded = [
            replace(self._relevance, outcome=grade / GRADES * self._relevance.outcome) for grade in range(GRADES + 1)
        ]
        self._context = config.context_of(section)
        self.stm = ShortTermMemory(section.capacity, self.codebook.width, self.codebook.output_width, self._relevance)
        self._detector = ContextDetector(self._context)
        self._ltm = LongTermMemory(config.long_term_of(section))
        self._stability = Stability(self._ltm.config)
        self._pairs: dict[int, messages.Pair] = {}
        self._details: dict[int, messages.LongTermModel] = {}
        self._seeds: list[messages.ModelWeights] = []
        self._recalled_at = 0
        """The version in which a stored model was recalled for the present context; 0 when none was."""

    def restore(self, file: MemoryFile) -> None:
        """Take over what was on disk; ValueError when it is not of a memory like this one."""
        for model in file.long_term(self.name):
            self._take_stored(model)
        entries = file.entries(self.name)
        rows = [self._rows(facts_of(entry.pair)) for entry in entries]
        known = [row for row in rows if row is not None]
        if len(known) < len(rows):
            raise ValueError(f"its pairs do not fit model {self.name}: they are of another experiment")
        if entries:
            self.stm.restore(
                {
                    "inputs": np.concatenate([inputs for inputs, _ in known]),
                    "targets": np.concatenate([targets for _, targets in known]),
                    "ids": np.array([entry.id for entry in entries]),
                    "slots": np.array([entry.slot for entry in entries]),
                    "orders": np.array([entry.version for entry in entries]),
                    "entry_errors": np.array([entry.error for entry in entries]),
                    "version": np.array(file.version(self.name)),
                }
            )
        self._pairs = {entry.id: entry.pair for entry in entries}
        self._replay(file)

    def _replay(self, file: MemoryFile) -> None:
        """Bring detector and stability to where they were, from the errors since the present context began."""
        began = file.context(self.name)
        if began is not None:
            self._detector.begin(began.first, known=began.known)
            self._seeds = file.seeds(self.name)
            if began.known:
                self._act_upon_seed(began.version)
        for version, error in file.errors(self.name, began.version if began else 0):
            self._detector.step(error, version)
            self._stability.step(error)
        self.stm.configure(self._setting)

    def knows(self, model: messages.LongTermModel) -> bool:
        """Whether a stored model is one that this memory can take over."""
        try:
            self._take_stored(model)
        except ValueError:
            return False
        return True

    def _take_stored(self, model: messages.LongTermModel) -> None:
        rows = [self._rows(facts_of(pair)) for pair in model.pairs]
        known = [row for row in rows if row is not None]
        if list(model.reads.items()) != list(self._reads.items()) or len(known) < len(rows) or not rows:
            raise ValueError(f"model {model.model} {model.id} of the long-term memory reads other variables")
        inputs, targets = (np.concatenate(parts) for parts in zip(*known, strict=True))
        network = _network(model)
        if (misfit := self.codebook.misfit(network.sizes)) is not None:
            raise ValueError(f"model {model.model} {model.id} of the long-term memory: {misfit}")
        self._ltm.restore(Stored(model.id, network, inputs, targets, model.uses, model.touched))
        self._details[model.id] = model

    def take(self, network: Network, version: int) -> None:
        """Follow a current model that was learnt on `version`; after a recall, not one from before it."""
        if version >= self._recalled_at:
            self.network = network

    def _act_upon_seed(self, version: int) -> None:
        """Take the recalled model for the current one, which it is as soon as the evolver has heard of it."""
        if self._seeds:
            self.network, self._recalled_at = _network(self._seeds[0]), version

    @property
    def _setting(self) -> MemoryConfig:
        if self._detector.changing:
            return self._context.temporal
        return self._graded[round(GRADES * max(0.0, 1 - self._detector.usual / NOISY))]

    def _rows(self, facts: Facts) -> Rows | None:
        inputs, targets = self.codebook.input_rows(facts), self.codebook.target_rows(facts)
        return None if inputs is None or targets is None else (inputs, targets)

    def reads(self, pair: messages.Pair) -> bool:
        """Whether a pair has all that this model's rows consist of."""
        return self._rows(facts_of(pair)) is not None

    def enter(self, pair: messages.Pair, facts: Facts, recalled_ids: Iterator[int]) -> Effects | None:
        """Take a pair in, of which these are the facts; return what it did, None when it lacks a variable or is
        stored already.

        recalled_ids are ids for pairs that come back from the long-term memory.
        """
        rows = self._rows(facts)
        if rows is None:
            return None
        error = None if self.network is None else float(self._errors(*rows)[0])
        errors_now = self._errors(*self.stm.arrays()[:2]) if self._relevance.current_error else None
        change = self.stm.insert(pair.iteration, rows[0][0], rows[1][0], error or 0.0, errors_now)
        if change is None:
            return None
        effects = Effects(entry_error=error)
        self._keep(change, {pair.iteration: pair})
        effects.changes.append(self._message(change, rows))
        if error is not None:
            self._follow(pair, error, effects, recalled_ids)
        return effects

    def _follow(self, pair: messages.Pair, error: float, effects: Effects, recalled_ids: Iterator[int]) -> None:
        """See whether the context has changed, came back or is known now, and whether the model is worth storing."""
        was_changing = self._detector.changing
        changed = self._detector.step(error, self.stm.version) or self._is_back()
        if changed:
            effects.events.append(self._event(pair, "changed", error))
        if self._detector.changing:
            self._begin_context(pair, effects, recalled_ids, changed=changed)
        elif was_changing:
            effects.events.append(self._event(pair, "known", self._detector.usual))
        if effects.context is None and self._stability.step(error) and self._ltm.config.capacity:
            self._store(pair, effects)
        self.stm.configure(self._setting)

    def _is_back(self) -> bool:
        """Whether what looks like a change is a context that a stored model knows; then the change is told."""
        suspected, config = self._detector.suspected, self._ltm.config
        if suspected is None or not self._detector.settled:
            return False
        inputs, targets, errors = self.stm.since(suspected)
        if (errors > config.missed_error).sum() < config.fit_pairs:
            return False
        trials = self._ltm.trials(inputs, targets, before=suspected)
        if not trials or not trials[0].fits:
            return False
        self._detector.begin(suspected)
        return True

    def _begin_context(
        self, pair: messages.Pair, effects: Effects, recalled_ids: Iterator[int], *, changed: bool
    ) -> None:
        """Drop the old context; if a stored model fits the new one, take back its sample. Its network is a seed."""
        first = self._detector.first
        trials = self._ltm.trials(*self.stm.since(first)[:2], before=first)
        best = trials[0] if trials and trials[0].fits else None
        if not changed and best is None:
            return
        if best is not None:
            self._recall(pair, best, effects, recalled_ids)
        seeds = [trial.stored.network for trial in trials[: self._ltm.config.seeds]]
        self._start_context(effects, first, best.stored if best else None, seeds)

    def _start_context(self, effects: Effects, first: int, stored: Stored | None, seeds: Sequence[Network]) -> None:
        """Begin a context at version `first`, with the sample of a stored model that fits it, if one does."""
        drop_before = first if stored or self._context.forget else 0
        if stored is None:
            change = self.stm.begin_context(drop_before)
            rows = None
        else:
            rows = stored.inputs, stored.targets
            change = self.stm.begin_context(drop_before, tuple(effects.recalled), *rows)
            rows = rows[0][: len(change.ids)], rows[1][: len(change.ids)]
        self._keep(change, effects.recalled)
        self._detector.begin(first, known=stored is not None)
        self._stability.begin()
        self._seeds = [_weights(network) for network in seeds]
        if stored is not None:
            self._act_upon_seed(change.version)
        effects.context = Context(change.version, first, stored is not None)
        effects.changes.append(self._message(change, rows, self._seeds))

    def _recall(self, pair: messages.Pair, trial: Trial, effects: Effects, recalled_ids: Iterator[int]) -> None:
        used = self._ltm.use(trial.stored.id, self.stm.version)
        details = msgspec.structs.replace(self._details[used.id], uses=used.uses, touched=used.touched)
        self._details[used.id] = details
        effects.long_term.append(details)
        effects.recalled = {next(recalled_ids): sampled for sampled in details.pairs}
        effects.events.append(self._event(pair, "recalled", trial.error, used.id))

    def _store(self, pair: messages.Pair, effects: Effects) -> None:
        assert self.network is not None
        inputs, targets, ids = self.stm.arrays()
        chosen = sample_of(inputs, self._ltm.config.sample)
        stored, effects.forgotten = self._ltm.store(self.network, inputs[chosen], targets[chosen], self.stm.version)
        for id in effects.forgotten:
            del self._details[id]
        if stored.network is not self.network:  # a model is there that knows more
            self._details[stored.id] = msgspec.structs.replace(self._details[stored.id], touched=stored.touched)
            effects.long_term.append(self._details[stored.id])
            return
        layers, weights = self.network.to_arrays()
        details = messages.LongTermModel(
            id=stored.id,
            model=self.name,
            reads=self._reads,
            layers=layers,
            weights=weights,
            error=self._stability.error,
            pairs=[self._pairs[int(id)] for id in ids[chosen]],
            uses=stored.uses,
            touched=stored.touched,
            iteration=pair.iteration,
            experiment=self._experiment.name,
            brain=self._experiment.brain,
            seed=self._experiment.seed,
        )
        self._details[stored.id] = details
        effects.long_term.append(details)
        effects.events.append(self._event(pair, "stored", self._stability.error, stored.id))

    def _event(
        self, pair: messages.Pair, kind: Kind, error: float, stored: int | None = None
    ) -> messages.ContextEvent:
        return messages.ContextEvent(model=self.name, iteration=pair.iteration, kind=kind, stored=stored, error=error)

    def _keep(self, change: Change, pairs: Mapping[int, messages.Pair]) -> None:
        """Follow a change with the pairs as they came, which a sample for the long-term memory consists of."""
        for id in change.evicted:
            del self._pairs[id]
        self._pairs |= {id: pairs[id] for id in change.ids}

    def _message(
        self, change: Change, rows: Rows | None, seeds: list[messages.ModelWeights] | None = None
    ) -> messages.MemoryChange:
        inputs, targets = rows or [array[:0] for array in self.stm.arrays()[:2]]
        return messages.MemoryChange(
            model=self.name,
            version=change.version,
            slots=np.array(change.slots, dtype=np.int64),
            pairs=np.array(change.ids, dtype=np.int64),
            inputs=inputs,
            targets=targets,
            freed=np.array(change.freed, dtype=np.int64),
            evicted=np.array(change.evicted, dtype=np.int64),
            seeds=seeds or [],
        )

    def _errors(self, inputs: Floats, targets: Floats) -> Floats:
        """Return the current model's mean squared error on each row (n,); 0 without a model."""
        if self.network is None or not len(inputs):
            return np.zeros(len(inputs), np.float32)
        squares = np.square(self.network.predict(inputs) - targets)
        errors: Floats = np.add.reduce(squares, axis=1) / squares.shape[1]
        return errors

    def snapshot(self) -> messages.MemorySnapshot:
        """Return the whole memory as a message."""
        return snapshot_of(self.name, self.stm, self._seeds)

    def begin(self, recalled_ids: Iterator[int]) -> Effects | None:
        """Take back the most useful stored model with its sample when the memory has nothing yet; return the effects.

        That is the beginning of a run with the models of another one. Without the sample they would be lost on the
        first few pairs, which anything fits.
        """
        stored = self._ltm.most_useful()
        if self.stm.version or stored is None:
            return None
        effects = Effects()
        effects.recalled = {next(recalled_ids): pair for pair in self._details[stored.id].pairs}
        self._start_context(effects, 1, stored, [stored.network])
        return effects

    def values(self) -> dict[str, float]:
        """Version, models in the long-term memory, the usual error, and whether the context is changing."""
        return {
            f"version.{self.name}": float(self.stm.version),
            f"long_term.{self.name}": float(len(self._ltm)),
            f"usual_error.{self.name}": self._detector.usual,
            f"changing.{self.name}": float(self._detector.changing),
        }


def _network(weights: messages.ModelWeights | messages.LongTermModel) -> Network:
    return Network.from_arrays(weights.layers, weights.weights)


def _weights(network: Network) -> messages.ModelWeights:
    layers, weights = network.to_arrays()
    return messages.ModelWeights(layers=layers, weights=weights)
