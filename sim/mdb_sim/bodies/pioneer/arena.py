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
from collections import deque
from collections.abc import Mapping
from types import TracebackType
from typing import Annotated, Any, Literal, Self

import msgspec
import numpy as np
from msgspec import Meta

from mdb_protocol.messages import Drawing
from mdb_services.mechanism.networks.streams import philox
from mdb_sim.bodies.pioneer.drawing import draw
from mdb_sim.bodies.pioneer.perceive import perceive
from mdb_sim.bodies.pioneer.sonar import BODY_CENTRE_X_M, Array, SonarRing
from mdb_sim.bodies.pioneer.world import (
    Changes,
    PioneerConfig,
    Placement,
    Pose,
    changed,
    config_of,
    placement_of,
    scene_of,
    spec_of,
)
from mdb_sim.body import NOTHING, BodyError, Numbers, Outcome, Reading, Resting, Spec, check, check_episode

BODY_RADIUS_M = 0.22
"""Radius of the circle about the body's centre that touches things (sim/README.md, "The Pioneer 2 DX")."""

NEAR_WALL_M = 0.5, 1.2
"""How far from a wall an episode begins there, from the centre of rotation (ours)."""
TRAIL = 256
"""Places that are remembered of the robot's way in an episode, to be drawn."""
REACH_MARGIN_M = 0.02
"""How much farther than asked for a motion may carry the body, amply (ours)."""

Purpose = Literal["placement", "reached", "placed", "sense"]
_PURPOSES: tuple[Purpose, ...] = ("placement", "reached", "placed", "sense")


def stream(seed: int, purpose: Purpose, index: int, repeat: int = 0) -> np.random.Generator:
    """The random stream of one purpose at one index (an iteration or an episode)."""
    return philox((seed, _PURPOSES.index(purpose)), (0, repeat, index, 0))


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


def is_captured(placement: Placement, config: PioneerConfig) -> bool:
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


def clearance_m(placement: Placement, config: PioneerConfig) -> float:
    """How far the body's circle is from the nearest thing, object or wall; 0 or less when it touches."""
    x_m, y_m = body_centre_m(placement.robot)
    object_m = math.hypot(placement.object_x_m - x_m, placement.object_y_m - y_m) - config.object_radius_m
    wall_m = config.arena_m / 2.0 - max(abs(x_m), abs(y_m))
    return min(object_m, wall_m) - BODY_RADIUS_M


def draw_placement(config: PioneerConfig, seed: int, episode: int) -> Placement:
    """Robot in the central point with any heading, the object in an area around it (paper, section 3)."""
    rng = stream(seed, "placement", episode)
    if config.start == "wall":
        return _beside_a_wall(config, rng)
    heading_rad, direction_rad = rng.uniform(-math.pi, math.pi, size=2).tolist()
    distance_m = config.object_radius_m + float(rng.uniform(config.place_min_m, config.place_max_m))
    robot = Pose(0.0, 0.0, heading_rad)
    return Placement(robot, distance_m * math.cos(direction_rad), distance_m * math.sin(direction_rad))


def _beside_a_wall(config: PioneerConfig, rng: np.random.Generator) -> Placement:
    """Robot near one of the walls with any heading, the object in the middle of the arena (ours)."""
    along_m, from_wall_m = rng.uniform(-0.3, 0.3) * config.arena_m, rng.uniform(*NEAR_WALL_M)
    away_m, turns = config.arena_m / 2.0 - from_wall_m, int(rng.integers(4))
    x_m, y_m = ((away_m, along_m), (along_m, away_m), (-away_m, along_m), (along_m, -away_m))[turns]
    return Placement(Pose(float(x_m), float(y_m), float(rng.uniform(-math.pi, math.pi))), 0.0, 0.0)


class _State(msgspec.Struct, frozen=True):
    """All from which a body goes on."""

    seed: int
    acts: Annotated[int, Meta(ge=0)]
    unseen: Annotated[int, Meta(ge=0)]
    scene: Numbers
    changes: Changes


class ArenaRobot(Resting, abc.ABC):
    """A `mdb_sim.body.Body` but for its motion: a body fills in `_place`, `_move`, `_pose` and `cast`."""

    simulated = True

    def __init__(self, **options: Any) -> None:
        """Take the options of `[robot.options]`; BodyError when they are wrong."""
        self.config = config_of(options)
        self.ring = SonarRing(self.config)
        self.changes = Changes()
        self._seed: int | None = None
        self._closed = False
        self._object_m = (0.0, 0.0)
        self._acts = self._unseen = self._senses = 0
        self._trail: deque[tuple[float, float]] = deque(maxlen=TRAIL)

    @classmethod
    def spec_of(cls, **options: Any) -> Spec:
        """Return what such a body has, without making one."""
        return spec_of(config_of(options))

    @property
    def spec(self) -> Spec:
        """See `Body.spec`."""
        return spec_of(self.config)

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
    def placement(self) -> Placement:
        """Where robot and object are now."""
        self._begun()
        return Placement(self._pose(), *self._object_m)

    def scene(self) -> Numbers:
        """See `Body.scene`."""
        return scene_of(self.placement)

    def draw(self, reading: Reading) -> Drawing:
        """See `Drawable.draw`."""
        placement = self.placement
        hull = body_centre_m(placement.robot), BODY_RADIUS_M
        return draw(placement, self._trail, reading, self.config, hull)

    def reset(self, seed: int, episode: int) -> Reading:
        """See `Body.reset`: each episode has a placement of its own."""
        self._open()
        check_episode(seed, episode)
        self._seed = seed
        if episode == 0:
            self._acts = 0
        self._unseen = 0
        self._put(draw_placement(self.config, seed, episode))
        return self._read("placed", 0)

    def put(self, placement: Placement, seed: int, acts: int = 0) -> None:
        """Go on from a placement after so many actions of a run: for measurements."""
        self._open()
        self._check_place(placement)
        if acts < 0:
            raise BodyError(f"acts={acts}; expected 0 or more")
        check_episode(seed, 0)
        self._seed, self._acts, self._unseen = seed, acts, 0
        self._put(placement)

    def state(self) -> bytes | None:
        """See `Body.state`."""
        return msgspec.msgpack.encode(_State(self._begun(), self._acts, self._unseen, self.scene(), self.changes))

    def restore(self, state: bytes) -> None:
        """See `Body.restore`."""
        try:
            found = msgspec.msgpack.decode(state, type=_State)
            placement = placement_of(found.scene)
        except (msgspec.ValidationError, msgspec.DecodeError, KeyError) as error:
            raise BodyError(f"no state of a Pioneer: {error}; expected what `state` gave") from error
        self.put(placement, found.seed, found.acts)
        self.changes, self._unseen = found.changes, found.unseen

    def change(self, **settings: Any) -> None:
        """See `Changeable.change`; the settings are those of `Changes`."""
        made = changed(self.changes, settings)
        x_m, y_m = made.object_x_m, made.object_y_m
        if (x_m, y_m) != (None, None):
            here = self.placement
            moved = Placement(
                here.robot,
                here.object_x_m if x_m is None else x_m,
                here.object_y_m if y_m is None else y_m,
            )
            self._check_place(moved)
            self._put(moved)
        self.changes = msgspec.structs.replace(made, object_x_m=None, object_y_m=None)

    def sense(self) -> Reading:
        """Take a fresh reading: other noise each time, and no later action changes by it."""
        self._senses += 1
        return self._read("sense", self._senses)

    def act(self, values: Mapping[str, float]) -> Outcome:
        """Turn, advance, sense."""
        turn_rad = self._turned_rad(values)
        self._begun()
        bumped = self._move(turn_rad, self.config.advance_m)
        self._acts += 1
        self._senses = 0
        pose = self._pose()
        self._trail.append((pose.x_m, pose.y_m))
        reading = self._read("reached", 0)
        self._unseen = 0 if reading else self._unseen + 1
        return Outcome(self._event(bumped), reading)

    def foresee(self, values: Mapping[str, float]) -> tuple[Numbers, str]:
        """Return where an action would lead from here, and the event of the motion; nothing is sensed or counted."""
        before = self.placement
        bumped = self._move(self._turned_rad(values), self.config.advance_m)
        after, event = self.scene(), "capture" if is_captured(self.placement, self.config) else NOTHING
        self._place(before)
        return after, "bump" if bumped and event == NOTHING else event

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

    def _turned_rad(self, values: Mapping[str, float]) -> float:
        """Return how far an action turns the body as it is now."""
        check(self.spec, values)
        share = -self.changes.turn_share if self.changes.swapped else self.changes.turn_share
        return math.radians(values["turn"]) * share

    def _may_touch(self, start: Pose, advance_m: float) -> bool:
        """Whether anything is within reach of a motion from there: a cheap answer that spares most searches."""
        reach_m = BODY_RADIUS_M + abs(BODY_CENTRE_X_M) + advance_m + REACH_MARGIN_M
        object_m = math.hypot(self._object_m[0] - start.x_m, self._object_m[1] - start.y_m)
        wall_m = self.config.arena_m / 2.0 - max(abs(start.x_m), abs(start.y_m))
        return object_m <= reach_m + self.config.object_radius_m or wall_m <= reach_m

    def _event(self, bumped: bool) -> str:
        """What happened, if anything did. Touching the object frontally is reaching it."""
        if is_captured(self.placement, self.config):
            return "capture"
        if bumped:
            return "bump"
        return "lost" if self._unseen >= self.config.lost_readings else NOTHING

    def _put(self, placement: Placement) -> None:
        self._object_m = (placement.object_x_m, placement.object_y_m)
        self._senses = 0
        self._trail.clear()
        self._trail.append((placement.robot.x_m, placement.robot.y_m))
        self._place(placement)

    def _read(self, purpose: Purpose, repeat: int) -> Reading:
        rng = stream(self._begun(), purpose, self._acts, repeat)
        ranges_m = self.ring.ranges_m(self._pose(), self.cast, rng)
        ranges_m[list(self.changes.blind)] = np.nan
        return perceive(ranges_m, self.config)

    def _begun(self) -> int:
        """The run's seed; an error when there is no run yet."""
        self._open()
        if self._seed is None:
            raise BodyError("the robot has no placement yet; call reset(seed, 0) or restore(state) first")
        return self._seed

    def _open(self) -> None:
        if self._closed:
            raise BodyError("the robot is closed; make another one")

    def _check_place(self, placement: Placement) -> None:
        half_m = self.config.arena_m / 2.0
        robot = placement.robot
        places = (robot.x_m, robot.y_m, placement.object_x_m, placement.object_y_m)
        if not all(abs(value) <= half_m for value in places) or not math.isfinite(robot.heading_rad):
            raise BodyError(
                f"{placement} is not inside the arena; expected coordinates within ±{half_m} m and a finite"
                " heading; restore with the arena_m the run was begun with"
            )
