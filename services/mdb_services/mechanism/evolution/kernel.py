"""Errors of a whole population over the short-term memory, compiled.

Genomes are flat float32 rows, laid out as `networks.network.split_layers` views them; promoters are one byte a hidden
unit. Genomes are taken `GROUP` at a time: first their expressed units are packed, so that the weights which are at the
same place in each lie side by side. A vector register then holds a few pairs for each genome of the group, and few
pairs fill it, too. The pairs come transposed in blocks (`genomes.in_blocks`), each number as often as a group has
genomes. A unit that is not expressed costs nothing, unless another genome of the group expresses more.

The inner loops are written as LLVM instructions, since Python cannot say what makes them fast: the sums of several
units for several vectors of pairs stay in registers from bias to tanh, and vectors are as wide as the processor has.

One thread, without Python's lock. A genome's error depends on no other genome, so callers may share the rows of a
population among threads; the same machine gives the same bits each time.
"""

# ruff: noqa: PLR0917 - compiled functions take arrays by position
# mypy: allow-untyped-calls

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import config, types
from numba.core import cgutils
from numba.core.codegen import get_host_cpu_features
from numba.core.errors import TypingError

from mdb_services.mechanism.evolution.compiling import compiled, emitted
from mdb_services.mechanism.evolution.vectors import (
    BYTES,
    FLOATS,
    NUMBERS,
    ROW,
    Array,
    first_lanes,
    compressed,
    every,
    interleaved,
    spread,
)

_FEATURES = get_host_cpu_features() if config.CPU_FEATURES is None else config.CPU_FEATURES  # type: ignore[attr-defined]
LANES = 16 if "+avx512f" in _FEATURES else 8
"""Numbers in a vector: one register of AVX-512 or AVX, two of smaller processors."""

GROUP = 4
"""Genomes taken through the pairs together: in a vector, the numbers of a pair for each of them lie side by side."""

VECTORS = 5 if LANES == 16 else 3
"""Vectors taken through a layer together: with four units, as many sums as registers have room for."""

BLOCK = LANES // GROUP * VECTORS
"""Pairs of a block. Of the last one, vectors without any pair are left out."""

UNITS = (4, 2, 1)
"""Units taken through the pairs together: as many fours as there are, then what is left."""

TANH_ERROR = 1e-4
"""Bound of the absolute error of a hidden unit's tanh, over all float32 numbers."""

# tanh(x) = x (A + (B u + C) / (u^2 + E)) with u = x^2 + D up to the limit, constant beyond (ours). Any quotient of
# two quadratics in x^2 has this form, the one with the fewest instructions. Fitted for the least maximum of the error
# together with what a rough division adds, 2^-14 of the quotient, and so that no result is beyond 1.
_LIMIT = 5.0
_A, _B, _C, _D, _E = 0.0517993160, 6.27023983, -32.7830391, 17.2101669, -216.933945

LINE = 64
"""Bytes of a cache line: a vector that lies across two is read twice."""
_FUSED = ("contract",)
_FLOAT, _INDEX, _WORD = ir.FloatType(), ir.IntType(32), ir.IntType(64)
_VECTOR, _FEW = ir.VectorType(_FLOAT, LANES), ir.VectorType(_FLOAT, GROUP)


class _Plan(NamedTuple):
    """What a group expresses, and where its weights are packed.

    columns (layers, GROUP, units and room for `ROW` more) int32 says which units of a layer a genome expresses, own
    (layers, GROUP) how many, counts (layers,) the most of them, firsts (layers,) where the layer's signals begin,
    inputs first, starts (layers,) where it begins in packed, all int64. packed (float32): for each layer, expressed
    unit, expressed unit of the layer before, and last the bias, a weight of each genome, 0 where it has none.
    """

    columns: Any
    own: Any
    counts: Any
    starts: Any
    firsts: Any
    packed: Any


# ---- LLVM instructions: these functions run when the kernel is compiled, and emit it ----


def _constant(number: float) -> Any:
    """Return a vector of one number."""
    return ir.Constant(_VECTOR, [float(np.float32(number))] * LANES)


def _multiply_add(builder: Any, left: Any, right: Any, summand: Any) -> Any:
    return builder.fadd(builder.fmul(left, right, flags=_FUSED), summand, flags=_FUSED)


def _tanh(builder: Any, values: Sequence[Any]) -> list[Any]:
    """Return tanh of one or two vectors, within `TANH_ERROR` and never beyond 1."""
    limit, least = _constant(_LIMIT), _constant(-_LIMIT)
    inside, over, under = [], [], []
    for x in values:
        x = builder.select(builder.fcmp_ordered("<", limit, x), limit, x)  # noqa: PLW2901 - NaN stays
        x = builder.select(builder.fcmp_ordered(">", least, x), least, x)  # noqa: PLW2901
        u = _multiply_add(builder, x, x, _constant(_D))
        inside.append(x)
        over.append(_multiply_add(builder, u, _constant(_B), _constant(_C)))
        under.append(_multiply_add(builder, u, u, _constant(_E)))
    quotients = zip(over, _inverses(builder, under), strict=True)
    return [
        builder.fmul(x, _multiply_add(builder, *quotient, _constant(_A)))
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


def _at(builder: Any, pointer: Any, *steps: Any) -> Any:
    """Return the pointer moved on by steps, numbers or values."""
    for step in steps:
        pointer = builder.gep(pointer, [_WORD(step) if isinstance(step, int) else step])
    return pointer


def _loop(builder: Any, first: Any, end: Any, step: int = 1) -> Any:
    return cgutils.for_range_slice(builder, first, end, _WORD(step), _WORD)


class _Blocks(NamedTuple):
    """Rows of pairs in blocks (blocks, rows, BLOCK, GROUP): a pointer, and how many rows a block has."""

    pointer: Any
    rows: Any

    def vectors(self, builder: Any, block: Any, row: Any, count: int) -> list[Any]:
        """Return pointers to the first vectors of a row."""
        place = builder.mul(builder.add(builder.mul(block, self.rows), row), _WORD(BLOCK * GROUP))
        start = builder.bitcast(_at(builder, self.pointer, place), _VECTOR.as_pointer())
        return [_at(builder, start, vector) for vector in range(count)]


class _Matrix(NamedTuple):
    """Packed weights of a layer: a pointer, how many units it has, and how many weights each of them."""

    pointer: Any
    units: Any
    width: Any

    def row(self, builder: Any, unit: Any) -> Any:
        """Return the pointer to a unit's weights."""
        return _at(builder, self.pointer, builder.mul(builder.mul(unit, self.width), _WORD(GROUP)))


def _weight(builder: Any, row: Any, column: Any) -> Any:
    """Return a vector of a weight of each genome."""
    place = _at(builder, row, builder.mul(column, _WORD(GROUP)))
    return spread(builder, builder.load(builder.bitcast(place, _FEW.as_pointer()), align=4 * GROUP), LANES)


class _Layer(NamedTuple):
    """What the instructions for a hidden layer refer to; receivers: the outputs, if they come next."""

    weights: _Matrix
    receivers: _Matrix
    source: _Blocks
    work: _Blocks
    slot: Any
    first_receiver: Any


def _emit_units(builder: Any, layer: _Layer, unit: Any, units: int, block: Any, vectors: int) -> None:
    """Take some units through the first vectors of a block of pairs."""
    own = [builder.add(unit, _WORD(u)) for u in range(units)]
    signals = _emit_signals(builder, layer, own, block, vectors)
    with builder.if_then(builder.icmp_signed("==", layer.receivers.units, _WORD(0))):
        for u, its in zip(own, signals, strict=True):
            slot = builder.add(layer.slot, u)
            for signal, place in zip(its, layer.work.vectors(builder, _WORD(0), slot, vectors), strict=True):
                builder.store(signal, place, align=4)
    _emit_sending(builder, layer, own, signals)


def _emit_signals(builder: Any, layer: _Layer, units: Sequence[Any], block: Any, vectors: int) -> list[list[Any]]:
    """Return the signals of units for the first vectors of a block: tanh of the bias plus what they receive."""
    rows, senders = [layer.weights.row(builder, u) for u in units], builder.sub(layer.weights.width, _WORD(1))
    biases = [_weight(builder, row, senders) for row in rows]
    sums = [[cgutils.alloca_once_value(builder, bias) for _ in range(vectors)] for bias in biases]
    with _loop(builder, _WORD(0), senders) as (sender, _):
        received = [builder.load(place, align=4) for place in layer.source.vectors(builder, block, sender, vectors)]
        for row, own in zip(rows, sums, strict=True):
            weight = _weight(builder, row, sender)
            for vector, total in zip(received, own, strict=True):
                builder.store(_multiply_add(builder, weight, vector, builder.load(total)), total)
    flat = [builder.load(total) for own in sums for total in own]
    flat = [signal for pair in range(0, len(flat), 2) for signal in _tanh(builder, flat[pair : pair + 2])]
    return [flat[start : start + vectors] for start in range(0, len(flat), vectors)]


def _emit_sending(builder: Any, layer: _Layer, units: Sequence[Any], signals: Sequence[Sequence[Any]]) -> None:
    """Add the weighted signals of units to each receiver's row."""
    with _loop(builder, _WORD(0), layer.receivers.units) as (receiver, _):
        row, slot = layer.receivers.row(builder, receiver), builder.add(layer.first_receiver, receiver)
        places = layer.work.vectors(builder, _WORD(0), slot, len(signals[0]))
        sums = [builder.load(place, align=4) for place in places]
        for unit, own in zip(units, signals, strict=True):
            weight = _weight(builder, row, unit)
            sums = [_multiply_add(builder, weight, *pair) for pair in zip(own, sums, strict=True)]
        for total, place in zip(sums, places, strict=True):
            builder.store(total, place, align=4)


# ---- what compiled Python calls of it ----


def _array(context: Any, builder: Any, kind: Any, value: Any) -> tuple[Any, list[Any]]:
    """Return an array's pointer and shape."""
    array = context.make_array(kind)(context, builder, value)
    return array.data, cgutils.unpack_tuple(builder, array.shape)


def _blocks(context: Any, builder: Any, kind: Any, value: Any) -> _Blocks:
    pointer, shape = _array(context, builder, kind, value)
    return _Blocks(pointer, shape[1])


def _check(**arrays: Any) -> None:
    for name, kind in arrays.items():
        if kind.dtype != types.float32 or kind.layout != "C":
            raise TypingError(f"{name}: {kind}; expected float32, C-contiguous: np.ascontiguousarray(x, np.float32)")


def _tables(context: Any, builder: Any, kind: Any, plan: Any) -> tuple[Any, ...]:
    """Return the pointers to a plan's arrays."""
    arrays = zip(kind, cgutils.unpack_tuple(builder, plan), strict=True)
    return tuple(_array(context, builder, *array)[0] for array in arrays)


def _packed(context: Any, builder: Any, kind: Any, plan: Any, layer: Any) -> _Matrix:
    _, _, counts, starts, _, packed = _tables(context, builder, kind, plan)
    units, senders = (builder.load(_at(builder, counts, builder.sub(layer, _WORD(step)))) for step in (0, 1))
    pointer = _at(builder, packed, builder.load(_at(builder, starts, layer)))
    return _Matrix(pointer, units, builder.add(senders, _WORD(1)))


@emitted
def _hidden_layer(
    typingctx: Any,  # noqa: ARG001
    plan: Any,
    layer: Any,
    last: Any,
    inputs: Any,
    work: Any,
    block: Any,
    vectors: Any,
) -> Any:
    """Take a hidden layer's units through the first vectors of a block.

    plan: `_Plan`; last: the outputs' layer; inputs (blocks, inputs, BLOCK, GROUP); work (1, slots, BLOCK, GROUP): the
    units' signals go to their rows; those of the last hidden layer are weighted and added to the outputs' rows.
    """
    _check(inputs=inputs, work=work)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, (plan, layer, last, inputs, work, block, vectors) = signature.args, arguments
        inputs, work = (_blocks(context, builder, kinds[k], array) for k, array in ((3, inputs), (4, work)))
        firsts = _tables(context, builder, kinds[0], plan)[4]
        weights, receivers = (_packed(context, builder, kinds[0], plan, which) for which in (layer, last))
        layers = (builder.sub(layer, _WORD(1)), layer, last)
        sent, slot, outputs = (builder.load(_at(builder, firsts, which)) for which in layers)
        is_last = builder.icmp_signed("==", layer, builder.sub(last, _WORD(1)))
        receivers = receivers._replace(units=builder.select(is_last, receivers.units, _WORD(0)))
        is_first = builder.icmp_signed("==", layer, _WORD(1))
        signals = _at(builder, work.pointer, builder.mul(sent, _WORD(BLOCK * GROUP)))
        source = _Blocks(*map(builder.select, [is_first] * 2, inputs, (signals, work.rows)))
        parts = _Layer(weights, receivers, source, work, slot, outputs)
        block = builder.select(is_first, block, _WORD(0))
        for number in range(1, VECTORS + 1):
            with builder.if_then(builder.icmp_signed("==", vectors, _WORD(number))):
                first = _WORD(0)
                for count in UNITS:
                    stop = builder.add(first, builder.and_(builder.sub(weights.units, first), _WORD(-count)))
                    with _loop(builder, first, stop, count) as (unit, _):
                        _emit_units(builder, parts, unit, count, block, number)
                    first = stop
        return context.get_dummy_value()

    return types.void(plan, layer, last, inputs, work, block, vectors), generate


@emitted
def _set_row(typingctx: Any, plan: Any, last: Any, output: Any, targets: Any, block: Any, work: Any) -> Any:  # noqa: ARG001
    """Set an output's row of work to the bias minus the targets: what units send then makes it the misses."""
    _check(work=work, targets=targets)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, (plan, last, output, targets, block, work) = signature.args, arguments
        weights = _packed(context, builder, kinds[0], plan, last)
        bias = _weight(builder, weights.row(builder, output), builder.sub(weights.width, _WORD(1)))
        first = builder.load(_at(builder, _tables(context, builder, kinds[0], plan)[4], last))
        work, targets = (_blocks(context, builder, kinds[k], array) for k, array in ((5, work), (3, targets)))
        places = work.vectors(builder, _WORD(0), builder.add(first, output), VECTORS)
        for place, target in zip(places, targets.vectors(builder, block, output, VECTORS), strict=True):
            builder.store(builder.fsub(bias, builder.load(target, align=4)), place, align=4)
        return context.get_dummy_value()

    return types.void(plan, last, output, targets, block, work), generate


@emitted
def _add_squares(typingctx: Any, work: Any, slot: Any, count: Any, sums: Any) -> Any:  # noqa: ARG001
    """Add the squares of a row of work, of as many pairs as count, to sums (LANES,)."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, (work, slot, count, sums) = signature.args, arguments
        place_of_sums = builder.bitcast(_array(context, builder, kinds[3], sums)[0], _VECTOR.as_pointer())
        total, zero = builder.load(place_of_sums, align=4), ir.Constant(_VECTOR, [0.0] * LANES)
        places = _blocks(context, builder, kinds[0], work).vectors(builder, _WORD(0), slot, VECTORS)
        count = spread(builder, builder.trunc(count, _INDEX), LANES)
        for vector, place in enumerate(places):
            pairs = [(vector * LANES + lane) // GROUP for lane in range(LANES)]
            counts = builder.icmp_signed("<", ir.Constant(ir.VectorType(_INDEX, LANES), pairs), count)
            number = builder.select(counts, builder.load(place, align=4), zero)
            total = _multiply_add(builder, number, number, total)
        builder.store(total, place_of_sums, align=4)
        return context.get_dummy_value()

    return types.void(work, slot, count, sums), generate


@emitted
def _note_expressed(
    typingctx: Any,  # noqa: ARG001
    promoters: Any,
    gene: Any,
    units: Any,
    unit: Any,
    width: Any,
    columns: Any,
    rows: Any,
    place: Any,
) -> Any:
    """Write which of a row of units are expressed, and return how many; unit: the number of the first one."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, (promoters, gene, units, unit, width, *tables, place) = signature.args, arguments
        promoters = Array(context, builder, kinds[0], promoters)
        columns, rows = (Array(context, builder, kind, table) for kind, table in zip(kinds[5:7], tables, strict=True))
        genes = promoters.load(gene, BYTES, first_lanes(builder, units), every(BYTES, 0))
        expressed = builder.icmp_unsigned("!=", genes, every(BYTES, 0))
        numbers = builder.add(spread(builder, builder.trunc(unit, _INDEX)), NUMBERS)
        numbers = compressed(builder, numbers, expressed)
        columns.store(numbers, place)
        rows.store(builder.mul(numbers, spread(builder, builder.trunc(width, _INDEX))), place)
        count = builder.bitcast(expressed, ir.IntType(ROW))
        return builder.zext(builder.ctpop(count), _WORD)

    word = types.int64
    return types.int64(promoters, word, word, word, word, columns, rows, word), generate


class _Packing:
    """Where the weights of a layer are, and where they go; see `_Plan`."""

    def __init__(self, context: Any, builder: Any, kinds: Any, arguments: Any) -> None:
        weights, packed, bases, self.place, self.layer, rows = arguments
        self.weights, self.packed = (Array(context, builder, kinds[k], a) for k, a in ((0, weights), (1, packed)))
        first = _array(context, builder, kinds[2], bases)[0]
        self.bases = [builder.load(_at(builder, first, genome)) for genome in range(GROUP)]
        self.rows = self.table(context, builder, kinds[5], rows)

    def table(self, context: Any, builder: Any, kind: Any, table: Any, *, before: bool = False) -> list[Any]:
        """Return where each genome's numbers of units begin, of the layer or of the one before it."""
        pointer, shape = _array(context, builder, kind, table)
        layer = builder.sub(self.layer, _WORD(int(before)))
        genomes = [builder.add(builder.mul(layer, _WORD(GROUP)), _WORD(genome)) for genome in range(GROUP)]
        return [_at(builder, pointer, builder.mul(genome, shape[2])) for genome in genomes]

    def starts(self, builder: Any, unit: Any) -> list[Any]:
        """Return where each genome's weights of an expressed unit begin."""
        rows = [builder.zext(builder.load(_at(builder, table, unit)), _WORD) for table in self.rows]
        return [builder.add(base, row) for base, row in zip(self.bases, rows, strict=True)]


@emitted
def _pack_rows(
    typingctx: Any,  # noqa: ARG001
    weights: Any,
    packed: Any,
    bases: Any,
    place: Any,
    layer: Any,
    rows: Any,
    units: Any,
    width: Any,
) -> Any:
    """Pack all weights of the first expressed units of a layer; bases: as `_pack` has them."""
    _check(weights=weights, packed=packed)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        parts, (units, width) = _Packing(context, builder, signature.args, arguments[:6]), arguments[6:]

        def emit(unit: Any, part: Any) -> None:
            left, at = builder.sub(width, part), builder.add(builder.mul(unit, width), part)
            at = builder.add(parts.place, builder.mul(at, _WORD(GROUP)))
            starts, mask = (builder.add(start, part) for start in parts.starts(builder, unit)), first_lanes(builder, left)
            row = [parts.weights.load(start, FLOATS, mask, every(FLOATS, 0.0)) for start in starts]
            for step, mixed in enumerate(interleaved(builder, row)):
                with builder.if_then(builder.icmp_signed(">", left, _WORD(step * ROW // GROUP))):
                    parts.packed.store(mixed, builder.add(at, _WORD(step * ROW)))

        with builder.if_else(builder.icmp_signed(">", width, _WORD(ROW))) as (long, short):
            with long, _loop(builder, _WORD(0), units) as (unit, _), _loop(builder, _WORD(0), width, ROW) as (part, _):
                emit(unit, part)
            with short, _loop(builder, _WORD(0), units) as (unit, _):
                emit(unit, _WORD(0))
        return context.get_dummy_value()

    word = types.int64
    return types.void(weights, packed, bases, word, word, rows, word, word), generate


@emitted
def _pack_columns(
    typingctx: Any,  # noqa: ARG001
    weights: Any,
    packed: Any,
    bases: Any,
    place: Any,
    layer: Any,
    rows: Any,
    units: Any,
    columns: Any,
    own: Any,
    senders: Any,
    bias: Any,
) -> Any:
    """The same, but only the weights of expressed senders and the bias, whose column is given."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, (units, columns, own, senders, bias) = signature.args, arguments[6:]
        parts = _Packing(context, builder, kinds, arguments[:6])
        columns = parts.table(context, builder, kinds[7], columns, before=True)
        own, _ = _array(context, builder, kinds[8], own)
        own = _at(builder, own, builder.mul(builder.sub(parts.layer, _WORD(1)), _WORD(GROUP)))
        own = builder.load(builder.bitcast(own, ir.VectorType(_WORD, GROUP).as_pointer()), align=8)

        def pack(starts: Sequence[Any], at: Any, mask: Any = None) -> None:
            few = ir.Constant(_FEW, ir.Undefined)
            for genome, start in enumerate(starts):
                weight = builder.load(_at(builder, parts.weights.data, start))
                few = builder.insert_element(few, weight, _INDEX(genome))
            if mask is not None:
                few = builder.select(mask, few, ir.Constant(_FEW, [0.0] * GROUP))
            place = _at(builder, parts.packed.data, builder.add(parts.place, builder.mul(at, _WORD(GROUP))))
            builder.store(few, builder.bitcast(place, _FEW.as_pointer()), align=4 * GROUP)

        with _loop(builder, _WORD(0), units) as (unit, _):
            starts, at = parts.starts(builder, unit), builder.mul(unit, builder.add(senders, _WORD(1)))
            with _loop(builder, _WORD(0), senders) as (sender, _):
                steps = (builder.zext(builder.load(_at(builder, table, sender)), _WORD) for table in columns)
                places = [builder.add(start, step) for start, step in zip(starts, steps, strict=True)]
                pack(places, builder.add(at, sender), builder.icmp_signed("<", spread(builder, sender, GROUP), own))
            pack([builder.add(start, bias) for start in starts], builder.add(at, senders))
        return context.get_dummy_value()

    word = types.int64
    return types.void(weights, packed, bases, word, word, rows, word, columns, own, word, word), generate


@emitted
def _squared_weights(typingctx: Any, plan: Any, layer: Any, sums: Any) -> Any:  # noqa: ARG001
    """Add the squares of a layer's packed weights to sums (GROUP,)."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, (plan, layer, sums) = signature.args, arguments
        weights = _packed(context, builder, kinds[0], plan, layer)
        place_of_sums = builder.bitcast(_array(context, builder, kinds[2], sums)[0], _FEW.as_pointer())
        total, own = (cgutils.alloca_once_value(builder, ir.Constant(_FEW, [0.0] * GROUP)) for _ in range(2))
        builder.store(builder.load(place_of_sums, align=4), total)
        with _loop(builder, _WORD(0), weights.units) as (unit, _):
            row = builder.bitcast(weights.row(builder, unit), _FEW.as_pointer())
            builder.store(ir.Constant(_FEW, [0.0] * GROUP), own)
            with _loop(builder, _WORD(0), weights.width) as (column, _):
                weight = builder.load(_at(builder, row, column), align=4 * GROUP)
                builder.store(_multiply_add(builder, weight, weight, builder.load(own)), own)
            # One unit's sum need not wait for another's.
            builder.store(builder.fadd(builder.load(total), builder.load(own)), total)
        builder.store(builder.load(total), place_of_sums, align=4)
        return context.get_dummy_value()

    return types.void(plan, layer, sums), generate


# ---- compiled Python ----


@compiled
def _by_size(promoters: Any) -> Any:
    """Return the individuals in the order of how many units they express: a group should have equals."""
    population, units = promoters.shape
    sizes, starts = np.empty(population, np.int64), np.zeros(units + 2, np.int64)
    for individual in range(population):
        size = 0
        for unit in range(units):
            size += promoters[individual, unit]
        sizes[individual] = size
        starts[size + 1] += 1
    for size in range(units):
        starts[size + 1] += starts[size]
    order = np.empty(population, np.int64)
    for individual in range(population):
        order[starts[sizes[individual]]] = individual
        starts[sizes[individual]] += 1
    return order


@compiled
def _find_expressed(promoters: Any, sizes: Any, group: Any, columns: Any, rows: Any, own: Any, counts: Any) -> None:
    """Write which units are expressed by a group of individuals; see `_Plan`."""
    room, last = columns.shape[2], sizes.size - 1
    for layer in range(1, last):
        counts[layer] = 0
    for genome in range(GROUP):
        gene = group[genome] * promoters.shape[1]
        for layer in range(1, last):
            place, count = (layer * GROUP + genome) * room, 0
            for unit in range(0, sizes[layer], ROW):
                left, width = sizes[layer] - unit, sizes[layer - 1] + 1
                count += _note_expressed(promoters, gene + unit, left, unit, width, columns, rows, place + count)
            gene += sizes[layer]
            own[layer, genome], counts[layer] = count, max(counts[layer], count)


@compiled
def _pack(
    weights: Any, sizes: Any, bases: Any, columns: Any, rows: Any, own: Any, counts: Any, starts: Any, packed: Any
) -> None:
    """Pack what a group expresses; bases (GROUP,): where its genomes begin in weights. See `_Plan`."""
    place = 0
    for layer in range(1, sizes.size):
        senders, before, whole = counts[layer - 1], sizes[layer - 1], True
        for genome in range(GROUP):
            whole &= own[layer - 1, genome] == before
        starts[layer], units = place, counts[layer]
        if whole:
            _pack_rows(weights, packed, bases, place, layer, rows, units, before + 1)
        else:
            _pack_columns(weights, packed, bases, place, layer, rows, units, columns, own, senders, before)
        place += units * (senders + 1) * GROUP
        for genome in range(GROUP):
            if own[layer, genome] < units:
                for at in range(starts[layer] + own[layer, genome] * (senders + 1) * GROUP + genome, place, GROUP):
                    packed[at] = 0
            bases[genome] += sizes[layer] * (before + 1)


@compiled
def population_errors(
    weights: Any, promoters: Any, sizes: Any, inputs: Any, targets: Any, pairs: int, errors: Any, squares: Any
) -> None:
    """Write each genome's mean squared error over the pairs, and the sum of its squared weights that count.

    weights (population, weights) float32; promoters (population, hidden units) uint8; sizes (layers,) int64;
    inputs (blocks, inputs, BLOCK, GROUP) and targets (blocks, outputs, BLOCK, GROUP) float32 from
    `genomes.in_blocks`; pairs is the number of true pairs, at least one; errors and squares (population,) float64.
    Squares of size 0 are not written, which saves their time. Raises TypingError when weights, inputs or targets are
    not contiguous float32.
    """
    blocks, last, outputs, slots = inputs.shape[0], sizes.size - 1, targets.shape[1], sizes.sum()
    columns, rows = np.zeros((2, sizes.size, GROUP, sizes.max() + ROW), np.int32)
    own = np.zeros((sizes.size, GROUP), np.int64)
    counts, starts, firsts = sizes.copy(), np.zeros(sizes.size, np.int64), np.zeros(sizes.size, np.int64)
    firsts[1:], own[0], own[last] = np.cumsum(sizes[:-1]), sizes[0], sizes[last]
    for genome in range(GROUP):
        for output in range(outputs):
            rows[last, genome, output] = output * (sizes[last - 1] + 1)
    memory = np.empty((slots * BLOCK + weights.shape[1] + ROW) * GROUP + 2 * LINE // 4, np.float32)
    start = -(memory.ctypes.data // 4) % (LINE // 4)
    end = start + slots * BLOCK * GROUP
    work = memory[start:end].reshape(1, slots, BLOCK, GROUP)
    packed = memory[end + -(end - start) % (LINE // 4) :]
    plan = _Plan(columns, own, counts, starts, firsts, packed)
    genomes, order = weights.reshape(-1), _by_size(promoters)
    group, bases = np.empty((2, GROUP), np.int64)
    sums, squared, population = np.empty(LANES, np.float32), np.empty(GROUP, np.float32), weights.shape[0]
    for first in range(0, population, GROUP):
        for genome in range(GROUP):
            group[genome] = order[min(first + genome, population - 1)]
            bases[genome] = group[genome] * weights.shape[1]
        _find_expressed(promoters, sizes, group, columns, rows, own, counts)
        _pack(genomes, sizes, bases, columns, rows, own, counts, starts, packed)
        for lane in range(LANES):
            sums[lane] = 0
        for block in range(blocks):
            left = pairs - block * BLOCK
            for output in range(outputs):
                _set_row(plan, last, output, targets, block, work)
            for layer in range(1, last):
                vectors = min(-(-left * GROUP // LANES), VECTORS)
                _hidden_layer(plan, layer, last, inputs, work, block, vectors)
            for output in range(outputs):
                _add_squares(work, firsts[last] + output, left, sums)
        if squares.size > 0:
            for genome in range(GROUP):
                squared[genome] = 0
            for layer in range(1, sizes.size):
                _squared_weights(plan, layer, squared)
        for genome in range(min(GROUP, population - first)):
            total = 0.0
            for lane in range(genome, LANES, GROUP):
                total += sums[lane]
            errors[group[genome]] = total / (pairs * outputs)
            if squares.size > 0:
                squares[group[genome]] = squared[genome]
