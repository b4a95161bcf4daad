"""The two bodies agree, and both give the bounds that were measured (sim/README.md, "Bounds")."""

import math

import pytest

from mdb_sim.bodies.finding import make_body
from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.bodies.pioneer.world import Placement, Pose
from mdb_sim.body import BodyError
from mdb_sim.studies.twins import captures_per_100, compare_bodies, facing, random_policy


@pytest.fixture(scope="module")
def comparison():
    pytest.importorskip("pybullet")
    return compare_bodies(iterations=80, bound_iterations=0)


def test_the_bodies_move_alike(comparison):
    spreads = comparison.spreads
    assert spreads["pybullet: turn error, deg"].max < 0.1
    assert spreads["pybullet: advance error, mm"].max < 0.5
    assert spreads["kinematic: turn error, deg"].max < 1e-9
    assert spreads["between: heading, deg"].max < 0.1
    assert spreads["between: place, mm"].max < 0.5


def test_what_stops_one_body_stops_the_other_at_its_surface():
    pytest.importorskip("pybullet")
    with make_body("kinematic", {}) as twin, make_body("pybullet", {}) as body:
        for bearing_deg in range(30, 65, 5):
            bearing = math.radians(bearing_deg)
            beside = Placement(Pose(0.0, 0.0, 0.0), 0.42 * math.cos(bearing), 0.42 * math.sin(bearing))
            events = []
            for robot in (twin, body):
                robot.put(beside, 1)
                events.append(robot.act({"turn": 0.0}).event)
            assert events == ["bump", "bump"]
            here, there = twin.placement.robot, body.placement.robot
            assert math.hypot(here.x_m - there.x_m, here.y_m - there.y_m) < 0.006


def test_the_bodies_hear_alike(comparison):
    assert comparison.spreads["between: clean range, same place, mm"].max < 5.0
    assert comparison.figures["between: echo heard by one body alone, %"] < 0.5
    assert comparison.spreads["between: read angle, deg"].p95 < 2.0
    assert comparison.figures["between: both or neither perceive, %"] > 97.0
    assert comparison.figures["between: same event, %"] > 97.0


def test_the_table_names_every_quantity(comparison):
    lines = comparison.table().splitlines()
    assert len(lines) == 1 + len(comparison.spreads) + len(comparison.figures)
    assert lines[0].split() == ["mean", "p95", "max", "count"]


def test_ideal_and_random_policy_bound_what_can_be_captured():
    with KinematicRobot() as robot:
        # sim/README.md, "Bounds": 23.7 and 0.85 over 30,000 iterations.
        assert captures_per_100(robot, facing(), 3000, 1) == pytest.approx(23.7, abs=0.8)
        assert 0.3 < captures_per_100(robot, random_policy(1), 3000, 1) < 2.0


def test_only_simulated_bodies_and_positive_counts_are_compared():
    with pytest.raises(BodyError, match="expected at least 1 and 0"):
        compare_bodies("kinematic", "kinematic", iterations=0)
    with pytest.raises(BodyError, match="without"):
        compare_bodies("builtins:object", "kinematic")
    with pytest.raises(BodyError, match="has no simulated arena to compare in"):
        compare_bodies("kinematic", "tests.conformance.small_bodies:Turntable")


def test_bodies_with_other_options_are_compared_and_bounded_for_each_policy():
    found = compare_bodies("kinematic", "kinematic", {"advance_m": 0.3}, iterations=20, bound_iterations=50)
    assert found.spreads["kinematic: advance error, mm"].max < 1e-6
    assert found.spreads["between: place, mm"].max == 0.0
    assert found.figures["between: same event, %"] == 100.0
    assert {name for name in found.figures if "captures/100" in name} == {
        f"kinematic: captures/100, {policy} policy" for policy in ("ideal", "random")
    }
