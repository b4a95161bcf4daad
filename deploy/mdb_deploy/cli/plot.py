"""`mdb plot`: the figures of a run, from its log alone."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from mdb_deploy.cli.options import Commands
from mdb_protocol.errors import DamageError


def add(commands: Commands) -> None:
    """Add `plot`."""
    plot = commands.add_parser("plot", help="draw the figures of a run from its log alone")
    plot.add_argument("run", type=Path, nargs="+", help="run folder; several: one figure with a confidence band")
    plot.add_argument(
        "--out", type=Path, help="where the figures go (the run folder; RUN here if that takes nothing)"
    )
    plot.set_defaults(command=_plot)


def _plot(arguments: argparse.Namespace) -> int:
    for path in draw(arguments.run, arguments.out):
        sys.stdout.write(f"{path}\n")
    return 0


def draw(runs: list[Path], out: Path | None) -> list[Path]:
    """Draw the figures of one run, or one figure with a band of several; return their paths."""
    from mdb_deploy.running.up import writable
    from mdb_sim.figures.four_to_six import draw, draw_band
    from mdb_sim.figures.learning import draw_runs

    try:
        if len(runs) == 1:
            out = out or writable(runs[0])
            return [*draw(runs[0], out), *draw_runs(runs, out)]
        return [*draw_band(runs, out or Path()), *draw_runs(runs, out or Path())]
    except (LookupError, ValueError, ArithmeticError) as error:  # each message is one, but not of this machine
        names = ", ".join(map(str, runs))
        raise DamageError(
            f"what the run log says does not fit its experiment, so {names} cannot be drawn: {error!r}"
        ) from error
