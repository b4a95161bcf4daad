"""The two bodies agree, and both give the bounds that were measured (sim/README.md, "Bounds")."""

import math

import pytest

from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.body import Placement, Pose, RobotConfig, RobotError, make_robot
from mdb_sim.studies.twins import captures_per_100, compare_bodies, ideal_policy, random_policy


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
    config = RobotConfig()
    with make_robot("kinematic", config) as twin, make_robot("pybullet", config) as body:
        for bearing_deg in range(30, 65, 5):
            bearing = math.radians(bearing_deg)
            beside = Placement(Pose(0.0, 0.0, 0.0), 0.42 * math.cos(bearing), 0.42 * math.sin(bearing))
            steps = []
            for robot in (twin, body):
                robot.restore(beside, 0, seed=1)
                steps.append(robot.act(0))
            assert [step.event for step in steps] == ["bump", "bump"]
            here, there = (step.reached.robot for step in steps)
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
    config = RobotConfig()
    with KinematicRobot(config) as robot:
        # sim/README.md, "Bounds": 23.7 and 0.85 over 30,000 iterations.
        assert captures_per_100(robot, ideal_policy(config), 3000, 1) == pytest.approx(23.7, abs=0.8)
        assert 0.3 < captures_per_100(robot, random_policy(config, 1), 3000, 1) < 2.0


def test_only_simulated_bodies_and_positive_counts_are_compared():
    with pytest.raises(RobotError, match="expected at least 1 and 0"):
        compare_bodies("kinematic", "kinematic", iterations=0)
    with pytest.raises(RobotError, match="without"):
        compare_bodies("builtins:type", "kinematic")
