"""What every contestant does, and who they are."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

from numpy.typing import NDArray

from tests.benchmarks.peers.problem import Floats, Problem


class Contestant(ABC):
    """An evolution of one problem with one population size."""

    def __init__(self, problem: Problem, population: int) -> None:
        self.problem, self.population = problem, population

    @abstractmethod
    def reset(self, seed: int) -> None:
        """Begin anew with the first population of the seed, measured."""

    @abstractmethod
    def run(self, generations: int) -> None:
        """Evolve; each generation measures exactly `population` genomes."""

    @abstractmethod
    def best(self) -> float:
        """Return the lowest error found since the reset (or in the present population, where it keeps the best)."""

    @abstractmethod
    def errors(self, genomes: Floats) -> NDArray:
        """Return the errors (n,) of genomes (n, weights), by the function that evolution uses."""


@dataclass(frozen=True)
class Entry:
    """A contestant: module.class below this package, the library it needs, and which form of it this is."""

    label: str
    place: str
    library: str
    form: Literal["ours", "documented", "fastest"]


ENTRIES = {
    "ours": Entry("this project", "ours.Ours", "numba", "ours"),
    "shipped": Entry("this project, promoters as shipped", "ours.Shipped", "numba", "ours"),
    "tuned": Entry("this project, tuned on these memories", "ours.Tuned", "numba", "ours"),
    "evosax": Entry("evosax SimpleGA, as documented", "with_evosax.Documented", "evosax", "documented"),
    "evosax+": Entry("evosax SimpleGA, fastest form", "with_evosax.Fastest", "evosax", "fastest"),
    "evosax snes": Entry("evosax SNES, fastest form", "with_evosax.Snes", "evosax", "fastest"),
    "evotorch": Entry(
        "EvoTorch GeneticAlgorithm, as documented", "with_evotorch.Documented", "evotorch", "documented"
    ),
    "evotorch+": Entry("EvoTorch functional operators, fastest form", "with_evotorch.Fastest", "evotorch", "fastest"),
    "deap": Entry("DEAP eaSimple, as documented", "with_deap.Documented", "deap", "documented"),
    "deap+": Entry("DEAP eaSimple, fastest form", "with_deap.Fastest", "deap", "fastest"),
    "pygad": Entry("PyGAD, as documented", "with_pygad.Documented", "pygad", "documented"),
    "pygad+": Entry("PyGAD, fastest form", "with_pygad.Fastest", "pygad", "fastest"),
}
"""Contestants by name, those of one library together: they share a process."""
