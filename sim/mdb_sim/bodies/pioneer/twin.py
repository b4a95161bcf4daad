"""The kinematic body: the Pioneer 2 DX's motion and sonar by plain geometry, a few hundred times real time.

Owns: exact motion up to the first contact, and the rays' meeting with the object's circle and the four walls.
Keeps the same contract, sonar rules and episodes as the PyBullet body; must not import pybullet.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mdb_sim.bodies.pioneer.arena import BODY_RADIUS_M, ArenaRobot, wrap_rad
from mdb_sim.bodies.pioneer.sonar import BODY_CENTRE_X_M, Array
from mdb_sim.bodies.pioneer.world import TRACK_M, Placement, Pose

CONTACT_STEP_RAD = math.radians(1.0)
CONTACT_STEP_M = 0.002
"""How finely a motion is searched for its first contact (ours)."""


class KinematicRobot(ArenaRobot):
    """See `mdb_sim.body.Body`."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._at = Pose(0.0, 0.0, 0.0)
        self._half_m = self.config.arena_m / 2.0

    def _place(self, placement: Placement) -> None:
        self._at = placement.robot

    def _pose(self) -> Pose:
        return self._at

    def _move(self, turn_rad: float, advance_m: float) -> bool:
        if (self.changes.left_wheel, self.changes.right_wheel) != (1.0, 1.0):
            return self._roll(turn_rad, advance_m)
        start = self._at
        end_rad = start.heading_rad + turn_rad
        end_x_m = start.x_m + advance_m * math.cos(end_rad)
        end_y_m = start.y_m + advance_m * math.sin(end_rad)
        end = Pose(end_x_m, end_y_m, wrap_rad(end_rad))
        if not self._may_touch(start, advance_m):
            self._at = end
            return False
        path = self._path(start, turn_rad, advance_m)
        touching = self._touching(path)
        if not touching.any():
            self._at = end
            return False
        x_m, y_m, heading_rad = path[max(int(touching.argmax()) - 1, 0)].tolist()
        self._at = Pose(x_m, y_m, wrap_rad(heading_rad))
        return True

    def _roll(self, turn_rad: float, advance_m: float) -> bool:
        """Move by what the wheels roll, each its share of what it is told: two arcs."""
        left, right = self.changes.left_wheel, self.changes.right_wheel
        aside_m = turn_rad * TRACK_M / 2.0
        path = np.array([[self._at.x_m, self._at.y_m, self._at.heading_rad]])
        for left_m, right_m in ((-left * aside_m, right * aside_m), (left * advance_m, right * advance_m)):
            path = np.concatenate([path, _arc(path[-1], left_m, right_m)])
        touching = self._touching(path)
        place = max(int(touching.argmax()) - 1, 0) if touching.any() else len(path) - 1
        x_m, y_m, heading_rad = path[place].tolist()
        self._at = Pose(x_m, y_m, wrap_rad(heading_rad))
        return bool(touching.any())

    def _path(self, start: Pose, turn_rad: float, advance_m: float) -> Array:
        """The motion as poses (n, 3) of x_m, y_m, heading_rad, start and end included."""
        turns = np.linspace(0.0, turn_rad, math.ceil(abs(turn_rad) / CONTACT_STEP_RAD) + 1)
        advances = np.linspace(0.0, advance_m, math.ceil(advance_m / CONTACT_STEP_M) + 1)[1:]
        headings = start.heading_rad + np.concatenate([turns, np.full(len(advances), turn_rad)])
        along_m = np.concatenate([np.zeros(len(turns)), advances])
        end_rad = start.heading_rad + turn_rad
        x_m = start.x_m + along_m * math.cos(end_rad)
        y_m = start.y_m + along_m * math.sin(end_rad)
        return np.stack([x_m, y_m, headings], axis=1)

    def _touching(self, path: Array) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """For each pose (n, 3) whether the body's circle touches the object or a wall, (n,)."""
        x_m = path[:, 0] + BODY_CENTRE_X_M * np.cos(path[:, 2])
        y_m = path[:, 1] + BODY_CENTRE_X_M * np.sin(path[:, 2])
        object_m = np.hypot(x_m - self._object_m[0], y_m - self._object_m[1])
        wall_m = self._half_m - np.maximum(np.abs(x_m), np.abs(y_m))
        touching: np.ndarray[tuple[int], np.dtype[np.bool_]] = (
            object_m <= BODY_RADIUS_M + self.config.object_radius_m
        ) | (wall_m <= BODY_RADIUS_M)
        return touching

    def cast(self, origins_m: Array, directions: Array) -> tuple[Array, Array]:
        """Rays against the object's circle and the walls; see `sonar.RayCaster`."""
        wall_m, wall_cos = self._cast_walls(origins_m, directions)
        object_m, object_cos = self._cast_object(origins_m, directions)
        nearer = object_m < wall_m
        return np.where(nearer, object_m, wall_m), np.where(nearer, object_cos, wall_cos)

    def _cast_walls(self, origins_m: Array, directions: Array) -> tuple[Array, Array]:
        """From inside a square each ray leaves through the wall of x or of y, whichever it meets first."""
        with np.errstate(divide="ignore", invalid="ignore"):
            per_axis_m = (np.copysign(self._half_m, directions) - origins_m) / directions
        through_x = per_axis_m[:, 0] < per_axis_m[:, 1]
        distances_m = np.where(through_x, per_axis_m[:, 0], per_axis_m[:, 1])
        return distances_m, np.abs(np.where(through_x, directions[:, 0], directions[:, 1]))

    def _cast_object(self, origins_m: Array, directions: Array) -> tuple[Array, Array]:
        """Ray against circle: the hit is half a chord before the foot of the centre's perpendicular.

        The incidence angle's cosine is that half chord over the radius.
        """
        radius_m = self.config.object_radius_m
        to_centre = np.asarray(self._object_m) - origins_m
        foot_m = np.einsum("ij,ij->i", to_centre, directions)
        half_chord_sq = radius_m**2 - (np.einsum("ij,ij->i", to_centre, to_centre) - foot_m**2)
        half_chord_m = np.sqrt(np.maximum(half_chord_sq, 0.0))
        hit = (half_chord_sq > 0.0) & (foot_m > half_chord_m)
        return np.where(hit, foot_m - half_chord_m, np.inf), half_chord_m / radius_m


def _arc(start: Array, left_m: float, right_m: float) -> Array:
    """Return the poses (n, 3) of x_m, y_m, heading_rad while the wheels roll so far, the start not included."""
    turn_rad, forward_m = (right_m - left_m) / TRACK_M, (left_m + right_m) / 2.0
    count = max(1, math.ceil(abs(turn_rad) / CONTACT_STEP_RAD), math.ceil(abs(forward_m) / CONTACT_STEP_M))
    headings = start[2] + turn_rad * np.arange(1, count + 1) / count
    middles = headings - turn_rad / count / 2.0
    x_m = start[0] + np.cumsum(np.cos(middles)) * forward_m / count
    y_m = start[1] + np.cumsum(np.sin(middles)) * forward_m / count
    return np.stack([x_m, y_m, headings], axis=1)
