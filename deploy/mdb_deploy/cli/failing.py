"""What is said when a command fails: one line, whatever happened, and where the whole of it is written."""

from __future__ import annotations

import os
import platform
import sys
import tempfile
import traceback
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from typing import TextIO, cast

from mdb_deploy.cli.parsing import DISTRIBUTION, own_version
from mdb_protocol.errors import UNHEARD, MdbError, UnheardError
from mdb_protocol.words import shown

FAILED, INTERRUPTED, NOBODY_READS = 2, 130, 141
UNEXPECTED = 70
"""The exit status of an error that nobody expected (EX_SOFTWARE of sysexits.h)."""

ANOTHER_PATH = "give a path that can be read and written"


class Unbreakable:
    """A stream that loses what cannot be written.

    No service is to fail because its log is on a full disk, and no run because its reader has left.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write, if that is possible."""
        with suppress(OSError, ValueError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, if that is possible."""
        with suppress(OSError, ValueError):
            self._stream.flush()

    def __getattr__(self, name: str) -> object:
        return getattr(self._stream, name)


def unbreakable(stream: TextIO) -> TextIO:
    """Return the stream as one that loses what cannot be written."""
    return cast(TextIO, Unbreakable(stream))


def told(error: BaseException, extra: str) -> int:
    """Say what happened, in one line; return the exit status. `extra`: what a package that is missing comes with."""
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED
    if isinstance(error, BrokenPipeError):
        return NOBODY_READS
    line, status = _line(error, extra)
    with suppress(OSError, ValueError):
        sys.stderr.write(f"mdb: {shown(line, lines=True)}\n")
    return status


def _line(error: BaseException, extra: str) -> tuple[str, int]:
    if isinstance(error, RuntimeError) and str(error).startswith("Symlink loop"):  # of `Path.resolve`
        error = MdbError(f"{error}: a link to itself; give a path that can be read")
    if isinstance(error, MdbError):
        return str(error), UNHEARD if isinstance(error, UnheardError) else FAILED
    if isinstance(error, ModuleNotFoundError) and error.name and not error.name.startswith("mdb_"):
        wanted = f"pip install '{DISTRIBUTION}[{extra}]'"
        return f"this needs {error.name}, which is not installed: {wanted}", FAILED
    if isinstance(error, OSError):
        return _refused(error), FAILED
    if isinstance(error, MemoryError):
        return f"there is not enough memory for this; {_whole(error)}", FAILED
    said = " ".join(str(error).split())
    words = f"an error that nobody expected: {type(error).__name__}: {said[:500]}; please report it{_where()}"
    return f"{words}; {_whole(error)}", UNEXPECTED


def _refused(error: OSError) -> str:
    """Return what the system refused, and whether that is for the working directory was deleted."""
    try:
        os.getcwd()
    except OSError:
        if not os.path.isabs(error.filename or ""):
            return "the folder that you are in is not there any more; change into another (cd)"
    if error.filename is not None:
        return f"{error.filename}: {error.strerror}; {ANOTHER_PATH}"
    return f"the system refused: {error.strerror or error}; {_whole(error)}"


def _whole(error: BaseException) -> str:
    """Write the whole error into a file; return where it is."""
    trace = "".join(traceback.format_exception(error))
    text = f"mdb {own_version()}, Python {sys.version}, {platform.platform()}\n{sys.argv}\n\n{trace}"
    try:
        handle, path = tempfile.mkstemp(prefix="mdb-error-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text)
    except OSError:
        return "no file could be written that tells more" + ("" if isinstance(error, OSError) else f":\n{trace}")
    return f"all of it is in {Path(path)}"


def _where() -> str:
    try:
        urls = metadata(DISTRIBUTION).get_all("Project-URL") or []
    except PackageNotFoundError:
        return ""
    return next((f" at {url.partition(', ')[2]}" for url in urls if url.startswith("Issues,")), "")


def let_go(stream: TextIO) -> None:
    """Flush a stream for the last time; of one that nobody reads any more Python says nothing at its end then."""
    try:
        stream.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
