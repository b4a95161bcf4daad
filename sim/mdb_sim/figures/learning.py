"""How any machine learnt: what each episode brought, the error of every model, and episodes as they looked.

From what a study keeps of runs, or from one run's log; needs matplotlib. Owns how this figure looks.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mdb_sim.figures.four_to_six import BLUE, INK, MUTED, TEACHER_SHADES, band, need_matplotlib, note, save, shade
from mdb_sim.figures.pictures import box_of, show
from mdb_sim.runs import measures
from mdb_sim.runs.films import MOMENTS, Film
from mdb_sim.runs.record import Doubles, read_record
from mdb_sim.studies.machines import RETURN, measured
from mdb_sim.studies.rows import PhaseRow, rows_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

LATELY = 5
"""Episodes in a running mean."""
RATE = 50
"""Successes are counted over so many iterations where an episode has no score."""
NAMED = 0.09
"""Phases are named where the shortest has such a share of the run."""
FEWEST = 5
"""Pairs in a mean error."""
SMALLEST = 1e-4
"""An error below is drawn as this."""
POINTS = 800
"""Of a curve, about."""
NOTE_LETTERS = 120
MODEL_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#8A4F7D", "#9a7b00")
WIDTH_IN, CURVES_IN, FILM_IN, NOTE_IN = 9.6, 4.8, 1.9, 0.6
PIXELS_IN = 110
"""Of an inch: enough to read, and a small file."""


@dataclass(frozen=True)
class Learning:
    """Runs of one machine, alike but for their seeds."""

    title: str
    measure: str
    """What a score is, ..."""
    scored: bool
    """... or else that successes are counted."""
    runs: Sequence[Sequence[PhaseRow]]
    aim: float | None = None


def draw_runs(runs: Sequence[Path], out: Path) -> list[Path]:
    """Draw one run, or several of one experiment file, from their logs alone, into `out`; return the files."""
    need_matplotlib()
    records = [read_record(run) for run in runs]
    score, measure = measured(records[0])
    name = records[0].experiment.brain.experiment.name
    learning = Learning(name, measure, score is not None, [rows_of(record) for record in records])
    stem = "learning" if len(runs) == 1 else "learning-seeds"
    return draw_learning(learning, out / stem, ("png", "svg"))


def draw_learning(learning: Learning, stem: Path, kinds: Sequence[str] = ("png",)) -> list[Path]:
    """Draw the figure; return its files. Episodes are shown of the first run."""
    films = [film for row in learning.runs[0] for film in row.films]
    drawn = [film for film in films if film.pictures]
    missing = [] if drawn else [_why_none(films)]
    heights_in = [CURVES_IN, *(FILM_IN for _ in drawn), *(NOTE_IN for _ in missing)]

    def fill(figure: Figure) -> None:
        curves, *below = figure.subfigures(len(heights_in), 1, height_ratios=heights_in, squeeze=False)[:, 0]
        _fill_curves(learning, curves)
        for film, part in zip(drawn, below, strict=False):
            _fill_film(film, learning, part)
        for text in missing:
            below[-1].text(0.02, 0.5, text, fontsize=8.5, color=MUTED, va="center")

    return save(stem, (WIDTH_IN, sum(heights_in)), fill, kinds, PIXELS_IN)


def _why_none(films: Sequence[Film]) -> str:
    missing = films[0].missing if films else "no episode has ended in the last phase, or these results hold none"
    return "\n".join(textwrap.wrap(f"No pictures of episodes: {missing}.", NOTE_LETTERS))


def _fill_curves(learning: Learning, figure: SubFigure) -> None:
    above, below = figure.subplots(2, 1, sharex=True)
    phases = learning.runs[0]
    length = phases[-1].stop
    named = min(phase.stop - phase.start for phase in phases) >= NAMED * length
    for axes in (above, below):
        shade(axes, phases, labelled=named and axes is above)
        axes.set_xlim(0, length)
    if forced := phases[0].random_iterations:
        above.axvspan(0, min(forced, length), facecolor="none", edgecolor="#9bb4c6", hatch="///", linewidth=0)
    if learning.scored:
        _draw_scores(above, learning)
    else:
        _draw_rate(above, learning)
    _draw_errors(below, learning)
    below.set_xlabel("iteration")
    count = len(learning.runs)
    seeds = f"seed {phases[0].seed}" if count == 1 else f"mean of {count} runs with its 95 % band"
    figure.suptitle(f"{learning.title}: {seeds}", x=0.01, ha="left", fontsize=12)
    above.legend(handles=_legend(above, phases), loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8.5)
    if below.get_legend_handles_labels()[0]:
        below.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8.5)


def _legend(axes: Axes, phases: Sequence[PhaseRow]) -> list[object]:
    """Return what is drawn, and who teaches on which background."""
    from matplotlib.patches import Patch

    teachers = list(dict.fromkeys(phase.teacher for phase in phases if phase.teacher is not None))
    shades = [TEACHER_SHADES[place % len(TEACHER_SHADES)] for place in range(len(teachers))]
    backgrounds = [(f"taught by “{name}”", colour) for name, colour in zip(teachers, shades, strict=True)]
    if any(phase.alone for phase in phases):
        backgrounds.append(("alone", "white"))
    patches = [Patch(facecolor=colour, edgecolor=MUTED, linewidth=0.6, label=text) for text, colour in backgrounds]
    if phases[0].random_iterations:
        patches.append(Patch(facecolor="none", edgecolor="#9bb4c6", hatch="///", label="forced exploration"))
    return [*axes.get_legend_handles_labels()[0], *patches]


def _draw_scores(axes: Axes, learning: Learning) -> None:
    """Draw each episode where it ended, and the mean of the last few."""
    for rows in learning.runs:
        ends = np.concatenate([row.ended_after for row in rows])
        scores = np.concatenate([row.ended_scores for row in rows])
        label = "episode" if rows is learning.runs[0] else None
        axes.plot(ends, scores, ".", color=MUTED, markersize=6, alpha=0.5, markeredgewidth=0, label=label)
    lately = [np.concatenate([_lately(row) for row in rows]) for rows in learning.runs]
    _draw_mean(axes, lately, BLUE, f"mean of the last {LATELY}")
    if learning.aim is not None:
        axes.axhline(learning.aim, color=INK, linewidth=1.0, linestyle=(0, (4, 3)), label="aim, alone")
    axes.set_ylabel(learning.measure)
    if learning.measure != RETURN:
        axes.set_ylim(-0.05, 1.05)
        axes.yaxis.set_major_formatter(lambda value, _: _share(value))
    if not any(len(row.ended_scores) for rows in learning.runs for row in rows):
        note(axes, "no episode has ended")


def _share(value: float) -> str:
    return f"{100 * value:.0f} %"


def _lately(row: PhaseRow) -> Doubles:
    """Return the mean score of the last episodes that ended in a phase, by iteration; nan before the first."""
    means = measures.mean_of_last(row.ended_scores.astype(np.float64), LATELY)
    return _held(row.ended_after - row.start, means, len(row.captured))


def _held(places: NDArray[np.integer], values: Doubles, length: int) -> Doubles:
    """Return values that stay until the next (length,); nan before the first."""
    last = np.searchsorted(places, np.arange(length), side="right") - 1
    return np.where(last >= 0, values[last], np.nan) if len(values) else np.full(length, np.nan)


def _draw_rate(axes: Axes, learning: Learning) -> None:
    """Draw the successes of the last iterations, and what the ideal has in as many."""
    captured = [np.concatenate([row.captured for row in rows]).astype(np.float64) for rows in learning.runs]
    rates = [RATE * measures.mean_of_last(each, RATE, full=True) for each in captured]
    _draw_mean(axes, rates, BLUE, f"in the last {RATE}")
    label: str | None = "the ideal"
    for row in learning.runs[0]:
        ideals = [RATE * rows[row.phase].ideal_captures for rows in learning.runs]
        ideal = float(np.mean(ideals)) / max(row.stop - row.counted_from, 1)
        if np.isfinite(ideal):
            x = [row.counted_from, row.stop]
            axes.plot(x, [ideal] * 2, color=INK, linewidth=1.0, linestyle=(0, (4, 3)), label=label)
            label = None
    axes.set_ylim(0, max(1.0, axes.get_ylim()[1]))
    axes.set_ylabel(f"successes in {RATE} iterations")


def _draw_errors(axes: Axes, learning: Learning) -> None:
    """Draw the error of every model where there was something to foresee."""
    axes.set_yscale("log")
    axes.set_ylabel("error (MSE)")
    names = list(dict.fromkeys(name for row in learning.runs[0] for name in row.errors))
    title = f"Every model: each pair before it was learnt, values in about ±1, mean of {measures.AVERAGED}"
    axes.set_title(f"{title}, below {SMALLEST:g} drawn as that", fontsize=9.5)
    for name, colour in zip(names, MODEL_COLOURS, strict=False):
        curves = [np.concatenate([_error(row, name) for row in rows]) for rows in learning.runs]
        _draw_mean(axes, curves, colour, name)
    if not names:
        note(axes, "these results hold no errors")


def _error(row: PhaseRow, name: str) -> Doubles:
    """Return the mean error of the last pairs of a phase by iteration, `SMALLEST` at least; nan before the first."""
    errors = row.errors.get(name, np.full(len(row.captured), np.nan)).astype(np.float64)
    known = np.flatnonzero(np.isfinite(errors))
    means = measures.mean_of_last(errors[known], measures.AVERAGED)
    means[: FEWEST - 1] = np.nan
    return _held(known, np.maximum(means, SMALLEST), len(errors))


def _draw_mean(axes: Axes, curves: Sequence[Doubles], colour: str, label: str) -> None:
    """Draw the mean of runs, and of several its band; at a few hundred places, which is all that can be seen."""
    longest = max(len(curve) for curve in curves)
    step = max(1, longest // POINTS)
    mean, low, high = band([curve[::step] for curve in curves])
    x = step * np.arange(len(mean))
    if len(curves) > 1:
        axes.fill_between(x, low, high, color=colour, alpha=0.25, linewidth=0)
    axes.plot(x, mean, color=colour, linewidth=1.5, label=label)


def _fill_film(film: Film, learning: Learning, figure: SubFigure) -> None:
    """Draw an episode: a panel a moment, all with one scale."""
    score = ""
    if film.score is not None:
        score = f"return {film.score:.4g}, " if learning.measure == RETURN else f"score {_share(film.score)}, "
    what = "Typical (median) episode" if film.what == "median" else "Worst episode"
    title = (
        f"{what} of the last phase {_who(learning)}, from iteration {film.start}: {film.steps} actions, {score}"
        f"ended with “{film.event}”"
    )
    figure.suptitle(title, x=0.01, ha="left", fontsize=9.5)
    shown = list(film.shown())
    box = box_of([picture.drawing for _, picture in shown if picture.drawing is not None])
    panels = figure.subplots(1, MOMENTS, squeeze=False)[0]
    for axes in panels[len(shown) :]:
        axes.set_visible(False)
    for axes, (moment, picture) in zip(panels, shown, strict=False):
        show(axes, picture, box)
        axes.set_xlabel(f"after {moment} action{'s' if moment > 1 else ''}" if moment else "at first", fontsize=8.5)


def _who(learning: Learning) -> str:
    row = next(row for row in learning.runs[0] if row.films)
    return "alone" if row.alone else "taught"
