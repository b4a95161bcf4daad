"""From 16 sonar ranges to what the brain perceives: distance, folded angle and continuity bit.

Owns: the search for the nearest cluster of echoes and the estimate of its place. Must see sonar ranges only,
never the simulator's truth.

The angle phi to the object jumps at ±180 degrees, behind the robot. Folded, `alpha = asin(sin(phi))`, and
joined by a bit that tells front from rear, it does not jump (sim/README.md, "State"; the bit is the paper's,
section 3).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mdb_sim.bodies.pioneer.sonar import TRANSDUCERS, Array
from mdb_sim.bodies.pioneer.world import PioneerConfig
from mdb_sim.body import Reading

SAME_OBJECT_M = 0.25
"""Neighbouring echoes whose distances differ by less than this are taken to come from one object (ours)."""
DROPPED_IN_A_ROW = 1
"""A cluster may have a gap of this many silent transducers, since echoes get lost (ours)."""
NOMINAL_RADIUS_M = 0.15
"""The roundness that bearings are matched with (ours); an object of another size costs some accuracy only."""

_UNEXPECTED_ECHO = 8.0
"""Cost, as a negative logarithm of likelihood, of an echo that a bearing cannot explain (ours)."""
_UNCERTAINTY_M = 0.005
_CANDIDATES_RAD = np.radians(np.arange(-40.0, 41.0, 2.0))

_PLACES = [(float(x), float(y)) for x, y, _ in TRANSDUCERS]
_AXES = [(math.cos(heading), math.sin(heading)) for *_, heading in TRANSDUCERS]


def perceive(ranges_m: Array, config: PioneerConfig) -> Reading:
    """The nearest echo cluster in the robot's frame, or an empty reading when there is none.

    ranges_m: (16,) in the ring's order, nan without echo. Echoes farther than `attention_m` from the centre
    of rotation are left out. "distance" is from the centre of rotation to the object's surface in metres.
    """
    located = locate(ranges_m, config)
    return {} if located is None else fold(*located)


def fold(distance_m: float, phi_rad: float) -> Reading:
    """Distance and raw angle as the brain's three inputs."""
    return {
        "distance": distance_m,
        "angle": math.asin(math.sin(phi_rad)),
        "continuity": 1.0 if math.cos(phi_rad) < 0.0 else 0.0,
    }


def unfold(reading: Mapping[str, Any]) -> float:
    """The raw angle phi in radians that a non-empty reading stands for."""
    angle_rad = float(reading["angle"])
    return math.pi - angle_rad if reading["continuity"] > 0.5 else angle_rad


def locate(ranges_m: Array, config: PioneerConfig) -> tuple[float, float] | None:
    """Distance in metres and raw angle in radians of the nearest cluster's surface, None without any echo."""
    echoes = _echo_points(ranges_m, config.attention_m)
    if not echoes:
        return None
    nearest = min(echoes, key=lambda index: echoes[index][0])
    members = _cluster(echoes, nearest)
    distance_m, about_rad = _centre([echoes[index] for index in members])
    return _likeliest(ranges_m, members, (distance_m, about_rad), config)


def _echo_points(ranges_m: Array, attention_m: float) -> dict[int, tuple[float, float]]:
    """Each heard echo by its transducer's index, as (distance_m, bearing_rad) from the centre of rotation."""
    points = {}
    for index, range_m in enumerate(ranges_m.tolist()):
        if not math.isnan(range_m):
            x_m = _PLACES[index][0] + range_m * _AXES[index][0]
            y_m = _PLACES[index][1] + range_m * _AXES[index][1]
            distance_m = math.hypot(x_m, y_m)
            if distance_m <= attention_m:
                points[index] = (distance_m, math.atan2(y_m, x_m))
    return points


def _cluster(echoes: dict[int, tuple[float, float]], nearest: int) -> list[int]:
    """The transducers around the nearest echo, both ways round the ring, that hear the same object."""
    members = [nearest]
    for direction in (1, -1):
        gap = 0
        for offset in range(1, len(TRANSDUCERS) // 2):
            index = (nearest + direction * offset) % len(TRANSDUCERS)
            if index in echoes and abs(echoes[index][0] - echoes[nearest][0]) <= SAME_OBJECT_M:
                members.append(index)
                gap = 0
            elif (gap := gap + 1) > DROPPED_IN_A_ROW:
                break
    return members


def _centre(points: list[tuple[float, float]]) -> tuple[float, float]:
    """Weighted middle of a cluster: the nearer an echo, the nearer its axis passes the object's middle."""
    least_m = min(distance_m for distance_m, _ in points)
    weights = [math.exp(-(distance_m - least_m) / 0.05) for distance_m, _ in points]
    x = sum(weight * math.cos(bearing) for weight, (_, bearing) in zip(weights, points, strict=True))
    y = sum(weight * math.sin(bearing) for weight, (_, bearing) in zip(weights, points, strict=True))
    mean_m = sum(w * distance_m for w, (distance_m, _) in zip(weights, points, strict=True)) / sum(weights)
    return mean_m, math.atan2(y, x)


def _likeliest(
    ranges_m: Array, members: list[int], guess: tuple[float, float], config: PioneerConfig
) -> tuple[float, float]:
    """The likeliest distance and bearing near a first guess, from who heard what and who was silent.

    A cone of 30 degrees tells little by itself; which transducers hear an object and which do not tells more.
    The bearing is the mean over candidates, weighted by how well each explains what was heard; the distance
    is mended by how the ranges differ from those that the candidates expect, weighted alike.
    """
    distance_m, about_rad = guess
    bearings = about_rad + _CANDIDATES_RAD
    expected_m, heard = _expected_ranges_m(bearings, distance_m, config)
    inside = np.zeros(len(TRANSDUCERS), dtype=np.bool_)
    inside[members] = True
    spread_m = config.sonar_noise * distance_m + _UNCERTAINTY_M
    error = (np.where(inside, ranges_m, 0.0) - expected_m) / spread_m
    if_echo = np.where(heard, np.minimum(error**2 / 2.0, _UNEXPECTED_ECHO), _UNEXPECTED_ECHO)
    if_silent = np.where(heard, -math.log(max(config.sonar_dropout, 1e-3)), 0.0)
    costs = np.where(inside, if_echo, if_silent).sum(axis=1)
    weights = np.exp(costs.min() - costs)
    weights /= weights.sum()
    explained = weights @ (inside & heard)
    excess_m = weights @ np.where(inside & heard, error * spread_m, 0.0)
    mended_m = float(excess_m.sum() / max(explained.sum(), 1.0))
    return max(distance_m + mended_m, 0.0), float(weights @ bearings)


def _expected_ranges_m(
    bearings: Array, distance_m: float, config: PioneerConfig
) -> tuple[Array, np.ndarray[tuple[int, ...], np.dtype[np.bool_]]]:
    """What each transducer would read, (n, 16), and whether it would hear anything, for n candidate bearings.

    The ray that hears is the one of the cone that points nearest to the object's centre.
    """
    centre_m, (x_m, y_m, heading_rad) = distance_m + NOMINAL_RADIUS_M, TRANSDUCERS.T
    ahead_m = (centre_m * np.cos(bearings))[:, None] - x_m
    aside_m = (centre_m * np.sin(bearings))[:, None] - y_m
    away_m = np.hypot(ahead_m, aside_m)
    off_axis = np.arctan2(aside_m, ahead_m) - heading_rad
    off_axis = np.abs((off_axis + math.pi) % (2.0 * math.pi) - math.pi)
    past_cone = np.minimum(np.maximum(off_axis - math.radians(config.sonar_half_cone_deg), 0.0), math.pi / 2.0)
    beside_m = away_m * np.sin(past_cone)
    heard = beside_m <= NOMINAL_RADIUS_M * math.sin(math.radians(config.sonar_specular_deg))
    depth_m = np.sqrt(np.maximum(NOMINAL_RADIUS_M**2 - beside_m**2, 0.0))
    return away_m * np.cos(past_cone) - depth_m, heard
