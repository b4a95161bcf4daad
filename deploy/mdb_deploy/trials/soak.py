"""`mdb chaos --soak`: a brain at full speed that nobody kills, and what its processes hold, second by second.

Owns samples, growth and plot. Growth is the mean of the last fifth of the samples over that of the second: before
that memories and caches fill up, which is no leak.
"""

from __future__ import annotations

import csv
import json
import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import psutil
from numpy.typing import NDArray

from mdb_deploy.trials.chaos_report import yes
from mdb_deploy.trials.evidence import Findings, compare
from mdb_deploy.trials.under_test import BrainError, BrainUnderTest, long_experiment, stop_on_sigterm
from mdb_services.experiment.run_folder import MEMORY_FILE
from mdb_sim.figures.four_to_six import need_matplotlib, save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FULL_SPEED = ("robot.action_s=0", "robot.body=kinematic")
ITERATIONS_S = 1000
"""Iterations a second for which the experiment is long enough; a loaded machine does fewer."""
EVERY_S = 1.0
PARTS = 5
GROWTH = 0.05
"""What no process's figure may grow by."""
RUNNER = "mdb up"
FIGURES = {"memory": "resident memory, MB", "threads": "threads", "files": "open files"}

Samples = dict[str, NDArray[np.float64]]
"""By figure: samples (n,) of one process."""


@dataclass(frozen=True)
class SoakOptions:
    """What the command line says of `mdb chaos --soak`."""

    experiment: Path
    overrides: tuple[str, ...]
    out: Path
    minutes: float


@dataclass(frozen=True)
class Soak:
    """What was sampled: by process and figure, at `times_s` (n,), with the iterations done by then."""

    times_s: NDArray[np.float64]
    iterations: NDArray[np.float64]
    processes: Mapping[str, Samples]
    findings: Findings
    loads: tuple[float, float]

    def growth(self, process: str, figure: str) -> float:
        """Return by how much the last fifth is above the second, as a fraction."""
        parts = np.array_split(self.processes[process][figure], PARTS)
        return float(parts[-1].mean() / parts[1].mean() - 1.0) if len(parts[1]) and parts[1].mean() else 0.0

    @property
    def worst(self) -> float:
        """The greatest growth of any figure of any process."""
        return max(self.growth(process, figure) for process in self.processes for figure in FIGURES)

    @property
    def holds(self) -> bool:
        """Whether nothing grew beyond the bound, and nothing acknowledged was lost."""
        return self.worst < GROWTH and self.findings.holds

    def markdown(self) -> str:
        """Return the report as it stands in `soak.md`."""
        took_s = float(self.times_s[-1] - self.times_s[0])
        rows = []
        for name, samples in self.processes.items():
            last = {figure: np.array_split(samples[figure], PARTS)[-1].mean() for figure in FIGURES}
            cells = [f"{last[figure]:.0f} | {self.growth(name, figure):+.1%}" for figure in FIGURES]
            rows.append(f"| {name} | {' | '.join(cells)} |")
        return "\n".join(
            [
                f"{took_s / 60:.1f} min at full speed, {self.iterations[-1]:.0f} iterations "
                f"({(self.iterations[-1] - self.iterations[0]) / took_s:.0f} a second). Load of the machine: "
                f"{self.loads[0]:.1f} before, {self.loads[1]:.1f} after, on {os.cpu_count()} cores.",
                "",
                "| process | memory, MB | growth | threads | growth | open files | growth |",
                "|---|--:|--:|--:|--:|--:|--:|",
                *rows,
                "",
                f"Greatest growth from the second to the last fifth: {self.worst:.1%}; less than {GROWTH:.0%}: "
                f"{yes(self.worst < GROWTH)}. Acknowledged pairs lost: {len(self.findings.lost)} of "
                f"{self.findings.acknowledged}.",
            ]
        )


def run(options: SoakOptions, say: Callable[[str], None]) -> Soak:
    """Run a brain for so long and sample its processes; BrainError when it does not last."""
    need_matplotlib()
    overrides = (*FULL_SPEED, *options.overrides)
    experiment = long_experiment(options.experiment, overrides, int(options.minutes * 60 * ITERATIONS_S))
    load_before = os.getloadavg()[0]
    with BrainUnderTest(experiment, options.out) as brain:
        say(f"watching {brain.run} for {options.minutes:g} min")
        watched = {**brain.processes(), RUNNER: psutil.Process(brain.process.pid)}
        rows: list[tuple[float, int]] = []
        samples: dict[str, list[tuple[float, float, float]]] = {name: [] for name in watched}
        began_s = time.monotonic()
        while (now_s := time.monotonic() - began_s) < options.minutes * 60 and not brain.finished:
            if now_s >= len(rows) * EVERY_S:
                rows.append((now_s, brain.iteration))
                for name, process in watched.items():
                    samples[name].append(_sample(name, process))
            brain.look()
            brain.check_alive()
            time.sleep(0.05)
        brain.finish(interrupt=True)
        findings = compare(brain.witness_file, brain.run / MEMORY_FILE)
    columns = {n: dict(zip(FIGURES, np.array(s, dtype=np.float64).T, strict=True)) for n, s in samples.items()}
    times_s, iterations = np.array(rows, dtype=np.float64).T
    return Soak(times_s, iterations, columns, findings, (load_before, os.getloadavg()[0]))


def _sample(name: str, process: psutil.Process) -> tuple[float, float, float]:
    try:
        with process.oneshot():
            return process.memory_info().rss / 1e6, process.num_threads(), process.num_fds()
    except psutil.NoSuchProcess as error:
        raise BrainError(
            f"{name} was replaced, so that its growth cannot be told; its log in the run folder says why. Measure on "
            "a machine that does nothing else"
        ) from error


def command(options: SoakOptions) -> int:
    """Do as `mdb chaos --soak` says: watch, write report, samples and plot; status 1 when something grew."""

    def say(text: str) -> None:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()

    stop_on_sigterm()
    soak = run(options, say)
    text, stem = soak.markdown(), options.out / "soak"
    stem.with_suffix(".md").write_text(text + "\n", encoding="utf-8")
    figures = {n: {figure: soak.growth(n, figure) for figure in FIGURES} for n in soak.processes}
    plain = {"growth": figures, "iterations": soak.iterations[-1], "seconds": soak.times_s[-1], "holds": soak.holds}
    stem.with_suffix(".json").write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
    _write_samples(soak, stem.with_suffix(".csv"))
    save(stem, (9.0, 8.0), lambda figure: _draw(soak, figure))
    say(f"{text}\n\nresults: {options.out}")
    return 0 if soak.holds else 1


def _write_samples(soak: Soak, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["s", "iteration", *(f"{n}: {figure}" for n in soak.processes for figure in FIGURES)])
        columns = [samples[figure] for samples in soak.processes.values() for figure in FIGURES]
        writer.writerows(zip(soak.times_s, soak.iterations, *columns, strict=True))


def _draw(soak: Soak, figure: Figure) -> None:
    panels = figure.subplots(len(FIGURES), 1, sharex=True)
    for axes, (name, label) in zip(panels, FIGURES.items(), strict=True):
        for process, samples in soak.processes.items():
            axes.plot(soak.times_s / 60, samples[name], linewidth=1.2, label=process)
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0)
    panels[-1].set_xlabel("minutes at full speed")
    panels[0].legend(fontsize=8, ncols=2, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    panels[0].set_title(f"{soak.iterations[-1]:.0f} iterations; greatest growth {soak.worst:.1%}")
