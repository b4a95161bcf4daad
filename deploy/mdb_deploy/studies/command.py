"""What `mdb study` and `mdb acceptance` do: sweep, then say what was found.

The runs are those of `sweep`, their variants those of `mdb_sim.studies.tables`; what is said of them is in
`mdb_sim.report`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec

from mdb_deploy.experiments import experiment_path
from mdb_deploy.studies import sweep
from mdb_deploy.studies.sweep import Outcome, Sweep
from mdb_protocol.errors import ConfigError, MdbError
from mdb_sim.figures.four_to_six import need_matplotlib
from mdb_sim.report import document
from mdb_sim.runs.experiment import Experiment
from mdb_sim.studies import results, tables
from mdb_sim.studies.catalogue import ACCEPTANCE, REPORTED, Study
from mdb_sim.studies.results import Result
from mdb_sim.studies.running import Task
from mdb_sim.verdicts.acceptance import acceptance_table, failures, judge

MISSED = 1
FAILED = 3
"""Exit status when a run failed."""
_OTHER_FORM = (KeyError, TypeError, ValueError, OSError, OverflowError, msgspec.MsgspecError)
"""What comes of a file whose columns are not those of a `PhaseRow`."""


def accept(wanted: Sweep) -> int:
    """Run `mdb acceptance`; print the table, write it beside the runs; status 1 when a criterion is missed."""
    tasks = sweep.tasks_of(ACCEPTANCE, wanted)
    outcome = sweep.run(tasks, wanted)
    seeds = {result.label.seed: result.rows for result in sweep.results_of(tasks, wanted.out)}
    table = acceptance_table(seeds)
    _write(wanted.out / "acceptance.md", table)
    sys.stdout.write(table)
    if outcome.failed or not seeds:
        return FAILED
    criteria = judge(seeds)
    met = all(criterion.met for criterion in criteria) and not failures(seeds)[0]
    return 0 if met and criteria else MISSED


def study(which: Study, wanted: Sweep) -> int:
    """Run one study; print what was found and write it, with its figures, into `out`."""
    need_matplotlib()
    tasks = sweep.tasks_of(which, wanted)
    _check(which, tasks, wanted)
    outcome = sweep.run(tasks, wanted)
    found = sweep.results_of(tasks, wanted.out)
    if found:
        _tell(which, found, wanted.out)
    return _status(outcome)


def every(wanted: Sweep, seeds: Sequence[int] | None) -> int:
    """Run all studies of the report, each with its usual seeds unless `seeds` says others."""
    need_matplotlib()
    status = 0
    for which in REPORTED:
        sys.stderr.write(f"== {which.name}: {which.what}\n")
        its_own = replace(wanted, seeds=tuple(sweep.seeds_of(which.seeds)) if seeds is None else tuple(seeds))
        tasks = sweep.tasks_of(which, its_own)
        status = max(status, _status(sweep.run(tasks, its_own)))
    return status


def report(folder: Path, out: Path) -> int:
    """Write the report and its figures from the results of a folder alone."""
    need_matplotlib()
    results.need_pyarrow()
    if not folder.is_dir():
        raise MdbError(f"--results {folder}: no such folder; expected one that 'mdb study NAME --out' has written")
    found = _read(folder)
    if not found:
        raise MdbError(
            f"--results {folder}: no results in it; expected a folder that 'mdb study NAME --out' has written"
        )
    for path in document.write(found, out, _variants()):
        sys.stderr.write(f"{path}\n")
    return 0


def _read(folder: Path) -> list[Result]:
    """Return all results; MdbError names those that another version of the project made in another form."""
    try:
        return results.read(folder)
    except _OTHER_FORM:
        old = ", ".join(str(path) for path, _ in results.labels(folder) if not _readable(path))
        raise MdbError(
            f"made by another version of the project, which kept other things of a run: {old}; "
            "run their studies again, or delete these files"
        ) from None


def _readable(path: Path) -> bool:
    try:
        results.decode(results.content(path))
    except _OTHER_FORM:
        return False
    return True


def _variants() -> dict[str, set[str]]:
    """Return the names of each study's variants; they are the same for all experiments."""
    shipped = experiment_path("paper")
    made = {which.name: Experiment.read(shipped, tables.overrides_of(which)) for which in REPORTED}
    return {name: {variant.name for variant in tables.VARIANTS[name](of)} for name, of in made.items()}


def _check(which: Study, tasks: Sequence[Task], wanted: Sweep) -> None:
    if which.name in ("memory", "comings") and len({task.label.variant for task in tasks}) < 2 and not wanted.only:
        raise ConfigError(
            f"{wanted.experiment}: long_term.capacity is 0 for every model; expected a long-term memory"
        )


def _tell(which: Study, found: Sequence[Result], out: Path) -> None:
    text, figures = document.one(which, found, out)
    path = out / f"{which.name}.md"
    _write(path, text)
    sys.stdout.write(text)
    for file in (path, *figures):
        sys.stderr.write(f"{file}\n")


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def _status(outcome: Outcome) -> int:
    for name, failure in outcome.failed.items():
        sys.stderr.write(f"failed: {name}: {failure}\n")
    return FAILED if outcome.failed else 0
