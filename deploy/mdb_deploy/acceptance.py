"""`mdb acceptance`: the experiment over many seeds, each in a process of its own, judged by the table.

The runs are inline and in lockstep, which gives the same run as the processes do (a test shows it).
"""

from __future__ import annotations

import multiprocessing
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from mdb_protocol.errors import ConfigError
from mdb_sim.acceptance import acceptance_row, acceptance_table, judge
from mdb_sim.experiment import Experiment
from mdb_sim.inline import run_experiment
from mdb_sim.record import read_record

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


def accept(experiment: Path, seeds: Sequence[int], overrides: Sequence[str], out: Path, workers: int) -> int:
    """Run the seeds, print the table, write it beside the runs; status 1 when a must is missed."""
    jobs = [(experiment, seed, tuple(overrides), out / f"seed{seed}") for seed in seeds]
    Experiment.read(experiment, overrides)
    with multiprocessing.get_context("spawn").Pool(max(1, min(workers, len(jobs)))) as pool:
        for folder in pool.imap(_run_one, jobs):
            sys.stderr.write(f"done: {folder}\n")
    rows = [acceptance_row(read_record(folder)) for *_, folder in jobs]
    table = acceptance_table(rows)
    (out / "acceptance.md").write_text(table + "\n", encoding="utf-8")
    sys.stdout.write(table + "\n")
    return 0 if all(criterion.must_met for criterion in judge(rows)) else MISSED


def _run_one(job: tuple[Path, int, tuple[str, ...], Path]) -> Path:
    path, seed, overrides, folder = job
    settings = [*overrides, f"experiment.seed={seed}", "experiment.pace=lockstep"]
    shutil.rmtree(folder, ignore_errors=True)
    run_experiment(Experiment.read(path, settings), folder)
    return folder
