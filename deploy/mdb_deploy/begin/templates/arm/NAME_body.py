"""An arm of two links in a plane, by plain geometry, and a point that its hand is to reach. Change it into yours.

What counts are the members, those of `mdb_sim.body.Body`: what the robot has (`spec`), and what it does. A class of
yours that speaks to a real arm has the same ones; `Resting` is for bodies that stand still after each action, so that
`halt` has nothing to do, and `Unrestorable` for those that cannot be put back where they were.
"""

import math

import numpy as np

from mdb_sim.body import NOTHING, Actuator, Outcome, Resting, Sensor, Spec, Unrestorable, check

UPPER_M, FORE_M, NEAR_M = 0.5, 0.4, 0.08  # the links' lengths; so near the hand has reached the point
TURN_DEG = 15.0  # how far a joint turns in one action


class Robot(Resting, Unrestorable):
    """See the module's docstring."""

    spec = Spec(
        sensors=(
            Sensor(name="x", low=-0.9, high=0.9, unit="m"),  # where the point is, as the hand sees it, in metres ...
            Sensor(name="y", low=-0.9, high=0.9, unit="m"),  # ... along the forearm and to its left
            Sensor(name="bend", low=-180.0, high=180.0, unit="deg"),  # of the elbow
            Sensor(name="distance", low=0.0, high=1.8, unit="m"),
        ),
        actuators=(
            Actuator(name="shoulder", low=-TURN_DEG, high=TURN_DEG, unit="deg"),
            Actuator(name="elbow", low=-TURN_DEG, high=TURN_DEG, unit="deg"),
        ),
        events=("reached",),  # its words for what can happen
        scene=("hand_x_m", "hand_y_m", "point_x_m", "point_y_m"),  # what is true, for the teacher
    )

    def reset(self, seed, episode):
        """Put arm and point anywhere: the same seed and episode, the same place."""
        rng = np.random.default_rng((seed, episode))
        self._shoulder_rad, self._elbow_rad = rng.uniform(-math.pi, math.pi), rng.uniform(0.3, 2.5)
        away_m, where_rad = rng.uniform(0.3, 0.8), rng.uniform(-math.pi, math.pi)
        self._point = away_m * math.cos(where_rad), away_m * math.sin(where_rad)
        return self._sense()

    def act(self, values):
        """Turn both joints; say what happened and what is perceived. The elbow bends from 10 to 170 degrees."""
        check(self.spec, values)
        self._shoulder_rad = math.remainder(self._shoulder_rad + math.radians(values["shoulder"]), math.tau)
        bent_rad = self._elbow_rad + math.radians(values["elbow"])
        self._elbow_rad = min(max(bent_rad, math.radians(10.0)), math.radians(170.0))
        return Outcome("reached" if math.dist(self._hand(), self._point) < NEAR_M else NOTHING, self._sense())

    def scene(self):
        """Return what is true; the brain never sees it."""
        return dict(zip(self.spec.scene, (*self._hand(), *self._point), strict=True))

    def close(self):
        """Free what it holds: nothing."""

    def _hand(self):
        upper, fore = self._shoulder_rad, self._shoulder_rad + self._elbow_rad
        x_m = UPPER_M * math.cos(upper) + FORE_M * math.cos(fore)
        return x_m, UPPER_M * math.sin(upper) + FORE_M * math.sin(fore)

    def _sense(self):
        hand, along = self._hand(), self._shoulder_rad + self._elbow_rad
        x_m, y_m = self._point[0] - hand[0], self._point[1] - hand[1]
        return {
            "x": x_m * math.cos(along) + y_m * math.sin(along),
            "y": y_m * math.cos(along) - x_m * math.sin(along),
            "bend": math.degrees(self._elbow_rad),
            "distance": math.hypot(x_m, y_m),
        }
