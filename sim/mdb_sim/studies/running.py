"""One run of a study, from plain values to the bytes of its results: what a worker does, here or far away.

Owns `Task` and the fingerprint that tells whether a result is of this experiment and this code. A worker needs
no folder in common with anybody: a run works in a temporary folder of its own, which is deleted after measuring.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import json
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import structlog

from mdb_protocol.errors import MdbError
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment
from mdb_sim.runs.record import RunRecord, read_record
from mdb_sim.studies.players import baselines, rewarded
from mdb_sim.studies.results import Label, encode
from mdb_sim.studies.rows import PhaseRow, rows_of

BRAIN = "brain"
"""The player that is the brain itself; others are in `baselines.PLAYERS`, those without a teacher in `rewarded`."""
PACKAGES = ("mdb_protocol", "mdb_services", "mdb_sim")
"""What a run's result depends upon, ..."""
PRESENTING = ("verdicts/", "figures/", "report/", "studies/tables.py")
"""... but for what only shows results, and for the variants, whose experiments are in the fingerprint anyway."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """A run that is to be done. Plain values only, for it may go to another machine."""

    label: Label
    content: dict[str, Any]
    """The resolved experiment."""
    player: str = BRAIN
    keep: str | None = None
    """The run folder, when it is to be kept, on the machine that does the run."""


@cache
def code_checksum() -> str:
    """Return a checksum of the code that runs depend upon; comments and docstrings do not count."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        found = importlib.util.find_spec(package)
        if found is None or found.origin is None:
            raise MdbError(f"the package {package} cannot be found; expected it beside mdb_sim")
        root = Path(found.origin).parent
        for path in sorted(root.rglob("*.py")):
            name = path.relative_to(root).as_posix()
            if not name.startswith(PRESENTING):
                digest.update(f"{package}/{name}\n{_without_words(path.read_text(encoding='utf-8'))}\n".encode())
    return digest.hexdigest()[:16]


def _without_words(source: str) -> str:
    """Return code without comments and docstrings, so that a better word throws no results away."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            kept = [line for line in body if not _is_word(line)]
            node.body = kept or [ast.Pass()]  # type: ignore[attr-defined]
    return ast.unparse(tree)


def _is_word(line: ast.AST) -> bool:
    return isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant) and isinstance(line.value.value, str)


def fingerprint(content: dict[str, Any], player: str) -> str:
    """Return what a result is of: the resolved experiment, who plays, and the code."""
    text = json.dumps([content, player, code_checksum()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def do(task: Task) -> bytes:
    """Do a run and return the bytes of its result; MdbError when this worker has other code than asked for."""
    if task.label.code != code_checksum():
        raise MdbError(
            f"this worker has the code {code_checksum()}, the study is of {task.label.code}; "
            "install the same version of the project on every worker"
        )
    began_s = time.perf_counter()
    with _folder(task.keep) as run:
        rows = _rows(task, run)
    return encode(replace(task.label, seconds=time.perf_counter() - began_s), rows)


def _rows(task: Task, run: Path) -> list[PhaseRow]:
    experiment = Experiment(task.content, f"{task.label.study}, {task.label.variant}")
    if task.player in rewarded.PLAYERS:
        return rewarded.trained(experiment, task.player)
    return rows_of(_played(task, experiment, run))


def _played(task: Task, experiment: Experiment, run: Path) -> RunRecord:
    if task.player != BRAIN:
        return baselines.play(experiment, task.player, run)
    run_experiment(experiment, run)
    return read_record(run)


@contextmanager
def _folder(keep: str | None) -> Iterator[Path]:
    if keep is not None:
        # A recorder would go on beside an older log.
        shutil.rmtree(keep, ignore_errors=True)
        yield Path(keep)
        return
    with tempfile.TemporaryDirectory(prefix="mdb-study-", ignore_cleanup_errors=True) as folder:
        yield Path(folder) / "run"


def quiet() -> None:
    """Log warnings only, on standard error: a worker's part in a table is what it returns."""
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger("warning"),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
