"""Errors of a whole population over the short-term memory, compiled, without keeping any activation.

Genomes are flat float32 rows, laid out as `network.split_layers` views them; promoters are one byte a hidden
unit. The pairs come transposed in blocks (`in_blocks`), so that each innermost loop runs over a block of
pairs and becomes vector instructions. A unit that is not expressed costs nothing. One thread; the same
machine gives the same bits each time.
"""

# ruff: noqa: PLR0917 - compiled functions take arrays by position

from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mdb_services.mechanism.network import Floats, split_layers

_Function = TypeVar("_Function", bound=Callable[..., Any])

# Sums may be reordered into vectors and fused; infinities and NaN keep their meaning.
_FAST = {"contract", "reassoc", "nsz", "arcp"}


def compiled(function: _Function) -> _Function:
    """Compile at the first call and keep the result on disk; arrays are not checked for their bounds.

    A check for division by zero would keep loops from becoming vector instructions, hence numpy's error model.
    The disk cache looks at a function's own file only: after editing this one, also touch ``operators.py``.
    """
    return cast(_Function, njit(cache=True, fastmath=_FAST, error_model="numpy")(function))


BLOCK = 64
"""Pairs handled at once: four AVX-512 registers, and few enough for the first-level cache."""

GROUP = 4
"""Senders added in one pass over a block, so that the sums are read and written a quarter as often."""

TANH_ERROR = 5e-7
"""Bound of the absolute error of `tanh32`, over all float32 numbers."""

# tanh(x) = x P(x^2) / Q(x^2): the rational minimax approximation for |x| < 7.9 that Eigen and XLA use.
_LIMIT = np.float32(7.90531110763549805)
_P0, _P1 = np.float32(4.89352455891786e-03), np.float32(6.37261928875436e-04)
_P2, _P3 = np.float32(1.48572235717979e-05), np.float32(5.12229709037114e-08)
_P4 = np.float32(-8.60467152213735e-11)
_P5, _P6 = np.float32(2.00018790482477e-13), np.float32(-2.76076847742355e-16)
_Q0, _Q1 = np.float32(4.89352518554385e-03), np.float32(2.26843463243900e-03)
_Q2, _Q3 = np.float32(1.18534705686654e-04), np.float32(1.19825839466702e-06)
_ONE, _ZERO = np.float32(1), np.float32(0)
_1, _2, _3 = np.uint64(1), np.uint64(2), np.uint64(3)


@compiled
def tanh32(x: Any) -> Any:
    """Return tanh of a float32, within `TANH_ERROR`; no branch, so a loop over it vectorises."""
    x = min(max(x, -_LIMIT), _LIMIT)
    y = x * x
    over = ((((((_P6 * y + _P5) * y + _P4) * y + _P3) * y + _P2) * y + _P1) * y + _P0) * x
    return over / (((_Q3 * y + _Q2) * y + _Q1) * y + _Q0)


def in_blocks(rows: NDArray[Any]) -> Floats:
    """Return rows (n, columns) as float32 (blocks, columns, BLOCK), filled up with zeros.

    The columns are filled up to a multiple of `GROUP`, the last block to `BLOCK` pairs.
    """
    count, columns = rows.shape
    blocks, padded_columns = -(-count // BLOCK), -(-columns // GROUP) * GROUP
    padded = np.zeros((blocks * BLOCK, padded_columns), dtype=np.float32)
    padded[:count, :columns] = rows
    return np.ascontiguousarray(padded.reshape(blocks, BLOCK, padded_columns).transpose(0, 2, 1))


@compiled
def _pack(weights: Any, promoters: Any, sizes: Any, packed: Any, counts: Any) -> Any:
    """Copy the weights that count: for each unit the bias, then the expressed senders, zeros up to a group.

    counts (layers,) receives the expressed units of each layer; the senders of the first layer are the inputs.
    Returns how many numbers were written.
    """
    counts[0] = sizes[0]
    offset, free, gene, sender_gene = 0, 0, 0, 0
    for layer in range(1, sizes.size):
        before, last = sizes[layer - 1], layer == sizes.size - 1
        counts[layer] = 0
        for unit in range(sizes[layer]):
            if last or promoters[gene + unit]:
                row = offset + unit * (before + 1)
                packed[free] = weights[row + before]
                free += 1
                end = free
                for sender in range(before):
                    if layer == 1 or promoters[sender_gene + sender]:
                        packed[end] = weights[row + sender]
                        end += 1
                free += max(-(-counts[layer - 1] // GROUP), 1) * GROUP
                packed[end:free] = _ZERO
                counts[layer] += 1
        offset += sizes[layer] * (before + 1)
        sender_gene = gene
        gene += sizes[layer]
    return free


@compiled
def _weigh(packed: Any, start: Any, senders: Any, source: Any, sums: Any) -> Any:
    """Write to sums (BLOCK,) the bias plus the weighted senders, source (units, BLOCK); return the next start.

    Unsigned indices and four senders a pass are what make these loops good vector instructions.
    """
    bias, w = packed[start], start + np.uint64(1)
    w0, w1, w2, w3 = packed[w], packed[w + _1], packed[w + _2], packed[w + _3]
    for b in range(BLOCK):
        sums[b] = bias + w0 * source[0, b] + w1 * source[1, b] + w2 * source[2, b] + w3 * source[3, b]
    j = np.uint64(GROUP)
    while j < senders:
        w += np.uint64(GROUP)
        w0, w1, w2, w3 = packed[w], packed[w + _1], packed[w + _2], packed[w + _3]
        for b in range(BLOCK):
            first_two = w0 * source[j, b] + w1 * source[j + _1, b]
            sums[b] += first_two + w2 * source[j + _2, b] + w3 * source[j + _3, b]
        j += np.uint64(GROUP)
    return w + np.uint64(GROUP)


@compiled
def _squared_errors(sums: Any, targets: Any, valid: int) -> Any:
    """Return the sum over a block of the squared differences between outputs and targets."""
    total = _ZERO
    for b in range(valid):
        miss = sums[b] - targets[b]
        total += miss * miss
    return total


@compiled
def _sum_of_squares(values: Any) -> Any:
    total = _ZERO
    for value in values:
        total += value * value
    return total


@compiled
def _genome_error(packed: Any, counts: Any, inputs: Any, targets: Any, pairs: int, work: Any) -> Any:
    """Return the mean squared error of one packed genome over all pairs and outputs."""
    total = 0.0
    last = counts.size - 1
    for block in range(inputs.shape[0]):
        source, start = inputs[block], np.uint64(0)
        for layer in range(1, last):
            for unit in range(counts[layer]):
                sums = work[layer % 2, unit]
                start = _weigh(packed, start, np.uint64(counts[layer - 1]), source, sums)
                for b in range(BLOCK):
                    sums[b] = tanh32(sums[b])
            source = work[layer % 2]
        for unit in range(counts[last]):
            sums = work[last % 2, unit]
            start = _weigh(packed, start, np.uint64(counts[last - 1]), source, sums)
            total += _squared_errors(sums, targets[block, unit], min(BLOCK, pairs - block * BLOCK))
    return total / (pairs * counts[last])


@compiled
def population_errors(
    weights: Any, promoters: Any, sizes: Any, inputs: Any, targets: Any, pairs: int, errors: Any, squares: Any
) -> None:
    """Write each genome's mean squared error over the pairs, and the sum of its squared weights that count.

    weights (population, weights) float32; promoters (population, hidden units) uint8; sizes (layers,) int64;
    inputs (blocks, inputs, BLOCK) and targets (blocks, outputs, BLOCK) float32 from `in_blocks`; pairs is the
    number of true pairs, at least one; errors and squares (population,) float64.
    """
    rows = (sizes.max() // GROUP + 1) * GROUP
    counts = np.empty(sizes.size, np.int64)
    packed = np.empty(weights.shape[1] + GROUP * sizes.sum(), np.float32)
    work = np.zeros((2, rows, BLOCK), np.float32)
    for individual in range(weights.shape[0]):
        used = _pack(weights[individual], promoters[individual], sizes, packed, counts)
        squares[individual] = _sum_of_squares(packed[:used])
        errors[individual] = _genome_error(packed, counts, inputs, targets, pairs, work)


def reference_errors(
    weights: Floats, promoters: NDArray[np.uint8], sizes: Sequence[int], inputs: Floats, targets: Floats
) -> NDArray[np.float64]:
    """Return what `population_errors` must give, by batched numpy in double precision: the tests' oracle.

    inputs (n, inputs) and targets (n, outputs) are rows, neither transposed nor padded.
    """
    errors = np.empty(len(weights))
    for individual, genome in enumerate(weights.astype(np.float64)):
        rows, gene = inputs.astype(np.float64), 0
        *hidden, last = split_layers(sizes, genome)
        for layer in hidden:
            mask = promoters[individual, gene : gene + len(layer)]
            rows = np.tanh(rows @ layer[:, :-1].T + layer[:, -1]) * mask
            gene += len(layer)
        outputs = rows @ last[:, :-1].T + last[:, -1]
        errors[individual] = np.mean((outputs - targets) ** 2)
    return errors
