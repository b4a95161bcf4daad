"""The current models and the short-term memories, as far as they were heard."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdb_deploy.web.telling.beliefs import Pairs
from mdb_deploy.web.telling.plan import Plan, numbers
from mdb_protocol.messages import CurrentModel, MemoryChange, MemorySnapshot
from mdb_services.experiment.sections import ModelSection
from mdb_services.mechanism.actions.foresight import Known
from mdb_services.mechanism.networks.network import Network

MOST_PAIRS = 400
"""Pairs of a memory that are told, the newest."""
KEPT_MODELS = 8
"""Versions of each current model that are kept: an action may have been chosen by one of some versions ago."""


class Models:
    """The newest versions of one current model, each made ready when it is asked for."""

    def __init__(self, plan: Plan, name: str) -> None:
        self._book = plan.books[name]
        self._kept: OrderedDict[int, CurrentModel] = OrderedDict()
        self._ready: dict[int, Known] = {}
        self.newest: CurrentModel | None = None

    def take(self, model: CurrentModel) -> bool:
        """Keep a version; return whether it is the newest, and new. What does not fit this experiment is none."""
        if len(model.layers) < 3 or self._book.misfit(model.layers) is not None:
            return False
        known = self._kept.get(model.version)
        if known is not None and known.generation == model.generation:
            return False
        self._kept[model.version] = model
        self._ready.pop(model.version, None)
        while len(self._kept) > KEPT_MODELS:
            gone, _ = self._kept.popitem(last=False)
            self._ready.pop(gone, None)
        if self.newest is not None and model.version < self.newest.version:
            return False
        self.newest = model
        return True

    def known(self, version: int) -> Known | None:
        """Return a version ready to use; None when it is not kept, or its weights make no network."""
        if version not in self._ready and version in self._kept:
            model = self._kept[version]
            try:
                network = Network.from_arrays(model.layers, model.weights)
            except ValueError:
                return None
            self._ready[version] = Known(self._book, network, model.support)
        return self._ready.get(version)


class Memory:
    """The short-term memory of one model, as far as its changes were heard: slots, with pair, inputs and targets."""

    def __init__(self, plan: Plan, section: ModelSection) -> None:
        self._section, book = section, plan.books[section.name]
        self._shape = book.width, book.output_width
        self.version = 0
        self.whole = True
        """Whether no change was missed."""
        self._slots: dict[int, tuple[int, NDArray[Any], NDArray[Any]]] = {}

    def take(self, message: MemoryChange | MemorySnapshot) -> bool:
        """Apply a change, or take the whole; return whether it is another memory then."""
        capacity, (inputs, targets) = self._section.capacity, self._shape
        slots = message.slots.tolist()
        fits = message.inputs.shape[1] == inputs and message.targets.shape[1] == targets
        if (slots and not fits) or any(not 0 <= slot < capacity for slot in slots):
            return False
        if isinstance(message, MemorySnapshot):
            if message.version < self.version or (self.whole and message.version == self.version):
                return False
            self.whole, self._slots = True, {}
        else:
            if message.version <= self.version:
                return False
            self.whole = self.whole and message.version == self.version + 1
            for slot in message.freed.tolist():
                self._slots.pop(slot, None)
        for place, (slot, pair) in enumerate(zip(slots, message.pairs.tolist(), strict=True)):
            self._slots[slot] = pair, message.inputs[place], message.targets[place]
        self.version = message.version
        return True

    def copy(self) -> Memory:
        """Return another one of the same content: its rows are shared, and never changed."""
        made = object.__new__(Memory)
        made._section, made._shape = self._section, self._shape
        made.version, made.whole, made._slots = self.version, self.whole, dict(self._slots)
        return made

    def rows(self) -> Pairs:
        """Return the pairs in order of their age, the oldest first."""
        held = sorted(self._slots.values(), key=lambda entry: entry[0])
        if not held:
            return Pairs(np.zeros((0, self._shape[0]), np.float32), np.zeros((0, self._shape[1]), np.float32))
        return Pairs(np.array([entry[1] for entry in held]), np.array([entry[2] for entry in held]))

    def told(self, now: int) -> dict[str, Any]:
        """Return its part. now: the iteration, from which the pairs' age is counted; of recalled ones it is null."""
        newest = sorted(self._slots.items(), key=lambda entry: -entry[1][0])[:MOST_PAIRS]
        inputs = numbers(np.array([entry[1] for _, entry in newest])) if newest else []
        targets = numbers(np.array([entry[2] for _, entry in newest])) if newest else []
        return {
            "version": self.version,
            "used": len(self._slots),
            "capacity": self._section.capacity,
            "pairs": [
                {
                    "slot": slot,
                    "pair": pair,
                    "inputs": inputs[place],
                    "targets": targets[place],
                    "age": max(now - pair, 0) if pair >= 0 else None,
                }
                for place, (slot, (pair, _, _)) in enumerate(newest)
            ],
        }
