"""Gradient descent: one network, a few steps of Adam on each version of the memory (Kingma and Ba 2015).

The gradient is that of the squared error before outputs are cut off, as evolution measures it (`network.py`).
Weight decay is apart from the gradient (Loshchilov and Hutter 2019). Adam's moments go on from version to
version: a change of the memory is a change of the loss, which both outlive after some steps.
"""

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.evolution.genomes import signals_of
from mdb_services.mechanism.learners.contract import Arrays
from mdb_services.mechanism.learners.single import SingleNetwork
from mdb_services.mechanism.networks import streams
from mdb_services.mechanism.networks.network import Floats, Shape, split_layers
from mdb_services.mechanism.settings import AdamConfig

MEAN_RATE, SQUARE_RATE, TINY = np.float32(0.9), np.float32(0.999), np.float32(1e-8)
"""Adam's constants beta 1, beta 2 and epsilon, as in its paper."""


class Adam(SingleNetwork):
    """One network and the running means of its gradient and its squared gradient."""

    arrays: ClassVar = ("weights", "waiting", "means", "squares", "steps")

    def __init__(self, shape: Shape, config: AdamConfig, seed: int, name: str) -> None:
        """Draw the first network from the stream of (seed, name)."""
        super().__init__(shape, config.steps, seed, name)
        self.config = config
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._means, self._squares = np.zeros_like(self._weights), np.zeros_like(self._weights)
        self._steps = np.zeros(1, dtype=np.int64)

    def _improve(self, inputs: Floats, targets: Floats, key: int, generations: range) -> None:
        inputs, targets = inputs.astype(np.float32, copy=False), targets.astype(np.float32, copy=False)
        for generation in generations:
            rows: NDArray[np.intp] | slice = slice(None)
            if self.config.batch < len(inputs):
                random = streams.generator(key, "batch", generation)
                rows = random.choice(len(inputs), self.config.batch, replace=False)
            self._step(gradient(self.shape, self._weights[0], inputs[rows], targets[rows]))

    def _step(self, slope: Floats) -> None:
        self._steps += 1
        count = int(self._steps[0])
        self._means += (1 - MEAN_RATE) * (slope - self._means)
        self._squares += (1 - SQUARE_RATE) * (slope * slope - self._squares)
        mean = self._means / np.float32(1 - float(MEAN_RATE) ** count)
        square = self._squares / np.float32(1 - float(SQUARE_RATE) ** count)
        rate = np.float32(self.config.rate)
        self._weights *= 1 - rate * np.float32(self.config.decay)
        self._weights -= rate * mean / (np.sqrt(square) + TINY)

    def _check_state(self, state: Arrays) -> None:
        super()._check_state(state)
        if state["squares"].min() < 0 or state["steps"][0] < 0:
            raise ValueError("squares or steps are negative: the state is damaged, start afresh")


def gradient(shape: Shape, genome: Floats, inputs: Floats, targets: Floats) -> Floats:
    """Return the gradient (weights,) of the mean squared error of a genome's sums over inputs and targets."""
    layers = split_layers(shape.sizes, genome)
    signals = signals_of(layers, inputs)
    miss = signals[-1] @ layers[-1][:, :-1].T + layers[-1][:, -1] - targets
    found = np.empty_like(genome)
    slope = miss * np.float32(2 / miss.size)
    for place, matrix in reversed(list(enumerate(split_layers(shape.sizes, found)))):
        matrix[:, :-1], matrix[:, -1] = slope.T @ signals[place], slope.sum(axis=0)
        if place:
            slope = (slope @ layers[place][:, :-1]) * (1 - signals[place] ** 2)
    return found
