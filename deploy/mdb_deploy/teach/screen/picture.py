"""A scene on the terminal, any machine's: its drawing, its image, or its numbers. Pure functions to text.

Owns which part of a drawing is seen and how each shape is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from rich.text import Text

from mdb_deploy.teach.screen.canvas import Canvas, Window
from mdb_protocol import words
from mdb_protocol.messages import Drawing, Shape

STEP = math.sqrt(2.0)
"""A window is so much larger than the next smaller one: few sizes, so that the picture seldom jumps (ours)."""
FAR_TOO_WIDE = 2.0
"""A window that shows so much more than it must becomes smaller."""
STYLES = {
    "robot": "bold bright_white",
    "thing": "bold yellow",
    "trail": "cyan",
    "sensed": "bright_magenta",
    "wall": "white",
    "ground": "grey50",
}
GRID = "grey50"
FAINT, TITLE = "grey50", "bold"
MOST_WORDS = 200
"""Characters of the words in a drawing."""
HALF_BLOCK = "\u2580"
"""Its upper half has the text's colour, its lower half the background's."""


def follow(window: Window | None, drawing: Drawing) -> Window:
    """Return the window for a drawing: the same as long as it shows all that must be seen and is not far too wide."""
    left, low, right, high = drawing.box
    middle, needed = ((left + right) / 2, (low + high) / 2), math.hypot(right - left, high - low)
    if window is not None and window.span <= FAR_TOO_WIDE * needed:
        corners = [(x, y) for x in (left, right) for y in (low, high)]
        if all(math.hypot(x - window.x, y - window.y) <= window.span / 2 for x, y in corners):
            return window
    steps = math.ceil(math.log(needed) / math.log(STEP) - 1e-9)
    return Window(*middle, STEP**steps)


def draw(drawing: Drawing, window: Window, columns: int, rows: int, *, front_up: bool = False) -> Text:
    """Return a drawing in so many characters across and down, each line `columns` wide.

    front_up: turn it so that the robot's front is up; otherwise the scene's x axis is to the right.
    """
    if columns < 1 or rows < 1:
        return Text()
    turn_rad = math.pi / 2 - drawing.front_rad if front_up and drawing.front_rad is not None else 0.0
    canvas = Canvas(columns, rows, window, turn_rad)
    _draw_grid(canvas, window)
    for shape in drawing.shapes:
        _draw_shape(canvas, shape)
    return canvas.text()


def _draw_grid(canvas: Canvas, window: Window) -> None:
    """A dot at each unit, or at each ten, hundred, tenth of one, as it fits."""
    step = 10.0 ** math.floor(math.log10(window.span / 2))
    reach = 2 * window.span
    for i in range(math.ceil((window.x - reach) / step), math.floor((window.x + reach) / step) + 1):
        for j in range(math.ceil((window.y - reach) / step), math.floor((window.y + reach) / step) + 1):
            canvas.dot((i * step, j * step), GRID)


def _draw_shape(canvas: Canvas, shape: Shape) -> None:
    style, first = STYLES[shape.what], shape.points[0]
    match shape.kind:
        case "line" if shape.what == "sensed" and len(shape.points) == 2:
            canvas.line(first, shape.points[1], style, every=3)
        case "line":
            canvas.path(shape.points, style)
        case "circle":
            canvas.circle(first, shape.radius, style)
        case "disc":
            canvas.disc(first, shape.radius, style)
        case "cross":
            canvas.cross(first, style)
        case "words":
            canvas.write(first, words.shown(shape.words, MOST_WORDS), style)


def show_image(image: np.ndarray, columns: int, rows: int) -> Text:
    """Return an image (rows, columns, 3) as large as fits, two pixels a character."""
    height, width = image.shape[:2]
    scale = min(columns / width, 2 * rows / height)
    across, down = max(1, int(width * scale)), max(2, int(height * scale) // 2 * 2)
    picked = image[np.arange(down) * height // down][:, np.arange(across) * width // across]
    text = Text(no_wrap=True, end="")
    for upper, lower in zip(picked[0::2], picked[1::2], strict=True):
        for above, below in zip(upper.tolist(), lower.tolist(), strict=True):
            text.append(HALF_BLOCK, f"rgb({','.join(map(str, above))}) on rgb({','.join(map(str, below))})")
        text.append("\n")
    text.right_crop(1)
    return text


def show_numbers(now: Mapping[str, float], reading: Mapping[str, float | list[float]] | None, rows: int) -> Text:
    """Return the numbers of a scene and of what is perceived, one a line, as many as fit."""
    lines = [Text("the scene", TITLE), *(Text(f"  {name:<20}{value:>12.4g}") for name, value in now.items())]
    lines += [Text("perceived", TITLE)]
    for name, value in (reading or {}).items():
        told = " ".join(f"{number:.3g}" for number in value) if isinstance(value, list) else f"{value:>12.4g}"
        lines.append(Text(f"  {name:<20}{told}"))
    return Text("\n", end="").join(lines[:rows])
