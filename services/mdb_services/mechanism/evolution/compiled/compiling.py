"""How functions are compiled, and how those are made that emit instructions of their own."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import config, njit
from numba.extending import intrinsic

from mdb_services.mechanism.evolution.layout import FEATURES, PROCESSOR

_Function = TypeVar("_Function", bound=Callable[..., Any])

config.CPU_NAME, config.CPU_FEATURES = PROCESSOR, FEATURES  # type: ignore[attr-defined] # read at the first compiling

# Sums may be reordered into vectors and fused; infinities and NaN keep their meaning.
_FAST = {"contract", "reassoc", "nsz", "arcp"}


def compiled(function: _Function, **how: Any) -> _Function:
    """Compile for other compiled code; arrays are not checked for their bounds, and none can be made.

    Whoever makes no arrays needs no counts of references, each of which would cost locked instructions, and none of
    numba's own functions once it is compiled. A check for division by zero would keep loops from becoming vector
    instructions, hence numpy's error model; so do indices that might be negative, hence uint64 in short loops.
    Each view of an array takes seven words: inner loops take whole arrays and indices.
    """
    compiling = cast(Any, njit)(nogil=True, fastmath=_FAST, error_model="numpy", _nrt=False, **how)
    return cast(_Function, compiling(function))


def inlined(function: _Function) -> _Function:
    """Compile the same, and anew into each caller: in a call, each array takes seven words."""
    return compiled(function, forceinline=True)


def emitted(generator: Callable[..., Any]) -> Any:
    """Make a function that compiled Python calls, of one that returns its signature and what emits it."""
    return intrinsic(generator)
