"""What a teacher sees on the terminal: where each shape of a drawing lands, an image, numbers; whose turn it is."""

import math
from itertools import pairwise
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from rich.style import Style
from rich.text import Text

from mdb_deploy.teach.screen.canvas import Window
from mdb_deploy.teach.screen.panel import help_line
from mdb_deploy.teach.screen.picture import HALF_BLOCK, STEP, STYLES, draw, follow, show_image, show_numbers
from mdb_deploy.teach.screen.turn import HURRY, HURRY_S, closing, turn
from mdb_deploy.teach.view import Exchange, Summary, Turn, View
from mdb_protocol.messages import Drawing, Shape
from mdb_sim.bodies.pioneer.arena import BODY_RADIUS_M, body_centre_m
from mdb_sim.bodies.pioneer.drawing import draw as draw_pioneer
from mdb_sim.bodies.pioneer.drawing import echo
from mdb_sim.bodies.pioneer.perceive import fold
from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.bodies.pioneer.world import PioneerConfig, Placement, Pose
from mdb_sim.teaching.languages import Language

COLUMNS, ROWS = 40, 20
WHOLE = Window(0.0, 0.0, 4.0)
DOTS = 4 * ROWS / WHOLE.span
"""Of a unit of `WHOLE`; so many are in a row or column of the square that must be seen."""
BRAILLE = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
Place = tuple[float, float]
Cell = tuple[int, int]


def drawing_of(*shapes: Shape, box: tuple[float, float, float, float] = (-2, -2, 2, 2), **more: Any) -> Drawing:
    return Drawing(shapes=list(shapes), box=box, **more)


def shape(kind: str, *points: Place, **more: Any) -> Shape:
    return Shape(kind=kind, points=list(points), **more)  # type: ignore[arg-type]


def lines_of(text: Text) -> list[str]:
    lines = text.plain.split("\n")
    assert [len(line) for line in lines] == [COLUMNS] * ROWS
    return lines


def all_dots(drawing: Drawing, window: Window = WHOLE, **more: Any) -> set[Place]:
    """Where each dot of a drawing lies: right and up from the middle, in dots."""
    found = set()
    for row, line in enumerate(lines_of(draw(drawing, window, COLUMNS, ROWS, **more))):
        for column, character in enumerate(line):
            bits = ord(character) - 0x2800 if character >= "\u2800" else 0
            for down, pair in enumerate(BRAILLE):
                for right, bit in enumerate(pair):
                    if bits & bit:
                        found.add((2 * column + right + 0.5 - COLUMNS, 2 * ROWS - (4 * row + down + 0.5)))
    return found


def dots(*shapes: Shape, window: Window = WHOLE, **more: Any) -> list[Place]:
    """Where the dots of shapes alone lie, in the drawing's units."""
    with_them, without = drawing_of(*shapes, **more), drawing_of(**more)
    found = all_dots(with_them, window) - all_dots(without, window)
    scale = 4 * ROWS / window.span
    return [(window.x + right / scale, window.y + up / scale) for right, up in sorted(found)]


def cells_in(text: Text, style: str) -> list[Cell]:
    """Row and column of what is drawn in a style."""
    lines_of(text)
    spans = [span for span in text.spans if span.style == style]
    return [divmod(i, COLUMNS + 1) for span in spans for i in range(span.start, span.end)]


def middle_of(text: Text, style: str, window: Window = WHOLE) -> Place:
    """Mean place of what is drawn in a style: right and up from the middle, in the drawing's units."""
    cells = cells_in(text, style)
    assert cells, f"nothing is drawn in {style}"
    unit = window.span / (4 * ROWS)
    right = sum(2 * column + 1 for _, column in cells) / len(cells) - COLUMNS
    up = 2 * ROWS - sum(4 * row + 2 for row, _ in cells) / len(cells)
    return right * unit, up * unit


# ---- the shapes of a drawing ----

NEAR = 1.5 / DOTS
"""So far a dot may be from what it stands for."""


def test_a_line_goes_from_its_first_point_to_its_last_over_all_between() -> None:
    corner = [(-1.6, -1.2), (0.9, -1.2), (0.9, 1.3)]
    drawn = dots(shape("line", *corner, what="wall"))
    for x, y in drawn:
        assert min(abs(y + 1.2), abs(x - 0.9)) < NEAR, "all of it is on the line"
    for i in range(101):
        share = i / 100
        for (x0, y0), (x1, y1) in pairwise(corner):
            place = (x0 + share * (x1 - x0), y0 + share * (y1 - y0))
            assert min(math.dist(place, dot) for dot in drawn) < NEAR, "and there is no gap in it"


def test_a_line_to_what_is_sensed_is_a_broken_one() -> None:
    ends = ((-1.5, 0.3), (1.5, 0.3))
    solid, broken = dots(shape("line", *ends, what="robot")), dots(shape("line", *ends, what="sensed"))
    assert len(solid) > 2.5 * len(broken)
    assert set(broken) < set(solid)
    assert max(x for x, _ in broken) > 1.4


def test_a_circle_is_a_ring_around_its_point() -> None:
    drawn = dots(shape("circle", (0.4, -0.3), radius=1.1))
    assert all(abs(math.dist(dot, (0.4, -0.3)) - 1.1) < NEAR for dot in drawn)
    for degrees in range(0, 360, 5):
        angle_rad = math.radians(degrees)
        place = (0.4 + 1.1 * math.cos(angle_rad), -0.3 + 1.1 * math.sin(angle_rad))
        assert min(math.dist(place, dot) for dot in drawn) < NEAR


def test_a_disc_is_filled() -> None:
    drawn = set(dots(shape("disc", (0.43, -0.33), radius=0.6)))
    assert all(math.dist(dot, (0.43, -0.33)) < 0.6 + NEAR for dot in drawn)
    inside = [
        (x, y)
        for x in np.arange(-0.1, 1.0, 0.05)
        for y in np.arange(-0.9, 0.3, 0.05)
        if math.dist((x, y), (0.43, -0.33)) < 0.6
    ]
    assert all(min(math.dist(place, dot) for dot in drawn) < NEAR for place in inside)
    assert len(drawn) > 0.75 * math.pi * (0.6 * DOTS) ** 2


@pytest.mark.parametrize("kind", ["circle", "disc"])
def test_what_has_no_extent_is_a_dot_at_least(kind: str) -> None:
    ((x, y),) = dots(shape(kind, (0.72, 0.72), radius=0.0))
    assert (x, y) == pytest.approx((0.72, 0.72), abs=NEAR)


def test_a_cross_is_as_large_at_every_scale() -> None:
    sizes = []
    for span in (4.0, 400.0):
        window = Window(0.0, 0.0, span)
        drawn = dots(shape("cross", (0.13 * span, -0.16 * span), what="sensed"), window=window)
        middle = (sum(x for x, _ in drawn) / len(drawn), sum(y for _, y in drawn) / len(drawn))
        assert middle == pytest.approx((0.13 * span, -0.16 * span), abs=2 * span / (4 * ROWS))
        sizes.append((len(drawn), round((drawn[-1][0] - drawn[0][0]) * 4 * ROWS / span)))
    assert sizes == [(9, 4)] * 2


def test_words_stand_where_they_begin_over_what_is_drawn_there() -> None:
    said = shape("words", (0.5, -0.5), words="goal 1", what="ground")
    line = shape("line", (-1.9, -0.5), (1.9, -0.5), what="wall")
    lines = lines_of(draw(drawing_of(line, said), WHOLE, COLUMNS, ROWS))
    ((row, column),) = [(i, line.index("goal 1")) for i, line in enumerate(lines) if "goal 1" in line]
    assert (row, column) == (ROWS // 2 + int(0.5 * DOTS / 4), COLUMNS // 2 + int(0.5 * DOTS / 2))
    cut = lines_of(draw(drawing_of(shape("words", (1.9, 0.0), words="far away")), WHOLE, COLUMNS, ROWS))
    assert [line for line in cut if line.endswith(" f")], "what does not fit is cut off"


KINDS, STANDS_FOR = (get_args(get_type_hints(Shape)[name]) for name in ("kind", "what"))


@pytest.mark.parametrize("what", STANDS_FOR)
@pytest.mark.parametrize("kind", KINDS)
def test_what_a_shape_stands_for_gives_its_colour(kind: str, what: str) -> None:
    points = [(-1.0, 0.7), (-0.6, 0.7)] if kind == "line" else [(-0.8, 0.7)]
    drawing = drawing_of(shape(kind, *points, radius=0.1, what=what, words="...."))
    coloured, grid = (set(cells_in(draw(one, WHOLE, COLUMNS, ROWS), STYLES[what])) for one in (drawing, drawing_of()))
    rows, columns = zip(*(coloured - grid), strict=True)
    assert 2 * (sum(columns) / len(columns) + 0.5) == pytest.approx(
        COLUMNS - 0.8 * DOTS, abs=4.0 if kind == "words" else 1.0
    )
    assert 4 * (sum(rows) / len(rows) + 0.5) == pytest.approx(2 * ROWS - 0.7 * DOTS, abs=2.0)


def test_what_lies_outside_is_left_out() -> None:
    shapes = [
        shape("line", (-9.0, 0.3), (9.0, 0.3)),
        shape("circle", (30.0, 30.0), radius=1.0),
        shape("disc", (0.0, -40.0), radius=1.0),
        shape("cross", (0.0, 50.0)),
        shape("words", (-60.0, 0.0), words="far away"),
    ]
    assert all(abs(y - 0.3) < NEAR for _, y in dots(*shapes))


def test_the_grid_has_a_dot_at_each_unit_or_at_each_ten_or_tenth() -> None:
    for step in (0.1, 1.0, 10.0):
        window = Window(0.0, 0.0, 3.0 * step)
        unit = 4 * ROWS / 3.0
        found = sorted((right / unit, up / unit) for right, up in all_dots(drawing_of(), window))
        assert [(round(right), round(up)) for right, up in found] == [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)]
        assert all(abs(value - round(value)) < 1 / unit for dot in found for value in dot)


# ---- what of it is seen ----


def boxed(left: float, low: float, right: float, high: float) -> Drawing:
    return drawing_of(box=(left, low, right, high))


def is_seen(window: Window, box: tuple[float, float, float, float]) -> bool:
    """Whether a box lies in a window, however the drawing is turned."""
    left, low, right, high = box
    corners = [(x, y) for x in (left, right) for y in (low, high)]
    return all(math.hypot(x - window.x, y - window.y) <= window.span / 2 for x, y in corners)


@pytest.mark.parametrize("size", [1e-3, 0.1, 0.7, 1.5, 3.0, 9.0, 130.0, 1e5])
def test_the_box_is_seen_however_large_it_is_in_one_of_few_sizes(size: float) -> None:
    drawing = boxed(5.0, -2.0, 5.0 + size, -2.0 + size / 3)
    window = follow(None, drawing)
    assert is_seen(window, drawing.box)
    assert window.span < 1.01 * STEP * math.hypot(size, size / 3), "and not much beside it"
    steps = math.log(window.span) / math.log(STEP)
    assert steps == pytest.approx(round(steps), abs=1e-6)


def test_the_window_stays_while_the_box_is_in_it_and_follows_when_it_is_not() -> None:
    window = follow(None, boxed(-0.3, -0.3, 1.7, 0.3))
    assert follow(window, boxed(-0.1, -0.2, 1.7, 0.4)) is window
    moved = follow(window, boxed(-3.3, -0.3, 1.7, 0.3))
    assert is_seen(moved, (-3.3, -0.3, 1.7, 0.3))
    nearer = follow(moved, boxed(-0.3, -0.3, 0.3, 1.0))
    assert nearer.span < moved.span, "nearer when it is far too wide"
    assert is_seen(nearer, (-0.3, -0.3, 0.3, 1.0))


def test_turned_with_the_robot_its_front_is_up() -> None:
    thing = shape("disc", (1.0, 0.0), radius=0.15)
    for front_rad, place in (
        (0.0, (0.0, 1.0)),
        (math.pi, (0.0, -1.0)),
        (math.pi / 2, (1.0, 0.0)),
        (None, (1.0, 0.0)),
    ):
        text = draw(drawing_of(thing, front_rad=front_rad), WHOLE, COLUMNS, ROWS, front_up=True)
        assert middle_of(text, STYLES["thing"]) == pytest.approx(place, abs=0.1)


def test_a_drawing_without_room_is_empty() -> None:
    drawing = drawing_of(shape("disc", (0.0, 0.0), radius=0.5))
    assert draw(drawing, WHOLE, 0, 5).plain == ""
    assert draw(drawing, WHOLE, 5, 0).plain == ""
    assert len(draw(drawing, WHOLE, 1, 1).plain) == 1


# ---- the Pioneer's drawing ----

CONFIG = PioneerConfig()


def at(heading_rad: float, object_m: Place, robot_m: Place = (0.0, 0.0)) -> Placement:
    return Placement(Pose(*robot_m, heading_rad), *object_m)


def pioneer(placement: Placement, reading: dict[str, float] | None = None) -> Drawing:
    hull = body_centre_m(placement.robot), BODY_RADIUS_M
    return draw_pioneer(placement, [], reading or {}, CONFIG, hull)


def test_robot_and_object_are_where_they_are() -> None:
    text = draw(pioneer(at(0.0, (1.0, 1.0), robot_m=(-1.0, -0.5))), WHOLE, COLUMNS, ROWS)
    assert middle_of(text, STYLES["thing"]) == pytest.approx((1.0, 1.0), abs=0.1)
    assert middle_of(text, STYLES["robot"]) == pytest.approx((-1.0, -0.5), abs=0.15)


@pytest.mark.parametrize("heading_rad", [0.0, math.pi])
def test_turned_with_the_pioneer_what_is_in_front_is_up(heading_rad: float) -> None:
    text = draw(pioneer(at(heading_rad, (1.0, 0.0))), WHOLE, COLUMNS, ROWS, front_up=True)
    assert middle_of(text, STYLES["thing"]) == pytest.approx((0.0, math.cos(heading_rad)), abs=0.1)


@pytest.mark.parametrize("phi_deg", [0.0, 80.0, 100.0, 180.0, -100.0, -80.0])
def test_what_is_perceived_is_drawn_there_also_behind(phi_deg: float) -> None:
    heading_rad, phi_rad = 0.5, math.radians(phi_deg)
    placement, reading = at(heading_rad, (1.0, 0.0), robot_m=(0.2, 0.1)), fold(1.0, phi_rad)
    expected = 0.2 + math.cos(heading_rad + phi_rad), 0.1 + math.sin(heading_rad + phi_rad)
    assert echo(placement, reading) == pytest.approx(expected)
    (cross,) = [shape for shape in pioneer(placement, dict(reading)).shapes if shape.kind == "cross"]
    assert (cross.points[0], cross.what) == (pytest.approx(expected), "sensed")


def test_without_an_echo_nothing_is_drawn_of_it() -> None:
    placement = at(0.0, (1.0, 0.0))
    assert echo(placement, {}) is None
    assert echo(placement, {"light": 1.0}) is None, "another body's sensors"
    text = draw(pioneer(placement), WHOLE, COLUMNS, ROWS)
    assert STYLES["sensed"] not in {span.style for span in text.spans}


@pytest.mark.parametrize("distance_m", [0.1, 0.7, 1.5, 3.0, 9.0, 130.0])
def test_robot_and_object_are_both_seen_however_far_apart(distance_m: float) -> None:
    window = follow(None, pioneer(at(0.0, (distance_m, 0.0))))
    assert is_seen(window, (0.0, 0.0, distance_m, 0.0))


def test_the_trail_is_of_this_episode_and_drawing_again_adds_nothing() -> None:
    with KinematicRobot() as robot:

        def trail(reading: dict[str, float | list[float]]) -> list[Place]:
            found = [shape.points for shape in robot.draw(reading).shapes if shape.what == "trail"]
            return found[0] if found else []

        assert trail(robot.reset(1, 0)) == []
        places = [(0.0, 0.0)]
        for _ in range(2):
            _, reading = robot.act({"turn": 20.0})
            places.append((robot.scene()["x_m"], robot.scene()["y_m"]))
            assert trail(reading) == trail(reading) == places
        assert trail(robot.reset(1, 1)) == []


# ---- images ----


def pixels(text: Text) -> list[list[tuple[Any, Any]]]:
    """The colours of each line's characters: above and below."""
    lines, start = [], 0
    for line in text.plain.split("\n"):
        assert set(line) == {HALF_BLOCK}
        starting = {span.start: Style.parse(str(span.style)) for span in text.spans}
        both = [(starting[start + i].color, starting[start + i].bgcolor) for i in range(len(line))]
        lines.append([tuple(tuple(colour.triplet or ()) for colour in two if colour) for two in both])
        start += len(line) + 1
    return lines


def image_of(rows: int, columns: int) -> np.ndarray:
    """An image of which each pixel has a colour of its own."""
    numbers = np.arange(rows * columns)
    return (
        np.stack([numbers % 256, numbers // 256, 255 - numbers % 256], axis=-1)
        .astype(np.uint8)
        .reshape(rows, columns, 3)
    )


def test_an_image_that_fits_has_its_pixels_two_a_character() -> None:
    image = image_of(4, 6)
    shown = pixels(show_image(image, 6, 2))
    expected = [[(tuple(image[2 * r, c]), tuple(image[2 * r + 1, c])) for c in range(6)] for r in range(2)]
    assert shown == expected


@pytest.mark.parametrize(
    ("size", "room", "lines", "width"),
    [
        ((2, 2), (10, 5), 5, 10),
        ((64, 256), (40, 20), 5, 40),
        ((256, 64), (40, 20), 20, 10),
        ((256, 256), (3, 1), 1, 2),
    ],
)
def test_an_image_is_as_large_as_fits_and_keeps_its_shape(
    size: tuple[int, int], room: tuple[int, int], lines: int, width: int
) -> None:
    text = show_image(image_of(*size), *room)
    assert [len(line) for line in text.plain.split("\n")] == [width] * lines
    assert text.cell_len == lines * width


def test_of_a_large_image_pixels_all_over_it_are_shown_and_of_a_small_one_each_as_a_square() -> None:
    image = np.zeros((100, 100, 3), np.uint8)
    image[:60, 50:] = (255, 0, 0)
    black, red = (0, 0, 0), (255, 0, 0)
    upper, lower = [(black, black)] * 5 + [(red, red)] * 5, [(black, black)] * 10
    assert pixels(show_image(image, 10, 5)) == [upper] * 3 + [lower] * 2
    small = image_of(1, 2)
    assert pixels(show_image(small, 4, 1)) == [[(tuple(small[0, column // 2]),) * 2 for column in range(4)]]


# ---- numbers ----


def test_without_a_picture_the_scenes_numbers_and_what_is_perceived_are_shown() -> None:
    text = show_numbers({"x_m": 1.5, "speed": -0.25}, {"light": 0.75, "ranges": [1.0, 2.5]}, 20)
    assert [line.split() for line in text.plain.split("\n")] == [
        ["the", "scene"], ["x_m", "1.5"], ["speed", "-0.25"],
        ["perceived"], ["light", "0.75"], ["ranges", "1", "2.5"],
    ]  # fmt: skip


def test_as_many_numbers_are_shown_as_fit_and_none_of_what_is_not_perceived() -> None:
    many = {f"n{i}": float(i) for i in range(100)}
    assert len(show_numbers(many, None, 7).plain.split("\n")) == 7
    assert show_numbers({}, None, 7).plain.split("\n") == ["the scene", "perceived"]
    assert show_numbers(many, {"light": 1.0}, 0).plain == ""


@pytest.mark.parametrize("kind", ["disc", "circle", "line"])
def test_a_shape_far_larger_than_its_window_costs_no_more_than_the_window(kind: str) -> None:
    """Ring by ring, and dot by dot along its own length, it would not end within the test's bound."""
    places = [(-1e6, 0.0), (1e6, 0.0)] if kind == "line" else [(1e6, 0.0)]
    found = dots(shape(kind, *places, **({} if kind == "line" else {"radius": 1e6})))
    assert found
    if kind == "line":
        assert {abs(y) < 2 / DOTS for _, y in found} == {True}
    else:
        assert all(x >= -2 / DOTS for x, _ in found)


# ---- whose turn it is, and what is told at the end ----

LANGUAGE = Language("ordered", (0, 1, 2))
PLAYED = (Exchange(6, spoke=True, note=1),)


BOTH, PLAY = "your turn: judge what it did (0 to 9), then play a note", "your turn: play a note"


def seen(kind: Any, until_s: float | None = None, **more: Any) -> View:
    """A view of the next action's scene, 7."""
    return View(LANGUAGE, turn=Turn(kind, 7, until_s), **more)


@pytest.mark.parametrize(
    ("view", "said"),
    [
        (seen("play"), f"{PLAY}, see what it does, then judge"),
        (seen("play", exchanges=PLAYED), PLAY),
        (seen("both", 104.2), f"{BOTH} · 5 s left, w: wait"),
        (seen("play", 99.0, exchanges=PLAYED), f"{PLAY} · it goes on without you"),
        (seen("both", waits=True), f"{BOTH} · it waits for you"),
        (seen("judge", 104.2), "watch, then judge what it does"),
        (seen("watch"), "watch what it does"),
        (seen("watch", paused=True), "pause: you are silent, and the robot goes on; p ends the pause"),
        (seen("play", auto=True), "watch: your notes are played by themselves"),
        (seen("over", finished=True), "the experiment is over; q leaves"),
    ],
)
def test_whose_turn_it_is_is_said_in_a_line(view: View, said: str) -> None:
    assert turn(view, "ann", 100.0).plain == said


def test_the_countdown_changes_its_colour_near_its_end() -> None:
    for left_s, hurried in ((HURRY_S + 1.0, False), (HURRY_S - 1.0, True)):
        text = turn(View(LANGUAGE, turn=Turn("play", 7, 100.0 + left_s)), "ann", 100.0)
        assert (text.spans[-1].style == HURRY) is hurried


def test_who_leaves_is_told_what_was_reached() -> None:
    summary = Summary(
        commands=46, judged=44, obeyed=40, rewards=30, punishments=1, successes=11, first=0.35, last=0.95
    )
    assert closing(summary, "ann", "pioneer").splitlines() == [
        "ann has left pioneer.",
        "  notes      46; 40 of 44 were obeyed",
        "  obedience  35% of the first 20 notes, 95% of the last 20",
        "  feedback   30 rewards, 1 punishment",
        "  successes  11 while you were there",
        "The robot goes on with what it has learnt.",
    ]
    few = Summary(commands=3, judged=2, obeyed=1, first=0.5, last=0.5)
    assert "  obedience  50% of 2 notes\n" in closing(few, "ann", "pioneer")
    assert "notes      3; none could be followed" in closing(Summary(commands=3), "ann", "pioneer")
    assert closing(Summary(), "ann", "pioneer") == "ann has left pioneer. No note was played.\n"


def test_the_line_of_keys_fits_an_ordinary_terminal() -> None:
    assert help_line().cell_len <= 80
    assert help_line().plain.endswith("q leave")
