"""The options of `mdb study` and `mdb acceptance`. Imports nothing heavy before a command is run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from mdb_deploy.cli.options import number
from mdb_sim.studies.catalogue import ACCEPTANCE, PHASE, REPORTED, STUDIES, Study

if TYPE_CHECKING:
    from mdb_deploy.studies.sweep import Sweep

OUT = Path("runs/studies")
REPORT = Path("sim/REPORT.md")
EPILOG = """\
Runs are inline and in lockstep, with the kinematic twin unless --set robot.body says another body. A result is
kept for one experiment and one version of the code: what is there is not run again, so an interrupted study goes
on where it stopped, and a change of either is noticed. Studies with the same --out share runs that are the same.

a quick look:
  mdb study {study} --seeds 11-12
over a cluster (dask scheduler; dask worker tcp://HOST:8786 on each machine, same version of the project):
  mdb study {study} --scheduler tcp://HOST:8786
"""


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `acceptance` and `study` to the command line."""
    acceptance = commands.add_parser("acceptance", help=ACCEPTANCE.what, allow_abbrev=False)
    _add_sweep(acceptance, ACCEPTANCE.seeds, Path("runs/acceptance"))
    acceptance.set_defaults(command=_accept, goes_on=True)
    study = commands.add_parser("study", help="comparisons over many seeds, and their report", allow_abbrev=False)
    studies = study.add_subparsers(required=True, metavar="STUDY")
    for which in STUDIES.values():
        _add_study(studies, which)
    every = _parser(studies, "all", f"all studies of the report: {', '.join(which.name for which in REPORTED)}")
    _add_sweep(every, None, OUT)
    every.set_defaults(command=_every, goes_on=True)
    report = _parser(studies, "report", "the report with its figures, from results alone")
    report.add_argument("--results", type=Path, default=OUT, help=f"folder of the results ({OUT})")
    report.add_argument("--out", type=Path, default=REPORT, help=f"the report; figures go into gallery/ ({REPORT})")
    report.set_defaults(command=_report)


def _add_study(studies: argparse._SubParsersAction[argparse.ArgumentParser], which: Study) -> None:
    parser = _parser(studies, which.name, which.what)
    _add_sweep(parser, which.seeds, OUT)
    parser.add_argument("--only", default="", metavar="NAMES", help="some variants, as in fifo-only,scalar-note")
    if which.own_schedule:
        parser.add_argument("--phase", type=number(1), default=PHASE, help=f"iterations of each phase ({PHASE})")
    parser.set_defaults(command=_study, study=which, goes_on=True)


def _parser(
    studies: argparse._SubParsersAction[argparse.ArgumentParser], name: str, what: str
) -> argparse.ArgumentParser:
    return studies.add_parser(
        name,
        help=what,
        description=what,
        epilog=EPILOG.format(study="ablation" if name == "report" else name),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )


def _add_sweep(parser: argparse.ArgumentParser, seeds: str | None, out: Path) -> None:
    parser.add_argument(
        "experiment", nargs="?", default="paper", help="experiment file, or the name of a shipped one (paper)"
    )
    usual = seeds or "each study's own"
    parser.add_argument("--seeds", default=seeds, help=f"as in 11-20 or 1,4,9 ({usual})")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="override any setting")
    parser.add_argument("--out", type=Path, default=out, help=f"where results and report go ({out})")
    parser.add_argument(
        "--workers", type=number(0), default=2, help="runs at the same time, each in a process; 0: in this one (2)"
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="do the runs on a Dask cluster, as tcp://host:8786")
    parser.add_argument("--keep", action="store_true", help="keep the run folders too, below --out/runs")
    parser.add_argument("--fresh", action="store_true", help="run again also what is there already")


def _sweep(arguments: argparse.Namespace) -> Sweep:
    from mdb_deploy.experiments import experiment_path
    from mdb_deploy.studies.sweep import Sweep, seeds_of

    only = getattr(arguments, "only", "")
    return Sweep(
        experiment=experiment_path(arguments.experiment),
        seeds=tuple(dict.fromkeys(seeds_of(arguments.seeds))) if arguments.seeds else (),
        overrides=tuple(arguments.set),
        out=arguments.out,
        workers=arguments.workers,
        scheduler=arguments.scheduler,
        keep=arguments.keep,
        fresh=arguments.fresh,
        only=tuple(name for name in only.split(",") if name),
        phase=getattr(arguments, "phase", PHASE),
    )


def _accept(arguments: argparse.Namespace) -> int:
    from mdb_deploy.studies.command import accept

    return accept(_sweep(arguments))


def _study(arguments: argparse.Namespace) -> int:
    from mdb_deploy.studies.command import study

    return study(arguments.study, _sweep(arguments))


def _every(arguments: argparse.Namespace) -> int:
    from mdb_deploy.studies.command import every

    wanted = _sweep(arguments)
    return every(wanted, wanted.seeds or None)


def _report(arguments: argparse.Namespace) -> int:
    from mdb_deploy.studies.command import report

    return report(arguments.results, arguments.out)
