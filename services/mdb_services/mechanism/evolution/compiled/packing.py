"""What a group of genomes expresses, packed: the weights that are at the same place in each lie side by side.

Later code then reads a weight of each genome at once, and meets neither promoters nor units that are not expressed.
"""

# ruff: noqa: ARG001, PLR0917 - the compiler's argument has no use here; compiled functions take arrays by position
# mypy: allow-untyped-calls

from collections.abc import Sequence
from typing import Any, NamedTuple

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils

from mdb_services.mechanism.evolution.compiled.compiling import compiled, emitted
from mdb_services.mechanism.evolution.compiled.vectors import (
    BYTES,
    FLOATS,
    INDEX,
    NUMBERS,
    WORD,
    Array,
    compressed,
    every,
    first_lanes,
    interleaved,
    loop,
    memory_of,
    moved,
    multiply_add,
    spread,
)
from mdb_services.mechanism.evolution.layout import GROUP, ROW

FEW = ir.VectorType(ir.FloatType(), GROUP)


class Plan(NamedTuple):
    """Where the weights of a group are packed.

    counts (layers,) says how many units of a layer are expressed, by the genome that has most of them, starts
    (layers,) where the layer begins in packed, both int64. packed (float32): for each layer, expressed unit,
    expressed unit of the layer before, and last the bias, a weight of each genome, 0 where it has none.
    """

    counts: Any
    starts: Any
    packed: Any


# ---- LLVM instructions: these functions run when their callers are compiled, and emit them ----


class Matrix(NamedTuple):
    """Packed weights of a layer: a pointer, how many units it has, and how many weights each of them."""

    pointer: Any
    units: Any
    width: Any

    def row(self, builder: Any, unit: Any) -> Any:
        """Return the pointer to a unit's weights."""
        return moved(builder, self.pointer, builder.mul(builder.mul(unit, self.width), WORD(GROUP)))


def packed_layer(context: Any, builder: Any, kind: Any, plan: Any, layer: Any) -> Matrix:
    """Return the packed weights of a layer; kind: the type of the plan."""
    arrays = zip(kind, cgutils.unpack_tuple(builder, plan), strict=True)
    counts, starts, packed = (memory_of(context, builder, *array)[0] for array in arrays)
    units, senders = (builder.load(moved(builder, counts, builder.sub(layer, WORD(step)))) for step in (0, 1))
    pointer = moved(builder, packed, builder.load(moved(builder, starts, layer)))
    return Matrix(pointer, units, builder.add(senders, WORD(1)))


class _Packing:
    """Where the weights of a layer are, and where they go; see `pack`."""

    def __init__(self, context: Any, builder: Any, kinds: Any, arguments: Any) -> None:
        weights, packed, bases, self.place, self.layer, rows = arguments
        self.weights, self.packed = (Array(context, builder, kinds[k], a) for k, a in ((0, weights), (1, packed)))
        first = memory_of(context, builder, kinds[2], bases)[0]
        self.bases = [builder.load(moved(builder, first, genome)) for genome in range(GROUP)]
        self.rows = self.table(context, builder, kinds[5], rows)

    def table(self, context: Any, builder: Any, kind: Any, table: Any, *, before: bool = False) -> list[Any]:
        """Return where each genome's numbers of units begin, of the layer or of the one before it."""
        pointer, shape = memory_of(context, builder, kind, table)
        layer = builder.sub(self.layer, WORD(int(before)))
        genomes = [builder.add(builder.mul(layer, WORD(GROUP)), WORD(genome)) for genome in range(GROUP)]
        return [moved(builder, pointer, builder.mul(genome, shape[2])) for genome in genomes]

    def starts(self, builder: Any, unit: Any) -> list[Any]:
        """Return where each genome's weights of an expressed unit begin."""
        rows = [builder.zext(builder.load(moved(builder, table, unit)), WORD) for table in self.rows]
        return [builder.add(base, row) for base, row in zip(self.bases, rows, strict=True)]


# ---- what compiled Python calls of it ----


@emitted
def _note_expressed(
    typingctx: Any,
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
        numbers = builder.add(spread(builder, builder.trunc(unit, INDEX)), NUMBERS)
        numbers = compressed(builder, numbers, expressed)
        columns.store(numbers, place)
        rows.store(builder.mul(numbers, spread(builder, builder.trunc(width, INDEX))), place)
        count = builder.bitcast(expressed, ir.IntType(ROW))
        return builder.zext(builder.ctpop(count), WORD)

    word = types.int64
    return types.int64(promoters, word, word, word, word, columns, rows, word), generate


@emitted
def _pack_rows(
    typingctx: Any,
    weights: Any,
    packed: Any,
    bases: Any,
    place: Any,
    layer: Any,
    rows: Any,
    units: Any,
    width: Any,
) -> Any:
    """Pack all weights of the first expressed units of a layer; bases: as `pack` has them."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        parts, (units, width) = _Packing(context, builder, signature.args, arguments[:6]), arguments[6:]

        def emit(unit: Any, part: Any) -> None:
            left, at = builder.sub(width, part), builder.add(builder.mul(unit, width), part)
            at = builder.add(parts.place, builder.mul(at, WORD(GROUP)))
            mask, none = first_lanes(builder, left), every(FLOATS, 0.0)
            starts = (builder.add(start, part) for start in parts.starts(builder, unit))
            row = [parts.weights.load(start, FLOATS, mask, none) for start in starts]
            for step, mixed in enumerate(interleaved(builder, row)):
                with builder.if_then(builder.icmp_signed(">", left, WORD(step * ROW // GROUP))):
                    parts.packed.store(mixed, builder.add(at, WORD(step * ROW)))

        with builder.if_else(builder.icmp_signed(">", width, WORD(ROW))) as (long, short):
            with (
                long,
                loop(builder, WORD(0), units) as (unit, _),
                loop(builder, WORD(0), width, ROW) as (part, _),
            ):
                emit(unit, part)
            with short, loop(builder, WORD(0), units) as (unit, _):
                emit(unit, WORD(0))
        return context.get_dummy_value()

    word = types.int64
    return types.void(weights, packed, bases, word, word, rows, word, word), generate


@emitted
def _pack_columns(
    typingctx: Any,
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
        own, _ = memory_of(context, builder, kinds[8], own)
        own = moved(builder, own, builder.mul(builder.sub(parts.layer, WORD(1)), WORD(GROUP)))
        own = builder.load(builder.bitcast(own, ir.VectorType(WORD, GROUP).as_pointer()), align=8)

        def pack(starts: Sequence[Any], at: Any, mask: Any = None) -> None:
            few = ir.Constant(FEW, ir.Undefined)
            for genome, start in enumerate(starts):
                weight = builder.load(moved(builder, parts.weights.data, start))
                few = builder.insert_element(few, weight, INDEX(genome))
            if mask is not None:
                few = builder.select(mask, few, ir.Constant(FEW, [0.0] * GROUP))
            place = moved(builder, parts.packed.data, builder.add(parts.place, builder.mul(at, WORD(GROUP))))
            builder.store(few, builder.bitcast(place, FEW.as_pointer()), align=4 * GROUP)

        with loop(builder, WORD(0), units) as (unit, _):
            starts, at = parts.starts(builder, unit), builder.mul(unit, builder.add(senders, WORD(1)))
            with loop(builder, WORD(0), senders) as (sender, _):
                steps = (builder.zext(builder.load(moved(builder, table, sender)), WORD) for table in columns)
                places = [builder.add(start, step) for start, step in zip(starts, steps, strict=True)]
                pack(places, builder.add(at, sender), builder.icmp_signed("<", spread(builder, sender, GROUP), own))
            pack([builder.add(start, bias) for start in starts], builder.add(at, senders))
        return context.get_dummy_value()

    word = types.int64
    return types.void(weights, packed, bases, word, word, rows, word, columns, own, word, word), generate


@emitted
def add_squared_weights(typingctx: Any, plan: Any, layer: Any, sums: Any) -> Any:
    """Add the squares of a layer's packed weights to sums (GROUP,)."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, (plan, layer, sums) = signature.args, arguments
        weights = packed_layer(context, builder, kinds[0], plan, layer)
        place_of_sums = builder.bitcast(memory_of(context, builder, kinds[2], sums)[0], FEW.as_pointer())
        total, own = (cgutils.alloca_once_value(builder, ir.Constant(FEW, [0.0] * GROUP)) for _ in range(2))
        builder.store(builder.load(place_of_sums, align=4), total)
        with loop(builder, WORD(0), weights.units) as (unit, _):
            row = builder.bitcast(weights.row(builder, unit), FEW.as_pointer())
            builder.store(ir.Constant(FEW, [0.0] * GROUP), own)
            with loop(builder, WORD(0), weights.width) as (column, _):
                weight = builder.load(moved(builder, row, column), align=4 * GROUP)
                builder.store(multiply_add(builder, weight, weight, builder.load(own)), own)
            # One unit's sum need not wait for another's.
            builder.store(builder.fadd(builder.load(total), builder.load(own)), total)
        builder.store(builder.load(total), place_of_sums, align=4)
        return context.get_dummy_value()

    return types.void(plan, layer, sums), generate


# ---- compiled Python ----


@compiled
def by_size(promoters: Any, sizes: Any, starts: Any, order: Any) -> None:
    """Write the order of individuals by how many units they express: a group should have equals.

    sizes (population,) and starts (units + 2,): spaces to work in.
    """
    population, units = promoters.shape
    for size in range(units + 2):
        starts[size] = 0
    for individual in range(population):
        size = 0
        for unit in range(units):
            size += promoters[individual, unit]
        sizes[individual] = size
        starts[size + 1] += 1
    for size in range(units):
        starts[size + 1] += starts[size]
    for individual in range(population):
        order[starts[sizes[individual]]] = individual
        starts[sizes[individual]] += 1


@compiled
def find_expressed(promoters: Any, sizes: Any, group: Any, columns: Any, rows: Any, own: Any, counts: Any) -> None:
    """Write which units are expressed by a group of individuals (GROUP,).

    columns (layers, GROUP, units and room for `ROW` more) int32 gets which units of a layer a genome expresses, rows
    where in the layer their weights begin, own (layers, GROUP) how many they are, counts (layers,) the most of them.
    """
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
def pack(
    weights: Any, sizes: Any, bases: Any, columns: Any, rows: Any, own: Any, counts: Any, starts: Any, packed: Any
) -> None:
    """Pack what a group expresses, as `find_expressed` found it; the last two are written, see `Plan`.

    bases (GROUP,): where the group's genomes begin in weights; it is written over.
    """
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
