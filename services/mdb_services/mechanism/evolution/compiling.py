"""How functions are compiled, and how those are made that emit instructions of their own.

What the compiler keeps on disk of a function does not know this file: whoever changes it deletes that.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar, cast

from numba import njit
from numba.core.caching import FunctionCache
from numba.extending import intrinsic

_Function = TypeVar("_Function", bound=Callable[..., Any])

# Sums may be reordered into vectors and fused; infinities and NaN keep their meaning.
_FAST = {"contract", "reassoc", "nsz", "arcp"}


class _OptionalCache(FunctionCache):
    """What is kept on disk; when that cannot be read or written, a function is compiled as if nothing were kept."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except Exception:
            return None  # damaged, as by a full disk: what is unpickled may raise anything

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(Exception):  # the same: it reads the index first
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]


def compiled(function: _Function) -> _Function:
    """Compile at the first call and keep the result on disk; arrays are not checked for their bounds.

    A check for division by zero would keep loops from becoming vector instructions, hence numpy's error model; so do
    indices that might be negative, hence uint64 in short loops. Each view of an array, and each call that passes a
    tuple of arrays, costs locked instructions to count references: inner loops take whole arrays and indices.
    The disk keeps code under a function's own file and the types of its arguments only. So what calls functions of
    `kernel` from another file takes its `VERSION` as the default of an argument: the value is part of the type.
    """
    dispatcher: Any = njit(nogil=True, fastmath=_FAST, error_model="numpy")(function)
    with suppress(RuntimeError):  # no folder of the compiler's can be written: it compiles in each process
        dispatcher._cache = _OptionalCache(function)  # type: ignore[no-untyped-call] # as by cache=True
    return cast(_Function, dispatcher)


def emitted(generator: Callable[..., Any]) -> Any:
    """Make a function that compiled Python calls, of one that returns its signature and what emits it."""
    return intrinsic(generator)
