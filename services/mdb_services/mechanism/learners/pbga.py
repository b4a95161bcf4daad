"""The promoter-based genetic algorithm: a population of networks that learns what a short-term memory holds.

Owns one population, kept between calls (paper, section 2.3). Its generations are in ``generations.py``, the operators
in ``operators.py``, the errors in ``kernel.py``.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.evolution.genomes import embed
from mdb_services.mechanism.evolution.population import Population
from mdb_services.mechanism.learners.contract import Arrays, Layers, Learner, Memory
from mdb_services.mechanism.networks import streams
from mdb_services.mechanism.networks.network import Network, Shape, split_layers
from mdb_services.mechanism.settings import EvolutionConfig


class PromoterGA(Learner):
    """A population of networks of one shape, evolved a few generations for each version of a memory."""

    arrays: ClassVar = ("weights", "promoters", "steps", "errors", "fitness")
    unmeasured: ClassVar = ("errors", "fitness")
    compiled: ClassVar = True

    def __init__(self, shape: Shape, config: EvolutionConfig, seed: int, name: str) -> None:
        """Draw the first population from the stream of (seed, name)."""
        super().__init__(shape, config.generations, seed, name)
        self.config = config
        count = config.population
        random = streams.generator(seed, f"{name}/first population", 0)
        limit = config.weight_first
        self._weights = random.uniform(-limit, limit, (count, shape.weights)).astype(np.float32)
        self._promoters = (random.random((count, shape.units)) < config.expressed_first).astype(np.uint8)
        self._steps = np.full(count, config.step_first, dtype=np.float32)
        self._errors, self._fitness = np.full(count, np.inf), np.full(count, np.inf)
        self._population = self._as_population()

    def _as_population(self) -> Population:
        individuals = self._weights, self._promoters, self._steps
        return Population(self.shape, self.config, individuals, self._errors, self._fitness)

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """See `Learner`."""
        super().restore(state)
        self._population = self._as_population()

    def network(self, individual: int) -> Network:
        """Return the network that an individual expresses."""
        return Network(self._expressed_by(individual))

    def _expressed_by(self, individual: int) -> Layers:
        """Return the layers of the network that an individual expresses."""
        *hidden, outwards = split_layers(self.shape.sizes, self._weights[individual])
        promoters, start = self._promoters[individual].astype(bool), 0
        layers, senders = [], None
        for matrix in hidden:
            expressed = promoters[start : start + len(matrix)]
            layers.append(np.asfortranarray(matrix[expressed]) if senders is None else matrix[expressed][:, senders])
            start, senders = start + len(matrix), np.concatenate((expressed, (True,)))
        return [*layers, outwards[:, senders]]

    def _learn(self, memory: Memory, key: int, generations: range) -> None:
        self._population.evolve(memory.pairs, key, generations)

    def _best(self) -> Layers:
        return self._expressed_by(int(self._fitness.argmin()))

    def _seed(self, networks: Sequence[Network]) -> None:
        """Put networks into the population in the place of its worst; the units left over are not expressed."""
        if len(networks) > self.config.population:
            raise ValueError(f"{len(networks)} networks for a population of {self.config.population}: seed fewer")
        worst = np.argsort(-self._fitness, kind="stable")
        for network, place in zip(networks, worst, strict=False):
            embed(network, self.shape, self._weights[place])
            self._promoters[place] = self._expressed(network)
            self._steps[place] = self.config.step_first
            self._errors[place] = self._fitness[place] = -np.inf  # until it is measured, the best

    def _expressed(self, network: Network) -> NDArray[np.bool_]:
        """Return the promoters (units,) of a network that was written to the first units of each layer."""
        used = zip(network.sizes[1:-1], self.shape.hidden, strict=True)
        return np.concatenate([np.arange(room) < units for units, room in used])

    def _check_state(self, state: Arrays) -> None:
        super()._check_state(state)
        if state["promoters"].max(initial=0) > 1:
            raise ValueError("promoters hold something else than 0 and 1: the state is damaged, start afresh")
