"""`mdb acceptance`: the experiment over many seeds, each in a process of its own, judged by the table.

The runs are inline and in lockstep, which gives the same run as the processes do (a test shows it). Owns how
many runs are done at a time and measured, which `mdb study` uses too.
"""

from __future__ import annotations

import multiprocessing
import shutil
import signal
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import structlog
import tomli_w

from mdb_protocol import keys
from mdb_protocol.errors import ConfigError, MdbError
from mdb_services.config import EXPERIMENT_FILE
from mdb_services.recorder import Recorded, read_log
from mdb_sim.acceptance import acceptance_row, acceptance_table, judge
from mdb_sim.experiment import Experiment
from mdb_sim.inline import run_experiment
from mdb_sim.record import RunRecord, read_record, record_of

T = TypeVar("T")

MISSED = 1


def seeds_of(text: str) -> list[int]:
    """Return the seeds of "1-5" or "1,4,9"; ConfigError when it is neither."""
    seeds: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise ConfigError(f"--seeds {text!r}: expected numbers and ranges, as in 1-5 or 1,4,9")
        seeds += range(int(first), int(last or first) + 1)
    return seeds


@dataclass(frozen=True)
class Job(Generic[T]):
    """One run, and what is measured of it; `measure` is a function of a module, for it goes to another process."""

    experiment: Path
    seed: int
    overrides: tuple[str, ...]
    run: Path
    measure: Callable[[RunRecord], T]
    reuse: bool = False
    """Whether a finished run of the same resolved experiment in `run` is measured instead of run again."""

    def resolved(self) -> Experiment:
        """Return the experiment that is run; ConfigError when it cannot be."""
        settings = [*self.overrides, f"experiment.seed={self.seed}", "experiment.pace=lockstep"]
        return Experiment.read(self.experiment, settings)


def accept(experiment: Path, seeds: Sequence[int], overrides: Sequence[str], out: Path, workers: int) -> int:
    """Run the seeds, print the table, write it beside the runs; status 1 when a must is missed."""
    jobs = [Job(experiment, seed, tuple(overrides), out / f"seed{seed}", acceptance_row) for seed in seeds]
    rows = run_all(jobs, workers)
    table = acceptance_table(rows)
    (out / "acceptance.md").write_text(table + "\n", encoding="utf-8")
    sys.stdout.write(table + "\n")
    return 0 if all(criterion.must_met for criterion in judge(rows)) else MISSED


def run_all(jobs: Sequence[Job[T]], workers: int) -> list[T]:
    """Do the jobs, so many at a time, a line of progress for each; return what was measured, in their order.

    Raises ConfigError before the first run when one of them cannot be run.
    """
    for job in jobs:
        job.resolved()
    measured: dict[int, T] = {}
    count = max(1, min(workers, len(jobs)))
    # Ended by SIGTERM without this, it would leave its workers behind.
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with multiprocessing.get_context("spawn").Pool(count, _begin_worker) as pool:
            for place, value, how in pool.imap_unordered(_do, enumerate(jobs)):
                measured[place] = value
                sys.stderr.write(f"[{len(measured)}/{len(jobs)}] {how}: {jobs[place].run}\n")
                sys.stderr.flush()
    finally:
        signal.signal(signal.SIGTERM, before)
    return [measured[place] for place in range(len(jobs))]


def finished_record(job: Job[T]) -> RunRecord | None:
    """Return the record of a job's folder when it holds that experiment run to its end, else None."""
    experiment = job.resolved()
    try:
        text = (job.run / EXPERIMENT_FILE).read_text(encoding="utf-8")
        if tomllib.loads(text) != tomllib.loads(tomli_w.dumps(experiment.content)):
            return None
        finished: list[Recorded] = []
        record = record_of(job.run, experiment, _watched(job.run, finished))
    except (OSError, ValueError, MdbError):
        return None
    return record if finished and bool(record.reported.all()) else None


def _watched(run: Path, finished: list[Recorded]) -> Iterator[Recorded]:
    """Yield a run's log; keep the message that ends it."""
    for recorded in read_log(run):
        if recorded.row is keys.FINISHED:
            finished.append(recorded)
        yield recorded


def _do(numbered: tuple[int, Job[T]]) -> tuple[int, T, str]:
    place, job = numbered
    if job.reuse and (record := finished_record(job)) is not None:
        return place, job.measure(record), "already there"
    shutil.rmtree(job.run, ignore_errors=True)
    began_s = time.monotonic()
    run_experiment(job.resolved(), job.run)
    value = job.measure(read_record(job.run))
    return place, value, f"done in {time.monotonic() - began_s:.0f} s"


def _begin_worker() -> None:
    """Leave Ctrl-C to the parent, which ends the runs, and standard output to the table."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger("warning"),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
