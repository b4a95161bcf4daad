"""The paper's figures 4 to 6 from a run log alone, and figures 4 and 5 over several seeds.

Owns what is drawn and how it looks; what is measured is in `measures`. Needs matplotlib, which the extra
"plot" brings and which is imported only when something is drawn. Draws unfinished and short runs as far as
they go.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from mdb_protocol.errors import MdbError
from mdb_protocol.words import shown
from mdb_services.recorder import EmptyLogError
from mdb_sim.figures.people import Stay, lanes, stays
from mdb_sim.runs import measures
from mdb_sim.runs.record import Doubles, RunRecord, read_record
from mdb_sim.runs.trajectories import draw_trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 150
STYLE: Any = {
    "font.size": 10.5,
    "axes.titlesize": 11,
    "axes.labelsize": 10.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlelocation": "left",
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "text.parse_math": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "mdb",
}
BLUE, ORANGE, GREEN, INK, MUTED = "#0072B2", "#D55E00", "#009E73", "#222222", "#767676"
"""Colours that colour-blind readers tell apart (Okabe and Ito)."""
TEACHER_SHADES = ("#d9e8f3", "#fbe6d3", "#d9efe6", "#f3e0ec")
"""One background a teacher, in the order of appearance; without a teacher it is white."""
ERROR_TOP = (0.3, 2.0)
"""Least and greatest upper end of an error axis; above 1 the model is worse than saying 0 to everything."""
ROOM = 0.07
"""Words of a phase need so much of the iteration axis."""
LANE = 0.06
"""Height of the strip of a person who taught, as a share of the panel."""
MOST_NAME = 40
"""Characters of a phase's name."""
RESAMPLES = 2000
"""Bootstrap samples of the seeds behind a 95 % band."""


def draw(run: Path, out: Path | None = None) -> list[Path]:
    """Draw figures 4, 5 and 6 of a run as PNG and SVG into `out` (the run folder itself); return the files.

    MdbError when matplotlib, the run log or the experiment file is missing.
    """
    need_matplotlib()
    record = _drawable(run)
    folder = run if out is None else out
    figures: tuple[tuple[str, Callable[[RunRecord, Figure], None], tuple[float, float]], ...] = (
        ("figure4", _draw_errors, (9.0, 7.2)),
        ("figure5", _draw_successes, (9.0, 4.6)),
        ("figure6", draw_trajectories, (10.0, 5.5)),
    )
    return [
        path
        for name, fill, size in figures
        for path in save(folder / name, size, lambda figure, fill=fill: fill(record, figure))  # type: ignore[misc]
    ]


def draw_band(runs: Sequence[Path], out: Path) -> list[Path]:
    """Draw figures 4 and 5 over several runs: each run thin, their mean with its 95 % confidence band.

    The runs should be of one experiment file with different seeds: phases are drawn as in the first.
    """
    need_matplotlib()
    if not runs:
        raise MdbError("no runs to draw; give at least one run folder")
    records = [_drawable(run) for run in runs]
    return [
        *save(out / "figure4-seeds", (9.0, 7.2), lambda figure: _draw_errors_band(records, figure)),
        *save(out / "figure5-seeds", (9.0, 4.6), lambda figure: _draw_successes_band(records, figure)),
    ]


def _drawable(run: Path) -> RunRecord:
    """Return a run's record; EmptyLogError when there is no iteration in it."""
    record = read_record(run)
    if not record.reported.any():
        raise EmptyLogError(f"no iteration is in the run log of {run}: nothing to draw")
    return record


def need_matplotlib() -> None:
    """Raise MdbError when matplotlib is missing: to be called before hours of runs, not after."""
    try:
        import matplotlib  # noqa: F401 - an extra
    except ImportError as error:
        raise MdbError(
            "drawing needs matplotlib, which is not installed; run pip install 'multilevel-darwinist-brain[plot]'"
        ) from error


def save(
    stem: Path,
    size: tuple[float, float],
    fill: Callable[[Figure], None],
    kinds: Sequence[str] = ("png", "svg"),
    dpi: int = DPI,
) -> list[Path]:
    """Make, fill and write one figure in these kinds; nothing of matplotlib's global state is touched.

    Nor is it read: a user's `matplotlibrc` may want LaTeX, or another size.
    """
    from matplotlib import style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    stem.parent.mkdir(parents=True, exist_ok=True)
    paths = [stem.with_name(f"{stem.name}.{kind}") for kind in kinds]
    with style.context(["default", STYLE]):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        fill(figure)
        for path, kind in zip(paths, kinds, strict=True):
            figure.savefig(path, dpi=dpi, metadata={"Date": None} if kind == "svg" else None)
    return paths


ERRORS: tuple[tuple[str, Callable[[RunRecord], Doubles]], ...] = (
    (
        f"Prequential: each pair foreseen before it was learnt (mean of {measures.AVERAGED})",
        lambda record: measures.running_mean(record, measures.prequential_error(record)),
    ),
    ("Over the short-term memory", measures.memory_error),
    ("Over all command–action pairs of the present language", measures.pair_error),
)
"""The panels of figure 4."""


def _draw_errors(record: RunRecord, figure: Figure) -> None:
    """Figure 4: the three errors of the communication model; nothing where nobody teaches."""
    panels = _error_panels(record, figure)
    for axes, colour, (_, measure) in zip(panels, (BLUE, ORANGE, GREEN), ERRORS, strict=True):
        values = measure(record)
        for x, y in _pieces(record, values):
            axes.plot(x, y, color=colour, linewidth=1.5)
        _scale(axes, values)
        if not np.isfinite(values).any():
            note(axes, "no data in this log")
    raw = measures.prequential_error(record)
    panels[0].plot(raw, ".", color=BLUE, markersize=4, alpha=0.35, markeredgewidth=0)
    figure.suptitle("Error of the communication model (MSE, feedback in ±1)", x=0.01, ha="left", fontsize=12)


def _error_panels(record: RunRecord, figure: Figure) -> list[Axes]:
    panels: list[Axes] = list(figure.subplots(len(ERRORS), 1, sharex=True))
    for axes, (title, _) in zip(panels, ERRORS, strict=True):
        _shade(axes, record, labelled=axes is panels[0])
        axes.axhline(measures.THRESHOLD, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
        axes.text(1.005, measures.THRESHOLD, "10 %", transform=axes.get_yaxis_transform(), va="center", color=INK)
        axes.set_title(title, pad=20 if axes is panels[0] else 5)
        axes.set_ylabel("MSE")
    panels[-1].set_xlabel("Iteration")
    return panels


def _scale(axes: Axes, *curves: Doubles) -> None:
    """Let the error axis end a little above the curves."""
    highest = max((float(np.nanmax(curve)) for curve in curves if np.isfinite(curve).any()), default=0.0)
    axes.set_ylim(0, min(max(1.08 * highest, ERROR_TOP[0]), ERROR_TOP[1]))


def _pieces(record: RunRecord, values: Doubles) -> list[tuple[Doubles, Doubles]]:
    """Return the curve (x, y) of each taught phase by itself, so that no line crosses the phases between."""
    pieces = []
    for span in record.taught:
        x = span.start + np.flatnonzero(np.isfinite(values[span.start : span.stop]))
        if len(x):
            pieces.append((x.astype(np.float64), values[x]))
    return pieces


def _draw_successes(record: RunRecord, figure: Figure) -> None:
    """Figure 5: captures of the object against iterations, with the phases; of another machine, its successes.

    Where the experiment calls no event a success, each event that ends an episode is counted. People who taught
    beside the scripted phases have strips above the curve.
    """
    people = lanes(stays(record))
    axes = _success_axes(record, figure, under=LANE * len(people))
    if record.experiment.robot.successes:
        axes.plot(np.arange(record.iterations + 1), record.successes, color=BLUE, linewidth=2, drawstyle="steps-post")
        _count(axes, [record])
        most = int(record.successes[-1])
        if not most:
            note(axes, f"no {_successes_of(record).lower()} in this log")
    else:
        counts = {event: np.cumsum(record.event == event) for event in record.experiment.robot.ends}
        for (event, count), colour in zip(counts.items(), (BLUE, ORANGE, GREEN), strict=False):
            axes.plot(count, color=colour, linewidth=2, drawstyle="steps-post", label=event)
        axes.legend(loc="lower right", frameon=False)
        most = max((int(count[-1]) for count in counts.values() if len(count)), default=0)
    axes.set_ylim(0, max(10.0, 1.08 * most) / (1 - LANE * len(people)))
    _mark_people(axes, record, people)


def _mark_people(axes: Axes, record: RunRecord, rows: Sequence[Sequence[Stay]]) -> None:
    """Draw a strip a person at the top of the panel, in a colour of its own, from coming to leaving."""
    scripted = {span.teacher for span in record.taught}
    names = list(dict.fromkeys(stay.name for row in rows for stay in row))
    for place, row in enumerate(rows):
        top = 1 - LANE * place
        for stay in row:
            shade_of = TEACHER_SHADES[(len(scripted) + names.index(stay.name)) % len(TEACHER_SHADES)]
            axes.axvspan(
                stay.start, stay.stop, ymin=top - LANE, ymax=top, facecolor=shade_of, edgecolor=MUTED, linewidth=0.8
            )
            axes.annotate(
                f"{shown(stay.name, MOST_NAME)} teaches", (stay.start, top - LANE / 2),
                xycoords=axes.get_xaxis_transform(), xytext=(4, 0), textcoords="offset points",
                ha="left", va="center", fontsize=8.5, color=INK,
            )  # fmt: skip


def _successes_of(record: RunRecord) -> str:
    """Return in a word what is counted."""
    successes = record.experiment.robot.successes
    if successes == ("capture",):
        return "Captures"
    return f"Successes ({', '.join(successes)})" if successes else "Ends of episodes"


def _success_axes(record: RunRecord, figure: Figure, under: float = 0.0) -> Axes:
    """Make the panel of figure 5; words in it stay below its upper `under`, a share."""
    axes: Axes = figure.subplots()
    _shade(axes, record, labelled=True, above=1.07)
    axes.set_title(_title(record), pad=36, fontsize=12)
    axes.set_xlabel("Iteration")
    axes.set_ylabel(f"{_successes_of(record)} since the beginning")
    stop = min(record.random_iterations, _end(record))
    if stop > 0:
        axes.axvspan(0, stop, facecolor="none", edgecolor="#9bb4c6", hatch="///", linewidth=0)
        box = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
        axes.text(
            0.008, 0.96 - under, "random\nexploration", transform=axes.transAxes,
            ha="left", va="top", fontsize=9, color=INK, bbox=box,
        )  # fmt: skip
    return axes


def _title(record: RunRecord) -> str:
    return "Object captures" if record.experiment.robot.successes == ("capture",) else _successes_of(record)


def _count(axes: Axes, records: Sequence[RunRecord]) -> None:
    """Write above each phase the (mean) successes in it, where all logs hold all of it and there is room."""
    for span in records[0].spans:
        if span.stop - span.start < ROOM * _end(records[0]):
            continue
        start, stop = measures.success_window(records[0], span)
        count = float(np.mean([measures.successes(record, (start, stop)) for record in records]))
        if np.isfinite(count) and stop > start:
            axes.text(
                (span.start + span.stop) / 2, 1.02, f"{count:.4g} in {start}–{stop}",
                transform=axes.get_xaxis_transform(), ha="center", va="bottom", fontsize=9, color=MUTED,
            )  # fmt: skip


def _draw_errors_band(records: Sequence[RunRecord], figure: Figure) -> None:
    longest = max(records, key=lambda record: record.iterations)
    panels = _error_panels(longest, figure)
    for axes, colour, (_, measure) in zip(panels, (BLUE, ORANGE, GREEN), ERRORS, strict=True):
        found = [measure(record) for record in records]
        for record, values in zip(records, found, strict=True):
            for x, y in _pieces(record, values):
                axes.plot(x, y, color=colour, linewidth=0.6, alpha=0.35)
        mean, low, high = band(found)
        _scale(axes, *found)
        for x, y in _pieces(longest, mean):
            places = x.astype(np.int64)
            axes.fill_between(x, low[places], high[places], color=colour, alpha=0.25, linewidth=0)
            axes.plot(x, y, color=colour, linewidth=1.8)
        if not np.isfinite(mean).any():
            note(axes, "no data in these logs")
    figure.suptitle(f"Error of the communication model {_seeds(records)}", x=0.01, ha="left", fontsize=12)


def _draw_successes_band(records: Sequence[RunRecord], figure: Figure) -> None:
    longest = max(records, key=lambda record: record.iterations)
    axes = _success_axes(longest, figure)
    axes.set_title(f"{_title(longest)} {_seeds(records)}", pad=36, fontsize=12)
    found = [record.successes.astype(np.float64) for record in records]
    for values in found:
        axes.plot(values, color=BLUE, linewidth=0.6, alpha=0.4)
    mean, low, high = band(found)
    axes.fill_between(np.arange(len(mean)), low, high, color=BLUE, alpha=0.25, linewidth=0)
    axes.plot(mean, color=BLUE, linewidth=2)
    _count(axes, [longest, *(record for record in records if record is not longest)])
    axes.set_ylim(0, max(10.0, 1.08 * max(float(values[-1]) for values in found)))


def _seeds(records: Sequence[RunRecord]) -> str:
    if len(records) == 1:
        return f"(seed {records[0].seed} only: no band)"
    noun = "seed" if len({record.seed for record in records}) == len(records) else "run"
    return f"(mean of {len(records)} {noun}s, 95 % confidence band, each {noun} thin)"


def band(curves: Sequence[Doubles]) -> tuple[Doubles, Doubles, Doubles]:
    """Return the mean of curves and both ends of its 95 % bootstrap interval: (n,) for the longest curve's n.

    Resamples whole curves, always in the same way. nan where any curve is nan or has ended: a mean of fewer
    would jump where a run leaves it.
    """
    n, count = max(len(curve) for curve in curves), len(curves)
    values = np.full((count, n), np.nan)
    for row, curve in zip(values, curves, strict=True):
        row[: len(curve)] = curve
    rng = np.random.Generator(np.random.Philox(key=0))
    means = rng.multinomial(count, np.full(count, 1 / count), size=RESAMPLES) @ values / count
    low, high = np.percentile(means, [2.5, 97.5], axis=0)
    return values.mean(axis=0), low, high


class Shown(Protocol):
    """A phase as it is drawn: of a run, or of many runs alike."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def start(self) -> int: ...  # noqa: D102
    @property
    def stop(self) -> int: ...  # noqa: D102
    @property
    def teacher(self) -> str | None: ...  # noqa: D102


def shade(axes: Axes, phases: Sequence[Shown], *, labelled: bool, above: float = 1.02) -> None:
    """Mark the phases: the background of a teacher, a line at each beginning, names above."""
    teachers = list(dict.fromkeys(phase.teacher for phase in phases if phase.teacher is not None))
    for phase in phases:
        if phase.teacher is not None:
            colour = TEACHER_SHADES[teachers.index(phase.teacher) % len(TEACHER_SHADES)]
            axes.axvspan(phase.start, phase.stop, facecolor=colour, linewidth=0, zorder=0)
        if phase.start > 0:
            axes.axvline(phase.start, color=MUTED, linewidth=0.8)
    if not labelled:
        return
    for name, alike in groupby(phases, lambda phase: phase.name):  # a teacher who is silent for a while parts a phase
        parts = list(alike)
        axes.text(
            (parts[0].start + parts[-1].stop) / 2, above, shown(name, MOST_NAME),
            transform=axes.get_xaxis_transform(), ha="center", va="bottom", fontsize=9.5, color=INK,
        )  # fmt: skip


def _shade(axes: Axes, record: RunRecord, *, labelled: bool, above: float = 1.02) -> None:
    """Mark the phases of a run, and where it ended before its time."""
    shade(axes, record.spans, labelled=labelled, above=above)
    axes.set_xlim(0, _end(record))
    if labelled and record.iterations < record.experiment.brain.experiment.iterations:
        axes.axvline(record.iterations, color=ORANGE, linewidth=1, linestyle=":")
        text = f" the log ends at {record.iterations}"
        axes.text(record.iterations, 0.5, text, transform=axes.get_xaxis_transform(), color=ORANGE, fontsize=9)


def _end(record: RunRecord) -> int:
    """Return the right end of the iteration axis."""
    return max(record.spans[-1].stop if record.spans else 0, record.iterations, 1)


def note(axes: Axes, text: str) -> None:
    """Write into the middle of a panel what is missing in it."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=MUTED, fontsize=11)
