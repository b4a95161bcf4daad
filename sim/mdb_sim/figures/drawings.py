"""Figures of comparisons: every seed a dot or a thin line, every statistic with its interval.

Owns how they look; needs matplotlib, like `figures`.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mdb_sim.figures.four_to_six import BLUE, GREEN, INK, MUTED, ORANGE, band, note, save
from mdb_sim.runs import measures
from mdb_sim.runs.record import Doubles
from mdb_sim.verdicts.comings import ComingsRow
from mdb_sim.verdicts.quantities import Quantity
from mdb_sim.verdicts.statistics import FEWEST, percent, seeds_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 2
KINDS = ("png",)
"""Kinds of files that are drawn unless others are asked for."""
ROW_IN, WIDTH_IN = 0.27, 11.0
"""Inches of figure for a row of a panel, and for a figure."""
TITLE_LETTERS = 42
"""A panel's title is broken after so many."""
COLOURS = {"": MUTED, "better": GREEN, "worse": ORANGE}
"""Of an interval, by how it differs from the reference."""
VARIANT_COLOURS = (BLUE, ORANGE, GREEN, MUTED)
TICKS = (1, 5, measures.RECENT, 100, 500, 2000)
"""Iterations of a coming that are named at its axis: among them the first whole window."""


def draw_quantities(
    quantities: Sequence[Quantity], stem: Path, title: str, kinds: Sequence[str] = KINDS
) -> list[Path]:
    """Draw one panel a measure with one row a variant; return the files."""
    rows = math.ceil(len(quantities) / COLUMNS)
    height_in = rows * (1.2 + ROW_IN * len(quantities[0].values)) + 0.8
    return save(stem, (WIDTH_IN, height_in), lambda figure: _fill_quantities(quantities, title, figure), kinds)


def _fill_quantities(quantities: Sequence[Quantity], title: str, figure: Figure) -> None:
    rows = math.ceil(len(quantities) / COLUMNS)
    panels: list[Axes] = list(figure.subplots(rows, COLUMNS, sharey=True, squeeze=False).flat)
    for axes, quantity in zip(panels, quantities, strict=False):
        _draw_quantity(axes, quantity)
    for axes in panels[len(quantities) :]:
        axes.set_visible(False)
    seeds, reference = quantities[0].seeds, quantities[0].reference
    figure.suptitle(
        f"{title}: {seeds_text(seeds)}, each a dot; bar: 95 % interval",
        x=0.01, ha="left", fontsize=12,
    )  # fmt: skip
    _legend(figure, reference, clear=len(seeds) >= FEWEST)


def _legend(figure: Figure, reference: str, *, clear: bool) -> None:
    from matplotlib.lines import Line2D

    words = {"worse": f"worse than {reference}", "better": f"better than {reference}", "": "not clearly different"}
    words = words if clear else {"": f"fewer than {FEWEST} seeds: no difference is called clear"}
    marks = {INK: reference} | {COLOURS[verdict]: label for verdict, label in words.items()}
    handles = [
        Line2D([], [], color=colour, marker="D", markersize=6, linewidth=3, label=label)
        for colour, label in marks.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=10)


def _draw_quantity(axes: Axes, quantity: Quantity) -> None:
    """Draw the seeds as dots, the statistic as a diamond on its interval; what never happened is counted."""
    values = [value for variant in quantity.values.values() for value in variant if not math.isnan(value)]
    finite = [value for value in values if math.isfinite(value)]
    edge = _never_edge(axes, finite) if len(finite) < len(values) else math.inf
    axes.axvline(
        min(quantity.estimate(quantity.reference).value, edge),
        color=INK,
        linewidth=0.8,
        linestyle=(0, (4, 3)),
        zorder=1,
    )
    for row, variant in enumerate(quantity.values):
        colour = INK if row == 0 else COLOURS[quantity.verdict(variant)]
        places = np.array([value for value in quantity.values[variant] if math.isfinite(value)])
        heights = row + 0.2 + _spread(places)
        axes.plot(places, heights, ".", color=colour, markersize=6, alpha=0.55, markeredgewidth=0, zorder=3)
        if count := quantity.never(variant):
            axes.text(edge, row + 0.3, f"{count} of {len(quantity.seeds)}", ha="center", va="center", fontsize=8.5)
        found = quantity.estimate(variant)
        axes.plot(np.minimum([found.low, found.high], edge), [row - 0.12] * 2, color=colour, linewidth=3, zorder=2)
        axes.plot(min(found.value, edge), row - 0.12, "D", color=colour, markersize=5.5, zorder=4)
    axes.set_yticks(range(len(quantity.values)), list(quantity.values))
    axes.set_ylim(len(quantity.values) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    if quantity.shape is percent:
        axes.locator_params(axis="x", nbins=6)
        axes.xaxis.set_major_formatter(lambda value, _: f"{100 * value:g} %")
    title = f"{quantity.name}: {quantity.statistic}, {'← better' if quantity.low_is_good else 'better →'}"
    axes.set_title(textwrap.fill(title, TITLE_LETTERS))
    if not values:
        note(axes, "no data in these logs")


def _spread(places: Doubles) -> Doubles:
    """Return small heights that keep dots at the same place apart."""
    heights = np.zeros(len(places))
    for value in np.unique(places):
        same = np.flatnonzero(places == value)
        heights[same] = (np.arange(len(same)) % 3) * 0.1
    return heights


def _never_edge(axes: Axes, finite: Sequence[float]) -> float:
    """Mark off a strip at the right for what never happened; return its middle."""
    low, high = (min(finite), max(finite)) if finite else (0.0, 1.0)
    span = max(high - low, 0.05 * abs(high), 1e-9)
    edge = high + 0.17 * span
    axes.axvspan(high + 0.08 * span, high + 0.26 * span, facecolor="#eeeeee", linewidth=0, zorder=0)
    axes.set_xlim(low - 0.06 * span, high + 0.26 * span)
    ticks = [tick for tick in axes.get_xticks() if low - 0.06 * span <= tick <= high + 0.05 * span]
    axes.set_xticks([*ticks, edge], [*(f"{tick:g}" for tick in ticks), "never"])
    return edge


def draw_comings(results: Mapping[str, Sequence[ComingsRow]], stem: Path, kinds: Sequence[str] = KINDS) -> list[Path]:
    """Draw obedience within each coming, one row of panels a teacher; return the files."""
    comings = next(iter(results.values()))[0].comings
    teachers = list(dict.fromkeys(coming.teacher for coming in comings))
    return save(stem, (WIDTH_IN, 1.0 + 3.1 * len(teachers)), lambda figure: _fill_comings(results, figure), kinds)


def _fill_comings(results: Mapping[str, Sequence[ComingsRow]], figure: Figure) -> None:
    rows = next(iter(results.values()))
    teachers = [coming.teacher for coming in rows[0].comings]
    names = list(dict.fromkeys(teachers))
    columns = max(teachers.count(name) for name in names)
    panels: list[list[Axes]] = figure.subplots(len(names), columns, sharex=True, sharey=True, squeeze=False).tolist()
    for place, teacher in enumerate(teachers):
        column = teachers[:place].count(teacher)
        axes = panels[names.index(teacher)][column]
        _draw_coming(axes, results, place)
        if place == 0:
            _mark_exploration(axes, max(row.random_iterations for row in rows))
        axes.set_title(f"coming {place + 1}: teacher {teacher}, {column + 1} of {teachers.count(teacher)}")
    for row, name in zip(panels, names, strict=True):
        row[0].set_ylabel(f"obeyed of the last {measures.RECENT}")
        for axes in row[teachers.count(name) :]:
            axes.set_visible(False)
    for axes in panels[-1]:
        axes.set_xlabel("iteration of the coming")
    # Where a panel above stands over nothing, it has the axis.
    for above, below in pairwise(panels):
        for upper, lower in zip(above, below, strict=True):
            upper.tick_params(labelbottom=not lower.get_visible())
            if not lower.get_visible():
                upper.set_xlabel("iteration of the coming")
    seeds = [row.seed for row in rows]
    figure.suptitle(
        f"Obedience at each coming of a teacher: {seeds_text(seeds)}, each thin; mean with 95 % band",
        x=0.01, ha="left", fontsize=12,
    )  # fmt: skip
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 2), fontsize=10)


def _draw_coming(axes: Axes, results: Mapping[str, Sequence[ComingsRow]], place: int) -> None:
    for (variant, rows), colour in zip(results.items(), VARIANT_COLOURS, strict=False):
        curves = [row.comings[place].recent for row in rows]
        for curve in curves:
            axes.plot(np.arange(1, len(curve) + 1), curve, color=colour, linewidth=0.6, alpha=0.3)
        mean, low, high = band(curves)
        x = np.arange(1, len(mean) + 1)
        axes.fill_between(x, low, high, color=colour, alpha=0.25, linewidth=0)
        axes.plot(x, mean, color=colour, linewidth=2, label=variant)
    axes.axhline(measures.OBEDIENT, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
    axes.axvline(measures.RECENT, color=MUTED, linewidth=0.9, linestyle=":")
    # Logarithmic, for what a return takes and what a first coming takes lie a factor of ten apart.
    axes.set_xscale("log")
    end = max(2, *(len(row.comings[place].recent) for rows in results.values() for row in rows))
    ticks = [tick for tick in TICKS if tick <= end]
    axes.set_xticks(ticks, [f"{tick}" for tick in ticks])
    axes.set_xlim(1, end)
    axes.set_ylim(-0.02, 1.02)
    axes.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")


def _mark_exploration(axes: Axes, iterations: int) -> None:
    """Hatch the iterations in which commands are obeyed by chance only."""
    if iterations:
        axes.axvspan(1, iterations, facecolor="none", edgecolor="#c9d6de", hatch="///", linewidth=0, zorder=0)
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
        axes.text(0.03, 0.72, "forced exploration", transform=axes.transAxes, fontsize=9, color=INK, bbox=box)
