"""Genomes as flat rows of weights with every hidden unit expressed: their errors, and how a network gets in.

What the learners without promoters have in common. A genome is laid out as `networks.network.split_layers` views it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.evolution.kernel import BLOCK, LINE, population_errors
from mdb_services.mechanism.evolution.packing import GROUP
from mdb_services.mechanism.networks.network import Floats, Network, Shape, split_layers


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
    """Errors of genomes on one memory, inputs (n, inputs) and targets (n, outputs), by the compiled kernel."""

    def __init__(self, shape: Shape, inputs: Floats, targets: Floats) -> None:
        self._shape, self._sizes = shape, np.array(shape.sizes, dtype=np.int64)
        self._data = in_blocks(inputs), in_blocks(targets), len(inputs)

    def __call__(self, genomes: NDArray[Any], penalty: float = 0.0) -> NDArray[np.float64]:
        """Return the mean squared error of each genome (genomes, weights) plus the penalty on squared weights."""
        rows = np.ascontiguousarray(genomes, dtype=np.float32)
        promoters = np.ones((len(rows), self._shape.units), dtype=np.uint8)
        errors, squares = np.empty(len(rows)), np.empty(len(rows))
        population_errors(rows, promoters, self._sizes, *self._data, errors, squares)
        return errors + penalty * squares


def in_blocks(rows: NDArray[Any]) -> Floats:
    """Return rows (n, columns) as float32 (blocks, columns, BLOCK, GROUP), the last block filled up with zeros.

    Each number is there `GROUP` times, side by side.
    """
    count, columns = rows.shape
    blocks = -(-count // BLOCK)
    filled = np.zeros((blocks * BLOCK, columns), dtype=np.float32)
    filled[:count] = rows
    memory = np.empty(filled.size * GROUP * 4 + LINE, dtype=np.uint8)
    start = -memory.ctypes.data % LINE
    packed = memory[start:][: memory.size - LINE].view(np.float32).reshape(blocks, columns, BLOCK, GROUP)
    packed[:] = filled.reshape(blocks, BLOCK, columns).transpose(0, 2, 1)[..., np.newaxis]
    return packed
