"""A sweep: variants times seeds, over the cores of this machine or a Dask cluster, gone on with where it stopped.

Owns which runs are missing, who does them, what is shown meanwhile, and what becomes of a run that fails: it is
named with its seed and error, the others go on, and `Outcome.failed` tells. What one run is, is in
`mdb_sim.studies.running`; where its result lies, in `mdb_sim.studies.results`; the processes are in `processes`.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mdb_deploy.experiments import experiment_path
from mdb_deploy.running.console import console_of
from mdb_deploy.studies import workers as processes
from mdb_protocol import words
from mdb_protocol.errors import ConfigError, MdbError
from mdb_sim.runs.experiment import Experiment
from mdb_sim.studies import results, running, tables
from mdb_sim.studies.catalogue import PHASE, Study, Variant
from mdb_sim.studies.results import Label, Result
from mdb_sim.studies.running import Task

CONNECTED_S = 20.0
"""How long a Dask scheduler may take to answer."""


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """What the command line says of a sweep."""

    experiment: Path
    seeds: tuple[int, ...]
    overrides: tuple[str, ...]
    out: Path
    workers: int = 2
    """Processes that do the runs; 0: this one does them, one after the other."""
    scheduler: str | None = None
    """Address of a Dask scheduler; without one the runs are done here."""
    keep: bool = False
    """Whether run folders are kept, below `out`/runs, on the machine that does the run."""
    fresh: bool = False
    """Whether runs that are there already are done again."""
    only: tuple[str, ...] = ()
    """Variants, as words; all when it is empty."""
    phase: int = PHASE
    """Iterations of a phase, in a study that makes its own phases."""


@dataclass
class Outcome:
    """What became of the runs of a sweep."""

    there: int = 0
    """Runs that had a result already, here or in another study."""
    done: int = 0
    failed: dict[str, str] = field(default_factory=dict)
    """What went wrong, by the run's name."""


def seeds_of(text: str) -> list[int]:
    """Return the seeds of "1-5" or "1,4,9"; ConfigError when it is neither."""
    seeds: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()) or int(first) > int(last or first):
            raise ConfigError(f"--seeds {text!r}: expected numbers and ranges, as in 1-5 or 1,4,9")
        seeds += range(int(first), int(last or first) + 1)
    return seeds


def tasks_of(study: Study, sweep: Sweep) -> list[Task]:
    """Return the runs of a study, seed by seed, so that what an interrupted one has is balanced.

    ConfigError when one of them cannot be run, or `only` names no variant. A variant that changes nothing in
    this experiment is left out, but for the first.
    """
    base = (*tables.overrides_of(study, sweep.phase), *sweep.overrides)
    variants = tables.VARIANTS[study.name](Experiment.read(sweep.experiment, base))
    for name in sweep.only:
        if not any(name in _called(variant) for variant in variants):
            words = ", ".join(results.word(variant.name) for variant in variants)
            raise ConfigError(f"--only {name!r}: no such variant; there are {words}")
    tasks = []
    for seed in sweep.seeds:
        for order, variant in enumerate(variants):
            compared_with = order == 0 and variant.file is None
            chosen = compared_with or not sweep.only or not _called(variant).isdisjoint(sweep.only)
            if not chosen or not variant.applies:
                continue
            settings = (*base, *variant.overrides, f"experiment.seed={seed}", "experiment.pace=lockstep")
            file = sweep.experiment if variant.file is None else experiment_path(variant.file)
            experiment = Experiment.read(file, settings)
            label = Label(
                study=study.name,
                variant=variant.name,
                order=order,
                seed=seed,
                body=experiment.robot.body,
                fingerprint=running.fingerprint(experiment.content, variant.player),
                code=running.code_checksum(),
                overrides=(*sweep.overrides, *variant.overrides),
            )
            kept = sweep.out.resolve() / "runs" / label.path.with_suffix("") if sweep.keep else None
            tasks.append(
                Task(
                    label=label,
                    content=experiment.content,
                    player=variant.player,
                    keep=None if kept is None else str(kept),
                )
            )
    return tasks


def _called(variant: Variant) -> set[str]:
    """Return the words by which a variant is asked for: its name's, and the experiment's that is its own."""
    return {results.word(variant.name), *([variant.file] if variant.file is not None else [])}


def run(tasks: Sequence[Task], sweep: Sweep, console: Console | None = None) -> Outcome:
    """Do the runs that have no result yet and write theirs, each as soon as it is there."""
    results.need_pyarrow()
    console = console or console_of(sys.stderr)
    missing = _missing(tasks, sweep)
    sweep.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=sweep.out):
        pass  # it can be written: to be known before minutes of runs
    outcome = Outcome(there=len(tasks) - len(missing))
    if outcome.there:
        console.print(f"{outcome.there} of {len(tasks)} runs are already there", soft_wrap=True)
    if not missing:
        return outcome
    with _shown(console, len(missing)) as shown:
        for task, answer in _answers(missing, sweep):
            if isinstance(answer, BaseException):
                outcome.failed[_name(task)] = f"{type(answer).__name__}: {answer}"
                shown.failed(_name(task), answer)
            else:
                results.write(sweep.out, answer, task.label)
                outcome.done += 1
                shown.done(_name(task))
    return outcome


def results_of(tasks: Sequence[Task], folder: Path) -> list[Result]:
    """Return the results of these runs, in their order, without those that failed: a file of another run is none."""
    there = {path: label.fingerprint for path, label in results.labels(folder)}
    paths = [(folder / task.label.path, task.label.fingerprint) for task in tasks]
    return [results.decode(results.content(path)) for path, made_of in paths if there.get(path) == made_of]


def _name(task: Task) -> str:
    return f"{task.label.study}, {task.label.variant}, seed {task.label.seed}"


def _missing(tasks: Sequence[Task], sweep: Sweep) -> list[Task]:
    """Return the runs without a result. One that another study has is taken from there."""
    if sweep.fresh:
        return list(tasks)
    known: dict[str, list[Path]] = {}
    for path, label in results.labels(sweep.out):
        known.setdefault(label.fingerprint, []).append(path)
    missing = []
    for task in tasks:
        paths = known.get(task.label.fingerprint, [])
        if not paths or (task.keep is not None and not Path(task.keep).exists()):
            missing.append(task)
        elif sweep.out / task.label.path not in paths:
            results.write(sweep.out, results.relabelled(results.content(paths[0]), task.label), task.label)
    return missing


def _answers(tasks: Sequence[Task], sweep: Sweep) -> Iterator[tuple[Task, bytes | BaseException]]:
    """Yield what each run gave, or what it failed of, as they come."""
    if sweep.scheduler is not None:
        with _cluster(sweep.scheduler) as executor:
            yield from _submitted(executor, tasks)
        return
    if sweep.workers == 0:
        yield from _one_after_the_other(tasks)
        return
    yield from processes.answers(_done, tasks, sweep.workers)


def _done(task: Task) -> bytes:
    """Do a run; where its folder is kept, it has its name only when the run is whole."""
    if task.keep is None:
        return running.do(task)
    part = f"{task.keep}.part"
    # What is there is of another run, which is not to be taken for this one's if it fails.
    shutil.rmtree(task.keep, ignore_errors=True)
    data = running.do(replace(task, keep=part))
    Path(part).rename(task.keep)
    return data


def _one_after_the_other(tasks: Iterable[Task]) -> Iterator[tuple[Task, bytes | BaseException]]:
    for task in tasks:
        try:
            yield task, _done(task)
        except Exception as error:
            yield task, error


def _submitted(executor: Executor, tasks: Iterable[Task]) -> Iterator[tuple[Task, bytes | BaseException]]:
    futures: dict[Future[bytes], Task] = {executor.submit(_done, task): task for task in tasks}
    for future in as_completed(futures):
        failure = future.exception()
        yield futures[future], failure if failure is not None else future.result()


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    """Give the cluster of a Dask scheduler as an executor; it does again what a worker died of."""
    try:
        from distributed import Client
    except ImportError as error:
        raise MdbError(
            "--scheduler needs Dask; run pip install 'multilevel-darwinist-brain[cluster]', here and on the workers"
        ) from error
    try:
        client = Client(address, timeout=CONNECTED_S)
    except (OSError, ValueError) as error:
        raise MdbError(
            f"--scheduler {address}: {error}; expected a running Dask scheduler, as tcp://host:8786"
        ) from error
    with client:
        client.run(running.quiet)
        executor: Executor = client.get_executor()
        yield executor


class _Shown:
    """What the user sees: a bar with an estimate on a terminal, elsewhere a line a run."""

    def __init__(self, console: Console, total: int) -> None:
        self._console, self._total = console, total
        self._began_s = time.monotonic()
        self._ended = 0
        columns = (
            TextColumn("runs"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left:"),
            TimeRemainingColumn(),
        )  # fmt: skip
        self.bar = Progress(*columns, console=console, disable=not console.is_terminal)
        # Of a few long runs a moving average knows nothing before the first has ended.
        self._task = self.bar.add_task("runs", total=total)

    def done(self, name: str) -> None:
        """A run is done."""
        self._advance(f"done: {name}")

    def failed(self, name: str, failure: BaseException) -> None:
        """A run has failed."""
        self._advance(f"FAILED: {name}: {type(failure).__name__}: {failure}")

    def _advance(self, text: str) -> None:
        self._ended += 1
        self.bar.advance(self._task)
        if self._console.is_terminal:
            self.bar.console.print(words.shown(text, lines=True))
            return
        left_s = (time.monotonic() - self._began_s) / self._ended * (self._total - self._ended)
        line = f"[{self._ended}/{self._total}] {text}; about {left_s / 60:.0f} min left"
        self._console.print(words.shown(line), markup=False, soft_wrap=True, highlight=False)


@contextmanager
def _shown(console: Console, total: int) -> Iterator[_Shown]:
    shown = _Shown(console, total)
    with shown.bar:
        yield shown
