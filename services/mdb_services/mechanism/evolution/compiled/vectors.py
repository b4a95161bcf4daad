"""Rows of vector lanes as LLVM instructions, what the kernel and breeding share.

These functions run when their callers are compiled, and emit instructions. Arrays are taken whole, with a flat index.
"""

# mypy: allow-untyped-calls

from collections.abc import Sequence
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils

from mdb_services.mechanism.evolution.layout import ROW

INDEX, WORD = ir.IntType(32), ir.IntType(64)
BITS, BYTES = ir.VectorType(ir.IntType(1), ROW), ir.VectorType(ir.IntType(8), ROW)
INDICES, FLOATS = ir.VectorType(INDEX, ROW), ir.VectorType(ir.FloatType(), ROW)
NUMBERS = ir.Constant(INDICES, list(range(ROW)))
"""The number of each lane."""


def every(kind: Any, number: float) -> Any:
    """Return a row of a constant."""
    return ir.Constant(kind, [number] * ROW)


def moved(builder: Any, pointer: Any, *steps: Any) -> Any:
    """Return the pointer moved on by steps, numbers or values."""
    for step in steps:
        pointer = builder.gep(pointer, [WORD(step) if isinstance(step, int) else step])
    return pointer


def loop(builder: Any, first: Any, end: Any, step: int = 1) -> Any:
    """Return a context whose instructions are repeated for each index, signed, which it gives."""
    return cgutils.for_range_slice(builder, first, end, WORD(step), WORD)


def multiply_add(builder: Any, left: Any, right: Any, summand: Any) -> Any:
    """Return left times right plus summand, in one instruction where there is one."""
    return builder.fadd(builder.fmul(left, right, flags=("contract",)), summand, flags=("contract",))


def spread(builder: Any, numbers: Any, lanes: int = ROW) -> Any:
    """Return a vector of one number, or of a small vector again and again."""
    if not isinstance(numbers.type, ir.VectorType):
        none = ir.Constant(ir.VectorType(numbers.type, 1), ir.Undefined)
        numbers = builder.insert_element(none, numbers, INDEX(0))
    return shuffled(builder, numbers, numbers, [lane % numbers.type.count for lane in range(lanes)])


def shuffled(builder: Any, first: Any, second: Any, order: Sequence[int]) -> Any:
    """Return lanes of two vectors; those of the second count on from the first's."""
    return builder.shuffle_vector(first, second, ir.Constant(ir.VectorType(INDEX, len(order)), list(order)))


def first_lanes(builder: Any, count: Any) -> Any:
    """Return which lanes of a row are below a count."""
    return builder.icmp_unsigned("<", NUMBERS, spread(builder, builder.trunc(count, INDEX)))


def interleaved(builder: Any, rows: Sequence[Any]) -> list[Any]:
    """Return the lanes of rows side by side, a power of two of them: first the first lane of each."""
    order = [lane // 2 + ROW * (lane % 2) for lane in range(2 * ROW)]
    if len(rows) == 1:
        return list(rows)
    pairs = zip(interleaved(builder, rows[::2]), interleaved(builder, rows[1::2]), strict=True)
    return [shuffled(builder, *pair, order[part : part + ROW]) for pair in pairs for part in (0, ROW)]


def compressed(builder: Any, row: Any, chosen: Any) -> Any:
    """Return the chosen lanes of a row of indices side by side, then zeros."""
    kind = ir.FunctionType(INDICES, [INDICES, BITS, INDICES])
    name = f"llvm.experimental.vector.compress.v{ROW}i32"
    compress = cgutils.get_or_insert_function(builder.module, kind, name)
    return builder.call(compress, [row, chosen, every(INDICES, 0)])


def memory_of(context: Any, builder: Any, kind: Any, value: Any) -> tuple[Any, list[Any]]:
    """Return an array's pointer and shape."""
    array = context.make_array(kind)(context, builder, value)
    return array.data, cgutils.unpack_tuple(builder, array.shape)


class Array:
    """An array's memory, by flat indices."""

    def __init__(self, context: Any, builder: Any, kind: Any, value: Any) -> None:
        """Take an array of compiled Python."""
        self.builder, self.data = builder, context.make_array(kind)(context, builder, value).data

    def load(self, index: Any, kind: Any, mask: Any = None, instead: Any = None) -> Any:
        """Return the row at an index, under a mask or where there is room."""
        if mask is None:
            return self.builder.load(self._place(index, kind), align=1)
        return self._masked("load", kind, self._place(index, kind), INDEX(1), mask, instead)

    def store(self, row: Any, index: Any, mask: Any = None) -> None:
        """Write a row at an index, under a mask or where there is room."""
        if mask is None:
            self.builder.store(row, self._place(index, row.type), align=1)
        else:
            self._masked("store", ir.VoidType(), row, self._place(index, row.type), INDEX(1), mask)

    def _place(self, index: Any, kind: Any) -> Any:
        return self.builder.bitcast(self.builder.gep(self.data, [index]), kind.as_pointer())

    def _masked(self, what: str, result: Any, *arguments: Any) -> Any:
        kind = ir.FunctionType(result, [argument.type for argument in arguments])
        row = "f32" if FLOATS in (result, arguments[0].type) else "i8"
        name = f"llvm.masked.{what}.v{ROW}{row}.p0"
        return self.builder.call(cgutils.get_or_insert_function(self.builder.module, kind, name), arguments)
