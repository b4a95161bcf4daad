"""The settings of the learners, apart from their code: who only reads them need not import a compiler."""

from dataclasses import dataclass
from typing import Any

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
    made too small on its first few pairs could not grow again: neutral operators do not leave the bounds. Rounded: of
    a population of 24 a share of 0.02 is nobody; a committee's other members make up for one that is stuck."""
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
    error_penalty: float = 0.0
    """The same, as a share of the individual's error: what cannot be foreseen is not to be fitted by great weights.
    Ours."""
    expressed_first: float = 0.85
    """Share of hidden units expressed at the beginning."""

    def __post_init__(self) -> None:
        at_least(self, population=2)
        if not 0 < self.elite < self.population:
            raise ValueError(f"elite is {self.elite}; expected 1 to {self.population - 1}, fewer than population")
        at_least(self, generations=1)
        rates = ("crossover_rate", "mutation_rate", "structural_rate")
        _shares(self, "parent_share", *rates, "immigrant_share", "expressed_first")
        _not_negative(self, "step_rate", "weight_first", "weight_penalty", "error_penalty")
        _steps_in_order(self)
        _limited(self)


@dataclass(frozen=True, kw_only=True)
class DifferentialConfig:
    """Differential evolution, learner "de"; factor and crossover rate adapt themselves."""

    population: int = 100
    """Members."""
    generations: int = 10
    """Generations for each version of the memory."""
    best_share: float = 0.1
    """Share of the population, its best part, towards which trials are moved (p of JADE)."""
    immigrant_share: float = 0.05
    """Share of each generation, its worst part, that is replaced by members drawn like the first population."""
    weight_first: float = 1.0
    """Weights begin uniformly in plus or minus this."""
    weight_limit: float = 10.0
    """Weights stay in plus or minus this."""
    weight_penalty: float = 3e-5
    """Added to the fitness for each unit of the sum of squared weights."""

    def __post_init__(self) -> None:
        at_least(self, population=4, generations=1)
        _shares(self, "best_share", "immigrant_share")
        _not_negative(self, "weight_first", "weight_penalty")
        _limited(self)


@dataclass(frozen=True, kw_only=True)
class CmaConfig:
    """CMA-ES with a diagonal covariance matrix, learner "cma"."""

    population: int = 20
    """Samples in a generation; the library's own choice for a hundred weights is 17."""
    generations: int = 15
    """Generations for each version of the memory."""
    step_first: float = 0.3
    """Standard deviation of the weights at the beginning."""
    step_min: float = 0.05
    """Smallest standard deviation, over all weights, which keeps the search able to follow a change."""
    step_max: float = 1.0
    """Largest."""
    weight_limit: float = 10.0
    """Weights stay in plus or minus this."""
    weight_penalty: float = 0.0
    """Added to the fitness for each unit of the sum of squared weights."""

    def __post_init__(self) -> None:
        at_least(self, population=4, generations=1)
        _steps_in_order(self)
        _not_negative(self, "weight_penalty")
        _limited(self)


@dataclass(frozen=True, kw_only=True)
class AdamConfig:
    """Gradient descent by Adam, learner "adam"."""

    steps: int = 20
    """Steps for each version of the memory."""
    rate: float = 0.01
    """Learning rate."""
    batch: int = 32
    """Pairs of which each step computes the gradient, drawn anew; all of them when the memory has no more."""
    decay: float = 0.0
    """Weight decay: share of the weights that a step with learning rate 1 would take away. On the one seed
    compared (301), 0.01 made the communication model forget what its memory no longer showed: an error over all pairs
    of 50 % instead of 2 %."""

    def __post_init__(self) -> None:
        at_least(self, steps=1, batch=1)
        _not_negative(self, "decay")
        if not 0 < self.rate <= 1:
            raise ValueError(f"rate is {self.rate}; expected more than 0, at most 1")


@dataclass(frozen=True, kw_only=True)
class RidgeConfig:
    """Ridge regression on fixed random features, learner "ridge"."""

    features: int = 64
    """Units of the last hidden layer, drawn once; as many as the model's own when that has more."""
    scale: float = 3.0
    """Weights of the features, in units of the usual standard deviation, one over the root of their number."""
    penalty: float = 1e-4
    """Added to the mean squared error for each unit of the sum of the outputs' squared weights."""

    def __post_init__(self) -> None:
        for name, limit in (("features", 4096), ("scale", 1000), ("penalty", 1000)):
            if not 0 < getattr(self, name) <= limit:
                raise ValueError(f"{name} is {getattr(self, name)}; expected more than 0, at most {limit}")


LearnerConfig = EvolutionConfig | DifferentialConfig | CmaConfig | AdamConfig | RidgeConfig

LEARNER_CONFIGS: dict[str, type[LearnerConfig]] = {
    "pbga": EvolutionConfig,
    "ga": EvolutionConfig,
    "de": DifferentialConfig,
    "cma": CmaConfig,
    "adam": AdamConfig,
    "ridge": RidgeConfig,
}
"""The settings of each learner that an experiment file can name; `learners.LEARNERS` has their code."""


def at_least(settings: Any, **lowest: int) -> None:
    """Raise ValueError that names a setting which is less than it may be."""
    for name, limit in lowest.items():
        if getattr(settings, name) < limit:
            raise ValueError(f"{name} is {getattr(settings, name)}; expected {limit} or more")


def positive(settings: Any, *names: str) -> None:
    """Raise ValueError that names a setting which is not a finite number above zero."""
    for name in names:
        if not 0 < getattr(settings, name) < np.inf:
            raise ValueError(f"{name} is {getattr(settings, name)}; expected a positive number")


def _shares(settings: Any, *names: str) -> None:
    for name in names:
        if not 0 <= getattr(settings, name) <= 1:
            raise ValueError(f"{name} is {getattr(settings, name)}; expected a share from 0 to 1")


def _not_negative(settings: Any, *names: str) -> None:
    for name in names:
        if not 0 <= getattr(settings, name) < np.inf:
            raise ValueError(f"{name} is {getattr(settings, name)}; expected zero or a positive number")


def _steps_in_order(settings: Any) -> None:
    steps = (settings.step_min, settings.step_first, settings.step_max)
    if not 0 < steps[0] <= steps[1] <= steps[2] < np.inf:
        raise ValueError(f"step_min, step_first, step_max are {steps}; expected them positive, in that order")


def _limited(settings: Any) -> None:
    lowest = getattr(settings, "weight_first", 0.1)
    if not lowest <= settings.weight_limit <= 1000:
        raise ValueError(f"weight_limit is {settings.weight_limit}; expected {lowest} to 1000")
