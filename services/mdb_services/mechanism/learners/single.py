"""Learners that keep one network: what they have in common.

Networks that `seed` takes wait for the next memory. There the own network and they are measured, the best goes on.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from mdb_services.mechanism.evolution.genomes import Measure, embed
from mdb_services.mechanism.learners.contract import Layers, Learner, Memory
from mdb_services.mechanism.networks import streams
from mdb_services.mechanism.networks.network import Floats, Network, Shape, split_layers


class SingleNetwork(Learner):
    """A learner whose present network is one genome, `_weights` (1, weights), all of its units expressed."""

    arrays: ClassVar[tuple[str, ...]] = ("weights", "waiting")
    lists: ClassVar = ("waiting",)

    def __init__(self, shape: Shape, generations: int, seed: int, name: str) -> None:
        """Draw the first network from the stream of (seed, name)."""
        super().__init__(shape, generations, seed, name)
        random = streams.generator(seed, f"{name}/first network", 0)
        self._weights = np.zeros((1, shape.weights), dtype=np.float32)
        for matrix in split_layers(shape.sizes, self._weights[0]):
            matrix[:] = random.normal(0, matrix.shape[1] ** -0.5, matrix.shape)
        self._waiting = self._weights[:0].copy()

    def _learn(self, memory: Memory, key: int, generations: range) -> None:
        inputs, targets = memory.inputs, memory.targets
        if len(self._waiting):
            candidates = np.concatenate([self._weights, self._waiting])
            best = int(np.argmin(Measure(self.shape, inputs, targets)(candidates)))
            self._waiting = self._waiting[:0]
            if best > 0:
                self._weights = candidates[best : best + 1]
                self._begin_anew()
        self._improve(inputs, targets, key, generations)

    def _best(self) -> Layers:
        return split_layers(self.shape.sizes, self._weights[0])

    def _seed(self, networks: Sequence[Network]) -> None:
        genomes = np.repeat(self._weights, len(networks), axis=0)
        for network, genome in zip(networks, genomes, strict=True):
            embed(network, self.shape, genome)
        self._waiting = np.concatenate([self._waiting, genomes])

    @abstractmethod
    def _begin_anew(self) -> None:
        """Forget what belongs to the network before: a seed has taken its place."""

    @abstractmethod
    def _improve(self, inputs: Floats, targets: Floats, key: int, generations: range) -> None:
        """Learn the memory for these generations, beginning with the present network."""
