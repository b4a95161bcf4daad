"""The paper's figure 6 from a run log alone: real executions with the teacher, and without.

Owns which episodes are shown and how. They are typical, not the best: of those that ended in a success, the
ones whose length is nearest to the median, one for each side on which the object lay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mdb_sim.bodies.pioneer.world import config_of
from mdb_sim.body import Numbers
from mdb_sim.runs.record import Episode, RunRecord

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POSES = ("x_m", "y_m", "heading_rad", "object_x_m", "object_y_m")
"""What a scene must have to be drawn from above."""
PLACE = ("x_m", "y_m")
"""What a scene must have for its robot's path to be drawn."""
MOST_NUMBERS = 4
"""Numbers of another scene that are drawn."""
SIDES = 4
"""Sectors around the robot, each with at most one episode."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#8A4F7D")
"""One a sector; told apart by colour-blind readers (after Okabe and Ito)."""
MARGIN_M = 0.05
ARROW_M = 0.13
"""Length of the arrow that shows the heading after each step."""
SMALLEST_M = 1.6
"""Half of the panel's side, at least."""


def draw_trajectories(record: RunRecord, figure: Figure) -> None:
    """Fill a figure: left with a teacher, right without, in the same scale.

    Of a robot that is to reach an object: from above, every start in the centre. Of any other that has a place: its
    paths. Of any other machine: the scene's numbers.
    """
    known = set(next(iter(record.scenes.values())).now if record.scenes else ())
    if not (set(POSES) <= known and record.experiment.robot.successes == ("capture",)):
        (_draw_paths if set(PLACE) <= known else _draw_numbers)(record, figure)
        return
    panels: Sequence[Axes] = figure.subplots(1, 2, sharex=True, sharey=True)
    with_teacher, without = captured(record, taught=True), captured(record, taught=False)
    half_m = SMALLEST_M
    for axes, title, episodes in ((panels[0], "With teacher", with_teacher), (panels[1], "Without", without)):
        shown = typical(episodes)
        for side, episode in shown:
            half_m = max(half_m, _draw_episode(axes, record, episode, COLOURS[side % len(COLOURS)]))
        axes.plot(0, 0, "o", color="#222222", markersize=4.5, zorder=5)
        _caption(axes, title, shown, episodes)
    for axes in panels:
        axes.set_xlim(-half_m, half_m)
        axes.set_ylim(-half_m, half_m)
        axes.set_aspect("equal")
        axes.set_xlabel("x (m)")
    panels[0].set_ylabel("y (m)")


def captured(record: RunRecord, *, taught: bool) -> list[Episode]:
    """Return the episodes that ended in a success; see `ended`."""
    return [episode for episode in ended(record, taught=taught) if episode.success]


def ended(record: RunRecord, *, taught: bool) -> list[Episode]:
    """Return the episodes, whole in phases with or without a teacher, in order.

    None of those that began while exploration was forced: the robot did as it was told by chance.
    """
    found = []
    for episode in record.episodes():
        last = episode.start + episode.steps - 1
        first_span, last_span = record.span_at(episode.start), record.span_at(last)
        if episode.start < record.random_iterations or first_span is None:
            continue
        if first_span == last_span and (first_span.teacher is not None) == taught:
            found.append(episode)
    return found


def typical(episodes: Sequence[Episode]) -> list[tuple[int, Episode]]:
    """Return for each side of the robot the episode of the most ordinary length; the earliest of equals."""
    if not episodes:
        return []
    median = float(np.median([episode.steps for episode in episodes]))
    chosen: dict[int, Episode] = {}
    for episode in episodes:
        if not set(POSES) <= set(episode.places[0]):
            continue
        side = _side(episode.places[0])
        best = chosen.get(side)
        if best is None or abs(episode.steps - median) < abs(best.steps - median):
            chosen[side] = episode
    return sorted(chosen.items())


def nearest_to_median(episodes: Sequence[Episode]) -> list[Episode]:
    """Return as many episodes as there are colours, of the most ordinary length; the earliest of equals."""
    if not episodes:
        return []
    median = float(np.median([episode.steps for episode in episodes]))
    return sorted(episodes, key=lambda episode: abs(episode.steps - median))[: len(COLOURS)]


def _side(place: Numbers) -> int:
    direction_rad = math.atan2(place["object_y_m"] - place["y_m"], place["object_x_m"] - place["x_m"])
    return int((direction_rad + math.pi) / (2 * math.pi) * SIDES) % SIDES


def _draw_episode(axes: Axes, record: RunRecord, episode: Episode, colour: str) -> float:
    """Draw path, headings, object and capture distance; return how far from the centre they reach (m)."""
    from matplotlib.patches import Circle

    world = config_of(record.experiment.robot.options)
    first = episode.places[0]
    x = np.array([place["x_m"] for place in episode.places]) - first["x_m"]
    y = np.array([place["y_m"] for place in episode.places]) - first["y_m"]
    heading_rad = np.array([place["heading_rad"] for place in episode.places])
    axes.plot(x, y, color=colour, linewidth=1.3, alpha=0.7)
    axes.quiver(
        x, y, np.cos(heading_rad), np.sin(heading_rad), color=colour, angles="xy", scale_units="xy",
        scale=1 / ARROW_M, width=0.006, headwidth=4, headlength=4.5, headaxislength=4, zorder=4,
    )  # fmt: skip
    centre = (first["object_x_m"] - first["x_m"], first["object_y_m"] - first["y_m"])
    reach_m = world.object_radius_m + world.capture_distance_m
    axes.add_patch(Circle(centre, world.object_radius_m, facecolor=colour, edgecolor="none", alpha=0.55))
    axes.add_patch(Circle(centre, reach_m, fill=False, edgecolor=colour, linestyle=":", linewidth=0.9))
    return float(max(np.abs([*x, *y]).max(), np.abs(centre).max() + reach_m)) + MARGIN_M


def _draw_paths(record: RunRecord, figure: Figure) -> None:
    """Draw where the robot went in typical episodes, from above; a dot where each began."""
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, (title, taught) in zip(panels, (("With teacher", True), ("Without", False)), strict=True):
        episodes = ended(record, taught=taught)
        shown = nearest_to_median(episodes)
        for colour, episode in zip(COLOURS, shown, strict=False):
            x, y = ([place[name] for place in episode.places] for name in PLACE)
            axes.plot(x, y, color=colour, linewidth=1.3)
            axes.plot(x[0], y[0], "o", color=colour, markersize=4.5)
        axes.set_aspect("equal")
        axes.set_xlabel("x (m)")
        _caption(axes, title, [(0, episode) for episode in shown], episodes, "episodes")
    panels[0].set_ylabel("y (m)")


def _draw_numbers(record: RunRecord, figure: Figure) -> None:
    """Draw each number of the scene over the actions of typical episodes: of any machine."""
    with_teacher, without = ended(record, taught=True), ended(record, taught=False)
    first = next((e.places[0] for e in (*with_teacher, *without)), {})
    names = [name for name in first if name != "reward"][:MOST_NUMBERS]
    if not names:
        axes = figure.subplots()
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no episode has ended in this log", ha="center", color="#767676")
        return
    panels = figure.subplots(len(names), 2, sharex=True, sharey="row", squeeze=False)
    for column, (title, episodes) in enumerate((("With teacher", with_teacher), ("Without", without))):
        shown = nearest_to_median(episodes)
        for row, name in enumerate(names):
            axes = panels[row][column]
            for colour, episode in zip(COLOURS, shown, strict=False):
                axes.plot([place[name] for place in episode.places], color=colour, linewidth=1.3)
            if column == 0:
                axes.set_ylabel(name)
        panels[-1][column].set_xlabel("actions")
        _caption(panels[0][column], title, [(0, episode) for episode in shown], episodes, "episodes")


def _caption(
    axes: Axes, title: str, shown: Sequence[tuple[int, Episode]], episodes: Sequence[Episode], what: str = "captures"
) -> None:
    axes.set_title(title, fontsize=12, pad=20)
    if not episodes:
        text = f"no {what} in this log"
        axes.text(0.5, 0.6, text, transform=axes.transAxes, ha="center", color="#767676", fontsize=11)
        return
    median = np.median([episode.steps for episode in episodes])
    steps = ", ".join(str(episode.steps) for _, episode in shown)
    text = f"{steps} steps; median of all {len(episodes)} {what}: {median:g} steps"
    axes.text(0, 1.015, text, transform=axes.transAxes, fontsize=9, color="#767676")
