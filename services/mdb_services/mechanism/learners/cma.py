"""CMA-ES with a diagonal covariance matrix (Ros and Hansen 2008), by the library `cmaes`, an extra.

Diagonal, because a version of the memory brings a few generations only and a network has a hundred weights and
more: a full matrix takes thousands of generations to be learnt, and a hundred times the computing.

The search distribution goes on from version to version, and its mean moves by nothing but its own generations.
That it can follow a change of the memory, its step never falls below `step_min`. In one case it begins anew,
with the first step and no shape, around another mean: when a network given to `seed` is better than the best.
The best genome is kept, measured anew on every memory, until the mean or a sample is better.
"""

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.evolution.genomes import Measure
from mdb_services.mechanism.learners.contract import Arrays
from mdb_services.mechanism.learners.single import SingleNetwork
from mdb_services.mechanism.networks import streams
from mdb_services.mechanism.networks.network import Floats, Shape
from mdb_services.mechanism.settings import CmaConfig

MOVING = ("mean", "sigma", "C", "p_sigma", "pc", "g")
"""What a generation changes in the library's optimizer, by its names without underscore; all else is constant."""


class CovarianceAdaptation(SingleNetwork):
    """The best genome, and the search distribution: mean, step, variances, their paths and the generation."""

    arrays: ClassVar = ("weights", "waiting", *MOVING)

    def __init__(self, shape: Shape, config: CmaConfig, seed: int, name: str) -> None:
        """Begin around a network from the stream of (seed, name); ModuleNotFoundError without `cmaes`."""
        super().__init__(shape, config.generations, seed, name)
        self.config = config
        self._library = _library()
        self._begin_anew()

    def _begin_anew(self) -> None:
        limit = self.config.weight_limit
        self._mean = np.clip(self._weights[0].astype(np.float64), -limit, limit)
        self._sigma, self._C = np.full(1, self.config.step_first), np.ones_like(self._mean)
        self._p_sigma, self._pc = np.zeros_like(self._mean), np.zeros_like(self._mean)
        self._g = np.zeros(1, dtype=np.int64)

    def _improve(self, inputs: Floats, targets: Floats, key: int, generations: range) -> None:
        measure, search = Measure(self.shape, inputs, targets), self._resumed()
        self._lowest = np.inf
        self._fitness(measure, self._weights)
        self._fitness(measure, self._mean[None])
        for generation in generations:
            search.reseed_rng(streams.key(key, f"generation {generation}") % 2**32)
            genomes = np.array([search.ask() for _ in range(search.population_size)])
            search.tell(list(zip(genomes, self._fitness(measure, genomes).tolist(), strict=True)))
            self._keep_moving(search)
            self._fitness(measure, search.mean[None])
        for name in MOVING:
            own = getattr(self, f"_{name}")
            own[:] = getattr(search, f"_{name}")

    def _fitness(self, measure: Measure, genomes: NDArray[Any]) -> NDArray[np.float64]:
        """Return the fitness of genomes (n, weights), and keep the best there has been on this memory."""
        fitness = measure(genomes, self.config.weight_penalty)
        best = int(np.argmin(fitness))
        if fitness[best] < self._lowest:
            self._lowest, self._weights[0] = fitness[best], genomes[best]
        return fitness

    def _resumed(self) -> Any:
        """Return the library's optimizer with the state of this one."""
        limits = np.full((len(self._mean), 2), self.config.weight_limit) * (-1, 1)
        search = self._library.SepCMA(
            self._mean.copy(), self._sigma[0], limits, n_max_resampling=1, population_size=self.config.population
        )
        moving = {"C": self._C.copy(), "p_sigma": self._p_sigma, "pc": self._pc, "g": int(self._g[0])}
        vars(search).update({f"_{name}": value for name, value in moving.items()})
        return search

    def _keep_moving(self, search: Any) -> None:
        """Keep the root of the mean square of the steps of all weights within `step_min` and `step_max`.

        The step alone would not do: the variances shrink where the step may not.
        """
        spread = np.sqrt(np.mean(search._C))
        search._sigma = float(np.clip(search._sigma, self.config.step_min / spread, self.config.step_max / spread))

    def _check_state(self, state: Arrays) -> None:
        super()._check_state(state)
        if not (state["sigma"][0] > 0 and (state["C"] > 0).all() and state["g"][0] >= 0):
            raise ValueError("sigma, C or g are not positive: the state is damaged, start afresh")
        limit = self.config.weight_limit
        if np.abs(state["mean"]).max() > limit:
            raise ValueError(f"mean goes beyond weight_limit {limit}: the state is of other settings, start afresh")


def _library() -> Any:
    try:
        import cmaes
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "learner 'cma' needs the package cmaes: pip install 'multilevel-darwinist-brain[learners]'", name="cmaes"
        ) from error
    return cmaes
