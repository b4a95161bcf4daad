"""What is seen in scans: computed from places of things by plain geometry."""

import math

import numpy as np
import pytest

pytest.importorskip("rosbags")

from mdb_sim.bodies.ros2 import sight
from mdb_sim.bodies.ros2.messages import Scan
from mdb_sim.bodies.ros2.options import options_of, spec_of
from mdb_sim.body import BodyError

STEP = math.radians(1.0)


def scan_of(things, *, wall_x_m=None, all_around=True, x_m=0.0, yaw_rad=0.0):
    """A laser at x_m, turned by yaw, among round things (x, y, radius) in the robot's frame, and a wall in front."""
    bearings = np.arange(0.0 if all_around else -90.0, 360.0 if all_around else 91.0) * STEP
    ranges = np.full(len(bearings), np.inf)
    towards = np.stack([np.cos(bearings + yaw_rad), np.sin(bearings + yaw_rad)], axis=1)
    for cx, cy, radius in things:
        to = np.array([cx - x_m, cy])
        foot = towards @ to
        chord_sq = radius**2 - (to @ to - foot**2)
        hit = (chord_sq > 0) & (foot > 0)
        ranges = np.where(hit, np.minimum(ranges, foot - np.sqrt(np.maximum(chord_sq, 0))), ranges)
    if wall_x_m is not None:
        with np.errstate(divide="ignore"):
            wall = np.where(towards[:, 0] > 1e-6, (wall_x_m - x_m) / towards[:, 0], np.inf)
        ranges = np.minimum(ranges, np.where(wall < 3.5, wall, np.inf))
    heard = np.isfinite(ranges)
    return Scan(1.0, "laser", bearings[heard], ranges[heard], STEP, 3.5)


@pytest.mark.parametrize("bearing_deg", [0, 1, 37, 90, 135, 179, 180, 181, 270, 359])
@pytest.mark.parametrize("away_m", [0.5, 1.0, 1.9])
def test_a_round_thing_is_found_all_around(bearing_deg, away_m):
    bearing = math.radians(bearing_deg)
    middle_m = away_m + 0.15
    scan = scan_of([(middle_m * math.cos(bearing), middle_m * math.sin(bearing), 0.15)])
    found = sight.nearest_object(scan, options_of({}))
    assert found is not None
    assert found[0] == pytest.approx(away_m, abs=0.005)
    assert abs(math.remainder(found[1] - bearing, 2 * math.pi)) < STEP


def test_the_nearest_of_two_is_taken_and_walls_are_none():
    things = [(1.5, 0.0, 0.15), (0.0, 1.0, 0.15)]
    scan = scan_of(things, wall_x_m=0.8)
    distance_m, bearing = sight.nearest_object(scan, options_of({})) or (0.0, 0.0)
    assert (distance_m, bearing) == (pytest.approx(0.85, abs=0.005), pytest.approx(math.pi / 2, abs=STEP))
    assert sight.nearest_object(scan_of([], wall_x_m=0.8), options_of({})) is None
    assert sight.nearest_object(scan_of([]), options_of({})) is None


@pytest.mark.parametrize("wall_x_m", [3.2, 3.3, 3.4, 3.45, 3.49])
def test_the_piece_of_a_wall_that_the_laser_just_sees_is_none(wall_x_m):
    assert sight.nearest_object(scan_of([], wall_x_m=wall_x_m), options_of({})) is None


def test_a_laser_that_sits_elsewhere_and_looks_elsewhere_is_reckoned_with():
    laser = {"x_m": -0.1, "yaw_deg": 180.0}
    options = options_of({"laser": laser})
    scan = scan_of([(1.0, 0.0, 0.15)], x_m=-0.1, yaw_rad=math.pi)
    distance_m, bearing = sight.nearest_object(scan, options) or (0.0, 9.0)
    assert distance_m == pytest.approx(0.85, abs=0.005)
    assert abs(bearing) < STEP


def test_a_laser_that_looks_ahead_only_splits_nothing_and_joins_nothing():
    scan = scan_of([(0.0, 1.0, 0.15), (0.0, -1.0, 0.15)], all_around=False)
    assert len(sight._things(sight.points_of(scan, options_of({})), scan)) == 2


def test_ranges_by_sector_begin_in_front_and_go_to_the_left():
    options = options_of({"sectors": 4, "sectors_m": 3.0})
    ranges = sight.sectors_of(scan_of([(1.15, 0.0, 0.15), (0.0, 0.65, 0.15)]), options)
    assert ranges == [pytest.approx(1.0, abs=0.005), pytest.approx(0.5, abs=0.005), 3.0, 3.0]
    (sensor,) = [sensor for sensor in spec_of(options).sensors if sensor.name == "ranges"]
    assert sensor.numbers == 4


def test_how_far_the_way_is_free():
    options = options_of({"radius_m": 0.2})
    assert sight.free_m(scan_of([(1.15, 0.0, 0.15)]), options) == pytest.approx(0.8, abs=0.01)
    assert sight.free_m(scan_of([], wall_x_m=1.0), options) == pytest.approx(0.8, abs=0.01)
    assert sight.free_m(scan_of([(1.15, 0.5, 0.15)]), options) == math.inf, "it passes by"
    assert sight.free_m(scan_of([(-1.0, 0.0, 0.15)]), options) == math.inf, "it is behind"
    assert sight.free_m(scan_of([(0.0, 1.15, 0.15)]), options, math.pi / 2) == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"speed": 1}, "robot.options: .*speed"),
        ({"domain": 300}, r"robot\.options: .*domain"),
        ({"topics": {"scan": "my scan"}}, "expected letters"),
        ({"node": "a-b"}, "robot.options: .*node"),
        ({"actuators": {}}, "robot.options: .*actuators"),
        ({"actuators": {"a": {"does": "turn", "low": 1, "high": 1}}}, "expected low < high"),
        ({"actuators": {"a": {"does": "fly", "low": 0, "high": 1}}}, "fly"),
        ({"actuators": {"a": {"does": "turn", "low": 0, "high": 1, "scale": 0}}}, "a scale other than 0"),
        ({"actuators": {"a": {"does": "linear", "low": 0, "high": 1}}}, "goes to 1 m/s; expected 0.2 at most"),
        (
            {
                "actuators": {
                    "a": {"does": "linear", "low": 0, "high": 0.1},
                    "b": {"does": "turn", "low": 0, "high": 1},
                }
            },
            "expected turn and advance, or linear and angular",
        ),
        ({"object_width_m": [0.5, 0.1]}, "expected the lesser first"),
        ({"place_min_m": 2.0}, "expected the lesser first"),
        ({"begin": "around", "object": False}, "needs an object"),
    ],
)
def test_options_that_are_wrong_are_named(options, says):
    with pytest.raises(BodyError, match=says):
        options_of(options)


def test_without_an_object_there_is_none_to_sense_or_to_capture():
    spec = spec_of(options_of({"object": False, "sectors": 8}))
    assert [sensor.name for sensor in spec.sensors] == ["ranges"]
    assert spec.events == ("bump", "stuck")
    assert spec.scene == ("x_m", "y_m", "heading_rad")
