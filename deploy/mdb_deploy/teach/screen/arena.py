"""The arena from above in braille dots: pure functions from what a teacher sees to text.

Owns which part of the arena is drawn and how. Two dots a character across and four down, so they lie about
equally far apart both ways in most terminals.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby, pairwise
from operator import itemgetter

from rich.text import Text

from mdb_protocol.messages import Reading
from mdb_sim.bodies.pioneer.arena import BODY_RADIUS_M, body_centre_m
from mdb_sim.bodies.pioneer.perceive import unfold
from mdb_sim.body import Placement, RobotConfig

Point = tuple[float, float]

SPANS_M = (2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 48.0, 100.0, 200.0)
"""Sides of the square that is sure to be visible: few, so that the picture seldom jumps (ours)."""
MARGIN_M = 0.35
"""Free space around robot and object."""
NOSE_M = 0.38
"""The line that tells where the front is goes so far from the centre of rotation."""
GRID_M = 1.0
ROBOT, OBJECT, TRAIL, ECHO, WALL, GRID = (
    "bold bright_white",
    "bold yellow",
    "cyan",
    "bright_magenta",
    "white",
    "grey50",
)

_BLANK = 0x2800
_BITS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Unicode's first braille character, and the bit of each dot by row and column."""


@dataclass(frozen=True)
class Window:
    """The part of the arena that is drawn: its middle, and the side of the square around it that must be seen."""

    x_m: float
    y_m: float
    span_m: float

    def shows(self, points: Iterable[Point]) -> bool:
        """Whether all points, with their margin, are seen however the picture is turned."""
        reach_m = self.span_m / 2 - MARGIN_M
        return all(math.hypot(x - self.x_m, y - self.y_m) <= reach_m for x, y in points)


def follow(window: Window | None, placement: Placement) -> Window:
    """Return the window for this placement: the same as long as it shows robot and object and is not far too wide."""
    robot, thing = placement.robot, (placement.object_x_m, placement.object_y_m)
    needed_m = math.hypot(thing[0] - robot.x_m, thing[1] - robot.y_m) + 2 * MARGIN_M
    span_m = next((span for span in SPANS_M if span >= needed_m), needed_m)
    if window and window.span_m <= 2 * span_m and window.shows([(robot.x_m, robot.y_m), thing]):
        return window
    return Window((robot.x_m + thing[0]) / 2, (robot.y_m + thing[1]) / 2, span_m)


def echo(placement: Placement, reading: Reading) -> Point | None:
    """Return where in the arena the robot perceives the object's surface, x_m and y_m, or None: it does not.

    The reading's angle is folded to the front half, and its continuity tells front from rear.
    """
    if not {"distance", "angle", "continuity"} <= reading.keys():
        return None
    robot = placement.robot
    towards_rad = robot.heading_rad + unfold(reading)
    distance_m = reading["distance"]
    return robot.x_m + distance_m * math.cos(towards_rad), robot.y_m + distance_m * math.sin(towards_rad)


@dataclass(frozen=True)
class Picture:
    """What is to be drawn: the truth of the scene, the robot's way there, and what it perceives."""

    placement: Placement
    trail: tuple[Point, ...] = ()
    reading: Reading | None = None
    heading_up: bool = False
    """Turn the picture so that the robot's front is up; otherwise the arena's x axis is to the right."""


def draw(picture: Picture, window: Window, world: RobotConfig, columns: int, rows: int) -> Text:
    """Return the arena in so many characters across and down, each line `columns` wide."""
    if columns < 1 or rows < 1:
        return Text()
    turn_rad = math.pi / 2 - picture.placement.robot.heading_rad if picture.heading_up else 0.0
    canvas = Canvas(columns, rows, window, turn_rad)
    _draw_ground(canvas, window, world)
    canvas.path(picture.trail, TRAIL)
    placement, robot = picture.placement, picture.placement.robot
    canvas.disc((placement.object_x_m, placement.object_y_m), world.object_radius_m, OBJECT)
    centre = (robot.x_m, robot.y_m)
    if picture.reading and (heard := echo(placement, picture.reading)):
        canvas.line(centre, heard, ECHO, every=3)
        canvas.cross(heard, ECHO)
    canvas.circle(body_centre_m(robot), BODY_RADIUS_M, ROBOT)
    nose = (robot.x_m + NOSE_M * math.cos(robot.heading_rad), robot.y_m + NOSE_M * math.sin(robot.heading_rad))
    canvas.line(centre, nose, ROBOT)
    return canvas.text()


def _draw_ground(canvas: Canvas, window: Window, world: RobotConfig) -> None:
    """A dot at each metre, and the walls."""
    half_m, reach_m = world.arena_m / 2, 2 * window.span_m
    step_m = GRID_M * max(1, round(window.span_m / 12))
    for i in range(math.ceil((window.x_m - reach_m) / step_m), math.floor((window.x_m + reach_m) / step_m) + 1):
        for j in range(math.ceil((window.y_m - reach_m) / step_m), math.floor((window.y_m + reach_m) / step_m) + 1):
            if max(abs(i * step_m), abs(j * step_m)) <= half_m:
                canvas.dot((i * step_m, j * step_m), GRID)
    corners = [(half_m, half_m), (-half_m, half_m), (-half_m, -half_m), (half_m, -half_m), (half_m, half_m)]
    canvas.path(corners, WALL)


class Canvas:
    """Braille dots over a window of the arena; in each character the last colour drawn wins."""

    def __init__(self, columns: int, rows: int, window: Window, turn_rad: float = 0.0) -> None:
        self._columns, self._rows, self._window = columns, rows, window
        self._cos, self._sin = math.cos(turn_rad), math.sin(turn_rad)
        self._dots_per_m = min(2 * columns, 4 * rows) / window.span_m
        self._bits = [[0] * columns for _ in range(rows)]
        self._styles = [[""] * columns for _ in range(rows)]

    def _place(self, point: Point) -> Point:
        """Return where a point of the arena lies, in dots to the right and down."""
        x_m, y_m = point[0] - self._window.x_m, point[1] - self._window.y_m
        right_m, up_m = x_m * self._cos - y_m * self._sin, x_m * self._sin + y_m * self._cos
        return self._columns + right_m * self._dots_per_m, 2 * self._rows - up_m * self._dots_per_m

    def _set(self, x: float, y: float, style: str) -> None:
        column, row = math.floor(x / 2), math.floor(y / 4)
        if 0 <= column < self._columns and 0 <= row < self._rows:
            self._bits[row][column] |= _BITS[math.floor(y) % 4][math.floor(x) % 2]
            self._styles[row][column] = style

    def dot(self, point: Point, style: str) -> None:
        """Draw one dot."""
        self._set(*self._place(point), style)

    def line(self, start: Point, end: Point, style: str, every: int = 1) -> None:
        """Draw a straight line; `every` third dot, say, makes it a broken one."""
        (x0, y0), (x1, y1) = self._place(start), self._place(end)
        steps = max(1, math.ceil(max(abs(x1 - x0), abs(y1 - y0))))
        for i in range(0, steps + 1, every):
            self._set(x0 + (x1 - x0) * i / steps, y0 + (y1 - y0) * i / steps, style)

    def path(self, points: Iterable[Point], style: str) -> None:
        """Draw lines from each point to the next."""
        for start, end in pairwise(points):
            self.line(start, end, style)

    def circle(self, centre: Point, radius_m: float, style: str) -> None:
        """Draw a circle, a single dot at least."""
        x, y = self._place(centre)
        radius = radius_m * self._dots_per_m
        for i in range(count := max(8, math.ceil(2 * math.pi * radius))):
            angle_rad = 2 * math.pi * i / count
            self._set(x + radius * math.cos(angle_rad), y + radius * math.sin(angle_rad), style)

    def disc(self, centre: Point, radius_m: float, style: str) -> None:
        """Draw a filled circle."""
        for i in range(count := max(1, math.ceil(radius_m * self._dots_per_m))):
            self.circle(centre, radius_m * (i + 1) / count, style)
        self.dot(centre, style)

    def cross(self, centre: Point, style: str) -> None:
        """Draw a small × whose size does not depend on the scale."""
        x, y = self._place(centre)
        for i in (-2, -1, 0, 1, 2):
            self._set(x + i, y + i, style)
            self._set(x + i, y - i, style)

    def text(self) -> Text:
        """Return the characters."""
        text = Text(no_wrap=True, end="")
        for bits, styles in zip(self._bits, self._styles, strict=True):
            characters = (chr(_BLANK + dots) if dots else " " for dots in bits)
            for style, run in groupby(zip(styles, characters, strict=True), itemgetter(0)):
                text.append("".join(character for _, character in run), style or None)
            text.append("\n")
        text.right_crop(1)
        return text
