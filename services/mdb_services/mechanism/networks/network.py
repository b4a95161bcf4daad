"""Multilayer perceptrons as models: the shape of a genome, and the compact network that acts and travels.

Models are multilayer perceptrons (paper, section 2.3). A `Network` holds what acts, the expressed units
(that of a committee also idle ones, see `learners.committee`), so whoever uses it needs neither promoters nor numba.
Hidden units are tanh. Outputs are a sum, cut off at -1 and 1 where it is used (ours): all targets lie in [-1, 1],
and a bounded model cannot promise more than the best that can happen. Evolution measures the sum before it is cut
(`kernel.py`): what lies beyond the bounds then still says which way is better. Measured on the communication model
against cutting, or tanh, in evolution as well: a third of the error over all command-action pairs after the second
language.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Shape:
    """The largest network a genome can express: inputs, hidden units of each layer, outputs."""

    inputs: int
    hidden: tuple[int, ...]
    outputs: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "hidden", tuple(self.hidden))
        if not self.hidden or min(self.sizes) < 1:
            raise ValueError(f"shape {self.sizes}: expected at least one hidden layer, and one unit in each layer")

    @property
    def sizes(self) -> tuple[int, ...]:
        """Return the units of all layers, inputs first."""
        return (self.inputs, *self.hidden, self.outputs)

    @property
    def weights(self) -> int:
        """Return the number of weights of a genome: each unit has one for each unit before it, and a bias."""
        return sum(after * (before + 1) for before, after in pairwise(self.sizes))

    @property
    def units(self) -> int:
        """Return the number of hidden units, which is the number of promoters."""
        return sum(self.hidden)


def split_layers(sizes: Sequence[int], flat: NDArray[Any]) -> list[NDArray[Any]]:
    """View flat weights as one matrix (units, units before + 1) for each layer; the bias is last in a row."""
    matrices, start = [], 0
    for before, after in pairwise(sizes):
        stop = start + after * (before + 1)
        matrices.append(flat[start:stop].reshape(after, before + 1))
        start = stop
    return matrices


class Network:
    """A multilayer perceptron of expressed units: `predict` maps (n, inputs) to (n, outputs) in [-1, 1]."""

    def __init__(self, layers: Sequence[NDArray[Any]]) -> None:
        """Take one matrix (units, units before + 1), bias last, for each layer; hidden layers may be empty.

        Raises ValueError when the matrices do not follow one another or hold a number that is not finite.
        """
        matrices = tuple(np.array(layer, dtype=np.float32) for layer in layers)
        _check_layers(matrices)
        for matrix in matrices:
            matrix.setflags(write=False)
        self.layers: tuple[Floats, ...] = matrices

    @property
    def sizes(self) -> tuple[int, ...]:
        """Return the units of all layers, inputs first."""
        return (self.layers[0].shape[1] - 1, *(layer.shape[0] for layer in self.layers))

    @property
    def expressed(self) -> int:
        """Return the number of hidden units."""
        return sum(self.sizes[1:-1])

    def predict(self, inputs: NDArray[Any]) -> Floats:
        """Return the outputs, float32 (n, outputs) in [-1, 1], for inputs (n, inputs)."""
        sums = self.sums(inputs)
        np.maximum(sums, -1, out=sums)
        return np.minimum(sums, 1, out=sums)

    def sums(self, inputs: NDArray[Any]) -> Floats:
        """Return the outputs before they are cut off: for comparing cases that all come out at the bound."""
        rows = np.asarray(inputs, dtype=np.float32)
        if rows.ndim != 2 or rows.shape[1] != self.layers[0].shape[1] - 1:
            raise ValueError(f"inputs have shape {rows.shape}; expected (n, {self.sizes[0]}): one row a case")
        for layer in self.layers[:-1]:
            rows = rows @ layer[:, :-1].T  # an array of our own from here on
            rows += layer[:, -1].copy()  # side by side they are added several at once
            np.tanh(rows, out=rows)
        last = self.layers[-1]
        sums: Floats = rows @ last[:, :-1].T
        sums += last[:, -1]
        return sums

    def to_arrays(self) -> tuple[list[int], Floats]:
        """Return the layer sizes and all weights in one flat float32 array, as a message carries them."""
        return list(self.sizes), np.concatenate([layer.ravel() for layer in self.layers])

    @classmethod
    def from_arrays(cls, sizes: Sequence[int], weights: NDArray[Any]) -> Self:
        """Build a network from what `to_arrays` gave; raises ValueError when it is not consistent."""
        if len(sizes) < 3 or min(sizes) < 0 or sizes[0] < 1 or sizes[-1] < 1:
            raise ValueError(f"layer sizes {list(sizes)}: expected inputs, hidden units, outputs, none negative")
        needed = sum(after * (before + 1) for before, after in pairwise(sizes))
        flat = np.array(weights, dtype=np.float32)
        if flat.shape != (needed,):
            raise ValueError(f"weights have shape {flat.shape}; layer sizes {list(sizes)} need ({needed},)")
        _check_finite("weights", flat)
        flat.setflags(write=False)
        network = cls.__new__(cls)  # what was split of one array fits together
        network.layers = tuple(split_layers(sizes, flat))
        return network


def _check_layers(layers: tuple[Floats, ...]) -> None:
    if len(layers) < 2:
        raise ValueError(f"{len(layers)} layers of weights; expected a hidden layer and an output layer at least")
    for index, layer in enumerate(layers):
        if layer.ndim != 2 or layer.shape[1] < 1:
            raise ValueError(f"layer {index} has shape {layer.shape}; expected (units, units before + 1)")
        if index and layer.shape[1] != layers[index - 1].shape[0] + 1:
            before = layers[index - 1].shape[0]
            raise ValueError(f"layer {index} has {layer.shape[1]} columns; {before} units before need {before + 1}")
        _check_finite(f"weights of layer {index}", layer)


def _check_finite(what: str, weights: Floats) -> None:
    if not np.isfinite(weights).all():
        raise ValueError(f"{what} are not finite: the sender's evolution diverged")
