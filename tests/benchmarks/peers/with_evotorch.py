"""EvoTorch: a vectorised error function, and the library's genetic algorithm or its functional operators."""

import logging

import numpy as np
import torch
from evotorch import Problem as TorchProblem
from evotorch.algorithms import GeneticAlgorithm
from evotorch.decorators import vectorized
from evotorch.operators import GaussianMutation, OnePointCrossOver
from evotorch.operators.functional import combine, one_point_cross_over, take_best
from numpy.typing import NDArray

from tests.benchmarks.peers.contestant import Contestant
from tests.benchmarks.peers.problem import Floats, Problem, first_population

torch.set_num_threads(1)
torch.set_grad_enabled(False)
logging.disable(logging.INFO)  # it logs every problem that is made

STEP, STEP_DECAY, STEP_END, TOURNAMENT = 0.1, 0.99, 0.01, 4
"""The best of a small grid on the recorded memories."""
CHUNK = 50
"""Genomes at a time, so that activations stay in the cache."""


class Documented(Contestant):
    """`GeneticAlgorithm` with one-point crossover and Gaussian mutation, of which it measures the children only."""

    def __init__(self, problem: Problem, population: int) -> None:
        super().__init__(problem, population)
        self.inputs, self.targets = torch.from_numpy(problem.inputs), torch.from_numpy(problem.targets)

    def matrices(self, genomes):
        (hidden, before), (outputs, after) = self.problem.layers
        split = hidden * before
        return genomes[:, :split].reshape(-1, hidden, before), genomes[:, split:].reshape(-1, outputs, after)

    def population_errors(self, genomes):
        first, last = self.matrices(genomes)
        rows = torch.tanh(self.inputs @ first[:, :, :-1].mT + first[:, None, :, -1])
        outputs = rows @ last[:, :, :-1].mT + last[:, None, :, -1]
        return ((outputs - self.targets) ** 2).mean((1, 2))

    def reset(self, seed: int) -> None:
        torch.manual_seed(seed)

        @vectorized
        def error(genomes):
            return self.population_errors(genomes)

        problem = TorchProblem("min", error, solution_length=self.problem.weights, initial_bounds=(-1, 1))
        operators = [OnePointCrossOver(problem, tournament_size=TOURNAMENT), GaussianMutation(problem, stdev=STEP)]
        self.search = GeneticAlgorithm(problem, operators=operators, popsize=self.population, re_evaluate=False)
        self.search.population.set_values(torch.from_numpy(first_population(self.problem, self.population, seed)))
        self.search.step()

    def run(self, generations: int) -> None:
        for _ in range(generations):
            self.search.step()

    def best(self) -> float:
        return float(self.search.status["best_eval"])

    def errors(self, genomes: Floats) -> NDArray:
        return np.asarray(self.population_errors(torch.from_numpy(genomes)))


class Fastest(Documented):
    """The functional operators, pairs along the rows, one product for the first layer, some genomes at a time."""

    def __init__(self, problem: Problem, population: int) -> None:
        super().__init__(problem, population)
        ones = torch.ones(len(problem.inputs), 1)
        self.columns = torch.cat([self.inputs, ones], 1).T.contiguous()
        self.target_columns = self.targets.T.contiguous()

    def population_errors(self, genomes):
        return torch.cat([self.chunk_errors(chunk) for chunk in genomes.split(CHUNK)])

    def chunk_errors(self, genomes):
        first, last = self.matrices(genomes)
        hidden = (first.flatten(0, 1) @ self.columns).tanh_().unflatten(0, first.shape[:2])
        outputs = torch.baddbmm(last[:, :, -1:], last[:, :, :-1], hidden)
        return (outputs - self.target_columns).square_().mean((1, 2))

    def reset(self, seed: int) -> None:
        torch.manual_seed(seed)
        self.genomes = torch.from_numpy(first_population(self.problem, self.population, seed))
        self.costs = self.population_errors(self.genomes)
        self.step = STEP

    def run(self, generations: int) -> None:
        for _ in range(generations):
            children = one_point_cross_over(
                self.genomes, self.costs, tournament_size=TOURNAMENT, objective_sense="min"
            )
            children = children + self.step * torch.randn(children.shape)
            both = combine((self.genomes, self.costs), (children, self.population_errors(children)))
            self.genomes, self.costs = take_best(*both, self.population, objective_sense="min")
            self.step = max(self.step * STEP_DECAY, STEP_END)

    def best(self) -> float:
        return float(self.costs.min())
