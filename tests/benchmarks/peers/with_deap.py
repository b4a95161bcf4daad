"""DEAP: its `eaSimple`, each individual measured by numpy; every child is mutated, hence measured."""

import array
import random

import numpy as np
from deap import algorithms, base, creator, tools
from numpy.typing import NDArray

from tests.benchmarks.peers.contestant import Contestant
from tests.benchmarks.peers.numpy_networks import NumpyNetwork
from tests.benchmarks.peers.problem import Floats, Problem, first_population

CROSSOVER, MUTATED, STEP, TOURNAMENT = 0.5, 0.03, 0.15, 8
"""The best of a small grid on the recorded memories."""

creator.create("Cost", base.Fitness, weights=(-1.0,))
creator.create("Array", array.array, typecode="f", fitness=creator.Cost)
creator.create("Numpy", np.ndarray, fitness=creator.Cost)


class Documented(Contestant):
    """Individuals are `array.array`, a type that its tutorial names, here twice as fast as lists."""

    def __init__(self, problem: Problem, population: int) -> None:
        super().__init__(problem, population)
        self.network = NumpyNetwork(problem)
        self.toolbox = base.Toolbox()
        self.toolbox.register("select", tools.selTournament, tournsize=TOURNAMENT)
        self.toolbox.register("mate", tools.cxTwoPoint)
        self.toolbox.register("mutate", tools.mutGaussian, mu=0.0, sigma=STEP, indpb=MUTATED)
        self.toolbox.register("evaluate", lambda genes: (self.network.error(np.frombuffer(genes, np.float32)),))
        self.individual = lambda genes: creator.Array(genes.tolist())

    def reset(self, seed: int) -> None:
        random.seed(seed)
        np.random.seed(seed)
        self.population_list = [
            self.individual(genes) for genes in first_population(self.problem, self.population, seed)
        ]
        self.run(0)

    def run(self, generations: int) -> None:
        self.population_list, _ = algorithms.eaSimple(
            self.population_list, self.toolbox, CROSSOVER, 1.0, generations, verbose=False
        )

    def best(self) -> float:
        return min(individual.fitness.values[0] for individual in self.population_list)

    def errors(self, genomes: Floats) -> NDArray:
        return np.array([self.toolbox.evaluate(genes)[0] for genes in genomes])


class Fastest(Documented):
    """Individuals are numpy arrays, with numpy operators, and the toolbox's `map` measures them all at once."""

    def __init__(self, problem: Problem, population: int) -> None:
        super().__init__(problem, population)
        self.toolbox.register("mate", _cross)
        self.toolbox.register("mutate", _mutate)
        self.toolbox.register("map", self._measure)
        self.individual = creator.Numpy

    def _measure(self, _, individuals):
        if not individuals:
            return []
        return [(error,) for error in self.network.errors(np.stack(individuals)).tolist()]

    def errors(self, genomes: Floats) -> NDArray:
        return np.array(self._measure(None, list(genomes)))[:, 0]


def _cross(first, second):
    """Cross at two points (DEAP's own operator would exchange views of one another)."""
    start, stop = sorted(random.sample(range(1, len(first)), 2))
    first[start:stop], second[start:stop] = second[start:stop].copy(), first[start:stop].copy()
    return first, second


def _mutate(individual):
    places = np.flatnonzero(np.random.random(len(individual)) < MUTATED)
    individual[places] += np.random.normal(0.0, STEP, len(places))
    return (individual,)
