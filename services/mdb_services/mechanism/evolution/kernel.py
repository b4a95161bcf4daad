"""Errors of a whole population over the short-term memory, compiled.

Genomes are flat float32 rows, laid out as `networks.network.split_layers` views them; promoters are one byte a hidden
unit. The pairs come transposed in blocks (`genomes.in_blocks`), so that a vector register holds one column of several
pairs. A unit that is not expressed costs nothing.

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

_FEATURES = get_host_cpu_features() if config.CPU_FEATURES is None else config.CPU_FEATURES  # type: ignore[attr-defined]
LANES = 16 if "+avx512f" in _FEATURES else 8
"""Pairs in a vector: one register of AVX-512 or AVX, two of smaller processors."""

VECTORS = 3
"""Vectors taken through a layer together: with four units, twelve sums, as many as hide the time that one takes."""

BLOCK = LANES * VECTORS
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
_VECTOR = ir.VectorType(_FLOAT, LANES)


class _Plan(NamedTuple):
    """Which units of a genome count, and where their weights are.

    Units have slots, layer after layer, inputs first; in each layer those that count come first. For a slot, rows
    (slots,) says where a unit's weights begin, columns (slots,) which weight of a receiver is for its signal. For a
    layer, firsts (layers,) is its first slot, ends (layers,) that after its last unit that counts. All int64.
    """

    rows: Any
    columns: Any
    firsts: Any
    ends: Any


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


def _spread(builder: Any, number: Any) -> Any:
    """Return a vector of one number."""
    none = ir.Constant(ir.VectorType(number.type, LANES), ir.Undefined)
    first = ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES)
    return builder.shuffle_vector(builder.insert_element(none, number, _INDEX(0)), none, first)


def _loop(builder: Any, first: Any, end: Any, step: int = 1) -> Any:
    return cgutils.for_range_slice(builder, first, end, _WORD(step), _WORD)


class _Blocks(NamedTuple):
    """Rows of pairs in blocks (blocks, rows, BLOCK): a pointer, and how many rows a block has."""

    pointer: Any
    rows: Any

    def vectors(self, builder: Any, block: Any, row: Any, count: int) -> list[Any]:
        """Return pointers to the first vectors of a row."""
        place = builder.mul(builder.add(builder.mul(block, self.rows), row), _WORD(BLOCK))
        start = builder.bitcast(_at(builder, self.pointer, place), _VECTOR.as_pointer())
        return [_at(builder, start, vector) for vector in range(count)]


class _Layer(NamedTuple):
    """What the instructions for a hidden layer refer to; bias: its column; units, senders, receivers: (slot, end)."""

    weights: Any
    rows: Any
    columns: Any
    bias: Any
    source: _Blocks
    work: _Blocks
    units: Sequence[Any]
    senders: Sequence[Any]
    receivers: Sequence[Any]

    def row(self, builder: Any, slot: Any) -> Any:
        """Return the pointer to a unit's weights."""
        return _at(builder, self.weights, builder.load(_at(builder, self.rows, slot)))


def _emit_units(builder: Any, layer: _Layer, unit: Any, units: int, block: Any, vectors: int) -> None:
    """Take some units, from a slot on, through the first vectors of a block of pairs."""
    slots = [builder.add(unit, _WORD(u)) for u in range(units)]
    rows = [layer.row(builder, slot) for slot in slots]
    biases = [_spread(builder, builder.load(_at(builder, row, layer.bias))) for row in rows]

    signals = _emit_signals(builder, layer, rows, biases, block, vectors)
    first, end = layer.receivers
    with builder.if_then(builder.icmp_signed("==", first, end)):
        for slot, own in zip(slots, signals, strict=True):
            for signal, place in zip(own, layer.work.vectors(builder, _WORD(0), slot, vectors), strict=True):
                builder.store(signal, place, align=4)
    _emit_sending(builder, layer, slots, signals)


def _emit_signals(
    builder: Any, layer: _Layer, rows: Sequence[Any], biases: Sequence[Any], block: Any, vectors: int
) -> list[list[Any]]:
    """Return the signals of units for the first vectors of a block: tanh of the bias plus what they receive."""
    sums = [[cgutils.alloca_once_value(builder, bias) for _ in range(vectors)] for bias in biases]
    first, end = layer.senders
    with _loop(builder, _WORD(0), builder.sub(end, first)) as (sender, _):
        column = builder.load(_at(builder, layer.columns, first, sender))
        received = [builder.load(place, align=4) for place in layer.source.vectors(builder, block, sender, vectors)]
        for row, own in zip(rows, sums, strict=True):
            weight = _spread(builder, builder.load(_at(builder, row, column)))
            for vector, total in zip(received, own, strict=True):
                builder.store(_multiply_add(builder, weight, vector, builder.load(total)), total)
    flat = [builder.load(total) for own in sums for total in own]
    flat = [signal for pair in range(0, len(flat), 2) for signal in _tanh(builder, flat[pair : pair + 2])]
    return [flat[start : start + vectors] for start in range(0, len(flat), vectors)]


def _emit_sending(builder: Any, layer: _Layer, slots: Sequence[Any], signals: Sequence[Sequence[Any]]) -> None:
    """Add the weighted signals of units to each receiver's row."""
    columns = [builder.load(_at(builder, layer.columns, slot)) for slot in slots]
    with _loop(builder, *layer.receivers) as (receiver, _):
        row = layer.row(builder, receiver)
        places = layer.work.vectors(builder, _WORD(0), receiver, len(signals[0]))
        sums = [builder.load(place, align=4) for place in places]
        for column, own in zip(columns, signals, strict=True):
            weight = _spread(builder, builder.load(_at(builder, row, column)))
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


@emitted
def _hidden_layer(
    typingctx: Any,  # noqa: ARG001
    weights: Any,
    plan: Any,
    layer: Any,
    inputs: Any,
    work: Any,
    block: Any,
    vectors: Any,
) -> Any:
    """Take a hidden layer's units through the first vectors of a block.

    weights: those of all genomes, flat; plan: `_Plan`; inputs (blocks, inputs, BLOCK); work (1, slots, BLOCK): the
    units' signals go to their rows; those of the last hidden layer are weighted and added to the outputs' rows.
    """
    _check(weights=weights, inputs=inputs, work=work)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds, (weights, plan, layer, inputs, work, block, vectors) = signature.args, arguments
        inputs, work = (_blocks(context, builder, kinds[k], array) for k, array in ((3, inputs), (4, work)))
        tables = zip(kinds[1], cgutils.unpack_tuple(builder, plan), strict=True)
        rows, columns, firsts, ends = (_array(context, builder, *table) for table in tables)
        last = builder.sub(firsts[1][0], _WORD(1))

        def span(index: Any) -> list[Any]:
            return [builder.load(_at(builder, pointer, index)) for pointer, _ in (firsts, ends)]

        units, senders, receivers = span(layer), span(builder.sub(layer, _WORD(1))), span(last)
        is_last = builder.icmp_signed("==", layer, builder.sub(last, _WORD(1)))
        receivers[1] = builder.select(is_last, receivers[1], receivers[0])
        is_first = builder.icmp_signed("==", layer, _WORD(1))
        signals = _at(builder, work.pointer, builder.mul(senders[0], _WORD(BLOCK)))
        source = _Blocks(*map(builder.select, [is_first] * 2, inputs, (signals, work.rows)))
        pointers = (_array(context, builder, kinds[0], weights)[0], rows[0], columns[0])
        bias = builder.sub(units[0], senders[0])
        parts = _Layer(*pointers, bias, source, work, units, senders, receivers)
        block = builder.select(is_first, block, _WORD(0))
        for number in range(1, VECTORS + 1):
            with builder.if_then(builder.icmp_signed("==", vectors, _WORD(number))):
                first, end = units
                for count in UNITS:
                    stop = builder.add(first, builder.and_(builder.sub(end, first), _WORD(-count)))
                    with _loop(builder, first, stop, count) as (unit, _):
                        _emit_units(builder, parts, unit, count, block, number)
                    first = stop
        return context.get_dummy_value()

    return types.void(weights, plan, layer, inputs, work, block, vectors), generate


@emitted
def _set_row(typingctx: Any, work: Any, slot: Any, bias: Any, targets: Any, block: Any, output: Any) -> Any:  # noqa: ARG001
    """Set a row of work to the bias minus the targets: what units send then makes it the outputs' misses."""
    _check(work=work, targets=targets)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        work, slot, bias, targets, block, output = arguments
        places = _blocks(context, builder, signature.args[0], work).vectors(builder, _WORD(0), slot, VECTORS)
        wanted = _blocks(context, builder, signature.args[3], targets).vectors(builder, block, output, VECTORS)
        for place, target in zip(places, wanted, strict=True):
            builder.store(builder.fsub(_spread(builder, bias), builder.load(target, align=4)), place, align=4)
        return context.get_dummy_value()

    return types.void(work, slot, types.float32, targets, block, output), generate


@emitted
def _sum_of_squares(typingctx: Any, work: Any, slot: Any, count: Any) -> Any:  # noqa: ARG001
    """Return the sum of the squares of the first numbers of a row of work."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        work, slot, count = arguments
        total = zero = ir.Constant(_VECTOR, [0.0] * LANES)
        places = _blocks(context, builder, signature.args[0], work).vectors(builder, _WORD(0), slot, VECTORS)
        for vector, place in enumerate(places):
            indices = ir.Constant(ir.VectorType(_WORD, LANES), [vector * LANES + lane for lane in range(LANES)])
            counts = builder.icmp_signed("<", indices, _spread(builder, count))
            number = builder.select(counts, builder.load(place, align=4), zero)
            total = _multiply_add(builder, number, number, total)
        kind = ir.FunctionType(_FLOAT, [_FLOAT, _VECTOR])
        add_up = cgutils.get_or_insert_function(builder.module, kind, f"llvm.vector.reduce.fadd.v{LANES}f32")
        return builder.call(add_up, [_FLOAT(0.0), total], fastmath=("reassoc",))

    return types.float32(work, slot, count), generate


# ---- compiled Python ----


@compiled
def _find_expressed(promoters: Any, individual: int, sizes: Any, start: int, plan: _Plan) -> None:
    """Write the plan of an individual whose weights begin at start."""
    gene, last = np.uint64(0), sizes.size - 1
    for layer in range(1, sizes.size):
        slot = np.uint64(plan.firsts[layer])
        for unit in range(sizes[layer]):
            # No branch: nobody could foretell it. What is not expressed is written over by the next unit.
            plan.rows[slot], plan.columns[slot] = start, unit
            slot += np.uint64(1 if layer == last else promoters[individual, gene + np.uint64(unit)])
            start += sizes[layer - 1] + 1
        gene += np.uint64(sizes[layer])
        plan.ends[layer] = slot


@compiled
def _squared_weights(weights: Any, plan: _Plan) -> Any:
    """Return the sum of the squares of the weights that count."""
    total = np.float32(0)
    for layer in range(1, plan.ends.size):
        first, end = np.uint64(plan.firsts[layer - 1]), np.uint64(plan.ends[layer - 1])
        bias = np.uint64(plan.firsts[layer] - plan.firsts[layer - 1])
        for slot in range(np.uint64(plan.firsts[layer]), np.uint64(plan.ends[layer])):
            row = np.uint64(plan.rows[slot])
            own = weights[row + bias] ** 2
            for sender in range(first, end):
                own += weights[row + np.uint64(plan.columns[sender])] ** 2
            total += own  # one unit's sum need not wait for another's
    return total


@compiled
def population_errors(
    weights: Any, promoters: Any, sizes: Any, inputs: Any, targets: Any, pairs: int, errors: Any, squares: Any
) -> None:
    """Write each genome's mean squared error over the pairs, and the sum of its squared weights that count.

    weights (population, weights) float32; promoters (population, hidden units) uint8; sizes (layers,) int64;
    inputs (blocks, inputs, BLOCK) and targets (blocks, outputs, BLOCK) float32 from `genomes.in_blocks`; pairs is the
    number of true pairs, at least one; errors and squares (population,) float64. Squares of size 0 are not
    written, which saves their time. Raises TypingError when weights, inputs or targets are not contiguous float32.
    """
    blocks, last, outputs, slots = inputs.shape[0], sizes.size - 1, targets.shape[1], sizes.sum()
    rows, firsts, ends = np.empty(slots, np.int64), np.zeros(sizes.size, np.int64), np.zeros(sizes.size, np.int64)
    firsts[1:], ends[0] = np.cumsum(sizes[:-1]), sizes[0]
    plan, first_output = _Plan(rows, np.arange(slots), firsts, ends), firsts[last]
    memory = np.empty(slots * BLOCK + LINE // 4, np.float32)
    start = -(memory.ctypes.data // 4) % (LINE // 4)
    work = memory[start : start + slots * BLOCK].reshape(1, slots, BLOCK)
    genomes = weights.reshape(-1)
    for i in range(weights.shape[0]):
        _find_expressed(promoters, i, sizes, i * weights.shape[1], plan)
        total = 0.0
        for block in range(blocks):
            left = pairs - block * BLOCK
            for output in range(outputs):
                bias = genomes[rows[first_output + output] + sizes[last - 1]]
                _set_row(work, first_output + output, bias, targets, block, output)
            for layer in range(1, last):
                _hidden_layer(genomes, plan, layer, inputs, work, block, min(-(-left // LANES), VECTORS))
            for output in range(outputs):
                total += _sum_of_squares(work, first_output + output, left)
        errors[i] = total / (pairs * outputs)
        if i < squares.size:
            squares[i] = _squared_weights(genomes, plan)
