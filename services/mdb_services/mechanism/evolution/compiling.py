"""How functions are compiled, and how those are made that emit instructions of their own."""

import sys
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.core.caching import FunctionCache
from numba.extending import intrinsic

_Function = TypeVar("_Function", bound=Callable[..., Any])

VERSION = zlib.crc32(b"".join(file.read_bytes() for file in sorted(Path(__file__).parent.glob("*.py"))))
"""Changes with the files of this folder: what is kept on disk of one contains what others had then."""

# Sums may be reordered into vectors and fused; infinities and NaN keep their meaning.
_FAST = {"contract", "reassoc", "nsz", "arcp"}


def _without_linear_algebra() -> None:
    """Let numba find no `scipy.linalg` when it looks whether it is there, if nobody else has it yet.

    It would keep 8 MB of it, and load it for longer than our functions, which need none. Of what numba knows only
    np.cov and np.corrcoef go by what it finds here.
    """
    name = "scipy.linalg"
    if name in sys.modules:
        return
    sys.modules[name] = None  # type: ignore[assignment] # as Python says that there is none of that name
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        sys.modules.pop(name, None)


_without_linear_algebra()

_place = {"kept only": False, "nothing is kept": False}


class NotKeptError(Exception):
    """A function would have to be compiled."""


@contextmanager
def kept_only() -> Iterator[None]:
    """Compile nothing meanwhile, which takes long: what is not kept on disk raises NotKeptError when it is called."""
    if _place["nothing is kept"]:
        raise NotKeptError
    _place["kept only"] = True
    try:
        yield
    finally:
        _place["kept only"] = False


class _OptionalCache(FunctionCache):
    """What is kept on disk; when that cannot be read or written, a function is compiled as if nothing were kept."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        kept: Any = None
        with suppress(Exception):  # damaged, as by a full disk: what is unpickled may raise anything
            kept = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        if kept is None and _place["kept only"]:
            raise NotKeptError
        return kept

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (*super()._index_key(sig, codegen), VERSION)  # type: ignore[no-untyped-call]

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(Exception):  # the same: it reads the index first
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]


def compiled(function: _Function) -> _Function:
    """Compile at the first call and keep the result on disk; arrays are not checked for their bounds.

    A check for division by zero would keep loops from becoming vector instructions, hence numpy's error model; so do
    indices that might be negative, hence uint64 in short loops. Each view of an array, and each call that passes a
    tuple of arrays, costs locked instructions to count references: inner loops take whole arrays and indices.
    The disk keeps code under a function's own file, the types of its arguments, and `VERSION`.
    """
    return _compiled(function)


def inlined(function: _Function) -> _Function:
    """Compile the same, and anew into each caller: in a call, each array takes seven words."""
    return _compiled(function, forceinline=True)


def _compiled(function: _Function, *, forceinline: bool = False) -> _Function:
    compiling: Any = njit(nogil=True, fastmath=_FAST, error_model="numpy", forceinline=forceinline)
    dispatcher = compiling(function)
    try:
        dispatcher._cache = _OptionalCache(function)  # type: ignore[no-untyped-call] # as by cache=True
    except RuntimeError:  # no folder of the compiler's can be written: it compiles in each process
        _place["nothing is kept"] = True
    return cast(_Function, dispatcher)


def emitted(generator: Callable[..., Any]) -> Any:
    """Make a function that compiled Python calls, of one that returns its signature and what emits it."""
    return intrinsic(generator)
