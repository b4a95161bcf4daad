"""The settings of evolution, apart from its code: who only reads them need not import a compiler."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class EvolutionConfig:
    """How a population evolves; the defaults are ours, tuned in closed loop."""

    population: int = 200
    """Individuals."""
    generations: int = 6
    """Generations for each version of the memory: few, so that learning is gradual (paper, section 2.3)."""
    elite: int = 2
    """The best individuals, which stay as they are; they too are measured anew on every memory."""
    parent_share: float = 0.2
    """Share of the population, its best part, of which each offspring draws its parents with equal chances."""
    crossover_rate: float = 0.9
    """Share of offspring with two parents."""
    mutation_rate: float = 0.25
    """Probability that the weights of an expressed unit are mutated, all of them together."""
    structural_rate: float = 0.3
    """Share of offspring in which a promoter is flipped."""
    immigrant_share: float = 0.02
    """Share of each generation that is drawn like the first population. Without it, a population that selection
    made too small on its first few pairs could not grow again: neutral operators do not leave the bounds."""
    step_first: float = 0.3
    """Mutation step, a standard deviation, at the beginning."""
    step_rate: float = 0.3
    """Standard deviation of the logarithm of a step's change: steps adapt themselves."""
    step_min: float = 0.01
    """Smallest step, which keeps a population able to follow a change."""
    step_max: float = 1.0
    """Largest step."""
    weight_first: float = 1.0
    """Weights begin uniformly in plus or minus this."""
    weight_limit: float = 10.0
    """Weights stay in plus or minus this."""
    weight_penalty: float = 0.0
    """Added to the fitness for each unit of the sum of squared weights that count."""
    expressed_first: float = 0.85
    """Share of hidden units expressed at the beginning."""

    def __post_init__(self) -> None:
        if not 0 < self.elite < self.population:
            raise ValueError(f"elite is {self.elite}; expected 1 to {self.population - 1}, fewer than population")
        if self.generations < 1:
            raise ValueError(f"generations is {self.generations}; expected 1 or more")
        rates = ("crossover_rate", "mutation_rate", "structural_rate")
        for name in ("parent_share", *rates, "immigrant_share", "expressed_first"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} is {getattr(self, name)}; expected a share from 0 to 1")
        for name in ("step_rate", "weight_first", "weight_penalty"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; expected zero or a positive number")
        if not 0 < self.step_min <= self.step_first <= self.step_max < np.inf:
            steps = (self.step_min, self.step_first, self.step_max)
            raise ValueError(f"step_min, step_first, step_max are {steps}; expected them positive, in that order")
        if not self.weight_first <= self.weight_limit <= 1000:
            raise ValueError(f"weight_limit is {self.weight_limit}; expected {self.weight_first} to 1000")
