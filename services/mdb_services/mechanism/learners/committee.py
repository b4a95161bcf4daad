"""A committee: learners of one kind side by side, each with random numbers of its own; its network is their mean.

Networks that fit a memory alike err in different places, most of all where pairs are few; their mean errs less
(Hansen and Salamon, "Neural network ensembles", 1990). The mean of their sums is one network again, in which the
units of all members stand side by side, so that whoever uses a current model need not know of it. Ours.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.evolution.threads import together
from mdb_services.mechanism.learners.contract import Arrays, Layers, Learner, Memory, error_of
from mdb_services.mechanism.networks import streams
from mdb_services.mechanism.networks.network import Floats, Network, Shape, split_layers

WORTH_S = 0.001
"""What takes the members longer is shared among threads: what one learns depends on none of the others."""
ON = 20.0
"""The hyperbolic tangent of this is 1 in single precision."""


class Committee(Learner):
    """See the module's docstring. Its shape is that of `mean`.

    A network of that very shape, as a committee reports it, is a seed for its members part by part, and is reported
    itself as long as it is better than their mean; a network that fits one member is a seed for each of them.
    """

    arrays: ClassVar = ("waiting",)
    lists: ClassVar = ("waiting",)

    def __init__(self, members: Sequence[Learner], seed: int, name: str) -> None:
        """Take the members, one at least, all of one shape; and the stream (seed, name)."""
        self._room = members[0].shape
        *first, last = self._room.hidden
        hidden = tuple(units * len(members) for units in (*first, last + 1))
        super().__init__(Shape(self._room.inputs, hidden, self._room.outputs), members[0].generations, seed, name)
        self._members = tuple(members)
        self._waiting = np.zeros((0, self.shape.weights), np.float32)
        """Seeds (n, weights) that are better than the mean, or were not measured yet; the best is first."""
        self._took_s = [0.0] * len(members)
        """How long each member took for the last memory."""

    def _learn(self, memory: Memory, key: int, generations: range) -> None:
        places = range(len(self._members))
        if self._members[0].compiled and sum(self._took_s) > WORTH_S:
            together(partial(self._teach, place, memory, key, generations) for place in places)
        else:
            for place in places:
                self._teach(place, memory, key, generations)
        if not len(self._waiting):
            return
        limit = error_of(Network(self._mean()), memory.inputs, memory.targets)
        seeds = [Network.from_arrays(self.shape.sizes, weights) for weights in self._waiting]
        errors = [error_of(seed, memory.inputs, memory.targets) for seed in seeds]
        self._waiting = self._waiting[[place for place in np.argsort(errors) if errors[place] < limit]]

    def _teach(self, place: int, memory: Memory, key: int, generations: range) -> None:
        began_s = time.perf_counter()
        self._members[place]._learn(memory, streams.key(key, f"member {place}"), generations)
        self._took_s[place] = time.perf_counter() - began_s

    def _mean(self) -> Layers:
        return mean([member._best() for member in self._members], self._room)

    def _best(self) -> Layers:
        return split_layers(self.shape.sizes, self._waiting[0]) if len(self._waiting) else self._mean()

    def _check_fits(self, network: Network) -> None:
        if network.sizes != self.shape.sizes:
            self._members[0]._check_fits(network)

    def _seed(self, networks: Sequence[Network]) -> None:
        whole = [network for network in networks if network.sizes == self.shape.sizes]
        split = [parts(network, len(self._members)) for network in whole]
        small = [network for network in networks if network.sizes != self.shape.sizes]
        for place, member in enumerate(self._members):
            member.seed([*(network[place] for network in split), *small])
        for network in whole:
            weights = network.to_arrays()[1]
            if not (self._waiting == weights).all(axis=1).any():
                self._waiting = np.concatenate([self._waiting, weights[None]])

    def state(self) -> Arrays:
        """Return copies of all arrays, those of a member under its place and a dot."""
        of = {f"{place}.{name}": array for place, m in enumerate(self._members) for name, array in m.state().items()}
        return super().state() | of

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """See `Learner`; what one member refuses, all refuse."""
        before = [member.state() for member in self._members]
        try:
            for place, member in enumerate(self._members):
                start = f"{place}."
                member.restore({name[len(start) :]: state[name] for name in state if name.startswith(start)})
            super().restore(state)
        except ValueError:
            for member, arrays in zip(self._members, before, strict=True):
                member.restore(arrays)
            raise


def mean(networks: Sequence[Layers], room: Shape) -> Layers:
    """Return the layers of the network whose sums are the mean of those of `networks`, given by their layers.

    Each takes as much room as `room` says, and one unit more in its last hidden layer, which is always on and carries
    the biases of its outputs: so the mean can be taken apart again.
    """
    *first, last = room.hidden
    sizes = (room.inputs, *(units * len(networks) for units in (*first, last + 1)), room.outputs)
    whole = [np.zeros((after, before + 1), np.float32) for before, after in pairwise(sizes)]
    *inwards, outwards = whole
    for place, (*hidden, outs) in enumerate(networks):
        row = column = 0
        for own, matrix in zip(hidden, inwards, strict=True):
            row = place * (len(matrix) // len(networks))
            units, before = len(own), own.shape[1] - 1
            matrix[row : row + units, column : column + before] = own[:, :-1]
            matrix[row : row + units, -1] = own[:, -1]
            column = row
        inwards[-1][row + last, -1] = ON
        outwards[:, row : row + outs.shape[1] - 1], outwards[:, row + last] = outs[:, :-1], outs[:, -1]
    outwards /= np.float32(len(networks))
    return whole


def parts(network: Network, count: int) -> list[Network]:
    """Return the networks of which this one is the `mean`, without the units that send nothing to anything."""
    found = []
    for place in range(count):
        layers = []
        for depth, matrix in enumerate(network.layers[:-1]):
            rows = np.split(matrix, count)[place]
            weights = rows[:, :-1] if depth == 0 else np.split(rows[:, :-1], count, axis=1)[place]
            layers.append(np.hstack([weights, rows[:, -1:]]))
        layers[-1] = layers[-1][:-1]
        layers.append(np.split(network.layers[-1][:, :-1], count, axis=1)[place] * np.float32(count))
        found.append(Network(_without_idle(layers)))
    return found


def _without_idle(layers: list[Floats]) -> list[Floats]:
    for depth in range(len(layers) - 2, -1, -1):
        sends = layers[depth + 1][:, :-1].any(axis=0)
        layers[depth] = layers[depth][sends]
        layers[depth + 1] = layers[depth + 1][:, np.append(sends, True)]
    return layers
