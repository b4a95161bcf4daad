"""Past runs: which there are, and what a page asks of one.

Reads only, and only below the folder of runs: names are checked, and what a link leads out of there is not shown. A
run is read in a thread of its own, one question after the other; two runs are kept open.
"""

from __future__ import annotations

import asyncio
import re
import stat
import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from mdb_protocol.errors import MdbError

T = TypeVar("T")

SUFFIXES = frozenset({".mcap", ".toml", ".csv", ".png", ".svg", ".pdf", ".html", ".md", ".txt", ".json", ".gif"})
"""Of files that may be downloaded."""
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_. +-]{0,254}")
MOST_RUNS = 500
"""The newest so many are listed."""
KEPT_OPEN = 2
OPENED_AGAIN_S, OPENED_SHARE = 1.0, 10.0
"""A run that goes on is read again after so long at least, and so many times as long as that took."""
WAITING = 16
"""Questions that wait for the thread; who asks more is told to ask later."""


class _Opened(NamedTuple):
    """A run that is open: the size that its log had then, and when it may be read again if that is another."""

    size: int
    run: Any
    again_s: float


class NoRunError(MdbError):
    """There is no such run, or no such file in it."""


class BusyError(MdbError):
    """Too much was asked at once."""


class PastRuns:
    """See the module's docstring; `base` is the folder of runs (None: there are none)."""

    def __init__(self, base: Path | None) -> None:
        self._base = base
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="past")
        self._waiting = 0
        self._open: OrderedDict[str, _Opened] = OrderedDict()
        """Runs that are open, the one that was asked last at the end."""
        self._listed: dict[str, tuple[tuple[int, int], dict[str, Any]]] = {}

    async def runs(self) -> list[dict[str, Any]]:
        """Return name, experiment, iterations and time of each run, the newest first."""
        return await self._do(self._list)

    async def ask(self, name: str, question: Callable[[Any], T]) -> T:
        """Return what the `PastRun` of this name answers; NoRunError without one, MdbError when it is damaged."""
        return await self._do(lambda: question(self._run(name)))

    def file(self, name: str, path: str) -> Path:
        """Return the path of a file of a run that may be downloaded; NoRunError when there is none."""
        folder = self._folder(name)
        parts = path.split("/")
        if not parts or any(part in ("", ".", "..") or part.startswith(".") or "\0" in part for part in parts):
            raise NoRunError(f"no file of this name in {name}")
        found = folder.joinpath(*parts)
        try:
            inside = found.resolve(strict=True)
            kind = inside.stat().st_mode
        except (OSError, RuntimeError, ValueError):
            raise NoRunError(f"no file of this name in {name}") from None
        if not inside.is_relative_to(folder) or not stat.S_ISREG(kind) or inside.suffix not in SUFFIXES:
            raise NoRunError(f"no file of this name in {name}")
        return inside

    async def _do(self, work: Callable[[], T]) -> T:
        if self._waiting >= WAITING:
            raise BusyError("too many questions about past runs wait; ask again in a moment")
        self._waiting += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._thread, work)
        finally:
            self._waiting -= 1

    def _folder(self, name: str) -> Path:
        """Return the folder of a run, resolved; NoRunError when there is none."""
        if self._base is not None and NAME.fullmatch(name):
            base = self._base.resolve()
            folder = base / name
            if not folder.is_symlink() and folder.is_dir() and _log_of(folder) is not None:
                return folder
        raise NoRunError(f"there is no run of this name in {self._base or 'any folder'}")

    def _run(self, name: str) -> Any:
        from mdb_deploy.web.telling.past import PastRun
        from mdb_services.recorder import segments_of

        folder = self._folder(name)
        size, now_s = sum(path.stat().st_size for path in segments_of(folder)), time.monotonic()
        kept = self._open.pop(name, None)
        if kept is not None and kept.size != size and now_s >= kept.again_s:  # it goes on
            kept.run.close()
            kept = None
        if kept is None:
            while len(self._open) >= KEPT_OPEN:
                self._open.popitem(last=False)[1].run.close()
            run = PastRun(folder)
            took_s = time.monotonic() - now_s
            kept = _Opened(size, run, now_s + took_s + max(OPENED_AGAIN_S, OPENED_SHARE * took_s))
        self._open[name] = kept
        return kept.run

    def _list(self) -> list[dict[str, Any]]:
        if self._base is None or not self._base.is_dir():
            return []
        folders = []
        for folder in self._base.iterdir():
            if not NAME.fullmatch(folder.name) or folder.is_symlink() or not folder.is_dir():
                continue
            with suppress(OSError):  # it is being removed
                if (log := _log_of(folder)) is not None:
                    folders.append((log.stat().st_mtime, folder))
        folders.sort(key=lambda each: each[0], reverse=True)
        return [self._row(folder, when_s) for when_s, folder in folders[:MOST_RUNS]]

    def _row(self, folder: Path, when_s: float) -> dict[str, Any]:
        """Return what is listed of a run; of an experiment file that cannot be read nothing is known."""
        from mdb_services.experiment.reading import read_file
        from mdb_services.experiment.run_folder import EXPERIMENT_FILE

        said: dict[str, Any] = {}
        path = folder / EXPERIMENT_FILE
        try:
            seen = path.stat()
            mark = (seen.st_mtime_ns, seen.st_size)
            if (kept := self._listed.get(folder.name)) is None or kept[0] != mark:
                section = read_file(path).get("experiment", {})
                kept = (mark, {"experiment": str(section.get("name", "")), "iterations": section.get("iterations")})
                self._listed[folder.name] = kept
            said = kept[1]
        except (OSError, MdbError, AttributeError):
            said = {"experiment": "", "iterations": None}
        return {"name": folder.name, **said, "when": when_s}

    def close(self) -> None:
        """Free what is open; what is asked meanwhile is not waited for."""
        self._thread.shutdown(wait=False, cancel_futures=True)


def _log_of(folder: Path) -> Path | None:
    """Return the newest file of a run's log, which is imported only when it is asked for; None without one."""
    from mdb_services.recorder import segments_of

    return next(reversed(segments_of(folder)), None)
