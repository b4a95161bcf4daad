"""A robot on two wheels in a yard with a light, by plain geometry. Change it into yours.

What counts are the members, those of `mdb_sim.body.Body`: what the robot has (`spec`), and what it does. A class of
yours that speaks to a real robot has the same ones; `Resting` is for bodies that stand still after each action, so
that `halt` has nothing to do, and `Unrestorable` for those that cannot be put back where they were.
"""

import math

import numpy as np

from mdb_sim.body import NOTHING, Actuator, Outcome, Resting, Sensor, Spec, Unrestorable, check

TRACK_M, YARD_M, NEAR_M = (
    0.3,
    4.0,
    0.3,
)  # between the wheels; half of the yard's side; so near it has reached the light
ROLLED_M = (-0.1, 0.1, 0.3)  # what each wheel can roll in one action


class Robot(Resting, Unrestorable):
    """See the module's docstring."""

    spec = Spec(
        sensors=(Sensor(name="distance", low=0.0, high=4.0, unit="m"), Sensor(name="angle", low=-1.0, high=1.0)),
        actuators=(
            Actuator(name="left", low=ROLLED_M[0], high=ROLLED_M[-1], unit="m"),
            Actuator(name="right", low=ROLLED_M[0], high=ROLLED_M[-1], unit="m"),
        ),
        events=("reached", "outside"),  # its words for what can happen
        scene=("distance_m", "angle_rad"),  # what is true, for the teacher: here just what it senses
    )

    def reset(self, seed, episode):
        """Put robot and light anywhere: the same seed and episode, the same place."""
        rng = np.random.default_rng((seed, episode))
        self._x_m, self._y_m, self._heading_rad = 0.0, 0.0, rng.uniform(-math.pi, math.pi)
        away_m, where_rad = rng.uniform(1.0, 3.0), rng.uniform(-math.pi, math.pi)
        self._light = away_m * math.cos(where_rad), away_m * math.sin(where_rad)
        return self._sense()

    def act(self, values):
        """Roll both wheels; say what happened, and what is perceived there."""
        check(self.spec, values)
        ahead_m = (values["left"] + values["right"]) / 2
        self._heading_rad += (values["right"] - values["left"]) / TRACK_M
        self._x_m += ahead_m * math.cos(self._heading_rad)
        self._y_m += ahead_m * math.sin(self._heading_rad)
        outside = max(abs(self._x_m), abs(self._y_m)) > YARD_M
        event = "reached" if self._towards()[0] < NEAR_M else "outside" if outside else NOTHING
        return Outcome(event, self._sense())

    def scene(self):
        """Return what is true; the brain never sees it."""
        return dict(zip(self.spec.scene, self._towards(), strict=True))

    def close(self):
        """Free what it holds: nothing."""

    def _towards(self):
        """Return how far the light is, and how far to the left of the front, in radians."""
        x_m, y_m = self._light[0] - self._x_m, self._light[1] - self._y_m
        return math.hypot(x_m, y_m), math.remainder(math.atan2(y_m, x_m) - self._heading_rad, math.tau)

    def _sense(self):
        distance_m, angle_rad = self._towards()
        return {"distance": distance_m, "angle": angle_rad / math.pi}
