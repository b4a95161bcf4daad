"""What a teacher wants of the classic machines of control: a pole on a cart, a car in a valley, a pendulum.

Each policy is as small as the machine's physics allows, and each judges the push that the motion between two scenes
shows, by the machine's equation of motion (Gymnasium's documentation of the environment).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from mdb_sim.teaching.policy import as_listed


class _Pushes:
    """What these policies have in common: commands are pushes along one axis, judged by how near the push was."""

    needs: tuple[str, ...] = ()
    actuator = "motor"

    def __init__(self, pushes: Mapping[str, float], tolerance: float) -> None:
        """pushes: what each command asks for; a push that is `tolerance` away is worth 0, twice as far -1."""
        self.commands = tuple(pushes)
        self.order = as_listed(self.commands)
        self._pushes, self._tolerance = tuple(pushes.values()), tolerance

    def nearest(self, push: float) -> int:
        """Return the command that is nearest to a push; the first of equals."""
        return min(range(len(self._pushes)), key=lambda command: abs(self._pushes[command] - push))

    def judge(self, before: Mapping[str, float], after: Mapping[str, float], event: str, wanted: int) -> float | None:
        """See `Policy.judge`."""
        del event
        push = self.pushed(before, after)
        return None if push is None else self._worth(push, wanted)

    def pushed(self, before: Mapping[str, float], after: Mapping[str, float]) -> float | None:
        """Return the push that a motion shows; None: it shows none."""
        raise NotImplementedError

    def expected(self, wanted: int, action: Mapping[str, float]) -> float | None:
        """See `Policy.expected`."""
        return self._worth(self.meant(action[self.actuator]), wanted) if self.actuator in action else None

    def meant(self, value: float) -> float:
        """Return the push that a value of the actuator is meant to give."""
        return value

    def _worth(self, push: float, wanted: int) -> float:
        return max(-1.0, 1.0 - abs(push - self._pushes[wanted]) / self._tolerance)


class Balance(_Pushes):
    """CartPole: keep the pole up, and the cart near the middle."""

    needs = ("x", "x_speed", "angle", "angle_speed")

    def __init__(self, weights: Sequence[float] = (0.1, 0.25, 1.0, 0.5)) -> None:
        """weights: how much place, speed, angle and its speed call for a push to the right."""
        super().__init__({"left": -1.0, "right": 1.0}, tolerance=1.0)
        self._weights = tuple(weights)

    def want(self, scene: Mapping[str, float]) -> int | None:
        """See `Policy.want`."""
        return self.nearest(sum(w * scene[name] for w, name in zip(self._weights, self.needs, strict=True)))

    def pushed(self, before: Mapping[str, float], after: Mapping[str, float]) -> float:
        """Return 1 for a push to the right, -1 for one to the left: the cart's speed shows it."""
        return math.copysign(1.0, after["x_speed"] - before["x_speed"])

    def meant(self, value: float) -> float:
        """Return the push of the environment's action 0 or 1."""
        return 2.0 * value - 1.0


class Swing(_Pushes):
    """MountainCar: push where the car goes already, so that it swings higher and higher."""

    needs = ("position", "speed")

    _WALL, _MOST_SPEED = -1.19, 0.0699

    def __init__(
        self,
        force: float = 0.001,
        gravity: float = 0.0025,
        *,
        push: float = 1.0,
        rest: float = 1.0,
        tolerance: float = 1.0,
    ) -> None:
        """force, gravity: of the environment's equation of motion. push: how strong a push is wanted, of 1.

        rest: the motor's value that does not push; a value of 1 more pushes with all of the force.
        """
        super().__init__({"left": -push, "none": 0.0, "right": push}, tolerance)
        self._force, self._gravity, self._push, self._rest = force, gravity, push, rest

    def want(self, scene: Mapping[str, float]) -> int | None:
        """See `Policy.want`."""
        return self.nearest(-self._push if scene["speed"] < 0.0 else self._push)

    def pushed(self, before: Mapping[str, float], after: Mapping[str, float]) -> float | None:
        """Return the push from -1 to 1: the change of speed, less that by the slope.

        The wall on the left stops the car, and at its greatest speed a push does nothing.
        """
        if after["position"] < self._WALL or abs(after["speed"]) > self._MOST_SPEED:
            return None
        slope = -self._gravity * math.cos(3.0 * before["position"])
        return max(-1.0, min(1.0, (after["speed"] - before["speed"] - slope) / self._force))

    def meant(self, value: float) -> float:
        """Return the push that a value of the motor is meant to give."""
        return value - self._rest


class Whip(_Pushes):
    """Acrobot: two links hang from a bar, a motor between them. Bend where the lower one swings already."""

    needs = ("cos_1", "sin_1", "cos_2", "sin_2", "speed_1", "speed_2")

    _STEP_S, _GRAVITY, _PARTS = 0.2, 9.8, 4

    def __init__(self, upper: float = 0.3) -> None:
        """upper: how much the upper link's speed counts against the lower one's."""
        super().__init__({"left": -1.0, "none": 0.0, "right": 1.0}, tolerance=1.0)
        self._upper = upper

    def want(self, scene: Mapping[str, float]) -> int | None:
        """See `Policy.want`."""
        return self.nearest(1.0 if scene["speed_2"] > self._upper * scene["speed_1"] else -1.0)

    def pushed(self, before: Mapping[str, float], after: Mapping[str, float]) -> float | None:
        """Return the torque from -1 to 1 that explains the lower link's speed best."""
        speeds = [self._after(before, torque) for torque in (-1.0, 1.0)]
        if abs(speeds[1] - speeds[0]) < 1e-6:
            return None
        return max(-1.0, min(1.0, 2.0 * (after["speed_2"] - speeds[0]) / (speeds[1] - speeds[0]) - 1.0))

    def _after(self, before: Mapping[str, float], torque: float) -> float:
        """Return the lower link's speed after a step with a torque, by the midpoint rule."""
        state = (
            math.atan2(before["sin_1"], before["cos_1"]),
            math.atan2(before["sin_2"], before["cos_2"]),
            before["speed_1"],
            before["speed_2"],
        )
        part_s = self._STEP_S / self._PARTS
        for _ in range(self._PARTS):
            half = _moved(state, self._rates(state, torque), part_s / 2)
            state = _moved(state, self._rates(half, torque), part_s)
        return state[3]

    def _rates(self, state: _Links, torque: float) -> _Links:
        """Return how fast angles and speeds change: Sutton and Barto's equations, links of 1 m and 1 kg (11.3)."""
        first, second, speed, bend = state
        inertia = 3.5 + math.cos(second)
        shared = 1.25 + 0.5 * math.cos(second)
        lower = 0.5 * self._GRAVITY * math.cos(first + second - math.pi / 2)
        upper = -0.5 * bend * math.sin(second) * (bend + 2 * speed) + 1.5 * self._GRAVITY * math.cos(
            first - math.pi / 2
        )
        upper += lower
        push = torque + shared / inertia * upper - 0.5 * speed**2 * math.sin(second) - lower
        bending = push / (1.25 - shared**2 / inertia)
        return speed, bend, -(shared * bending + upper) / inertia, bending

    def meant(self, value: float) -> float:
        """Return the torque of the environment's action 0, 1 or 2."""
        return value - 1.0


_Links = tuple[float, float, float, float]
"""Angles of the upper link and of the lower one to it, rad, and their speeds, rad/s."""


def _moved(state: _Links, rates: _Links, time_s: float) -> _Links:
    first, second, speed, bend = (value + rate * time_s for value, rate in zip(state, rates, strict=True))
    return first, second, speed, bend


class Upright(_Pushes):
    """Pendulum: swing it up by its energy, then hold it there; the torques of the commands are coarse."""

    needs = ("cos", "sin", "speed")
    actuator = "torque"
    _STEP_S, _GRAVITY, _MOST_SPEED = 0.05, 10.0, 8.0

    def __init__(self, torques: Sequence[float] = (-2.0, -1.0, 0.0, 1.0, 2.0), tolerance: float = 2.0) -> None:
        """torques: those that can be wanted."""
        super().__init__({f"{torque:+g}": float(torque) for torque in torques}, tolerance)

    def want(self, scene: Mapping[str, float]) -> int | None:
        """See `Policy.want`."""
        angle, speed = math.atan2(scene["sin"], scene["cos"]), scene["speed"]
        if scene["cos"] > 0.8:
            return self.nearest(-(8.0 * angle + 2.0 * speed))
        missing = 1.5 * self._GRAVITY * (1.0 - scene["cos"]) - speed**2 / 2.0
        return self.nearest(math.copysign(2.0, speed if missing > 0.0 else -speed))

    def pushed(self, before: Mapping[str, float], after: Mapping[str, float]) -> float | None:
        """Return the torque: the change of speed, less that by gravity; at the greatest speed it does nothing."""
        if abs(after["speed"]) >= self._MOST_SPEED:
            return None
        change = (after["speed"] - before["speed"]) / self._STEP_S
        return (change - 1.5 * self._GRAVITY * before["sin"]) / 3.0
