"""From a laser's scan to what the brain and the drive need: the object, ranges by sector, what is in the way. Pure.

All in the robot's frame: x forward, y left, from its centre of rotation.
"""

from __future__ import annotations

import math

import numpy as np

from mdb_sim.bodies.ros2.messages import Array, Scan
from mdb_sim.bodies.ros2.options import Ros2Options

GAP_M = 0.15
"""Neighbouring echoes that are farther apart than this are of two things (ours)."""
FAR_SHARE = 0.9
"""A piece of a wall looks like a thing where the laser hardly sees: beyond this share of its range is none (ours)."""
SILENT_RAYS = 2.5
"""So many steps of the laser without an echo end a thing (ours)."""


def points_of(scan: Scan, options: Ros2Options) -> Array:
    """Return where the echoes are, (n, 2) in metres, in the order of the rays."""
    laser = options.laser
    bearings = scan.bearings_rad + math.radians(laser.yaw_deg)
    return np.stack(
        [laser.x_m + scan.ranges_m * np.cos(bearings), laser.y_m + scan.ranges_m * np.sin(bearings)], axis=1
    )


def nearest_object(scan: Scan, options: Ros2Options) -> tuple[float, float] | None:
    """Return distance in metres and bearing in radians of the nearest narrow thing's surface; None: there is none.

    The distance is to its nearest echo, the bearing to the middle of its two ends: what turns a round thing's edge
    away from the laser does so on both sides.
    """
    points = points_of(scan, options)
    least_m, most_m = options.object_width_m
    found: list[tuple[float, float]] = []
    for thing in _things(points, scan):
        away_m = np.hypot(thing[:, 0], thing[:, 1])
        width_m = float(np.hypot(*(thing[-1] - thing[0])))
        if len(thing) > 1 and away_m.min() <= FAR_SHARE * scan.most_m and least_m <= width_m <= most_m:
            first, last = np.arctan2(thing[[0, -1], 1], thing[[0, -1], 0]).tolist()
            found.append((float(away_m.min()), _wrapped(first + _wrapped(last - first) / 2.0)))
    return min(found, default=None)


def _things(points: Array, scan: Scan) -> list[Array]:
    """Return the echoes thing by thing; a thing may go over the scan's end when it goes all around."""
    if len(points) == 0:
        return []
    apart_m = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    ahead = np.roll(scan.bearings_rad, -1) - scan.bearings_rad
    turned = np.abs((ahead + math.pi) % (2.0 * math.pi) - math.pi)
    ends = np.flatnonzero((apart_m > GAP_M) | (turned > SILENT_RAYS * scan.step_rad)) + 1
    if len(ends) == 0:
        return [points]
    return np.split(np.roll(points, -ends[-1], axis=0), ends[:-1] + len(points) - ends[-1])


def sectors_of(scan: Scan, options: Ros2Options) -> list[float]:
    """Return the nearest range in each sector, straight ahead first, then to the left; the most where all is free."""
    points, count = points_of(scan, options), options.sectors
    nearest = np.full(count, options.sectors_m)
    sector = np.round(np.arctan2(points[:, 1], points[:, 0]) / (2.0 * math.pi) * count).astype(int) % count
    np.minimum.at(nearest, sector, np.hypot(points[:, 0], points[:, 1]))
    ranges: list[float] = nearest.tolist()
    return ranges


def free_m(scan: Scan, options: Ros2Options, towards_rad: float = 0.0, room_m: float = 0.0) -> float:
    """Return how far the robot's circle, so much wider, can go in a direction until an echo; infinite: for ever."""
    points, radius_m = points_of(scan, options), options.radius_m + room_m
    along = points @ np.array([math.cos(towards_rad), math.sin(towards_rad)])
    beside = points @ np.array([-math.sin(towards_rad), math.cos(towards_rad)])
    in_way = (np.abs(beside) < radius_m) & (along > 0.0)
    if not in_way.any():
        return math.inf
    reach = np.sqrt(radius_m**2 - beside[in_way] ** 2)
    return float(np.min(along[in_way] - reach))


def _wrapped(angle_rad: float) -> float:
    return math.remainder(angle_rad, 2.0 * math.pi)
