"""Perception: the nearest cluster's distance, folded angle and continuity bit, from ranges alone."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdb_sim.bodies.pioneer.arena import wrap_rad
from mdb_sim.bodies.pioneer.perceive import fold, locate, perceive, unfold
from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.bodies.pioneer.world import PioneerConfig, Placement, Pose

CONFIG = PioneerConfig()
SILENCE = np.full(16, np.nan)


@given(st.floats(-math.pi, math.pi))
def test_folding_loses_nothing(phi_rad):
    reading = fold(1.0, phi_rad)
    assert abs(reading["angle"]) <= math.pi / 2
    assert wrap_rad(unfold(reading) - phi_rad) == pytest.approx(0.0, abs=1e-6)


def test_the_bit_tells_front_from_rear_and_the_fold_does_not_jump_behind():
    assert fold(1.0, math.radians(89))["continuity"] == 0.0
    assert fold(1.0, math.radians(91))["continuity"] == 1.0
    left, right = fold(1.0, math.radians(179)), fold(1.0, math.radians(-179))
    assert left["angle"] - right["angle"] == pytest.approx(math.radians(2))


def test_silence_and_what_is_too_far_give_an_empty_reading():
    assert perceive(SILENCE, CONFIG) == {}
    assert perceive(np.full(16, 3.0), CONFIG) == {}


def test_the_nearest_cluster_is_taken_and_not_the_average_of_all():
    ranges_m = SILENCE.copy()
    ranges_m[[3, 4]] = 0.8
    ranges_m[[11, 12]] = 1.4
    distance_m, phi_rad = locate(ranges_m, CONFIG)
    assert distance_m == pytest.approx(0.8 + 0.166, abs=0.03)
    assert phi_rad == pytest.approx(0.0, abs=math.radians(2))


def test_perception_never_depends_on_what_it_was_given_before():
    ranges_m = SILENCE.copy()
    ranges_m[8] = 0.6
    before = ranges_m.copy()
    assert perceive(ranges_m, CONFIG) == perceive(ranges_m, CONFIG)
    assert np.array_equal(ranges_m, before, equal_nan=True)


def sample_errors(count):
    """Angle errors in degrees, distance errors in metres, and how many readings were empty, all around."""
    rng = np.random.default_rng(2)
    angles_deg, distances_m, empty = [], [], 0
    with KinematicRobot() as robot:
        for index in range(count):
            distance_m, phi_rad = rng.uniform(0.25, 1.6), rng.uniform(-math.pi, math.pi)
            reach_m = distance_m + CONFIG.object_radius_m
            place = (reach_m * math.cos(phi_rad), reach_m * math.sin(phi_rad))
            robot.put(Placement(Pose(0.0, 0.0, 0.0), *place), index)
            reading = robot.sense()
            if not reading:
                empty += 1
                continue
            angles_deg.append(abs(math.degrees(wrap_rad(unfold(reading) - phi_rad))))
            distances_m.append(abs(reading["distance"] - distance_m))
    return np.array(angles_deg), np.array(distances_m), empty


def test_estimates_are_good_all_around():
    angles_deg, distances_m, empty = sample_errors(1500)
    assert angles_deg.mean() < 4.0
    assert np.percentile(angles_deg, 95) < 10.0
    assert distances_m.mean() < 0.02
    assert empty / 1500 < 0.04
