"""The learning curves of machines: competence alone over the iterations taught. Needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mdb_sim.figures.drawings import KINDS
from mdb_sim.figures.four_to_six import BLUE, INK, MUTED, save
from mdb_sim.verdicts.machines import OF, curves_of
from mdb_sim.verdicts.quantities import Runs

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS, PANEL_IN = 3, 3.7


def draw_machines(runs: Runs, stem: Path, kinds: Sequence[str] = KINDS) -> list[Path]:
    """Draw a panel for each machine, each seed thin, the median thick, the aim dashed; return the files."""
    columns = min(COLUMNS, len(runs))
    lines = math.ceil(len(runs) / columns)
    size = (PANEL_IN * columns, 2.7 * lines + 0.6)
    return save(stem, size, lambda figure: _fill(runs, figure, lines, columns), kinds)


def _fill(runs: Runs, figure: Figure, lines: int, columns: int) -> None:
    panels = figure.subplots(lines, columns, squeeze=False)
    for axes in panels.flat[len(runs) :]:
        axes.set_visible(False)
    for axes, (what, seeds) in zip(panels.flat, runs.items(), strict=False):
        machine = OF[what]
        curves = list(curves_of(machine, seeds).values())
        for each in curves:
            axes.plot(each.taught, each.competence, color=BLUE, linewidth=0.8, alpha=0.5, marker=".")
        middle = np.median([each.competence for each in curves], axis=0)
        axes.plot(curves[0].taught, middle, color=BLUE, linewidth=2.2, label="alone, median")
        axes.axhline(machine.target, color=INK, linewidth=1.0, linestyle=(0, (4, 3)), label="aim")
        axes.set_title(what, fontsize=10)
        axes.set_ylabel(machine.measure, fontsize=8)
        axes.set_xlabel("iterations taught", fontsize=8, color=MUTED)
        axes.set_xlim(0, None)
    panels[0, 0].legend(frameon=False, fontsize=8, loc="best")
