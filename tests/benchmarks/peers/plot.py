"""The plot of one run's measurements."""

from pathlib import Path
from typing import Any

import numpy as np

from tests.benchmarks.peers import match
from tests.benchmarks.peers.contestant import ENTRIES
from tests.benchmarks.peers.match import Results
from tests.benchmarks.peers.results import MAIN_NETWORK, exponent, growth, processor, reach

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Colours that colour-blind readers tell apart (Okabe and Ito)."""
MARKERS = ("o", "s", "^", "D", "v", "P")


def draw(results: Results, path: Path) -> None:
    """Draw generation times, times to an error and growth as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 12), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 2, height_ratios=(1.2, 1))
    _draw_generations(results, panels[0, 0])
    _draw_reached(results, panels[0, 1])
    titles = {
        "pairs": f"Growth with the short-term memory, population {match.GROWTH_POPULATION}",
        "population": f"Growth with the population, {match.GROWTH_PAIRS} pairs",
    }
    for panel, (kind, title) in zip(panels[1], titles.items(), strict=True):
        _draw_growth(results, panel, kind, title)
    figure.savefig(path, dpi=120)


def _draw_generations(results: Results, axes: Any) -> None:
    names = [name for name in match.TIMED if name in results["names"]]
    cases = [here for here in results["generation"] if here["network"] == MAIN_NETWORK]
    for here, colour, marker in zip(cases, COLOURS, MARKERS, strict=False):
        milliseconds = [1e3 * np.median(processor(here["times"][name])) for name in names]
        label = f"{here['population']}x{here['pairs']}"
        axes.plot(milliseconds, range(len(names)), marker, color=colour, markersize=8, label=label)
    _list_contestants(axes, names)
    _finish(axes, f"A whole generation, {MAIN_NETWORK} network, population x pairs", "milliseconds", columns=3)


def _draw_reached(results: Results, axes: Any) -> None:
    names = [name for name in match.REACHING if name in results["names"]]
    series = [(here, place) for here in results["reach"] for place in range(len(here["errors"]))]
    for shift, ((here, place), colour, marker) in enumerate(zip(series, COLOURS, MARKERS, strict=False)):
        axes.plot([], [], marker, color=colour, label=f"{here['network']} to {here['errors'][place]:g}")
        for row, name in enumerate(names):
            tries = here["tries"][name]
            seconds, _, reached = reach(tries, place)
            at = min(seconds, match.REACH_LIMIT_S), row + 0.15 * (shift - 1.5)
            face = colour if np.isfinite(seconds) else "white"
            axes.plot(*at, marker, color=colour, markerfacecolor=face, markersize=8)
            if reached < len(tries):
                axes.annotate(f"{reached}/{len(tries)}", at, (7, -3), textcoords="offset points", fontsize=8)
    _list_contestants(axes, names)
    seeds, limit_s = len(match.REACH_SEEDS), match.REACH_LIMIT_S
    _finish(axes, f"Time to an error, median of {seeds} seeds, at most {limit_s:g} s", "seconds", columns=2)


def _draw_growth(results: Results, axes: Any, kind: str, title: str) -> None:
    for (name, short), colour, marker in zip(match.GROWING.items(), COLOURS, MARKERS, strict=False):
        if name in results["names"]:
            sizes, seconds = growth(results, kind, name)
            label = f"{short}: exponent {exponent(sizes, seconds):.2f}"
            axes.plot(sizes, 1e3 * seconds, marker=marker, color=colour, label=label)
    axes.set_yscale("log")
    _plain_ticks(axes.yaxis)
    axes.set_ylabel("milliseconds a generation")
    _finish(axes, title, kind if kind == "pairs" else "individuals", columns=2)
    axes.set_xticks(sizes, [str(size) for size in sizes])


def _list_contestants(axes: Any, names: list[str]) -> None:
    axes.set_yticks(range(len(names)), [ENTRIES[name].label.replace(", ", "\n") for name in names])
    axes.invert_yaxis()


def _plain_ticks(axis: Any) -> None:
    from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))


def _finish(axes: Any, title: str, unit: str, columns: int) -> None:
    axes.set_xscale("log")
    _plain_ticks(axes.xaxis)
    axes.set_xlabel(unit)
    axes.set_title(title, loc="left")
    axes.grid(color="#e4e4e4", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_axisbelow(True)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=columns, frameon=False)
