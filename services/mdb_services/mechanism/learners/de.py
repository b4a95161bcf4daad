"""Differential evolution: steps are differences between members of the population (Storn and Price 1997).

A trial is its target, moved towards one of the better members and along the difference of two others
(current-to-pbest/1 of JADE, Zhang and Sanderson 2009), mixed with the target gene by gene, and takes its place
when it is no worse. Factor and crossover rate belong to each member and adapt themselves (jDE, Brest et al. 2006).
Targets are measured anew on every memory. A few immigrants in each generation are ours: the differences within
a population that has converged are too small to follow a change.
"""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.evolution.genomes import Measure, embed
from mdb_services.mechanism.learners.contract import Layers, Learner, Memory
from mdb_services.mechanism.networks import streams
from mdb_services.mechanism.networks.network import Floats, Network, Shape, split_layers
from mdb_services.mechanism.settings import DifferentialConfig

CHANGE = 0.1
"""Probability that a trial draws a new factor, and that it draws a new rate (tau of jDE)."""
FACTORS = (0.1, 1.0)
"""Bounds of the factors (jDE)."""
FACTOR_FIRST, RATE_FIRST = 0.5, 0.9
"""What all members begin with (jDE)."""


class DifferentialEvolution(Learner):
    """A population of genomes (population, weights), all hidden units expressed."""

    arrays: ClassVar = ("weights", "factors", "rates", "fitness")
    unmeasured: ClassVar = ("fitness",)

    def __init__(self, shape: Shape, config: DifferentialConfig, seed: int, name: str) -> None:
        """Draw the first population from the stream of (seed, name)."""
        super().__init__(shape, config.generations, seed, name)
        self.config = config
        count = config.population
        self._weights = self._drawn(count, streams.generator(seed, f"{name}/first population", 0))
        self._factors = np.full(count, FACTOR_FIRST, dtype=np.float32)
        self._rates = np.full(count, RATE_FIRST, dtype=np.float32)
        self._fitness = np.full(count, np.inf)

    def _learn(self, memory: Memory, key: int, generations: range) -> None:
        measure = Measure(self.shape, memory.inputs, memory.targets)
        self._fitness = measure(self._weights, self.config.weight_penalty)
        for generation in generations:
            random = streams.generator(key, "generation", generation)
            self._compete(measure, random)
            self._immigrate(measure, random)

    def _compete(self, measure: Measure, random: np.random.Generator) -> None:
        """Let each member defend its place against one trial."""
        count = len(self._weights)
        factors = np.where(random.random(count) < CHANGE, random.uniform(*FACTORS, count), self._factors)
        rates = np.where(random.random(count) < CHANGE, random.random(count), self._rates)
        trials = self._trials(factors.astype(np.float32)[:, None], rates[:, None], random)
        fitness = measure(trials, self.config.weight_penalty)
        won = fitness <= self._fitness
        self._weights[won], self._fitness[won] = trials[won], fitness[won]
        self._factors[won], self._rates[won] = factors[won], rates[won]

    def _trials(self, factors: Floats, rates: NDArray[np.float64], random: np.random.Generator) -> Floats:
        """Return a trial (population, weights) for each member, of factors and rates (population, 1)."""
        count, genes = self._weights.shape
        better = np.argsort(self._fitness, kind="stable")[: max(1, round(self.config.best_share * count))]
        towards = self._weights[random.choice(better, count)]
        # Members other than the target; the two are the same one now and then, which is a step without difference.
        one, other = (np.arange(count) + random.integers(1, count, (2, count))) % count
        moves = factors * (towards - self._weights + self._weights[one] - self._weights[other])
        crossed = random.random((count, genes)) < rates
        crossed[np.arange(count), random.integers(genes, size=count)] = True
        limit = self.config.weight_limit
        trials: Floats = np.clip(np.where(crossed, self._weights + moves, self._weights), -limit, limit)
        return trials

    def _immigrate(self, measure: Measure, random: np.random.Generator) -> None:
        """Replace the worst members by some that are drawn as the first population was."""
        worst = np.argsort(-self._fitness, kind="stable")[: round(self.config.immigrant_share * len(self._weights))]
        if len(worst):
            self._weights[worst] = self._drawn(len(worst), random)
            self._fitness[worst] = measure(self._weights[worst], self.config.weight_penalty)

    def _drawn(self, count: int, random: np.random.Generator) -> Floats:
        limit = self.config.weight_first
        return random.uniform(-limit, limit, (count, self.shape.weights)).astype(np.float32)

    def _best(self) -> Layers:
        return split_layers(self.shape.sizes, self._weights[np.argmin(self._fitness)])

    def _seed(self, networks: Sequence[Network]) -> None:
        """Put networks into the population in the place of its worst."""
        if len(networks) > len(self._weights):
            raise ValueError(f"{len(networks)} networks for a population of {len(self._weights)}: seed fewer")
        worst = np.argsort(-self._fitness, kind="stable")
        for network, place in zip(networks, worst, strict=False):
            embed(network, self.shape, self._weights[place])
            self._fitness[place] = -np.inf  # until it is measured, the best
