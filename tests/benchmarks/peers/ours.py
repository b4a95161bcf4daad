"""The promoter-based genetic algorithm of this project, called as an evolver calls it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mdb_services.experiment.brain import brain_config
from mdb_services.experiment.reading import read_file
from mdb_services.mechanism.evolution.genomes import Measure
from mdb_services.mechanism.learners.pbga import PromoterGA
from mdb_services.mechanism.networks.network import Shape
from mdb_services.mechanism.settings import EvolutionConfig
from tests.benchmarks.peers.contestant import Contestant
from tests.benchmarks.peers.problem import Floats, Problem

PAPER = Path(__file__).parents[3] / "deploy" / "experiments" / "paper.toml"


class Ours(Contestant):
    """All hidden units stay expressed, so that a genome costs what it costs the others."""

    def __init__(self, problem: Problem, population: int) -> None:
        super().__init__(problem, population)
        self.shape = Shape(problem.inputs.shape[1], (problem.hidden,), problem.targets.shape[1])
        self.measure = Measure(self.shape, problem.inputs, problem.targets)

    def config(self) -> EvolutionConfig:
        """Return the settings. The elite is not measured again, so it comes on top of the population."""
        elite = EvolutionConfig().elite
        population = self.population + elite
        return EvolutionConfig(population=population, elite=elite, expressed_first=1.0, structural_rate=0.0)

    def reset(self, seed: int) -> None:
        self.learner = PromoterGA(self.shape, self.config(), seed, "benchmark")
        self.run(0)

    def run(self, generations: int) -> None:
        self.learner.learn(self.problem.inputs, self.problem.targets, version=0, generations=generations)

    def best(self) -> float:
        return float(self.learner.state()["errors"].min())

    def errors(self, genomes: Floats) -> NDArray:
        return self._errors(genomes, np.ones((len(genomes), self.shape.units), np.uint8))

    def _errors(self, genomes: Floats, promoters: NDArray) -> NDArray:
        errors, squares = np.empty(len(genomes)), np.empty(len(genomes))
        self.measure.write(genomes, promoters, errors, squares)
        return errors


class Shipped(Ours):
    """The experiment's own settings for the model: promoters evolve, and what is not expressed costs nothing."""

    def config(self) -> EvolutionConfig:
        brain = brain_config(read_file(PAPER), PAPER)
        model = brain.model_named(self.problem.name)
        elite = brain.evolution_of(model).elite
        evolution = {"population": self.population + elite}
        return EvolutionConfig(**(brain.evolution | model.evolution | evolution))


class Tuned(Shipped):
    """The best of a small grid on the recorded memories, as the others have it.

    What is shipped was chosen in closed loop instead, where a memory changes with every pair.
    """

    def config(self) -> EvolutionConfig:
        rates = {"crossover_rate": 0.2, "structural_rate": 0.1, "mutation_rate": 0.15}
        return replace(super().config(), parent_share=0.05, **rates)
