"""What a teacher wants of an arm that reaches for a point, and of a car that drives to a ball."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from mdb_sim.teaching.languages import TeacherError
from mdb_sim.teaching.policy import as_listed


class Manoeuvre(NamedTuple):
    """What a car does in one action: its steering, rad, ahead (1) or back (-1), and how far its nose then turns."""

    steer_rad: float
    gear: float
    turn_deg: float


MANOEUVRES = {
    "right 45": Manoeuvre(-0.6, 1.0, -45.0),
    "right 17": Manoeuvre(-0.25, 1.0, -17.5),
    "ahead": Manoeuvre(0.0, 1.0, 0.0),
    "left 17": Manoeuvre(0.25, 1.0, 17.5),
    "left 45": Manoeuvre(0.6, 1.0, 45.0),
    "back, left 41": Manoeuvre(-0.6, -1.0, 41.0),
    "back, right 41": Manoeuvre(0.6, -1.0, -41.0),
}
"""What can be wanted, with the turns that were measured (sim/README.md, "The car")."""
UNSEEN_DEG, TOLERANCE_DEG = 5.0, 22.0
"""A turn that is wrong by no more than the first looks right; one that is wrong by so much more as the second is
worth 0, twice so much more -1 (ours). Turns err by up to 5 degrees, as the tyres slip."""
WRONG_GEAR = 1.0
"""So much less is it worth to drive ahead in the place of back, or back in the place of ahead (ours)."""
CIRCLE_M, CLEAR_M = 0.475, 0.2
"""The least radius about which the rear axle turns; a ball so far inside that circle is passed by."""
SIDE_RAD = math.radians(100.0)
"""A ball that far from the front, or farther, is soonest in front when the car backs off (ours)."""


class Drive:
    """Wants the ball in front of the car; where it cannot get there in a curve it wants it to back off first."""

    commands = tuple(MANOEUVRES)
    order = (1, 2, 3, 4, 5, 6, 0)
    needs = ("x_m", "y_m", "heading_rad", "ball_x_m", "ball_y_m")

    def want(self, scene: Mapping[str, float]) -> int:
        """See `Policy.want`."""
        ahead_m, aside_m = _ball(scene)
        bearing_rad = math.atan2(aside_m, ahead_m)
        from_centre_m = math.hypot(ahead_m, abs(aside_m) - CIRCLE_M)
        if from_centre_m < CIRCLE_M - CLEAR_M or abs(bearing_rad) > SIDE_RAD:
            return self.commands.index("back, left 41" if bearing_rad > 0.0 else "back, right 41")
        return min(range(5), key=lambda c: abs(bearing_rad - math.radians(MANOEUVRES[self.commands[c]].turn_deg)))

    def judge(self, before: Mapping[str, float], after: Mapping[str, float], event: str, wanted: int) -> float:
        """See `Policy.judge`: by the turn and the way that the motion shows."""
        del event
        x_m, y_m = after["x_m"] - before["x_m"], after["y_m"] - before["y_m"]
        turn_rad = math.remainder(after["heading_rad"] - before["heading_rad"], math.tau)
        middle_rad = before["heading_rad"] + turn_rad / 2.0
        gear = math.copysign(1.0, x_m * math.cos(middle_rad) + y_m * math.sin(middle_rad))
        return self._worth(math.degrees(turn_rad), gear, wanted)

    def expected(self, wanted: int, action: Mapping[str, float]) -> float | None:
        """See `Policy.expected`: of another action than the manoeuvres nothing is known."""
        told = action.get("steer"), action.get("drive")
        done = next((m for m in MANOEUVRES.values() if (m.steer_rad, m.gear) == told), None)
        return None if done is None else self._worth(done.turn_deg, done.gear, wanted)

    def _worth(self, turn_deg: float, gear: float, wanted: int) -> float:
        manoeuvre = MANOEUVRES[self.commands[wanted]]
        wrong_deg = abs(math.remainder(turn_deg - manoeuvre.turn_deg, 360.0))
        miss = max(0.0, wrong_deg - UNSEEN_DEG) / TOLERANCE_DEG
        return max(-1.0, 1.0 - miss - WRONG_GEAR * (gear != manoeuvre.gear))


def _ball(scene: Mapping[str, float]) -> tuple[float, float]:
    """Return where the ball is from the middle of the rear axle, m ahead and to the left."""
    x_m, y_m = scene["ball_x_m"] - scene["x_m"], scene["ball_y_m"] - scene["y_m"]
    cos, sin = math.cos(scene["heading_rad"]), math.sin(scene["heading_rad"])
    return x_m * cos + y_m * sin, y_m * cos - x_m * sin


Point = tuple[float, float, float]

LEAST_M = 0.1
"""What can be won counts as so much at least: else nearly all that is done close to the point is punished alike, and
where it is right cannot be told (sim/README.md, "The arm")."""
DIRECTIONS = ("left", "right", "up", "down", "out", "in")
"""As the arm's eye sees them: two angles, and away from it or towards it."""


class Guide:
    """Wants the hand to go where it is farthest from the point: aside, up or down, out or in, as the eye sees it."""

    commands = DIRECTIONS
    order = as_listed(commands)
    needs = ("x_m", "y_m", "z_m", "target_x_m", "target_y_m", "target_z_m")

    def __init__(
        self, *, eye_m: Sequence[float] = (0.0, 0.0, 0.36), turn_rad: float = 0.25, out_m: float = 0.08
    ) -> None:
        """eye_m: where the eye is. turn_rad, out_m: how far the hand is to go in one action, at most."""
        if len(eye_m) != 3 or turn_rad <= 0.0 or out_m <= 0.0:
            raise TeacherError(
                f"eye_m={list(eye_m)}, turn_rad={turn_rad}, out_m={out_m}; expected three numbers, and above 0"
            )
        self._eye_m, self._most = tuple(eye_m), (turn_rad, turn_rad, out_m)

    def want(self, scene: Mapping[str, float]) -> int:
        """See `Policy.want`."""
        hand, target = self._points(scene)
        off, range_m = self._off(hand, target), hand[2]
        metres = (off[0] * range_m * math.cos(hand[1]), off[1] * range_m, off[2])
        axis = max(range(3), key=lambda a: abs(metres[a]))
        return 2 * axis + (off[axis] < 0.0)

    def judge(self, before: Mapping[str, float], after: Mapping[str, float], event: str, wanted: int) -> float:
        """See `Policy.judge`: the distance to the point that was won, of what one action can win at the most.

        Where the command leads away from the point, the distance counts to where it leads.
        """
        del event
        hand, target = self._points(before)
        axis, sign = wanted // 2, -1.0 if wanted % 2 else 1.0
        off = self._off(hand, target)
        if sign * off[axis] > 0.0:
            goal: Sequence[float] = target
            best = [h + math.copysign(min(abs(o), m), o) for h, o, m in zip(hand, off, self._most, strict=True)]
        else:
            step = sign * self._most[axis]
            goal = best = [h + step * (a == axis) for a, h in enumerate(hand)]
        start_m = _apart_m(hand, goal)
        won_m, most_m = (start_m - _apart_m(there, goal) for there in (self._points(after)[0], best))
        return max(-1.0, min(1.0, won_m / max(most_m, LEAST_M)))

    def expected(self, wanted: int, action: Mapping[str, float]) -> float | None:
        """See `Policy.expected`: it depends on how the arm is bent."""
        del wanted, action
        return None

    def _points(self, scene: Mapping[str, float]) -> tuple[Point, Point]:
        """Return hand and target as the eye sees them: azimuth and elevation, rad, and range, m."""
        hand, target = (self._seen([scene[name] for name in names]) for names in (self.needs[:3], self.needs[3:]))
        return hand, target

    def _seen(self, point: Sequence[float]) -> Point:
        x_m, y_m, z_m = (p - e for p, e in zip(point, self._eye_m, strict=True))
        return math.atan2(y_m, x_m), math.atan2(z_m, math.hypot(x_m, y_m)), math.hypot(x_m, y_m, z_m)

    def _off(self, hand: Point, target: Point) -> Point:
        """Return how far the target is to the left of the hand, above it, rad, and farther away, m."""
        return math.remainder(target[0] - hand[0], math.tau), target[1] - hand[1], target[2] - hand[2]


def _apart_m(one: Sequence[float], other: Sequence[float]) -> float:
    return math.dist(_placed(one), _placed(other))


def _placed(seen: Sequence[float]) -> Point:
    azimuth, elevation, range_m = seen
    level_m = range_m * math.cos(elevation)
    return level_m * math.cos(azimuth), level_m * math.sin(azimuth), range_m * math.sin(elevation)
