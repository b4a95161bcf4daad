"""Dots and words on a terminal, in braille: two dots a character across and four down, about equally far apart."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby, pairwise
from operator import itemgetter

from rich.text import Text

Point = tuple[float, float]

_BLANK = 0x2800
_BITS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Unicode's first braille character, and the bit of each dot by row and column."""


@dataclass(frozen=True)
class Window:
    """The part of the scene that is drawn: its middle, and the side of the square around it that must be seen."""

    x: float
    y: float
    span: float


class Canvas:
    """Braille dots over a window of the scene; in each character the last colour drawn wins."""

    def __init__(self, columns: int, rows: int, window: Window, turn_rad: float = 0.0) -> None:
        self._columns, self._rows, self._window = columns, rows, window
        self._cos, self._sin = math.cos(turn_rad), math.sin(turn_rad)
        self._dots_per_unit = min(2 * columns, 4 * rows) / window.span
        self._bits = [[0] * columns for _ in range(rows)]
        self._styles = [[""] * columns for _ in range(rows)]
        self._written: dict[tuple[int, int], str] = {}

    def _place(self, point: Point) -> Point:
        """Return where a point of the scene lies, in dots to the right and down."""
        x, y = point[0] - self._window.x, point[1] - self._window.y
        right, up = x * self._cos - y * self._sin, x * self._sin + y * self._cos
        return self._columns + right * self._dots_per_unit, 2 * self._rows - up * self._dots_per_unit

    def _set(self, x: float, y: float, style: str) -> None:
        column, row = math.floor(x / 2), math.floor(y / 4)
        if 0 <= column < self._columns and 0 <= row < self._rows:
            self._bits[row][column] |= _BITS[math.floor(y) % 4][math.floor(x) % 2]
            self._styles[row][column] = style

    def _clip(self, start: Point, end: Point) -> tuple[Point, Point] | None:
        """Return the part of a line, in dots, that lies in the window, if any: no line costs more than the window."""
        first, last = 0.0, 1.0
        for a, b, most in zip(start, end, (2 * self._columns, 4 * self._rows), strict=True):
            if a == b:
                if not 0 <= a <= most:
                    return None
                continue
            near, far = sorted(((0 - a) / (b - a), (most - a) / (b - a)))
            first, last = max(first, near), min(last, far)
        if first > last:
            return None
        (x0, y0), (dx, dy) = start, (end[0] - start[0], end[1] - start[1])
        return (x0 + first * dx, y0 + first * dy), (x0 + last * dx, y0 + last * dy)

    def dot(self, point: Point, style: str) -> None:
        """Draw one dot."""
        self._set(*self._place(point), style)

    def line(self, start: Point, end: Point, style: str, every: int = 1) -> None:
        """Draw a straight line; `every` third dot, say, makes it a broken one."""
        seen = self._clip(self._place(start), self._place(end))
        if seen is None:
            return
        (x0, y0), (x1, y1) = seen
        steps = max(1, math.ceil(max(abs(x1 - x0), abs(y1 - y0))))
        for i in range(0, steps + 1, every):
            self._set(x0 + (x1 - x0) * i / steps, y0 + (y1 - y0) * i / steps, style)

    def path(self, points: Iterable[Point], style: str) -> None:
        """Draw lines from each point to the next."""
        for start, end in pairwise(points):
            self.line(start, end, style)

    def circle(self, centre: Point, radius: float, style: str) -> None:
        """Draw a circle, a single dot at least."""
        x, y = self._place(centre)
        dots = radius * self._dots_per_unit
        for row in _within(y, dots, 4 * self._rows):
            half = _half_chord(row + 0.5 - y, dots)
            self._set(x - half, row, style)
            self._set(x + half, row, style)
        for column in _within(x, dots, 2 * self._columns):
            half = _half_chord(column + 0.5 - x, dots)
            self._set(column, y - half, style)
            self._set(column, y + half, style)
        if dots < 1:
            self._set(x, y, style)

    def disc(self, centre: Point, radius: float, style: str) -> None:
        """Draw a filled circle."""
        x, y = self._place(centre)
        dots = radius * self._dots_per_unit
        for row in _within(y, dots, 4 * self._rows):
            for column in _within(x, _half_chord(row + 0.5 - y, dots), 2 * self._columns):
                self._set(column, row, style)
        self.dot(centre, style)

    def cross(self, centre: Point, style: str) -> None:
        """Draw a small × whose size does not depend on the scale."""
        x, y = self._place(centre)
        for i in (-2, -1, 0, 1, 2):
            self._set(x + i, y + i, style)
            self._set(x + i, y - i, style)

    def write(self, place: Point, words: str, style: str) -> None:
        """Write words from a point on, over what is drawn there."""
        x, y = self._place(place)
        column, row = math.floor(x / 2), math.floor(y / 4)
        for i, character in enumerate(words):
            if 0 <= column + i < self._columns and 0 <= row < self._rows:
                self._written[row, column + i] = character
                self._styles[row][column + i] = style

    def text(self) -> Text:
        """Return the characters."""
        text = Text(no_wrap=True, end="")
        for row, (bits, styles) in enumerate(zip(self._bits, self._styles, strict=True)):
            dotted = (chr(_BLANK + dots) if dots else " " for dots in bits)
            characters = (self._written.get((row, column), dots) for column, dots in enumerate(dotted))
            for style, run in groupby(zip(styles, characters, strict=True), itemgetter(0)):
                text.append("".join(character for _, character in run), style or None)
            text.append("\n")
        text.right_crop(1)
        return text


def _within(middle: float, reach: float, count: int) -> range:
    """Return the rows or columns of dots, of `count` in the window, that are at most so far from a middle."""
    return range(max(0, math.ceil(middle - reach)), min(count, math.floor(middle + reach) + 1))


def _half_chord(away: float, radius: float) -> float:
    """Return half the length of a circle's chord that is so far from its middle; 0 outside."""
    return math.sqrt(max(0.0, radius * radius - away * away))
