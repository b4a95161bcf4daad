"""Figures of phases over many seeds: the paper's 4 to 6, a long life, and every seed against its ideal.

Owns how they look; needs matplotlib, like `figures`, whose colours and bands it takes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mdb_sim.figures.drawings import KINDS
from mdb_sim.figures.four_to_six import BLUE, GREEN, INK, MUTED, ORANGE, band, note, save, shade
from mdb_sim.runs import measures
from mdb_sim.runs.record import Doubles
from mdb_sim.studies.rows import Curve, PhaseRow
from mdb_sim.studies.tables import STOPPED
from mdb_sim.verdicts.acceptance import ALONE_WORST
from mdb_sim.verdicts.quantities import Runs, phases_of
from mdb_sim.verdicts.statistics import estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

VARIANT_COLOURS = (BLUE, ORANGE, GREEN, MUTED)
SIDE_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#8A4F7D")
ERROR_TOP = 1.2
"""An error axis ends here at the latest."""
RATE = 50
"""Captures are counted over so many iterations."""
ERRORS: tuple[tuple[str, Callable[[PhaseRow], Doubles]], ...] = (
    (
        f"Prequential: each pair foreseen before it was learnt (mean of {measures.AVERAGED})",
        lambda row: measures.mean_of_last(row.prequential_curve.astype(np.float64), measures.AVERAGED),
    ),
    ("Over the short-term memory", lambda row: row.memory_error_curve.astype(np.float64)),
    ("Over all command–action pairs of the present language", lambda row: row.pair_error_curve.astype(np.float64)),
)
"""The panels of figure 4."""


def draw_errors(runs: Runs, stem: Path, kinds: Sequence[str] = KINDS) -> list[Path]:
    """Draw figure 4, mean and band of each variant; return the files."""
    return save(stem, (9.0, 7.6), lambda figure: _fill_errors(runs, figure), kinds)


def _fill_errors(runs: Runs, figure: Figure) -> None:
    panels: list[Axes] = list(figure.subplots(len(ERRORS), 1, sharex=True))
    phases = phases_of(runs)
    for axes, (title, measure) in zip(panels, ERRORS, strict=True):
        shade(axes, phases, labelled=axes is panels[0])
        axes.set_xlim(0, phases[-1].stop)
        axes.axhline(measures.THRESHOLD, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
        axes.text(1.005, measures.THRESHOLD, "10 %", transform=axes.get_yaxis_transform(), va="center", color=INK)
        axes.set_title(title, pad=20 if axes is panels[0] else 5)
        axes.set_ylabel("MSE")
        highest = [0.3, *_draw_bands(axes, runs, measure)]
        axes.set_ylim(0, min(1.05 * max(highest), ERROR_TOP))
        if len(highest) == 1:
            note(axes, "no communication model in these runs")
    panels[-1].set_xlabel("Iteration")
    _title(figure, runs, "Error of the communication model (MSE, feedback in ±1)")
    _legend(figure, panels[0])


def _draw_bands(axes: Axes, runs: Runs, measure: Callable[[PhaseRow], Doubles]) -> list[float]:
    """Draw every taught phase by itself, so that no line crosses the phases between; return the highest values."""
    highest: list[float] = []
    for (variant, seeds), colour in zip(runs.items(), VARIANT_COLOURS, strict=False):
        label: str | None = variant
        for row in next(iter(seeds.values())):
            curves = [measure(rows[row.phase]) for rows in seeds.values()]
            mean, low, high = band(curves)
            x = np.flatnonzero(np.isfinite(mean))
            if row.alone or not len(x):
                continue
            axes.fill_between(row.start + x, low[x], high[x], color=colour, alpha=0.25, linewidth=0)
            axes.plot(row.start + x, mean[x], color=colour, linewidth=1.7, label=label)
            label = None
            highest.append(float(np.max(high[x])))
    return highest


def draw_captures(runs: Runs, stem: Path, kinds: Sequence[str] = KINDS) -> list[Path]:
    """Draw figure 5: each seed thin, mean and band of each variant, and the mean of the ideals; return the files."""
    return save(stem, (9.0, 5.0), lambda figure: _fill_captures(runs, figure), kinds)


def _fill_captures(runs: Runs, figure: Figure) -> None:
    axes: Axes = figure.subplots()
    phases = phases_of(runs)
    shade(axes, phases, labelled=True)
    axes.set_xlim(0, phases[-1].stop)
    axes.set_title("Object captures", pad=22)
    axes.set_xlabel("Iteration")
    axes.set_ylabel("Captures since the beginning")
    random = phases[0].random_iterations
    if random:
        axes.axvspan(0, random, facecolor="none", edgecolor="#9bb4c6", hatch="///", linewidth=0)
        axes.text(0.008, 0.96, "random\nexploration", transform=axes.transAxes, va="top", fontsize=9, color=INK)
    for (variant, seeds), colour in zip(runs.items(), VARIANT_COLOURS, strict=False):
        curves = [captured(rows) for rows in seeds.values()]
        for curve in curves:
            axes.plot(curve, color=colour, linewidth=0.4, alpha=0.25)
        mean, low, high = band(curves)
        axes.fill_between(np.arange(len(mean)), low, high, color=colour, alpha=0.25, linewidth=0)
        axes.plot(mean, color=colour, linewidth=2, label=variant)
    _draw_ideal(axes, runs)
    axes.set_ylim(0, None)
    _title(figure, runs, "")
    _legend(figure, axes)


def captured(rows: Sequence[PhaseRow]) -> Doubles:
    """Return the captures of a run after 0 to n iterations (n + 1,)."""
    return np.concatenate([[0.0], np.cumsum(np.concatenate([row.captured for row in rows]), dtype=np.float64)])


def _draw_ideal(axes: Axes, runs: Runs) -> None:
    seeds = next(iter(runs.values()))
    phases = phases_of(runs)
    ideals = np.array([[row.ideal_captures for row in rows] for rows in seeds.values()])
    if not np.isfinite(ideals).all():
        return
    x = [phases[0].counted_from, *(row.stop for row in phases)]
    before = np.mean([captured(rows)[phases[0].counted_from] for rows in seeds.values()])
    y = before + np.concatenate([[0.0], np.cumsum(ideals.mean(axis=0))])
    axes.plot(x, y, color=INK, linewidth=1.2, linestyle=(0, (4, 3)), label="ideal")


def draw_paths(runs: Runs, stem: Path, kinds: Sequence[str] = KINDS) -> list[Path]:
    """Draw figure 6 for each variant's first seed: with a teacher, and without; return the files."""
    return save(stem, (9.0, 4.9 * len(runs)), lambda figure: _fill_paths(runs, figure), kinds)


def _fill_paths(runs: Runs, figure: Figure) -> None:
    panels = figure.subplots(len(runs), 2, sharex=True, sharey=True, squeeze=False)
    for line, (variant, seeds) in zip(panels, runs.items(), strict=True):
        seed, rows = next(iter(seeds.items()))
        for axes, alone in zip(line, (False, True), strict=True):
            of = [row for row in rows if row.alone == alone]
            everybody = [row for each in seeds.values() for row in each if row.alone == alone]
            steps = np.concatenate([row.capture_steps for row in everybody]) if everybody else np.zeros(0)
            paths = of[-1].paths if of else ()
            for place, path in enumerate(paths):
                _draw_path(axes, path, SIDE_COLOURS[place % len(SIDE_COLOURS)])
            axes.plot(0, 0, "o", color=INK, markersize=4.5, zorder=5)
            axes.set_aspect("equal")
            axes.set_title(f"{variant}, {'without' if alone else 'with'} teacher (seed {seed})", pad=18)
            median = f"{np.median(steps):g}" if len(steps) else "–"
            text = f"median of {len(steps)} captures of all seeds: {median} movements"
            axes.text(0, 1.015, text, transform=axes.transAxes, fontsize=9, color=MUTED)
            if not paths:
                note(axes, "no captures")
    for axes in panels[-1]:
        axes.set_xlabel("x (m)")
    for line in panels:
        line[0].set_ylabel("y (m)")


def _draw_path(axes: Axes, path: Curve, colour: str) -> None:
    from matplotlib.patches import Circle

    x, y, heading_rad = path[2:].reshape(-1, 3).T
    x_m, y_m = x - x[0], y - y[0]
    axes.plot(x_m, y_m, color=colour, linewidth=1.3, alpha=0.7)
    axes.quiver(
        x_m, y_m, np.cos(heading_rad), np.sin(heading_rad), color=colour, angles="xy", scale_units="xy", scale=8,
        width=0.006, headwidth=4, headlength=4.5, headaxislength=4, zorder=4,
    )  # fmt: skip
    centre = (float(path[0] - x[0]), float(path[1] - y[0]))
    axes.add_patch(Circle(centre, 0.15, facecolor=colour, edgecolor="none", alpha=0.55))
    axes.plot(*centre, ".", color=colour, markersize=1)


def draw_life(runs: Runs, stem: Path, kinds: Sequence[str] = KINDS) -> list[Path]:
    """Draw the shares of the ideal phase by phase, of the first variant; return the files."""
    return save(stem, (10.0, 4.6), lambda figure: _fill_life(runs, figure), kinds)


def _fill_life(runs: Runs, figure: Figure) -> None:
    axes: Axes = figure.subplots()
    seeds = next(iter(runs.values()))
    for row in phases_of(runs):
        shares = {seed: rows[row.phase].share for seed, rows in seeds.items()}
        colour = BLUE if row.alone else ORANGE
        _draw_shares(axes, row.phase, shares, colour, named=row.alone)
    names = [row.name for row in phases_of(runs)]
    axes.set_xticks(range(len(names)), names, rotation=25, ha="right")
    _share_axis(axes)
    axes.set_title("Captures as a share of the ideal: blue alone, orange taught")
    _title(figure, runs, "")


def _draw_shares(axes: Axes, place: float, shares: dict[int, float], colour: str, *, named: bool) -> None:
    """Draw one column of seeds, the bad ones by number, and beside it their mean with its interval."""
    known = {seed: share for seed, share in shares.items() if math.isfinite(share)}
    values = np.array(list(known.values()))
    spread = 0.22 * ((np.arange(len(values)) * 0.618) % 1.0 - 0.5)
    axes.plot(place + spread, values, ".", color=colour, markersize=5, alpha=0.5, markeredgewidth=0)
    for x, (seed, share) in zip(place + spread, known.items(), strict=True):
        if named and share < ALONE_WORST:
            axes.text(x + 0.04, share, str(seed), fontsize=7.5, color=INK, va="center")
    found = estimate(values, "mean")
    axes.plot([place + 0.25] * 2, [found.low, found.high], color=colour, linewidth=3)
    axes.plot(place + 0.25, found.value, "D", color=colour, markersize=5)


def _share_axis(axes: Axes) -> None:
    axes.axhline(1.0, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
    axes.axhline(ALONE_WORST, color=ORANGE, linewidth=0.9, linestyle=(0, (4, 3)))
    axes.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
    low, high = axes.get_ylim()
    axes.set_ylim(max(0.0, min(low, 0.8)), max(high, 1.1))
    axes.set_ylabel("captures : ideal")


def draw_seeds(runs: Runs, stem: Path, kinds: Sequence[str] = KINDS) -> list[Path]:
    """Draw every seed's share of its ideal in each phase of the first variant; return the files."""
    count = len(phases_of(runs))
    return save(stem, (9.0, 2.3 * count + 0.6), lambda figure: _fill_seeds(runs, figure), kinds)


def _fill_seeds(runs: Runs, figure: Figure) -> None:
    seeds = next(iter(runs.values()))
    phases = phases_of(runs)
    panels: list[Axes] = list(figure.subplots(len(phases), 1, sharex=True, squeeze=False)[:, 0])
    numbers = list(seeds)
    for axes, row in zip(panels, phases, strict=True):
        shares = np.array([rows[row.phase].share for rows in seeds.values()])
        colour = BLUE if row.alone else ORANGE
        axes.plot(numbers, shares, "o", color=colour, markersize=4, alpha=0.7, markeredgewidth=0)
        for seed, share in zip(numbers, shares.tolist(), strict=True):
            if row.alone and share < ALONE_WORST:
                axes.text(seed, share, f"  {seed}", fontsize=8, va="center")
        found = estimate(shares, "mean")
        axes.axhspan(found.low, found.high, color=colour, alpha=0.2, linewidth=0)
        _share_axis(axes)
        axes.set_title(f"{row.name}, {row.counted_from}–{row.stop}: mean {100 * found.value:.1f} %")
    panels[-1].set_xlabel("seed")
    panels[-1].locator_params(axis="x", integer=True)
    _title(figure, runs, "")


def draw_readapt(runs: Runs, stem: Path, kinds: Sequence[str] = KINDS) -> list[Path]:
    """Draw captures round a change of the body, a panel for each change, taught or not; return the files."""
    return save(stem, (10.0, 0.5 * len(runs) + 1.5), lambda figure: _fill_readapt(runs, figure), kinds)


def _fill_readapt(runs: Runs, figure: Figure) -> None:
    names = [variant for variant in runs if not variant.endswith(STOPPED)]
    panels = figure.subplots(math.ceil(len(names) / 2), 2, sharex=True, sharey=True, squeeze=False)
    for axes, name in zip(panels.flat, names, strict=False):
        for variant, colour, label in ((name, BLUE, "learning"), (f"{name}, {STOPPED}", ORANGE, STOPPED)):
            if variant in runs:
                _draw_rate(axes, runs[variant], colour, label)
        _draw_ideal_rate(axes, runs[name])
        axes.set_title(name)
    panels[0, 0].set_ylim(0, None)
    for axes in panels[-1]:
        axes.set_xlabel("Iteration")
    for axes in panels[:, 0]:
        axes.set_ylabel(f"captures in {RATE}")
    _title(figure, runs, "")
    _legend(figure, panels[0][0])


def _draw_rate(axes: Axes, seeds: Mapping[int, Sequence[PhaseRow]], colour: str, label: str) -> None:
    """Draw the captures of every `RATE` iterations in the phases after the first."""
    rows = next(iter(seeds.values()))
    start, counts = rows[1].start, (rows[-1].stop - rows[1].start) // RATE
    rates = [np.diff(captured(of)[start::RATE][: counts + 1]) for of in seeds.values()]
    mean, low, high = band(rates)
    x = start + RATE * (np.arange(len(mean)) + 0.5)
    axes.fill_between(x, low, high, color=colour, alpha=0.25, linewidth=0)
    axes.plot(x, mean, color=colour, linewidth=1.7, label=label)


def _draw_ideal_rate(axes: Axes, seeds: Mapping[int, Sequence[PhaseRow]]) -> None:
    for row in next(iter(seeds.values()))[1:]:
        ideal = np.mean([RATE * rows[row.phase].ideal_captures / (row.stop - row.start) for rows in seeds.values()])
        label = "ideal of the body as it is" if row.phase == 1 else None
        axes.plot([row.start, row.stop], [ideal] * 2, color=INK, linewidth=1.2, linestyle=(0, (4, 3)), label=label)
        if row.phase > 1:
            axes.axvline(row.start, color=MUTED, linewidth=0.9, linestyle=":")


def _title(figure: Figure, runs: Runs, text: str) -> None:
    counts = sorted({len(seeds) for seeds in runs.values()})
    seeds = f"{' to '.join(map(str, dict.fromkeys((counts[0], counts[-1]))))} seed{'s' if counts[-1] != 1 else ''}"
    figure.suptitle(f"{text}, {seeds}" if text else seeds, x=0.01, ha="left", fontsize=12)


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(max(1, len(labels)), 3), fontsize=10)
