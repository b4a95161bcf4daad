"""What a body shows of its scene, in a figure: a drawing of shapes, or an image. Of any machine; needs matplotlib.

Owns how each shape looks and which part of a drawing is seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mdb_protocol.messages import Drawing, Picture, Shape
from mdb_protocol.words import shown
from mdb_sim.figures.four_to_six import BLUE, GREEN, INK, MUTED, ORANGE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Box = tuple[float, float, float, float]
COLOURS = {"robot": INK, "thing": ORANGE, "trail": BLUE, "sensed": GREEN, "wall": MUTED, "ground": "#c8c8c8"}
"""By what a shape stands for."""
MOST_WORDS = 200
"""Characters of the words in a drawing."""
SHAPE, MARGIN = 4 / 3, 1.25
"""Width of a drawing by its height; how much more is seen than must be."""


def show(axes: Axes, picture: Picture, box: Box | None) -> None:
    """Fill a panel with a picture; `box`: what must be seen of a drawing, x and y of its corners."""
    axes.set_xticks([])
    axes.set_yticks([])
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set(visible=True, color="#c8c8c8")
    if picture.image is not None:
        axes.imshow(picture.image)
    elif picture.drawing is not None and box is not None:
        for shape in picture.drawing.shapes:
            _draw_shape(axes, shape)
        axes.set_xlim(box[0], box[2])
        axes.set_ylim(box[1], box[3])
        axes.set_aspect("equal")


def box_of(drawings: Sequence[Drawing]) -> Box | None:
    """Return a box of `SHAPE` with all that must be seen of each, and a margin; None of no drawings."""
    if not drawings:
        return None
    left, low, right, high = zip(*(drawing.box for drawing in drawings), strict=True)
    x, y = (min(left) + max(right)) / 2, (min(low) + max(high)) / 2
    half = MARGIN * max(max(right) - min(left), SHAPE * (max(high) - min(low))) / 2
    return x - half, y - half / SHAPE, x + half, y + half / SHAPE


def _draw_shape(axes: Axes, shape: Shape) -> None:
    from matplotlib.patches import Circle

    colour, (x, y) = COLOURS[shape.what], shape.points[0]
    match shape.kind:
        case "line":
            dashed = ":" if shape.what == "sensed" else "-"
            axes.plot(*zip(*shape.points, strict=True), color=colour, linewidth=1.2, linestyle=dashed)
        case "circle" | "disc":
            filled = shape.kind == "disc"
            axes.add_patch(Circle((x, y), shape.radius, fill=filled, edgecolor=colour, facecolor=colour))
        case "cross":
            axes.plot(x, y, "x", color=colour, markersize=4)
        case "words":
            axes.text(x, y, shown(shape.words, MOST_WORDS), color=colour, fontsize=7, clip_on=True)
