"""The compiled code of `compiled/`, made once on a machine and kept on disk.

Who finds it kept needs neither numba nor the 50 MB that it takes: only LLVM, which links it.
"""

from __future__ import annotations

import ctypes
import zlib
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic, TypeVar

import llvmlite.binding as llvm  # type: ignore[import-untyped]
import numpy as np

from mdb_services.mechanism.evolution.kept import Kept
from mdb_services.mechanism.evolution.layout import (
    DIMENSIONS,
    ENTRY,
    FEATURES,
    KINDS,
    PROCESSOR,
    Evolved,
    Measured,
    Pairs,
    Spaces,
)

_HERE = Path(__file__).parent
_Arrays = TypeVar("_Arrays", bound=tuple[Any, ...])


class NotKeptError(Exception):
    """The code would have to be compiled, which takes long."""


class Table(Generic[_Arrays]):
    """The table of addresses of a record's arrays, as the compiled code reads it; it keeps the arrays alive."""

    def __init__(self, arrays: _Arrays) -> None:
        """Take the arrays. Raises ValueError when one is not of its kind."""
        words: list[int] = []
        for array, (name, (kind, dimensions)) in zip(arrays, KINDS[type(arrays)].items(), strict=True):
            if array.dtype != kind or array.ndim != dimensions or not array.flags.c_contiguous:
                raise ValueError(
                    f"{name}: {array.dtype} {array.shape}; expected {kind.__name__} of {dimensions} dimensions, "
                    f"contiguous: np.ascontiguousarray(x, np.{kind.__name__})"
                )
            words += (array.ctypes.data, *array.shape, *(0,) * (DIMENSIONS - dimensions))
        self.arrays, self._words = arrays, np.array(words, np.int64)
        self.address: int = self._words.ctypes.data

    def __reduce__(self) -> tuple[type[Table[_Arrays]], tuple[_Arrays]]:
        """Have a copy made of the copied arrays: their addresses are others."""
        return type(self), (self.arrays,)


_loaded: list[Any] = []
"""The function, and the engine that owns its memory."""
_results = np.zeros(2, np.int64)
"""Where compiled code says that it returns nothing, and what it raises: nothing."""
_returned: int = _results.ctypes.data
_raised: int = _returned + _results.itemsize


def run(task: Table[Evolved] | Table[Measured], pairs: Table[Pairs], spaces: Table[Spaces], what: int) -> None:
    """Do what is to be done, `layout.MEASURE` say, without Python's lock; the first call loads the code."""
    load()
    _loaded[0](_returned, _raised, task.address, pairs.address, spaces.address, what)


def load(*, compiling: bool = True) -> None:
    """Load the compiled code, once; when it is not kept, compile it, or raise NotKeptError."""
    if _loaded:
        return
    machine, kept = _machine(), Kept(_name())
    code = kept.read()
    if code is None:
        if not compiling:
            raise NotKeptError
        code = _made(machine, kept)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    kind = ctypes.CFUNCTYPE(ctypes.c_int32, *(ctypes.c_int64,) * 6)
    _loaded.extend((kind(engine.get_function_address(ENTRY)), engine))


def _machine() -> Any:
    """Return LLVM's description of this machine, for code that stays in this process's memory."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    where = {"reloc": "static"} if target.name.startswith("x86") else {}
    return target.create_target_machine(
        cpu=PROCESSOR, features=FEATURES, opt=3, codemodel="jitdefault", jit=True, **where
    )


def _name() -> str:
    """Return a name that is another one when the code would be."""
    files = b"".join(
        file.read_bytes()
        for file in sorted([_HERE / "layout.py", Path(__file__), *(_HERE / "compiled").glob("*.py")])
    )
    made_by = f"{version('numba')} {llvm.llvm_version_info} {PROCESSOR} {FEATURES}"
    return f"evolution-{zlib.crc32(files):08x}{zlib.crc32(made_by.encode()):08x}.code"


def _made(machine: Any, kept: Kept) -> bytes:
    """Compile and keep the result, or take what another process has compiled meanwhile."""
    with kept.alone():
        code = kept.read()
        if code is None:
            from mdb_services.mechanism.evolution.compiled.entry import object_code

            code = object_code(machine)
            kept.write(code)
    return code
