"""PyGAD: the whole population given to the fitness function in one batch, which it offers for speed."""

import numpy as np
import pygad
from numpy.typing import NDArray

from tests.benchmarks.peers.contestant import Contestant
from tests.benchmarks.peers.numpy_networks import NumpyNetwork
from tests.benchmarks.peers.problem import Floats, Problem, first_population

STEP, MUTATED, PARENTS = 0.2, 0.03, 0.05
"""The best of a small grid on the recorded memories."""


class Documented(Contestant):
    """Its own operators. One of the elite is kept and not measured again, so it comes on top of the population."""

    def __init__(self, problem: Problem, population: int) -> None:
        super().__init__(problem, population)
        self.network = NumpyNetwork(problem)

    def operators(self) -> dict:
        return {
            "parent_selection_type": "sss",
            "crossover_type": "uniform",
            "mutation_type": "random",
            "mutation_probability": MUTATED,
            "random_mutation_min_val": -STEP,
            "random_mutation_max_val": STEP,
        }

    def reset(self, seed: int) -> None:
        self.search = pygad.GA(
            num_generations=1,
            num_parents_mating=round(PARENTS * self.population),
            fitness_func=lambda _, genomes, __: -self.errors(np.asarray(genomes)),
            fitness_batch_size=self.population + 1,
            initial_population=first_population(self.problem, self.population + 1, seed),
            gene_type=np.float32,
            keep_elitism=1,
            random_seed=seed,
            suppress_warnings=True,
            **self.operators(),
        )

    def run(self, generations: int) -> None:
        if generations:
            self.search.num_generations = generations
            self.search.run()

    def best(self) -> float:
        return -float(np.max(self.search.last_generation_fitness))

    def errors(self, genomes: Floats) -> NDArray:
        return self.network.errors(genomes)


class Fastest(Documented):
    """Crossover and mutation of our own in numpy, all offspring at once; the library's loop over genes is slow."""

    def reset(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        super().reset(seed)

    def operators(self) -> dict:
        return {"parent_selection_type": "sss", "crossover_type": self._cross, "mutation_type": self._mutate}

    def _cross(self, parents, offspring_size, _):
        first, second = parents[self.random.integers(len(parents), size=(2, offspring_size[0]))]
        return np.where(self.random.random(offspring_size) < 0.5, first, second)

    def _mutate(self, offspring, _):
        moved = self.random.random(offspring.shape) < MUTATED
        return (offspring + moved * self.random.uniform(-STEP, STEP, offspring.shape)).astype(np.float32)
