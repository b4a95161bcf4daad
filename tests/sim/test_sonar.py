"""The sonar ring: where the transducers are, which echoes they hear, what noise does to them."""

import math

import numpy as np
import pytest

from mdb_sim.bodies.pioneer.sonar import BODY_CENTRE_X_M, TRANSDUCERS, SonarRing
from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.bodies.pioneer.world import PioneerConfig, Placement, Pose

AT_ORIGIN = Pose(0.0, 0.0, 0.0)
FAR_OFF = (4.5, 4.5)


def ring_over(surface_m, cos_incidence=1.0, **config):
    """A ring whose every ray hits a surface at this distance, and what casts those rays."""

    def cast(origins_m, _directions):
        return np.full(len(origins_m), surface_m), np.full(len(origins_m), cos_incidence)

    return SonarRing(PioneerConfig(**config)), cast


def clean_ranges(robot_pose, object_m, **options):
    with KinematicRobot(**options) as robot:
        robot.put(Placement(robot_pose, *object_m), 1)
        return robot.clean_ranges_m()


def test_the_ring_is_the_pioneers():
    assert TRANSDUCERS.shape == (16, 3)
    assert TRANSDUCERS[3] == pytest.approx([0.166, 0.027, math.radians(10)])
    assert TRANSDUCERS[11] == pytest.approx([-0.255, -0.027, math.radians(-170)])
    mirrored = {(round(x, 3), round(-y, 3), round(-heading, 6)) for x, y, heading in TRANSDUCERS}
    assert mirrored == {(round(x, 3), round(y, 3), round(heading, 6)) for x, y, heading in TRANSDUCERS}
    assert (TRANSDUCERS[:, 0].max() + TRANSDUCERS[:, 0].min()) / 2 == pytest.approx(BODY_CENTRE_X_M, abs=0.001)


def test_rays_fan_out_about_each_axis_and_turn_with_the_robot():
    ring = SonarRing(PioneerConfig())
    origins_m, directions = ring.rays(Pose(1.0, 2.0, math.pi / 2))
    assert origins_m.shape == directions.shape == (16 * 7, 2)
    assert np.hypot(*directions.T) == pytest.approx(1.0)
    assert origins_m[3 * 7] == pytest.approx([1.0 - 0.027, 2.0 + 0.166])
    angles = np.degrees(np.unwrap(np.arctan2(directions[:, 1], directions[:, 0]).reshape(16, 7)))
    assert angles[3] == pytest.approx(np.linspace(85.0, 115.0, 7))


def test_a_single_ray_lies_on_the_axis():
    _, directions = SonarRing(PioneerConfig(sonar_rays=1)).rays(AT_ORIGIN)
    expected = np.stack([np.cos(TRANSDUCERS[:, 2]), np.sin(TRANSDUCERS[:, 2])], axis=1)
    assert directions == pytest.approx(expected)


def test_an_object_ahead_is_heard_in_front_at_its_surface():
    ranges_m = clean_ranges(AT_ORIGIN, (1.0, 0.0))
    near = np.flatnonzero(ranges_m < 1.0)
    assert near.tolist() == [3, 4]
    assert ranges_m[near] == pytest.approx(1.0 - 0.15 - 0.166, abs=0.005)


def test_what_is_beyond_the_range_is_silent():
    ranges_m = clean_ranges(AT_ORIGIN, FAR_OFF, sonar_max_m=3.0, attention_m=2.0)
    assert np.isnan(ranges_m).all()


def test_a_wall_met_at_a_slant_is_silent():
    ranges_m = clean_ranges(Pose(2.0, 0.0, 0.0), (-4.5, -4.5), sonar_half_cone_deg=0.0)
    # Axes at 10 and 30 degrees meet the wall within 40 degrees of its normal, those at 50 do not.
    expected_m = [(3 - 0.166) / math.cos(math.radians(10)), (3 - 0.148) / math.cos(math.radians(30))]
    assert ranges_m[[3, 2]] == pytest.approx(expected_m)
    assert np.isnan(ranges_m[[1, 6]]).all()


def test_beyond_the_cut_off_nothing_is_heard():
    for slant_deg, silent in ((39, False), (41, True)):
        ring, cast = ring_over(1.0, math.cos(math.radians(slant_deg)))
        assert np.isnan(ring.clean_ranges_m(AT_ORIGIN, cast)).all() == silent


def test_noise_is_one_percent_and_two_echoes_in_a_hundred_are_dropped():
    ring, cast = ring_over(2.0)
    rng = np.random.default_rng(1)
    ranges_m = np.array([ring.ranges_m(AT_ORIGIN, cast, rng) for _ in range(2000)])
    assert np.nanmean(ranges_m) == pytest.approx(2.0, abs=0.002)
    assert np.nanstd(ranges_m) == pytest.approx(0.02, abs=0.001)
    assert np.isnan(ranges_m).mean() == pytest.approx(0.02, abs=0.004)


def test_an_echo_from_too_near_reads_as_the_least_range():
    ring, cast = ring_over(0.03, sonar_dropout=0.0)
    assert ring.ranges_m(AT_ORIGIN, cast, np.random.default_rng(1)) == pytest.approx(0.10)
