"""What a teacher wants of a robot that turns and advances: to reach the object (paper, section 3), to avoid it, or to
follow a wall. Each judges the turn that the robot made.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mdb_sim.teaching.languages import TeacherError

PAPERS_TURNS_DEG = (0.0, -20.0, -45.0, -90.0, 20.0, 45.0, 90.0)
"""In the paper's order: none, three to the right, three to the left."""
MISS_WITHOUT_PLEASURE = 3
"""Missing by so many steps of turn, or more, earns the full punishment (sim/README.md, "Teacher")."""
UNSEEN = 0.05
"""Of a step between two commands; what is nearer to a command than this looks like it (ours)."""


class _Turning:
    """What these policies have in common: commands are turns, left positive."""

    needs: tuple[str, ...] = ("x_m", "y_m", "heading_rad", "object_x_m", "object_y_m")

    def __init__(self, turns_deg: Sequence[float] = PAPERS_TURNS_DEG) -> None:
        """`turns_deg`: the turns that can be wanted."""
        known = all(-180.0 <= turn <= 180.0 for turn in turns_deg)
        if len(turns_deg) < 2 or len(set(turns_deg)) < len(turns_deg) or not known:
            raise TeacherError(f"turns_deg is {list(turns_deg)}; expected two or more of -180 to 180, all different")
        self.turns_deg = tuple(float(turn) for turn in turns_deg)
        self.commands = tuple(_name(turn) for turn in self.turns_deg)
        self._sorted = sorted(self.turns_deg)
        self.order = tuple(self._sorted.index(turn) for turn in self.turns_deg)

    def _nearest(self, turn_rad: float) -> int:
        """Return the command that is nearest to a turn; the first of equals."""
        turns_rad = [math.radians(turn) for turn in self.turns_deg]
        return min(range(len(turns_rad)), key=lambda command: abs(_wrap_rad(turn_rad - turns_rad[command])))

    def judge(self, before: Mapping[str, float], after: Mapping[str, float], event: str, wanted: int) -> float:
        """See `Policy.judge`."""
        del event
        return self._judged(math.degrees(_wrap_rad(after["heading_rad"] - before["heading_rad"])), wanted)

    def expected(self, wanted: int, action: Mapping[str, float]) -> float | None:
        """See `Policy.expected`."""
        return self._judged(action["turn"], wanted) if "turn" in action else None

    def _rank(self, turned_deg: float) -> float:
        """Return the place of a turn among those that can be wanted; beyond the outermost it goes on as before it."""
        turns = self._sorted
        if turned_deg < turns[0]:
            return -(turns[0] - turned_deg) / (turns[1] - turns[0])
        if turned_deg > turns[-1]:
            return len(turns) - 1 + (turned_deg - turns[-1]) / (turns[-1] - turns[-2])
        return float(np.interp(turned_deg, turns, range(len(turns))))

    def _judged(self, turned_deg: float, wanted: int) -> float:
        """Return 1 for what was wanted, less for each step missed, -1 from three steps on (paper, section 3)."""
        rank = self._rank(turned_deg)
        if abs(rank - round(rank)) < UNSEEN:
            rank = round(rank)
        miss = abs(rank - self.order[wanted])
        return 2.0 * max(0.0, 1.0 - miss / MISS_WITHOUT_PLEASURE) - 1.0


class Reach(_Turning):
    """Wants the turn after which the robot best faces the object."""

    def want(self, scene: Mapping[str, float]) -> int:
        """See `Policy.want`."""
        return self._nearest(_bearing_rad(scene))


class Avoid(_Turning):
    """Wants the smallest turn after which a near object is not in front; far from it, straight on."""

    def __init__(
        self, turns_deg: Sequence[float] = PAPERS_TURNS_DEG, *, near_m: float = 1.0, aside_deg: float = 80.0
    ) -> None:
        """near_m: to the object's centre; aside_deg: an object that far from the front is not in front."""
        super().__init__(turns_deg)
        self._near_m, self._aside_rad = near_m, math.radians(aside_deg)

    def want(self, scene: Mapping[str, float]) -> int:
        """See `Policy.want`."""
        away_m = math.hypot(scene["object_x_m"] - scene["x_m"], scene["object_y_m"] - scene["y_m"])
        bearing_rad = _bearing_rad(scene)

        def in_front_rad(turn_deg: float) -> float:
            """Return how much more aside the object should be."""
            left_rad = self._aside_rad - abs(_wrap_rad(bearing_rad - math.radians(turn_deg)))
            return max(0.0, left_rad) if away_m < self._near_m else 0.0

        commands = range(len(self.turns_deg))
        return min(commands, key=lambda c: (round(in_front_rad(self.turns_deg[c]), 6), abs(self.turns_deg[c])))


class FollowWall(_Turning):
    """Wants the wall of a square arena at the robot's right hand, at a distance."""

    needs = ("x_m", "y_m", "heading_rad")

    def __init__(
        self,
        turns_deg: Sequence[float] = PAPERS_TURNS_DEG,
        *,
        arena_m: float = 10.0,
        distance_m: float = 0.7,
        ahead_m: float = 0.9,
    ) -> None:
        """arena_m: its side; ahead_m: a wall that near in front is the next to follow."""
        super().__init__(turns_deg)
        self._half_m, self._distance_m, self._ahead_m = arena_m / 2.0, distance_m, ahead_m

    def want(self, scene: Mapping[str, float]) -> int:
        """See `Policy.want`."""
        x_m, y_m = scene["x_m"], scene["y_m"]
        # The walls' outward directions, counter-clockwise, and how far each wall is.
        away_m = [self._half_m - x_m, self._half_m - y_m, self._half_m + x_m, self._half_m + y_m]
        wall = min(range(4), key=lambda w: away_m[w])
        if away_m[(wall + 1) % 4] < self._ahead_m:  # with the wall on the right the next one comes in front
            wall = (wall + 1) % 4
        along_rad = (wall + 1) * math.pi / 2.0
        towards_rad = math.atan(2.0 * (away_m[wall] - self._distance_m))
        return self._nearest(_wrap_rad(along_rad - towards_rad - scene["heading_rad"]))


def _bearing_rad(scene: Mapping[str, float]) -> float:
    """Return the angle from the robot's front to the object's centre, left positive, in [-pi, pi]."""
    towards_rad = math.atan2(scene["object_y_m"] - scene["y_m"], scene["object_x_m"] - scene["x_m"])
    return _wrap_rad(towards_rad - scene["heading_rad"])


def _wrap_rad(angle_rad: float) -> float:
    return math.remainder(angle_rad, 2.0 * math.pi)


def _name(turn_deg: float) -> str:
    if turn_deg == 0.0:
        return "ahead"
    return f"{'left' if turn_deg > 0.0 else 'right'} {abs(turn_deg):g}"
