"""The Pioneer 2 DX's ring of 16 sonars, the same for every body.

Owns: where the transducers are, the rays that stand for their cones, and what becomes of an echo: nearest
ray, specular cut-off, range noise, range limits, dropped echoes. A body supplies one thing only, a
`RayCaster`. Must not know what an object is, nor where it truly is.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mdb_sim.bodies.pioneer.world import PioneerConfig, Pose

Array = NDArray[np.float64]

BODY_CENTRE_X_M = -0.045
"""The body's centre lies behind the axle, the robot's origin (sim/README.md, "The Pioneer 2 DX")."""
SONAR_HEIGHT_M = 0.21

_FRONT_LEFT = ((69, 136, 90), (114, 119, 50), (148, 78, 30), (166, 27, 10))
_REAR_RIGHT = ((-157, -136, -90), (-203, -119, -130), (-237, -78, -150), (-255, -27, -170))


def _mirrored(quarter: tuple[tuple[int, int, int], ...]) -> tuple[tuple[int, int, int], ...]:
    """The same transducers on the other side of the robot, so that the ring's order goes on clockwise."""
    return tuple((x, -y, -heading) for x, y, heading in reversed(quarter))


TRANSDUCERS = np.array(
    _FRONT_LEFT + _mirrored(_FRONT_LEFT) + _REAR_RIGHT + _mirrored(_REAR_RIGHT), dtype=np.float64
) * np.array([1e-3, 1e-3, math.pi / 180.0])
"""(16, 3): x_m, y_m from the axle's middle and heading_rad; the Pioneer's order, clockwise."""


class RayCaster(Protocol):
    """What a body must supply: the first surface that each ray meets."""

    def __call__(self, origins_m: Array, directions: Array) -> tuple[Array, Array]:
        """Cast rays in the sonars' plane.

        origins_m, directions: (n, 2) in the world, directions of unit length. Returns the distance of the
        first hit in metres, (n,), inf where there is none, and the cosine of the incidence angle there, (n,).
        """


class SonarRing:
    """Turns ray hits into the 16 ranges that the robot reads."""

    def __init__(self, config: PioneerConfig) -> None:
        self._config = config
        self._cos_specular = math.cos(math.radians(config.sonar_specular_deg))
        half_cone = math.radians(config.sonar_half_cone_deg)
        # Symmetric whatever the count; a single ray lies on the axis.
        offsets = half_cone * (np.arange(1, 2 * config.sonar_rays, 2) - config.sonar_rays)
        offsets /= max(config.sonar_rays - 1, 1)
        angles = (TRANSDUCERS[:, 2:3] + offsets).ravel()
        self._origins_m = np.repeat(TRANSDUCERS[:, :2], config.sonar_rays, axis=0)
        self._directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def rays(self, pose: Pose) -> tuple[Array, Array]:
        """Origins in metres and unit directions in the world, each (16 * rays, 2), seen from this pose."""
        cos, sin = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
        # Row vectors are multiplied by the transposed rotation.
        turned = np.array([[cos, sin], [-sin, cos]])
        return self._origins_m @ turned + (pose.x_m, pose.y_m), self._directions @ turned

    def clean_ranges_m(self, pose: Pose, cast: RayCaster) -> Array:
        """The (16,) ranges of a sonar without noise or dropped echoes; nan where there is no echo."""
        distances_m, cos_incidence = cast(*self.rays(pose))
        heard = (cos_incidence >= self._cos_specular) & (distances_m <= self._config.sonar_max_m)
        nearest_m = np.where(heard, distances_m, np.inf).reshape(len(TRANSDUCERS), -1).min(axis=1)
        return np.where(np.isfinite(nearest_m), nearest_m, np.nan)

    def ranges_m(self, pose: Pose, cast: RayCaster, rng: np.random.Generator) -> Array:
        """The (16,) ranges as read; nan where no echo was heard. Draws 32 numbers, whatever there is to see.

        An echo from nearer than the least range reads as the least range: the transducer still rings.
        """
        noise = 1.0 + self._config.sonar_noise * rng.standard_normal(len(TRANSDUCERS))
        dropped = rng.random(len(TRANSDUCERS)) < self._config.sonar_dropout
        ranges_m = self.clean_ranges_m(pose, cast) * noise
        ranges_m[dropped | (ranges_m > self._config.sonar_max_m)] = np.nan
        clipped: Array = np.maximum(ranges_m, self._config.sonar_min_m)
        return clipped
