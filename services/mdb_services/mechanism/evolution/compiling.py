"""How functions are compiled, and how those are made that emit instructions of their own.

What the compiler keeps on disk of a function does not know this file: whoever changes it deletes that.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit
from numba.extending import intrinsic

_Function = TypeVar("_Function", bound=Callable[..., Any])

# Sums may be reordered into vectors and fused; infinities and NaN keep their meaning.
_FAST = {"contract", "reassoc", "nsz", "arcp"}


def compiled(function: _Function) -> _Function:
    """Compile at the first call and keep the result on disk; arrays are not checked for their bounds.

    A check for division by zero would keep loops from becoming vector instructions, hence numpy's error model; so do
    indices that might be negative, hence uint64 in short loops. Each view of an array, and each call that passes a
    tuple of arrays, costs locked instructions to count references: inner loops take whole arrays and indices.
    The disk keeps code under a function's own file and the types of its arguments only. So what calls functions of
    `kernel` from another file takes its `VERSION` as the default of an argument: the value is part of the type.
    """
    return cast(_Function, njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")(function))


def emitted(generator: Callable[..., Any]) -> Any:
    """Make a function that compiled Python calls, of one that returns its signature and what emits it."""
    return intrinsic(generator)
