"""Genomes as flat rows of weights with every hidden unit expressed: their errors, and how a network gets in.

What the learners without promoters have in common. A genome is laid out as `networks.network.split_layers` views it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.evolution import native
from mdb_services.mechanism.evolution.layout import BLOCK, GROUP, MEASURE, Measured, Pairs, aligned, spaces_for
from mdb_services.mechanism.networks.network import Floats, Network, Shape, split_layers

Doubles = NDArray[np.float64]


def embed(network: Network, shape: Shape, genome: NDArray[Any]) -> None:
    """Write a network into a genome (weights,) of a shape that it fits.

    Units left over keep the weights that they receive and send nothing to the network's own units, which leaves
    its outputs as they are and the units ready to be learnt.
    """
    for matrix, layer in zip(split_layers(shape.sizes, genome), network.layers, strict=True):
        rows, columns = layer.shape
        used = matrix[:rows]
        used[:, : columns - 1], used[:, columns - 1 : -1], used[:, -1] = layer[:, :-1], 0, layer[:, -1]


def signals_of(layers: Sequence[Floats], inputs: Floats) -> list[Floats]:
    """Return the inputs (n, inputs) and the signals (n, units) of each hidden layer, which is all but the last."""
    signals = [inputs]
    for layer in layers[:-1]:
        signals.append(np.tanh(signals[-1] @ layer[:, :-1].T + layer[:, -1]))
    return signals


def network_of(shape: Shape, genome: NDArray[Any]) -> Network:
    """Return the network of a genome (weights,)."""
    return Network(split_layers(shape.sizes, genome))


class Measure:
    """Errors of genomes on one memory, inputs (n, inputs) and targets (n, outputs), by the compiled kernel.

    For one thread at a time.
    """

    def __init__(self, shape: Shape, inputs: Floats, targets: Floats) -> None:
        for what, rows, columns in (("inputs", inputs, shape.inputs), ("targets", targets, shape.outputs)):
            if rows.shape != (len(inputs), columns):
                raise ValueError(f"{what} have shape {rows.shape}; expected {(len(inputs), columns)}")
        self._shape, self._sizes = shape, np.array(shape.sizes, dtype=np.int64)
        self._pairs = as_pairs(inputs, targets)
        self._room, self._spaces = 0, native.Table(spaces_for(shape.sizes, 0))

    def __call__(self, genomes: NDArray[Any], penalty: float = 0.0) -> NDArray[np.float64]:
        """Return the mean squared error of each genome (genomes, weights) plus the penalty on squared weights."""
        rows = np.ascontiguousarray(genomes, dtype=np.float32)
        promoters = np.ones((len(rows), self._shape.units), dtype=np.uint8)
        errors, squares = np.empty(len(rows)), np.empty(len(rows))
        self.write(rows, promoters, errors, squares)
        return errors + penalty * squares

    def write(self, weights: Floats, promoters: NDArray[np.uint8], errors: Doubles, squares: Doubles) -> None:
        """Write each genome's mean squared error, and the sum of its squared weights that count.

        weights (genomes, weights), promoters (genomes, hidden units), errors and squares (genomes,); squares of size
        0 are not written, which saves their time. Raises ValueError when an array is not of its kind, or of another
        size than the others.
        """
        count, shape = len(weights), self._shape
        shapes = [array.shape for array in (weights, promoters, errors, squares)]
        expected = [(count, shape.weights), (count, shape.units), (count,), (count if squares.size else 0,)]
        if shapes != expected:
            raise ValueError(f"weights, promoters, errors, squares have shapes {shapes}; expected {expected}")
        if count > self._room:
            self._room, self._spaces = count, native.Table(spaces_for(shape.sizes, count))
        task = native.Table(Measured(weights, promoters, self._sizes, errors, squares))
        native.run(task, self._pairs, self._spaces, MEASURE)


def as_pairs(inputs: Floats, targets: Floats) -> native.Table[Pairs]:
    """Return a memory, inputs (n, inputs) and targets (n, outputs), as compiled code reads it."""
    return native.Table(Pairs(in_blocks(inputs), in_blocks(targets), np.array([len(inputs)])))


def in_blocks(rows: NDArray[Any]) -> Floats:
    """Return rows (n, columns) as float32 (blocks, columns, BLOCK, GROUP), the last block filled up with zeros.

    Each number is there `GROUP` times, side by side.
    """
    count, columns = rows.shape
    blocks = -(-count // BLOCK)
    filled = np.zeros((blocks * BLOCK, columns), dtype=np.float32)
    filled[:count] = rows
    once, packed = filled.reshape(blocks, BLOCK, columns).transpose(0, 2, 1), aligned((blocks, columns, BLOCK, GROUP))
    for place in range(GROUP):
        packed[..., place] = once
    return packed
