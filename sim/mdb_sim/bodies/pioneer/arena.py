"""The world's rules, the same for every body: placements, captures, episodes, and the source of randomness.

Owns: what is random and by which key, the capture rule, and `ArenaRobot`, the part of a body that runs
episodes. A body adds how it moves and what its rays meet. Must not know physics engines, models, rewards or
languages.

Every random number comes from a Philox stream that is a pure function of (seed, purpose, index): a run
that is restored elsewhere draws the same numbers, and no stream depends on how often another was used.
"""

from __future__ import annotations

import abc
import math
from types import TracebackType
from typing import Literal, Self

import numpy as np

from mdb_sim.bodies.pioneer.perceive import perceive
from mdb_sim.bodies.pioneer.sonar import BODY_CENTRE_X_M, Array, SonarRing
from mdb_sim.body import Event, Placement, Pose, Reading, RobotConfig, RobotError, Step

BODY_RADIUS_M = 0.22
"""Radius of the circle about the body's centre that touches things (sim/README.md, "The Pioneer 2 DX")."""

REACH_MARGIN_M = 0.02
"""How much farther than asked for a motion may carry the body, amply (ours)."""

Purpose = Literal["placement", "reached", "placed", "sense"]
_PURPOSES: tuple[Purpose, ...] = ("placement", "reached", "placed", "sense")


def stream(seed: int, purpose: Purpose, index: int, repeat: int = 0) -> np.random.Generator:
    """The random stream of one purpose at one index (an iteration or an episode)."""
    # Key and counter are 64-bit words; the counter's lowest word is the stream's own position.
    key = np.array([seed, _PURPOSES.index(purpose)], dtype=np.uint64)
    counter = np.array([0, repeat, index, 0], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=counter))


def wrap_rad(angle_rad: float) -> float:
    """The same angle in [-pi, pi]."""
    return math.remainder(angle_rad, 2.0 * math.pi)


def bearing_rad(placement: Placement) -> float:
    """True angle from the robot's front to the object's centre, left positive, in [-pi, pi]."""
    robot = placement.robot
    towards_rad = math.atan2(placement.object_y_m - robot.y_m, placement.object_x_m - robot.x_m)
    return wrap_rad(towards_rad - robot.heading_rad)


def surface_distance_m(placement: Placement, object_radius_m: float) -> float:
    """True distance from the robot's centre of rotation to the object's surface."""
    robot = placement.robot
    return math.hypot(placement.object_x_m - robot.x_m, placement.object_y_m - robot.y_m) - object_radius_m


def is_captured(placement: Placement, config: RobotConfig) -> bool:
    """The object is near and in front: "reach the object frontally" (paper, section 3).

    Near is counted from the centre of rotation to the object's surface, as a new placement's distance is.
    With both so counted the ideal policy captures 23.7 times in 100 iterations (sim/README.md, "Bounds").
    """
    near = surface_distance_m(placement, config.object_radius_m) <= config.capture_distance_m
    return near and abs(bearing_rad(placement)) <= math.radians(config.capture_angle_deg)


def body_centre_m(pose: Pose) -> tuple[float, float]:
    """Centre in the world of the circle that touches things."""
    return (
        pose.x_m + BODY_CENTRE_X_M * math.cos(pose.heading_rad),
        pose.y_m + BODY_CENTRE_X_M * math.sin(pose.heading_rad),
    )


def clearance_m(placement: Placement, config: RobotConfig) -> float:
    """How far the body's circle is from the nearest thing, object or wall; 0 or less when it touches."""
    x_m, y_m = body_centre_m(placement.robot)
    object_m = math.hypot(placement.object_x_m - x_m, placement.object_y_m - y_m) - config.object_radius_m
    wall_m = config.arena_m / 2.0 - max(abs(x_m), abs(y_m))
    return min(object_m, wall_m) - BODY_RADIUS_M


def draw_placement(config: RobotConfig, seed: int, episode: int) -> Placement:
    """Robot in the central point with any heading, the object in an area around it (paper, section 3)."""
    rng = stream(seed, "placement", episode)
    heading_rad, direction_rad = rng.uniform(-math.pi, math.pi, size=2).tolist()
    distance_m = config.object_radius_m + float(rng.uniform(config.place_min_m, config.place_max_m))
    robot = Pose(0.0, 0.0, heading_rad)
    return Placement(robot, distance_m * math.cos(direction_rad), distance_m * math.sin(direction_rad))


class ArenaRobot(abc.ABC):
    """A `mdb_sim.body.Robot` but for its motion: a body fills in `_place`, `_move`, `_pose` and `cast`."""

    def __init__(self, config: RobotConfig) -> None:
        self.config = config
        self.ring = SonarRing(config)
        self._turns_rad = config.turns_rad
        self._seed: int | None = None
        self._closed = False
        self._object_m = (0.0, 0.0)
        self._iteration = self._episode = self._captures = self._episode_age = self._unseen = self._senses = 0

    @abc.abstractmethod
    def _place(self, placement: Placement) -> None:
        """Put robot and object there, at rest."""

    @abc.abstractmethod
    def _move(self, turn_rad: float, advance_m: float) -> bool:
        """Turn, then advance; stop at the first contact. Returns whether the robot bumped."""

    @abc.abstractmethod
    def _pose(self) -> Pose:
        """Where the robot truly is."""

    @abc.abstractmethod
    def cast(self, origins_m: Array, directions: Array) -> tuple[Array, Array]:
        """See `sonar.RayCaster`."""

    @property
    def actions(self) -> int:
        """How many actions there are."""
        return len(self._turns_rad)

    @property
    def placement(self) -> Placement:
        """Where robot and object are now."""
        self._begun()
        return Placement(self._pose(), *self._object_m)

    def reset(self, seed: int) -> Step:
        """Start anew with the first placement of this seed."""
        self.restore(draw_placement(self.config, _checked_seed(seed), 0), 0, seed=seed)
        placement = self.placement
        reading = self._read("placed", 0)
        return Step(0, "none", placement, reading, placement, reading, 0, 0)

    def restore(
        self,
        placement: Placement,
        iteration: int,
        *,
        seed: int,
        episode: int = 0,
        captures: int = 0,
        episode_age: int = 0,
        unseen: int = 0,
    ) -> None:
        """Continue a run where a step left it; see `Robot.restore`."""
        counts = (iteration, episode, captures, episode_age, unseen)
        if min(counts) < 0:
            raise RobotError(f"restore got a negative count among {counts}; give the counts of a Step")
        self._open()
        self._check_place(placement)
        self._seed = _checked_seed(seed)
        self._iteration, self._episode, self._captures, self._episode_age, self._unseen = counts
        self._put(placement)

    def sense(self) -> Reading:
        """A fresh reading: other noise each time, and no later step changes by it."""
        self._senses += 1
        return self._read("sense", self._senses)

    def act(self, action: int) -> Step:
        """One iteration: turn, advance, sense, and a new placement when the episode is over."""
        self._check_action(action)
        self._begun()
        bumped = self._move(self._turns_rad[action], self.config.advance_m)
        self._iteration += 1
        self._episode_age += 1
        self._senses = 0
        reached = self.placement
        reading = self._read("reached", 0)
        self._unseen = 0 if reading else self._unseen + 1
        event = self._event(reached, bumped)
        self._captures += event == "capture"
        now, next_reading = (reached, reading) if event == "none" else self._place_anew()
        return Step(
            self._iteration, event, reached, reading, now, next_reading,
            self._captures, self._episode, self._episode_age, self._unseen,
        )  # fmt: skip

    def clean_ranges_m(self) -> Array:
        """The (16,) ranges without noise or dropped echoes where the robot stands; nan without echo."""
        return self.ring.clean_ranges_m(self.placement.robot, self.cast)

    def close(self) -> None:
        """End the use of this body; a body that holds more frees it here."""
        self._closed = True

    def __enter__(self) -> Self:
        """Use the body in a `with` block."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the body at the end of a `with` block."""
        self.close()

    def _may_touch(self, start: Pose, advance_m: float) -> bool:
        """Whether anything is within reach of a motion from there: a cheap answer that spares most searches."""
        reach_m = BODY_RADIUS_M + abs(BODY_CENTRE_X_M) + advance_m + REACH_MARGIN_M
        object_m = math.hypot(self._object_m[0] - start.x_m, self._object_m[1] - start.y_m)
        wall_m = self.config.arena_m / 2.0 - max(abs(start.x_m), abs(start.y_m))
        return object_m <= reach_m + self.config.object_radius_m or wall_m <= reach_m

    def _event(self, reached: Placement, bumped: bool) -> Event:
        """What ended the episode, if anything did. Touching the object frontally is reaching it."""
        if is_captured(reached, self.config):
            return "capture"
        if bumped:
            return "bump"
        if self._unseen >= self.config.lost_readings:
            return "lost"
        return "timeout" if self._episode_age >= self.config.episode_iterations else "none"

    def _place_anew(self) -> tuple[Placement, Reading]:
        self._episode += 1
        self._episode_age = self._unseen = 0
        self._put(draw_placement(self.config, self._begun(), self._episode))
        return self.placement, self._read("placed", 0)

    def _put(self, placement: Placement) -> None:
        self._object_m = (placement.object_x_m, placement.object_y_m)
        self._senses = 0
        self._place(placement)

    def _read(self, purpose: Purpose, repeat: int) -> Reading:
        rng = stream(self._begun(), purpose, self._iteration, repeat)
        return perceive(self.ring.ranges_m(self._pose(), self.cast, rng), self.config)

    def _begun(self) -> int:
        """The run's seed; an error when there is no run yet."""
        self._open()
        if self._seed is None:
            raise RobotError("the robot has no placement yet; call reset(seed) or restore(...) first")
        return self._seed

    def _open(self) -> None:
        if self._closed:
            raise RobotError("the robot is closed; make another one with make_robot(body, config)")

    def _check_action(self, action: int) -> None:
        whole = isinstance(action, int | np.integer) and not isinstance(action, bool)
        if not whole or not 0 <= action < self.actions:
            raise RobotError(
                f"action={action!r} is not an action; expected an int from 0 to {self.actions - 1}"
                " (an index into turns_deg)"
            )

    def _check_place(self, placement: Placement) -> None:
        half_m = self.config.arena_m / 2.0
        robot = placement.robot
        places = (robot.x_m, robot.y_m, placement.object_x_m, placement.object_y_m)
        if not all(abs(value) <= half_m for value in places) or not math.isfinite(robot.heading_rad):
            raise RobotError(
                f"{placement} is not inside the arena; expected coordinates within ±{half_m} m and a finite"
                " heading; restore with the arena_m the run was begun with"
            )


def _checked_seed(seed: int) -> int:
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**64:
        raise RobotError(f"seed={seed!r} is not a seed; expected an int from 0 to 2**64 - 1")
    return seed
