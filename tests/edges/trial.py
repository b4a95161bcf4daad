"""One input, one command: what it said, what it took, and whether anything of the run was touched.

The command runs in a process of its own, made by fork, so that it need not import everything again, and what it grows
by can be told.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import shutil
import sys
import threading
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.edges.cases import Kind, Make

GOLDEN = Path(__file__).parents[1] / "replay" / "golden" / "paper"
KILLED_S = 100.0
"""A command that has not ended by then hangs; it is ended by us."""
MOST_S, MOST_BYTES = 2.0, 200 * 2**20
"""What a command may take, in processor time and in memory beyond what it begins with."""
SURELY = 3.0
"""Beyond the bound times this it did not hold: on a busy machine processor time is longer, too."""
OURS = ("memory.sqlite-lock",)
"""What a command that writes into a run may leave there."""


@dataclass(frozen=True)
class Outcome:
    """What came of a command."""

    kind: str
    input: str
    command: str
    status: int
    said: str
    processor_s: float
    grown_bytes: int
    touched: bool
    may_pass: bool = False

    @property
    def held(self) -> str | None:
        """Return why it did not hold, or None: it refused in words, soon, in little memory, and wrote nothing."""
        wrong = {
            f"was ended after {KILLED_S:g} s, or died of signal {-self.status}": self.status < 0,
            "a traceback": "Traceback" in self.said,
            "was taken for good": self.status == 0 and not self.may_pass,
            "said nothing": not self.said.strip(),
            "let control characters through": any(
                unicodedata.category(letter) in ("Cc", "Cf") and letter not in "\n\t" for letter in self.said
            ),
            f"took {self.grown_bytes / 2**20:.0f} MB": self.grown_bytes > MOST_BYTES,
            f"took {self.processor_s:.1f} s of processor time": self.processor_s > SURELY * MOST_S,
            "wrote into the run": self.touched,
        }
        return next((why for why, is_so in wrong.items() if is_so), None)


def outcomes(kind: Kind, name: str) -> Iterator[Outcome]:
    """Try an input with every command that reads it."""
    for command in kind.commands:
        with TemporaryDirectory() as folder:
            made(kind, kind.inputs[name], Path(folder))
            yield attempt(kind, name, command, Path(folder))


def made(kind: Kind, make: Make, folder: Path) -> None:
    """Make a run, what is beside it, and the input in its place."""
    shutil.copytree(GOLDEN, folder / "RUN")
    (folder / "OUT").mkdir()
    path = folder / kind.file
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists():
        path.unlink()
    pid = os.fork()  # what making it takes is not to be there when a command is measured
    if not pid:
        status = 1
        try:
            make(path)
            status = 0
        finally:
            os._exit(status)
    assert os.waitpid(pid, 0)[1] == 0, f"the input for {kind.file} could not be made"


def attempt(kind: Kind, name: str, command: str, folder: Path) -> Outcome:
    """Do a command on an input that `made` has made."""
    where = {"RUN": folder / "RUN", "FILE": folder / "FILE", "OUT": folder / "OUT", "RESULTS": folder / "RESULTS"}
    words = [str(where[first] / rest if rest else where[first]) if first in where else word
             for word in command.split() for first, _, rest in [word.partition("/")]]  # fmt: skip
    before = _looks(folder / "RUN")
    status, said, processor_s, bytes_ = run(words)
    touched = _looks(folder / "RUN") != before and not command.startswith("ltm import")
    return Outcome(
        kind.name, name, command, status, said, processor_s, bytes_ - _idle(), touched, name in kind.may_pass
    )


def run(words: list[str]) -> tuple[int, str, float, int]:
    """Run `mdb` with these words in a fork; return status, what it said, processor time, greatest memory."""
    reads, writes = os.pipe()
    sys.stdout.flush()
    pid = os.fork()
    if not pid:
        status = 70
        try:
            said = io.TextIOWrapper(io.FileIO(writes, "w"), write_through=True, errors="replace")
            with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
                status = _main(words)
        finally:
            os._exit(status)
    os.close(writes)
    timer = threading.Timer(KILLED_S, lambda: os.kill(pid, 9))
    timer.start()
    with open(reads, "rb") as pipe:
        text = pipe.read().decode(errors="replace")
    _, code, used = os.wait4(pid, 0)
    timer.cancel()
    return os.waitstatus_to_exitcode(code), text, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024


def _main(words: list[str]) -> int:
    import traceback

    from mdb_deploy.cli.main import main

    try:
        return main(words)
    except SystemExit as left:
        return int(left.code or 0) if isinstance(left.code, int | None) else 1
    except BaseException:
        traceback.print_exc()
        return 1


IMPORTED = (
    "matplotlib.backends.backend_agg", "pyarrow.parquet", "mdb_deploy.cli.main", "mdb_deploy.runs.ltm",
    "mdb_deploy.runs.python", "mdb_deploy.runs.replay", "mdb_deploy.runs.rescue", "mdb_deploy.studies.command",
    "mdb_sim.figures.learning",
)  # fmt: skip


def warm() -> None:
    """Import what the commands import, so that a fork has it."""
    for name in IMPORTED:
        importlib.import_module(name)


_idles: list[int] = []


def _idle() -> int:
    """Return what a command that does nothing holds at the most."""
    if not _idles:
        _idles.append(run(["ltm", "list", "/nowhere/at/all"])[3])
    return _idles[0]


def _looks(folder: Path) -> dict[str, tuple[int, int]]:
    """Return size and time of all that is in a folder."""
    return {
        str(path.relative_to(folder)): (path.lstat().st_size, path.lstat().st_mtime_ns)
        for path in folder.rglob("*")
        if path.name not in OURS
    }
