"""The arena in braille dots: what is drawn where, and what of the arena is seen."""

import math

import pytest

from mdb_deploy.teach.screen.arena import ECHO, OBJECT, ROBOT, SPANS_M, Picture, Window, draw, echo, follow
from mdb_sim.bodies.pioneer.perceive import fold
from mdb_sim.body import Placement, Pose, RobotConfig

WORLD = RobotConfig()
COLUMNS, ROWS = 40, 20
WHOLE = Window(0.0, 0.0, 4.0)


def at(heading_rad: float, object_m: tuple[float, float], robot_m: tuple[float, float] = (0.0, 0.0)) -> Placement:
    return Placement(Pose(*robot_m, heading_rad), *object_m)


def centre_of(picture: Picture, style: str, window: Window = WHOLE) -> tuple[float, float]:
    """Mean place of what is drawn in a style: right and up from the middle, in metres."""
    text = draw(picture, window, WORLD, COLUMNS, ROWS)
    lines = text.plain.split("\n")
    assert [len(line) for line in lines] == [COLUMNS] * ROWS
    cells = [
        divmod(i, COLUMNS + 1) for span in text.spans if span.style == style for i in range(span.start, span.end)
    ]
    assert cells, f"nothing is drawn in {style}"
    metres = window.span_m / (4 * ROWS)
    right = sum(2 * column + 1 for _, column in cells) / len(cells) - COLUMNS
    up = 2 * ROWS - sum(4 * row + 2 for row, _ in cells) / len(cells)
    return right * metres, up * metres


def test_robot_and_object_are_where_they_are() -> None:
    picture = Picture(at(0.0, (1.0, 1.0), robot_m=(-1.0, -0.5)))
    assert centre_of(picture, OBJECT) == pytest.approx((1.0, 1.0), abs=0.1)
    assert centre_of(picture, ROBOT) == pytest.approx((-1.0, -0.5), abs=0.15)


def test_turned_with_the_robot_its_front_is_up() -> None:
    picture = Picture(at(0.0, (1.0, 0.0)), heading_up=True)
    assert centre_of(picture, OBJECT) == pytest.approx((0.0, 1.0), abs=0.1)
    picture = Picture(at(math.pi, (1.0, 0.0)), heading_up=True)
    assert centre_of(picture, OBJECT) == pytest.approx((0.0, -1.0), abs=0.1)


@pytest.mark.parametrize("phi_deg", [0.0, 80.0, 100.0, 180.0, -100.0, -80.0])
def test_what_is_perceived_is_drawn_there_also_behind(phi_deg: float) -> None:
    heading_rad, phi_rad = 0.5, math.radians(phi_deg)
    place = echo(at(heading_rad, (1.0, 0.0), robot_m=(0.2, 0.1)), fold(1.0, phi_rad))
    expected = 0.2 + math.cos(heading_rad + phi_rad), 0.1 + math.sin(heading_rad + phi_rad)
    assert place == pytest.approx(expected)


def test_without_an_echo_nothing_is_drawn_of_it() -> None:
    placement = at(0.0, (1.0, 0.0))
    assert echo(placement, {}) is None
    assert echo(placement, {"light": 1.0}) is None, "another body's sensors"
    text = draw(Picture(placement, reading={}), WHOLE, WORLD, COLUMNS, ROWS)
    assert ECHO not in {span.style for span in text.spans}


@pytest.mark.parametrize("distance_m", [0.1, 0.7, 1.5, 3.0, 9.0, 130.0])
def test_robot_and_object_are_both_seen_however_far_apart(distance_m: float) -> None:
    placement = at(0.0, (distance_m, 0.0))
    window = follow(None, placement)
    assert window.shows([(0.0, 0.0), (distance_m, 0.0)])
    assert window.span_m in SPANS_M


def test_the_window_stays_while_both_are_in_it_and_follows_when_they_are_not() -> None:
    window = follow(None, at(0.0, (1.4, 0.0)))
    assert follow(window, at(1.0, (1.4, 0.0), robot_m=(0.2, 0.1))) is window
    moved = follow(window, at(1.0, (1.4, 0.0), robot_m=(-3.0, 0.0)))
    assert moved.shows([(-3.0, 0.0), (1.4, 0.0)])
    assert follow(moved, at(1.0, (0.0, 0.7))).span_m < moved.span_m, "nearer when it is far too wide"


def test_an_arena_without_room_is_empty() -> None:
    assert draw(Picture(at(0.0, (1.0, 0.0))), WHOLE, WORLD, 0, 5).plain == ""
    assert len(draw(Picture(at(0.0, (1.0, 0.0))), WHOLE, WORLD, 1, 1).plain) == 1
