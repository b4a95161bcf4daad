"""What every learner does: it fits networks of one shape to each version of a short-term memory.

Owns the contract and what all learners share: the checks, the count of versions and generations, the state.
A learner must not know what the inputs mean, where pairs come from or who uses the network that it reports.
`tests/conformance/learner_conformance.py` holds the contract as tests.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.evolution.genomes import as_pairs
from mdb_services.mechanism.evolution.layout import Pairs
from mdb_services.mechanism.evolution.native import Table
from mdb_services.mechanism.networks import streams
from mdb_services.mechanism.networks.network import Floats, Network, Shape

Arrays = dict[str, NDArray[Any]]
Layers = Sequence[Floats]
"""Of a network, see `Network`."""


@dataclass(frozen=True)
class Memory:
    """What is learnt: inputs (n, inputs) and targets (n, outputs)."""

    inputs: Floats
    targets: Floats

    @cached_property
    def pairs(self) -> Table[Pairs]:
        """The same as compiled code reads it."""
        return as_pairs(self.inputs, self.targets)


@dataclass(frozen=True)
class Best:
    """The best network on the present memory."""

    network: Network
    error: float
    """Mean squared error of its predictions over the memory, without penalty; NaN when the memory is empty."""
    expressed: int
    """Hidden units of the network; of a committee's, idle ones too."""


def error_of(network: Network, inputs: Floats, targets: Floats) -> float:
    """Return a network's mean squared error on inputs (n, inputs) and targets (n, outputs); NaN without any."""
    if not len(inputs):
        return float("nan")
    misses = network.predict(inputs) - targets
    return float(np.add.reduce(np.square(misses, out=misses), axis=None, dtype=np.float64) / misses.size)


class Learner(ABC):
    """A learner of one shape. A subclass keeps all that changes in arrays, attributes `_NAME` for `arrays`."""

    arrays: ClassVar[tuple[str, ...]]
    """Names of the state's arrays."""
    unmeasured: ClassVar[tuple[str, ...]] = ()
    """Those that may hold infinity: what was not yet measured."""
    lists: ClassVar[tuple[str, ...]] = ()
    """Those that may have any number of rows."""
    compiled: ClassVar[bool] = False
    """Whether `_learn` is nearly all compiled code, without Python's lock."""

    def __init__(self, shape: Shape, generations: int, seed: int, name: str) -> None:
        """Take the shape, the generations (or steps) of one call of `learn`, and the stream (seed, name)."""
        self.shape, self.generations = shape, generations
        self._key = streams.key(seed, name)
        self._clock = np.array([-1, 0], dtype=np.int64)

    def learn(self, inputs: Floats, targets: Floats, *, version: int, generations: int | None = None) -> Best:
        """Learn a memory, inputs (n, inputs) and targets (n, outputs), and return the best network.

        All that is kept is measured on this memory first: an old error says nothing once the memory changed. An
        empty memory changes nothing. With generations 0 nothing is learnt, only measured. Random numbers depend
        on (seed, name, version, generation) alone.
        Raises ValueError when the arrays do not fit the shape or hold a number that is not finite.
        """
        self._check_memory(inputs, targets)
        if len(inputs):
            first = int(self._clock[1]) if version == self._clock[0] else 0
            end = first + (self.generations if generations is None else generations)
            self._learn(Memory(inputs, targets), streams.key(self._key, f"version {version}"), range(first, end))
            self._clock[:] = version, end
        network = Network(self._best())
        return Best(network, error_of(network, inputs, targets), network.expressed)

    def seed(self, networks: Sequence[Network]) -> None:
        """Take networks as a starting point: at the next memory the best is no worse than the best of them.

        A network may have fewer units than the shape. Raises ValueError when one does not fit.
        """
        for network in networks:
            self._check_fits(network)
        self._seed(networks)

    def state(self) -> Arrays:
        """Return copies of all arrays from which `restore` continues identically."""
        return {name: getattr(self, f"_{name}").copy() for name in (*self.arrays, "clock")}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from what `state` gave; raises ValueError when it is damaged or of another learner."""
        own = Learner.state(self)
        missing = sorted(own.keys() - state.keys())
        if missing:
            raise ValueError(f"state lacks {', '.join(map(repr, missing))}: it is not of this learner, start afresh")
        given = {name: np.array(state[name], order="C") for name in own}
        for name, array in given.items():
            self._check_array(name, array, own[name])
        self._check_state(given)
        for name, array in given.items():
            setattr(self, f"_{name}", array)

    @abstractmethod
    def _learn(self, memory: Memory, key: int, generations: range) -> None:
        """Measure all that is kept on a memory that is not empty, then learn it for these generations.

        `key` begins the streams of this memory version; the generations count on over calls with one version.
        """

    @abstractmethod
    def _best(self) -> Layers:
        """Return the layers of the network that was best on the last memory; any when there was none."""

    @abstractmethod
    def _seed(self, networks: Sequence[Network]) -> None:
        """Take in networks that fit."""

    def _check_state(self, state: Arrays) -> None:
        """Raise ValueError when arrays of the right type and shape hold what cannot be."""
        if state["clock"][1] < 0:
            raise ValueError(f"clock is {state['clock']}: the state is damaged, start afresh")

    def _check_array(self, name: str, given: NDArray[Any], own: NDArray[Any]) -> None:
        rows = given.shape[:1] if name in self.lists else own.shape[:1]
        if given.dtype != own.dtype or given.shape != (*rows, *own.shape[1:]):
            raise ValueError(
                f"{name} is {given.dtype} {given.shape}; expected {own.dtype} {own.shape}: "
                "the state is of another network shape or learner's settings, start afresh"
            )
        if np.isnan(given).any() or (name not in self.unmeasured and np.isinf(given).any()):
            raise ValueError(f"{name} holds a number that is not finite: the state is damaged, start afresh")

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
