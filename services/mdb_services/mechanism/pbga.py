"""The promoter-based genetic algorithm: a population of networks that learns what a short-term memory holds.

Owns one population, kept between calls (paper, section 2.3). It must not know what the inputs mean, where
pairs come from or who uses the best network. The operators are in ``operators.py``, the errors in ``kernel.py``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism import streams
from mdb_services.mechanism.kernel import in_blocks
from mdb_services.mechanism.network import Floats, Network, Shape, split_layers
from mdb_services.mechanism.operators import Settings, evolve
from mdb_services.mechanism.settings import EvolutionConfig


@dataclass(frozen=True)
class Best:
    """The best individual on the present memory."""

    network: Network
    error: float
    """Mean squared error of its predictions over the memory, without penalty; NaN when the memory is empty."""
    expressed: int
    """Hidden units of the network."""


class PromoterGA:
    """A population of networks of one shape, evolved a few generations for each version of a memory."""

    def __init__(self, shape: Shape, config: EvolutionConfig, seed: int, name: str) -> None:
        """Draw the first population from the stream of (seed, name)."""
        self.shape, self.config = shape, config
        self._key = streams.key(seed, name)
        self._sizes = np.array(shape.sizes, dtype=np.int64)
        count = config.population
        random = streams.generator(seed, f"{name}/first population", 0)
        limit = config.weight_first
        self._weights = random.uniform(-limit, limit, (count, shape.weights)).astype(np.float32)
        self._promoters = (random.random((count, shape.units)) < config.expressed_first).astype(np.uint8)
        self._steps = np.full(count, config.step_first, dtype=np.float32)
        self._errors, self._fitness = np.full(count, np.nan), np.full(count, np.nan)
        self._version, self._generation = -1, 0
        self._settings = Settings(**{name: getattr(config, name) for name in Settings._fields})

    def learn(self, inputs: Floats, targets: Floats, *, version: int, generations: int | None = None) -> Best:
        """Evolve on a memory, inputs (n, inputs) and targets (n, outputs), and return the best.

        All individuals are measured on this memory first. An empty memory changes nothing. With generations 0 the
        population is only measured. Random numbers depend on (seed, name, version, generation) alone.
        Raises ValueError when the arrays do not fit the shape or hold a number that is not finite.
        """
        self._check_memory(inputs, targets)
        if version != self._version:
            self._version, self._generation = version, 0
        if len(inputs):
            count = self.config.generations if generations is None else generations
            data = (in_blocks(inputs), in_blocks(targets), len(inputs))
            key = np.uint64(streams.key(self._key, f"version {version}"))
            span = (self._generation, self._generation + count)
            population = (self._weights, self._promoters, self._steps)
            evolve(population, self._errors, self._fitness, self._sizes, data, key, span, self._settings)
            self._generation = span[1]
        return self._best(inputs, targets)

    def seed(self, networks: Sequence[Network]) -> None:
        """Put networks into the population in the place of its worst.

        A network may have fewer units than the shape; the units left over keep the weights of the individual that
        is replaced, unexpressed. Raises ValueError when a network does not fit or there are too many.
        """
        if len(networks) > self.config.population:
            raise ValueError(f"{len(networks)} networks for a population of {self.config.population}: seed fewer")
        for network in networks:
            self._check_fits(network)
        worst = np.argsort(-self._fitness, kind="stable")  # NaN, not yet measured, comes last: any will do
        for network, place in zip(networks, worst, strict=False):
            self._write(network, place)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return copies of all arrays from which `restore` continues identically."""
        return {
            "weights": self._weights.copy(),
            "promoters": self._promoters.copy(),
            "steps": self._steps.copy(),
            "errors": self._errors.copy(),
            "fitness": self._fitness.copy(),
            "clock": np.array([self._version, self._generation], dtype=np.int64),
        }

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from what `state` gave; raises ValueError when it is of another shape or configuration."""
        fresh = self.state()
        for name, own in fresh.items():
            if name not in state:
                raise ValueError(f"state lacks {name!r}; expected {sorted(fresh)}: it is not of a population")
            given = state[name]
            if given.shape != own.shape or given.dtype != own.dtype:
                raise ValueError(
                    f"{name} is {given.dtype} {given.shape}; expected {own.dtype} {own.shape}: "
                    "the state is of another network shape or population size, start afresh"
                )
        if not (np.isfinite(state["weights"]).all() and np.isfinite(state["steps"]).all()):
            raise ValueError("weights or steps are not finite: the state is damaged, start afresh")
        if state["promoters"].max(initial=0) > 1:
            raise ValueError("promoters hold something else than 0 and 1: the state is damaged, start afresh")
        self._weights, self._promoters = state["weights"].copy(), state["promoters"].copy()
        self._steps, self._errors = state["steps"].copy(), state["errors"].copy()
        self._fitness = state["fitness"].copy()
        self._version, self._generation = (int(number) for number in state["clock"])

    def network(self, individual: int) -> Network:
        """Return the network that an individual expresses."""
        promoters = self._promoters[individual].astype(bool)
        ends = np.cumsum(self.shape.hidden)[:-1]
        outputs = np.ones(self.shape.outputs, dtype=bool)
        receivers = [*np.split(promoters, ends), outputs]
        senders = [np.ones(self.shape.inputs, dtype=bool), *receivers[:-1]]
        matrices = split_layers(self.shape.sizes, self._weights[individual])
        return Network(
            [
                matrix[expressed][:, np.append(sending, True)]
                for matrix, expressed, sending in zip(matrices, receivers, senders, strict=True)
            ]
        )

    def _best(self, inputs: Floats, targets: Floats) -> Best:
        measured = not np.isnan(self._fitness).all()
        network = self.network(int(np.nanargmin(self._fitness)) if measured else 0)
        misses = network.predict(inputs) - targets
        error = float(np.mean(misses**2, dtype=np.float64)) if len(inputs) else float("nan")
        return Best(network, error, network.expressed)

    def _check_memory(self, inputs: Floats, targets: Floats) -> None:
        for what, array, columns in (("inputs", inputs, self.shape.inputs), ("targets", targets, self.shape.outputs)):
            if array.ndim != 2 or array.shape[1] != columns:
                raise ValueError(f"{what} have shape {array.shape}; expected (n, {columns}): one row a pair")
            if not np.isfinite(array).all():
                raise ValueError(f"{what} hold a number that is not finite: leave such pairs out of the memory")
        if len(inputs) != len(targets):
            raise ValueError(f"{len(inputs)} rows of inputs, {len(targets)} of targets; expected as many")

    def _check_fits(self, network: Network) -> None:
        given, own = network.sizes, self.shape.sizes
        same_ends = len(given) == len(own) and (given[0], given[-1]) == (own[0], own[-1])
        if not same_ends or any(units > room for units, room in zip(given, own, strict=True)):
            raise ValueError(f"a network of layers {given} does not fit {own}: expected as many layers, none larger")

    def _write(self, network: Network, place: int) -> None:
        views = split_layers(self.shape.sizes, self._weights[place])
        self._promoters[place] = 0
        gene = 0
        for matrix, layer in zip(views, network.layers, strict=True):
            rows, columns = layer.shape
            matrix[:rows, : columns - 1], matrix[:rows, -1] = layer[:, :-1], layer[:, -1]
            self._promoters[place, gene : gene + rows] = 1
            gene += len(matrix)
        self._steps[place] = self.config.step_first
        self._errors[place] = self._fitness[place] = np.nan
