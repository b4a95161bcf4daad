"""What Python calls: one function, which reads from tables of addresses where its arrays are."""

# ruff: noqa: ARG001 - the compiler's argument has no use here
# mypy: allow-untyped-calls

from typing import Any

import llvmlite.binding as llvm  # type: ignore[import-untyped]
import numpy as np
from numba import types
from numba.np.arrayobj import populate_array
from numba.np.numpy_support import from_dtype

from mdb_services.mechanism.evolution.compiled.compiling import compiled, emitted
from mdb_services.mechanism.evolution.compiled.generations import do_parts, evolve
from mdb_services.mechanism.evolution.compiled.kernel import population_errors
from mdb_services.mechanism.evolution.compiled.vectors import WORD, memory_of, moved
from mdb_services.mechanism.evolution.layout import (
    DIMENSIONS,
    ENTRY,
    EVOLVE,
    KINDS,
    MEASURE,
    Evolved,
    Measured,
    Numbers,
    Pairs,
    Rates,
    Spaces,
)


def _arrays_of(record: type[Any]) -> Any:
    """Return a function that gives a record of arrays by the address of their table."""
    kinds = [types.Array(from_dtype(np.dtype(dtype)), dims, "C") for dtype, dims in KINDS[record].values()]
    result = types.NamedTuple(kinds, record)

    @emitted
    def read(typingctx: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            table, arrays = builder.inttoptr(arguments[0], WORD.as_pointer()), []
            for place, kind in enumerate(kinds):
                row = moved(builder, table, place * (1 + DIMENSIONS))
                address, *shape = (builder.load(moved(builder, row, word)) for word in range(1 + kind.ndim))
                size = WORD(kind.dtype.bitwidth // 8)
                strides = [size]
                for length in reversed(shape[1:]):
                    strides.insert(0, builder.mul(strides[0], length))
                array = context.make_array(kind)(context, builder)
                data = builder.inttoptr(address, array.data.type)
                populate_array(array, data=data, shape=shape, strides=strides, itemsize=size, meminfo=None)
                arrays.append(array._getvalue())
            return context.make_tuple(builder, result, arrays)

        return result(types.int64), generate

    return read


def _numbers_of(record: type[Any], kind: Any) -> Any:
    """Return a function that gives a record of numbers of one kind, which are in an array."""
    result = types.NamedUniTuple(kind, len(record._fields), record)

    @emitted
    def read(typingctx: Any, numbers: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer, _ = memory_of(context, builder, signature.args[0], arguments[0])
            found = [builder.load(moved(builder, pointer, place)) for place in range(len(record._fields))]
            return context.make_tuple(builder, result, found)

        return result(numbers), generate

    return read


_measured, _evolved, _pairs, _spaces = (_arrays_of(record) for record in (Measured, Evolved, Pairs, Spaces))
_numbers, _rates = _numbers_of(Numbers, types.int64), _numbers_of(Rates, types.float64)


def _enter(task: int, pairs: int, spaces: int, what: int) -> None:
    memory, own = _pairs(pairs), _spaces(spaces)
    if what == MEASURE:
        m = _measured(task)
        population_errors(m.weights, m.promoters, m.sizes, memory, m.errors, m.squares, own)
    else:
        shared = _evolved(task)
        numbers, rates = _numbers(shared.numbers), _rates(shared.rates)
        if what == EVOLVE:
            evolve(shared, memory, numbers, rates, own)
        else:
            do_parts(shared, memory, numbers, rates, False, own)


def object_code(machine: Any) -> bytes:
    """Compile all of it for a machine of LLVM; return the object code, which needs nothing of numba."""
    kinds = (types.int64, types.int64, types.int64, types.int64)
    function: Any = compiled(_enter, no_cpython_wrapper=True, no_cfunc_wrapper=True)
    function.compile(kinds)
    module = llvm.parse_assembly(function.inspect_llvm(kinds))
    module.get_function(function.overloads[kinds].fndesc.llvm_func_name).name = ENTRY
    code: bytes = machine.emit_object(module)
    return code
