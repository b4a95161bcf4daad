"""Errors of a whole population over the short-term memory, compiled.

Genomes are flat float32 rows, laid out as `networks.network.split_layers` views them; promoters are one byte a hidden
unit. `GROUP` genomes are taken together: first their expressed units are packed (`packing.py`), so that the weights
at the same place in each lie side by side. A vector register then holds a few pairs for each of them, and a memory
of few pairs fills it, too. The pairs come transposed in blocks (`genomes.in_blocks`), each number as often as a group
has genomes. A unit that is not expressed costs nothing, unless another genome of the group expresses more.

The inner loops are written as LLVM instructions, since Python cannot say what makes them fast: the sums of several
units for several vectors of pairs stay in registers from bias to tanh, and vectors are as wide as the processor has.

One thread, without Python's lock. A genome's error depends on no other genome, so callers may share the rows of a
population among threads; the same machine gives the same bits each time.
"""

# ruff: noqa: ARG001, PLR0917 - the compiler's argument has no use here; compiled functions take arrays by position
# mypy: allow-untyped-calls

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils

from mdb_services.mechanism.evolution.compiled.compiling import compiled, emitted, inlined
from mdb_services.mechanism.evolution.compiled.packing import (
    FEW,
    Matrix,
    Plan,
    add_squared_weights,
    by_size,
    find_expressed,
    pack,
    packed_layer,
)
from mdb_services.mechanism.evolution.compiled.vectors import (
    INDEX,
    WORD,
    loop,
    memory_of,
    moved,
    multiply_add,
    spread,
)
from mdb_services.mechanism.evolution.layout import BLOCK, GROUP, LANES, VECTORS, Pairs, Spaces

UNITS = (4, 2, 1)
"""Units taken through the pairs together: as many fours as there are, then what is left."""

# tanh(x) = x (A + (B u + C) / (u^2 + E)) with u = x^2 + D up to the limit, constant beyond (ours). Any quotient of
# two quadratics in x^2 has this form, the one with the fewest instructions. Fitted for the least maximum of the error
# together with what a rough division adds, 2^-14 of the quotient, and so that no result is beyond 1.
_LIMIT = 5.0
_A, _B, _C, _D, _E = 0.0517993160, 6.27023983, -32.7830391, 17.2101669, -216.933945

_VECTOR = ir.VectorType(ir.FloatType(), LANES)


# ---- LLVM instructions: these functions run when the kernel is compiled, and emit it ----


def _constant(number: float) -> Any:
    """Return a vector of one number."""
    return ir.Constant(_VECTOR, [float(np.float32(number))] * LANES)


def _tanh(builder: Any, values: Sequence[Any]) -> list[Any]:
    """Return tanh of one or two vectors, within `layout.TANH_ERROR` and never beyond 1."""
    limit, least = _constant(_LIMIT), _constant(-_LIMIT)
    inside, over, under = [], [], []
    for x in values:
        x = builder.select(builder.fcmp_ordered("<", limit, x), limit, x)  # noqa: PLW2901 - NaN stays
        x = builder.select(builder.fcmp_ordered(">", least, x), least, x)  # noqa: PLW2901
        u = multiply_add(builder, x, x, _constant(_D))
        inside.append(x)
        over.append(multiply_add(builder, u, _constant(_B), _constant(_C)))
        under.append(multiply_add(builder, u, u, _constant(_E)))
    quotients = zip(over, _inverses(builder, under), strict=True)
    return [
        builder.fmul(x, multiply_add(builder, *quotient, _constant(_A)))
        for x, quotient in zip(inside, quotients, strict=True)
    ]


def _inverses(builder: Any, values: Sequence[Any]) -> list[Any]:
    """Return 1 / x of one or two vectors: roughly where an instruction does that, else with one division for both."""
    if LANES == 16:
        kind = ir.FunctionType(_VECTOR, [_VECTOR, _VECTOR, ir.IntType(16)])
        rough = cgutils.get_or_insert_function(builder.module, kind, "llvm.x86.avx512.rcp14.ps.512")
        return [builder.call(rough, [x, x, ir.IntType(16)(-1)]) for x in values]
    both = builder.fdiv(_constant(1), builder.fmul(values[0], values[-1]))
    return [builder.fmul(both, x) for x in reversed(values)]


class _Blocks(NamedTuple):
    """Rows of pairs in blocks (blocks, rows, BLOCK, GROUP): a pointer, and how many rows a block has."""

    pointer: Any
    rows: Any

    def vectors(self, builder: Any, block: Any, row: Any, count: int) -> list[Any]:
        """Return pointers to the first vectors of a row."""
        place = builder.mul(builder.add(builder.mul(block, self.rows), row), WORD(BLOCK * GROUP))
        start = builder.bitcast(moved(builder, self.pointer, place), _VECTOR.as_pointer())
        return [moved(builder, start, vector) for vector in range(count)]


def weight_of(builder: Any, row: Any, column: Any) -> Any:
    """Return a vector of a weight of each genome."""
    place = moved(builder, row, builder.mul(column, WORD(GROUP)))
    return spread(builder, builder.load(builder.bitcast(place, FEW.as_pointer()), align=4 * GROUP), LANES)


class _Layer(NamedTuple):
    """What the instructions for a hidden layer refer to; receivers: the outputs, if they come next."""

    weights: Matrix
    receivers: Matrix
    source: _Blocks
    work: _Blocks
    slot: Any
    first_receiver: Any


def _emit_units(builder: Any, layer: _Layer, unit: Any, units: int, block: Any, vectors: int) -> None:
    """Take some units through the first vectors of a block of pairs."""
    own = [builder.add(unit, WORD(u)) for u in range(units)]
    signals = _emit_signals(builder, layer, own, block, vectors)
    with builder.if_then(builder.icmp_signed("==", layer.receivers.units, WORD(0))):
        for u, its in zip(own, signals, strict=True):
            slot = builder.add(layer.slot, u)
            for signal, place in zip(its, layer.work.vectors(builder, WORD(0), slot, vectors), strict=True):
                builder.store(signal, place, align=4)
    _emit_sending(builder, layer, own, signals)


def _emit_signals(builder: Any, layer: _Layer, units: Sequence[Any], block: Any, vectors: int) -> list[list[Any]]:
    """Return the signals of units for the first vectors of a block: tanh of the bias plus what they receive."""
    rows, senders = [layer.weights.row(builder, u) for u in units], builder.sub(layer.weights.width, WORD(1))
    biases = [weight_of(builder, row, senders) for row in rows]
    sums = [[cgutils.alloca_once_value(builder, bias) for _ in range(vectors)] for bias in biases]
    with loop(builder, WORD(0), senders) as (sender, _):
        received = [builder.load(place, align=4) for place in layer.source.vectors(builder, block, sender, vectors)]
        for row, own in zip(rows, sums, strict=True):
            weight = weight_of(builder, row, sender)
            for vector, total in zip(received, own, strict=True):
                builder.store(multiply_add(builder, weight, vector, builder.load(total)), total)
    loaded = [[builder.load(total) for total in own] for own in sums]
    # Two of one unit together: else a genome's bits would depend on how many units the others of its group have.
    pairs = range(0, vectors, 2)
    return [[signal for pair in pairs for signal in _tanh(builder, own[pair : pair + 2])] for own in loaded]


def _emit_sending(builder: Any, layer: _Layer, units: Sequence[Any], signals: Sequence[Sequence[Any]]) -> None:
    """Add the weighted signals of units to each receiver's row."""
    with loop(builder, WORD(0), layer.receivers.units) as (receiver, _):
        row, slot = layer.receivers.row(builder, receiver), builder.add(layer.first_receiver, receiver)
        places = layer.work.vectors(builder, WORD(0), slot, len(signals[0]))
        sums = [builder.load(place, align=4) for place in places]
        for unit, own in zip(units, signals, strict=True):
            weight = weight_of(builder, row, unit)
            sums = [multiply_add(builder, weight, *pair) for pair in zip(own, sums, strict=True)]
        for total, place in zip(sums, places, strict=True):
            builder.store(total, place, align=4)


# ---- what compiled Python calls of it ----


def _blocks(context: Any, builder: Any, kind: Any, value: Any) -> _Blocks:
    pointer, shape = memory_of(context, builder, kind, value)
    return _Blocks(pointer, shape[1])


@emitted
def _hidden_layer(
    typingctx: Any,
    plan: Any,
    firsts: Any,
    layer: Any,
    last: Any,
    inputs: Any,
    work: Any,
    block: Any,
    vectors: Any,
) -> Any:
    """Take a hidden layer's units through the first vectors of a block.

    plan: `Plan`; firsts (layers,): the first row of each layer in work; last: the outputs' layer; inputs (blocks,
    inputs, BLOCK, GROUP); work (1, rows, BLOCK, GROUP): the units' signals go to their rows; those of the last hidden
    layer are weighted and added to the outputs' rows.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, (plan, firsts, layer, last, inputs, work, block, vectors) = signature.args, arguments
        inputs, work = (_blocks(context, builder, kinds[k], array) for k, array in ((4, inputs), (5, work)))
        firsts, _ = memory_of(context, builder, kinds[1], firsts)
        weights, receivers = (packed_layer(context, builder, kinds[0], plan, which) for which in (layer, last))
        layers = (builder.sub(layer, WORD(1)), layer, last)
        sent, slot, outputs = (builder.load(moved(builder, firsts, which)) for which in layers)
        is_last = builder.icmp_signed("==", layer, builder.sub(last, WORD(1)))
        receivers = receivers._replace(units=builder.select(is_last, receivers.units, WORD(0)))
        is_first = builder.icmp_signed("==", layer, WORD(1))
        signals = moved(builder, work.pointer, builder.mul(sent, WORD(BLOCK * GROUP)))
        source = _Blocks(*map(builder.select, [is_first] * 2, inputs, (signals, work.rows)))
        parts = _Layer(weights, receivers, source, work, slot, outputs)
        block = builder.select(is_first, block, WORD(0))
        for number in range(1, VECTORS + 1):
            with builder.if_then(builder.icmp_signed("==", vectors, WORD(number))):
                first = WORD(0)
                for count in UNITS:
                    stop = builder.add(first, builder.and_(builder.sub(weights.units, first), WORD(-count)))
                    with loop(builder, first, stop, count) as (unit, _):
                        _emit_units(builder, parts, unit, count, block, number)
                    first = stop
        return context.get_dummy_value()

    return types.void(plan, firsts, layer, last, inputs, work, block, vectors), generate


@emitted
def _set_row(
    typingctx: Any, plan: Any, last: Any, output: Any, targets: Any, block: Any, work: Any, slot: Any
) -> Any:
    """Set an output's row of work to the bias minus the targets: what units send then makes it the misses."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, (plan, last, output, targets, block, work, slot) = signature.args, arguments
        weights = packed_layer(context, builder, kinds[0], plan, last)
        bias = weight_of(builder, weights.row(builder, output), builder.sub(weights.width, WORD(1)))
        work, targets = (_blocks(context, builder, kinds[k], array) for k, array in ((5, work), (3, targets)))
        places = work.vectors(builder, WORD(0), slot, VECTORS)
        for place, target in zip(places, targets.vectors(builder, block, output, VECTORS), strict=True):
            builder.store(builder.fsub(bias, builder.load(target, align=4)), place, align=4)
        return context.get_dummy_value()

    return types.void(plan, last, output, targets, block, work, slot), generate


@emitted
def _add_squares(typingctx: Any, work: Any, slot: Any, count: Any, sums: Any) -> Any:
    """Add the squares of a row of work, of as many pairs as count, to sums (LANES,)."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, (work, slot, count, sums) = signature.args, arguments
        place_of_sums = builder.bitcast(memory_of(context, builder, kinds[3], sums)[0], _VECTOR.as_pointer())
        total, zero = builder.load(place_of_sums, align=4), ir.Constant(_VECTOR, [0.0] * LANES)
        places = _blocks(context, builder, kinds[0], work).vectors(builder, WORD(0), slot, VECTORS)
        count = spread(builder, builder.trunc(count, INDEX), LANES)
        for vector, place in enumerate(places):
            pairs = [(vector * LANES + lane) // GROUP for lane in range(LANES)]
            counts = builder.icmp_signed("<", ir.Constant(ir.VectorType(INDEX, LANES), pairs), count)
            number = builder.select(counts, builder.load(place, align=4), zero)
            total = multiply_add(builder, number, number, total)
        builder.store(total, place_of_sums, align=4)
        return context.get_dummy_value()

    return types.void(work, slot, count, sums), generate


# ---- compiled Python ----


@inlined
def _write(group: Any, sums: Any, divisor: int, results: Any) -> None:
    """Write each genome's part of the sums (LANES,), divided by a number."""
    for genome in range(GROUP):
        total = 0.0
        for lane in range(genome, LANES, GROUP):
            total += sums[lane]
        results[group[genome]] = total / divisor


@compiled
def population_errors(
    weights: Any, promoters: Any, sizes: Any, pairs: Pairs, errors: Any, squares: Any, spaces: Spaces
) -> None:
    """Write each genome's mean squared error over the pairs, and the sum of its squared weights that count.

    weights (population, weights) float32; promoters (population, hidden units) uint8; sizes (layers,) int64; pairs,
    at least one, have inputs (blocks, inputs, BLOCK, GROUP) and targets (blocks, outputs, BLOCK, GROUP) float32;
    errors and squares (population,) float64. Squares of size 0 are not written, which saves their time.
    """
    inputs, targets, number = pairs.inputs, pairs.targets, pairs.count[0]
    blocks, last, outputs, order = inputs.shape[0], sizes.size - 1, targets.shape[1], spaces.by_size
    counts, starts, firsts, packed = spaces.counts, spaces.starts, spaces.firsts, spaces.packed
    columns, rows, own, work = spaces.columns, spaces.rows, spaces.own, spaces.work
    group, bases, sums, plan = spaces.group, spaces.bases, spaces.sums, Plan(counts, starts, packed)
    by_size(promoters, spaces.expressed, spaces.bins, order)
    for first in range(0, errors.size, GROUP):
        for genome in range(GROUP):
            group[genome] = order[min(first + genome, errors.size - 1)]
            bases[genome] = group[genome] * weights.shape[1]
        find_expressed(promoters, sizes, group, columns, rows, own, counts)
        pack(weights, sizes, bases, columns, rows, own, counts, starts, packed)
        for lane in range(LANES):
            sums[lane] = 0
        for block in range(blocks):
            left = number - block * BLOCK
            for output in range(outputs):
                _set_row(plan, last, output, targets, block, work, firsts[last] + output)
            for layer in range(1, last):
                vectors = min(-(-left * GROUP // LANES), VECTORS)
                _hidden_layer(plan, firsts, layer, last, inputs, work, block, vectors)
            for output in range(outputs):
                _add_squares(work, firsts[last] + output, left, sums)
        _write(group, sums, number * outputs, errors)
        if squares.size > 0:
            for lane in range(LANES):
                sums[lane] = 0
            for layer in range(1, sizes.size):
                add_squared_weights(plan, layer, sums)
            _write(group, sums, 1, squares)
