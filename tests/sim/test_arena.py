"""The world's rules: placements, captures, random streams."""

import math

from hypothesis import given
from hypothesis import strategies as st

from mdb_sim.bodies.pioneer.arena import (
    NEAR_WALL_M,
    bearing_rad,
    clearance_m,
    draw_placement,
    is_captured,
    stream,
    surface_distance_m,
)
from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.bodies.pioneer.world import PioneerConfig, Placement, Pose, placement_of, scene_of

CONFIG = PioneerConfig()
BESIDE_A_WALL = PioneerConfig(start="wall")
seeds = st.integers(0, 2**64 - 1)
episodes = st.integers(0, 2**32)


def at(distance_m, phi_deg, heading_rad=0.0):
    """An object whose surface is so far away and whose middle is so far left of the front."""
    reach_m, angle = distance_m + CONFIG.object_radius_m, heading_rad + math.radians(phi_deg)
    return Placement(Pose(0.0, 0.0, heading_rad), reach_m * math.cos(angle), reach_m * math.sin(angle))


@given(seeds, episodes)
def test_placements_keep_to_the_range_and_are_no_capture(seed, episode):
    placement = draw_placement(CONFIG, seed, episode)
    assert placement == draw_placement(CONFIG, seed, episode)
    distance_m = surface_distance_m(placement, CONFIG.object_radius_m)
    assert CONFIG.place_min_m - 1e-9 <= distance_m <= CONFIG.place_max_m + 1e-9
    assert not is_captured(placement, CONFIG)
    assert clearance_m(placement, CONFIG) > 0.0


@given(seeds, episodes)
def test_beside_a_wall_the_robot_touches_nothing_and_captures_nothing(seed, episode):
    placement = draw_placement(BESIDE_A_WALL, seed, episode)
    assert placement == draw_placement(BESIDE_A_WALL, seed, episode)
    robot = placement.robot
    wall_m = CONFIG.arena_m / 2.0 - max(abs(robot.x_m), abs(robot.y_m))
    assert NEAR_WALL_M[0] - 1e-9 <= wall_m <= NEAR_WALL_M[1] + 1e-9
    assert clearance_m(placement, BESIDE_A_WALL) > 0.0
    assert surface_distance_m(placement, CONFIG.object_radius_m) > CONFIG.attention_m
    assert not is_captured(placement, BESIDE_A_WALL)


def test_each_wall_is_begun_at():
    found = set()
    for episode in range(60):
        robot = draw_placement(BESIDE_A_WALL, 1, episode).robot
        along_x = abs(robot.x_m) > abs(robot.y_m)
        found.add((along_x, (robot.x_m if along_x else robot.y_m) > 0.0))
    assert len(found) == 4


def test_placements_lie_all_around():
    bearings = [bearing_rad(draw_placement(CONFIG, 1, episode)) for episode in range(400)]
    quarters = [int((bearing + math.pi) // (math.pi / 2)) for bearing in bearings]
    assert all(70 <= quarters.count(quarter) <= 130 for quarter in range(4))


@given(st.floats(-math.pi, math.pi))
def test_a_capture_needs_nearness_and_the_front(heading_rad):
    assert is_captured(at(0.39, 19.0, heading_rad), CONFIG)
    assert is_captured(at(0.39, -19.0, heading_rad), CONFIG)
    assert not is_captured(at(0.41, 0.0, heading_rad), CONFIG)
    assert not is_captured(at(0.3, 21.0, heading_rad), CONFIG)
    assert not is_captured(at(0.3, 180.0, heading_rad), CONFIG)


def test_streams_depend_on_each_part_of_their_key_and_on_nothing_else():
    keys = [
        (1, "reached", 5, 0),
        (2, "reached", 5, 0),
        (1, "placed", 5, 0),
        (1, "reached", 6, 0),
        (1, "sense", 5, 1),
    ]
    draws = [tuple(stream(*key).random(3)) for key in keys]
    assert len(set(draws)) == len(keys)
    assert draws == [tuple(stream(*key).random(3)) for key in keys]


@given(seeds, episodes)
def test_a_scene_stands_for_its_placement(seed, episode):
    placement = draw_placement(CONFIG, seed, episode)
    assert placement_of(scene_of(placement)) == placement
    assert placement_of(scene_of(placement) | {"reward": 1.0}) == placement


def test_what_an_action_would_lead_to_is_what_it_leads_to_and_looking_changes_nothing():
    with KinematicRobot() as robot:
        for changes in ({}, {"swapped": True}, {"turn_share": 0.5}, {"left_wheel": 0.5}):
            robot.reset(5, 0)
            robot.change(**changes)
            before = robot.state()
            foreseen, event = robot.foresee({"turn": 45.0})
            assert robot.state() == before
            assert robot.act({"turn": 45.0}).event == event
            assert robot.scene() == foreseen
