"""Work that threads share: it is put up in parts, and whoever is free takes the next one.

Nobody waits for a part that was not taken yet: a helper that the machine does not run at the moment costs nothing.
"""

# ruff: noqa: ARG001 - the compiler's argument has no use here
# mypy: allow-untyped-calls

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types

from mdb_services.mechanism.evolution.compiled.compiling import compiled, emitted
from mdb_services.mechanism.evolution.layout import DONE, PUT_UP, TAKEN

_give_way = types.ExternalFunction("sched_yield", types.int32())


def _pointer(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    return builder.gep(array.data, [arguments[1]])


@emitted
def _load(typingctx: Any, board: Any, place: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load_atomic(_pointer(context, builder, signature, arguments), "acquire", 8)

    return types.int64(board, types.int64), generate


@emitted
def _add(typingctx: Any, board: Any, place: Any, number: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.atomic_rmw("add", _pointer(context, builder, signature, arguments), arguments[2], "seq_cst")

    return types.int64(board, types.int64, types.int64), generate


@emitted
def _count_on(typingctx: Any, board: Any, place: Any, number: Any) -> Any:
    """Add one if there is still that number; return whether there was."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer, more = _pointer(context, builder, signature, arguments), builder.add(arguments[2], ir.IntType(64)(1))
        return builder.extract_value(builder.cmpxchg(pointer, arguments[2], more, "seq_cst", "seq_cst"), 1)

    return types.boolean(board, types.int64, types.int64), generate


@compiled
def put_up(board: Any, parts: int) -> None:
    """Let parts be taken; they are numbered on and on."""
    _add(board, PUT_UP, parts)


@compiled
def take(board: Any) -> Any:
    """Return the number of a part that is now the caller's to do, or -1 after giving way to other threads."""
    number = _load(board, TAKEN)
    if number < _load(board, PUT_UP) and _count_on(board, TAKEN, number):
        return number
    _give_way()
    return -1


@compiled
def report(board: Any) -> None:
    """Say that a part is done."""
    _add(board, DONE, 1)


@compiled
def is_done(board: Any) -> Any:
    """Return whether all parts are done that were put up."""
    return _load(board, DONE) >= _load(board, PUT_UP)


@compiled
def is_open(board: Any) -> Any:
    """Return whether there may be more work."""
    return _load(board, PUT_UP) >= 0
