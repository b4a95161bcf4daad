"""Runs in Python: `run` makes one, `Run` reads one, its tables as arrays, Arrow tables or files. For scripts and
notebooks; nothing is printed.

    from mdb_deploy import Run, run

    cart = run("cartpole", iterations=300)
    cart.iterations["feedback"]      # numpy, one value an iteration
    cart.arrow("pairs")              # a pyarrow.Table; `to_pandas()` of it is a data frame
"""

from __future__ import annotations

import csv
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from mdb_deploy.experiments import experiment_path
from mdb_deploy.running.up import new_run_folder, writable
from mdb_protocol.errors import MdbError
from mdb_protocol.messages import IterationReport
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_services.recorder import EmptyLogError, read_log
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment
from mdb_sim.runs.record import RunRecord, record_of
from mdb_sim.runs.tables import TABLES, Columns, tables_of

if TYPE_CHECKING:
    import pyarrow

Arrays = dict[str, NDArray[Any]]
"""A table: arrays (rows,) by column. What there is not is nan among numbers and "" among words."""
EXPORTED = "tables"
"""The folder in a run's own where its tables go."""


class Run:
    """A run folder, finished or not, read when it is asked for; MdbError when it holds no log or no experiment.

    `record` has the arrays from which the figures are made, networks included. Each table is a dict of numpy arrays:
    `iterations`: what the optimizer did, and how well each model had foreseen it. `pairs`: action-perception pairs,
    with feedback that came late. `models`: each current model, on which version of its memory, with which error.
    `contexts`: changes of context that were noticed. `scenes`: what was true, for a bystander.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    def __repr__(self) -> str:
        record = self.record
        successes = int(record.successes[-1])
        return f"Run({str(self.path)!r}): {record.iterations} iterations, seed {record.seed}, {successes} successes"

    @property
    def experiment(self) -> Experiment:
        """The experiment, as it was run."""
        return self.record.experiment

    @cached_property
    def record(self) -> RunRecord:
        """The run by iteration: see `mdb_sim.runs.record.RunRecord`."""
        return self._read[0]

    @cached_property
    def iterations(self) -> Arrays:
        """A row an iteration."""
        return self.table("iterations")

    @cached_property
    def pairs(self) -> Arrays:
        """A row an action-perception pair."""
        return self.table("pairs")

    @cached_property
    def models(self) -> Arrays:
        """A row a current model."""
        return self.table("models")

    @cached_property
    def contexts(self) -> Arrays:
        """A row an event of a context."""
        return self.table("contexts")

    @cached_property
    def scenes(self) -> Arrays:
        """A row a scene; the first is before any action."""
        return self.table("scenes")

    def table(self, name: str) -> Arrays:
        """Return a table by its name, one of `TABLES`."""
        return {column: _array(values) for column, values in self._columns(name).items()}

    def arrow(self, name: str) -> pyarrow.Table:
        """Return a table as a pyarrow.Table, null where there is nothing; needs the extra `study`."""
        return _arrow().table(self._columns(name))

    def export(self, to: Literal["parquet", "csv"] = "csv", folder: str | Path | None = None) -> list[Path]:
        """Write all tables into a folder and return the files.

        Without a folder that is `tables` in the run's own, or RUN-tables in this one where the run's takes nothing.
        """
        if to not in ("parquet", "csv"):
            raise MdbError(f"to={to!r}: no such kind of file; expected 'parquet' or 'csv'")
        there = writable(self.path, EXPORTED) if folder is None else Path(folder)
        tables = self._read[1]
        if not any(column for columns in tables.values() for column in columns.values()):
            raise EmptyLogError(f"nothing for a table is in the run log of {self.path}: no file is written")
        write = _write_csv if to == "csv" else _parquet_writer()
        there.mkdir(parents=True, exist_ok=True)
        files = {there / f"{name}.{to}": tables[name] for name in TABLES}
        for path, columns in files.items():
            write(path, columns)
        return list(files)

    def _columns(self, name: str) -> Columns:
        if name not in TABLES:
            raise MdbError(f"no table {name!r}; there are {', '.join(TABLES)}")
        return self._read[1][name]

    @cached_property
    def _read(self) -> tuple[RunRecord, dict[str, Columns]]:
        if not (self.path / EXPERIMENT_FILE).exists():
            raise MdbError(
                f"{self.path} is no run folder: it has no {EXPERIMENT_FILE}; give the one that a run named"
            )
        experiment = Experiment.read(self.path / EXPERIMENT_FILE)
        log = list(read_log(self.path, experiment.brain.experiment.brain))
        record = record_of(self.path, experiment, log)
        return record, tables_of(record, log)


def run(
    experiment: str | Path | Experiment,
    *,
    iterations: int | None = None,
    seed: int | None = None,
    settings: Mapping[str, object] | None = None,
    folder: str | Path | None = None,
    processes: bool = False,
    on_iteration: Callable[[IterationReport], None] | None = None,
) -> Run:
    """Run an experiment to its end and return the run.

    experiment: a file, a folder that `mdb init` wrote, or the name of a shipped one. settings: of its file, as
    {"robot.body": "kinematic"}. folder: the run's own, a new one in `runs` by default. The whole brain is in this
    process, in lockstep: the same seed gives the same run. With `processes` it is `mdb up`, in its file's pace;
    `on_iteration` hears of each iteration in the first case only. Raises MdbError when something is wrong.
    """
    if not isinstance(experiment, Experiment):
        given = {"experiment.iterations": iterations, "experiment.seed": seed, **(settings or {})}
        pace = () if processes else ("experiment.pace=lockstep",)
        words = [f"{name}={_word(value)}" for name, value in given.items() if value is not None]
        experiment = Experiment.read(experiment_path(str(experiment)), [*pace, *words])
    elif iterations is not None or seed is not None or settings:
        raise MdbError("iterations, seed and settings are for a file; an Experiment has its own")
    experiment.check_machine()
    section = experiment.brain.experiment
    path = new_run_folder(Path("runs"), section.name, section.seed) if folder is None else Path(folder)
    if (path / EXPERIMENT_FILE).exists():
        raise MdbError(f"{path} holds a run already; give another folder, or read it: Run({str(path)!r})")
    if processes:
        _in_processes(experiment, path)
    else:
        run_experiment(experiment, path, on_iteration=on_iteration)
    return Run(path)


def _in_processes(experiment: Experiment, path: Path) -> None:
    path.mkdir(parents=True, exist_ok=True)
    experiment.write(path / EXPERIMENT_FILE)
    words = ("up", "--resume", str(path), "--no-plot", "--listen", "tcp/127.0.0.1:0")
    done = subprocess.run(
        [sys.executable, "-P", "-m", "mdb_deploy.cli", *words], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise MdbError(f"mdb {' '.join(words)} ended with {done.returncode}: {done.stderr.strip() or done.stdout}")


def _word(value: object) -> str:
    """Return a setting as `--set` takes it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"[{', '.join(map(repr, value))}]" if isinstance(value, list | tuple) else str(value)


def _array(values: list[Any]) -> NDArray[Any]:
    """Return a column as an array: nan for a number that is missing, "" for a word."""
    kinds = {type(value) for value in values}
    if str in kinds:
        return np.array(["" if value is None else value for value in values])
    if kinds and kinds <= {bool, int} and len(kinds) == 1:
        return np.array(values)
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _write_csv(path: Path, columns: Columns) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def _parquet_writer() -> Callable[[Path, Columns], None]:
    arrow = _arrow()
    from pyarrow import parquet

    return lambda path, columns: parquet.write_table(arrow.table(columns), path)


def _arrow() -> Any:
    try:
        import pyarrow
    except ModuleNotFoundError as error:
        raise MdbError(
            "Arrow tables and Parquet need the package pyarrow: pip install 'multilevel-darwinist-brain[study]'; CSV "
            "and numpy arrays do without"
        ) from error
    return pyarrow
