"""The contract every body keeps, its configuration, and the way to get a body by name.

Owns: `Robot` (what the robot service may ask of a body), the frozen values that cross it, `RobotConfig`
and `make_robot`. Must not import zenoh, pybullet or any service: a body is found by name, when asked for.

Frames: x forward, y left, angles counter-clockwise in radians, the robot's origin half-way between the
driven wheels (its centre of rotation). World: the arena's centre is the origin.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal, Protocol

import msgspec
from msgspec import Meta

Reading = dict[str, float]
"""What the brain gets: "distance" (m), "angle" (rad, folded to ±pi/2) and "continuity" (1.0 when the object
is behind), or no key at all when the sonar sees no object."""

Event = Literal["none", "capture", "bump", "lost", "timeout"]

BODIES = {
    "kinematic": "mdb_sim.bodies.pioneer.twin:KinematicRobot",
    "pybullet": "mdb_sim.bodies.pioneer.physics:PioneerRobot",
}
"""The bodies that have a short name; any other is named "package.module:Factory"."""


class RobotError(ValueError):
    """A body was asked for something it cannot do; the message tells what was expected and how to mend it."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where the robot's centre of rotation is, and where its front points."""

    x_m: float
    y_m: float
    heading_rad: float


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the robot and the (centre of the) object are: the truth, which the brain never sees."""

    robot: Pose
    object_x_m: float
    object_y_m: float


@dataclass(frozen=True, slots=True)
class Step:
    """What one action did.

    `reached` and `reading` tell where the action brought the robot and what it sensed there, before any new
    placement; `now` and `next_reading` tell the same after one. Without a new placement they are the same
    objects. `iteration` counts actions since `reset` (its own step is iteration 0); `captures` and `episode`
    are counts since `reset`, after this step. `episode_age` (actions since the last placement) and `unseen`
    (readings without the object, in a row) complete what `Robot.restore` needs.
    """

    iteration: int
    event: Event
    reached: Placement
    reading: Reading
    now: Placement
    next_reading: Reading
    captures: int
    episode: int
    episode_age: int = 0
    unseen: int = 0


class Robot(Protocol):
    """A body in its world. One thread uses it at a time; nothing here knows models, rewards or languages."""

    @property
    def actions(self) -> int:
        """How many actions there are; an action is an index from 0 to actions - 1."""

    @property
    def placement(self) -> Placement:
        """Where robot and object are now (truth: for the teacher, the log and `restore`)."""

    def reset(self, seed: int) -> Step:
        """Start anew: iteration 0, no captures, a first placement drawn from the seed."""

    def sense(self) -> Reading:
        """Take a fresh reading where the robot stands; it moves nothing and changes no later step."""

    def act(self, action: int) -> Step:
        """Turn by the action's angle, advance, sense. RobotError when the action or the moment is wrong."""

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
        """Continue a run begun elsewhere: the next `act` does, value by value, what it would have done there.

        Give it the run's seed and a step's `now`, `iteration`, `episode`, `captures`, `episode_age` and
        `unseen`.
        """

    def close(self) -> None:
        """Free what the body holds; calling it twice is harmless."""


Metres = Annotated[float, Meta(gt=0.0, le=100.0)]
Share = Annotated[float, Meta(ge=0.0, lt=1.0)]
TurnDeg = Annotated[float, Meta(ge=-180.0, le=180.0)]


class RobotConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Body, world and episode rules. Defaults: paper, section 3, and ours.

    What they mean is in sim/README.md, "Actions, episodes, captures", and where they come from in
    sim/README.md, "Which seeds chose which constant".

    Bounds are checked however it is made (decoded or constructed): msgspec.ValidationError or RobotError,
    both ValueErrors.
    """

    turns_deg: Annotated[tuple[TurnDeg, ...], Meta(min_length=2, max_length=64)] = (
        0.0, -20.0, -45.0, -90.0, 20.0, 45.0, 90.0,
    )  # fmt: skip
    """One turn an action, left positive, in the paper's order: none, three to the right, three left."""
    advance_m: Annotated[float, Meta(ge=0.0, le=2.0)] = 0.20

    arena_m: Annotated[float, Meta(gt=1.0, le=100.0)] = 10.0
    """Side of the square that the walls enclose."""
    object_radius_m: Annotated[float, Meta(gt=0.0, le=2.0)] = 0.15
    place_min_m: Metres = 0.7
    """Nearest and farthest the object is placed, counted as the capture distance is."""
    place_max_m: Metres = 1.5

    capture_distance_m: Metres = 0.40
    """Centre of rotation to the object's surface; see `arena.is_captured`."""
    capture_angle_deg: Annotated[float, Meta(gt=0.0, le=180.0)] = 20.0
    episode_iterations: Annotated[int, Meta(ge=1, le=1_000_000)] = 40
    lost_readings: Annotated[int, Meta(ge=1, le=1_000_000)] = 3

    sonar_min_m: Metres = 0.10
    sonar_max_m: Metres = 5.0
    sonar_half_cone_deg: Annotated[float, Meta(ge=0.0, le=45.0)] = 15.0
    sonar_rays: Annotated[int, Meta(ge=1, le=101)] = 7
    sonar_noise: Share = 0.01
    """Standard deviation of a range, as a share of it."""
    sonar_dropout: Share = 0.02
    """Probability that an echo is not heard."""
    sonar_specular_deg: Annotated[float, Meta(gt=0.0, le=90.0)] = 40.0
    """Beyond this angle between ray and surface normal the sound is mirrored away."""
    attention_m: Metres = 2.0
    """Echoes farther than this from the centre of rotation are not taken for the object (they are walls)."""

    physics_hz: Annotated[int, Meta(ge=60, le=2000)] = 90
    """Steps of physics in a second of robot time, for bodies that have physics."""

    def __post_init__(self) -> None:
        """Check each field's bounds (msgspec alone does so only on decoding), then those between fields."""
        for field in msgspec.structs.fields(self):
            value = getattr(self, field.name)
            try:
                msgspec.convert(value, field.type)
            except msgspec.ValidationError as error:
                raise RobotError(f"robot config: {field.name}={value!r}: {error}; mend that value") from None
        self._check_order("place_min_m", "place_max_m")
        self._check_order("sonar_min_m", "sonar_max_m")
        needed_m = 2.0 * (self.place_max_m + 2.0 * self.object_radius_m + 0.5)
        if self.arena_m < needed_m:
            raise RobotError(
                f"robot config: arena_m={self.arena_m} has no room for an object {self.place_max_m} m"
                f" from the centre; expected at least {needed_m:.2f}; enlarge arena_m or lower place_max_m"
            )

    def _check_order(self, low: str, high: str) -> None:
        if getattr(self, low) > getattr(self, high):
            values = f"{low}={getattr(self, low)} exceeds {high}={getattr(self, high)}"
            raise RobotError(f"robot config: {values}; expected the lesser first; swap or mend them")

    @property
    def turns_rad(self) -> tuple[float, ...]:
        """The actions' turns in radians, left positive."""
        return tuple(math.radians(turn) for turn in self.turns_deg)


def make_robot(body: str, config: RobotConfig | None = None, *, gui: bool = False) -> Robot:
    """Make the body named "pybullet", "kinematic" or "package.module:Factory" (called with the config).

    `gui` asks for a window, which only the pybullet body has. RobotError when there is no such body, when a
    package it needs is missing, or when what the factory returns does not keep the contract.
    """
    factory = _factory(body)
    if gui and body != "pybullet":
        raise RobotError(f"body={body!r} has no window; drop the gui option or use body='pybullet'")
    try:
        robot = factory(config or RobotConfig(), gui=True) if gui else factory(config or RobotConfig())
    except TypeError as error:
        raise RobotError(
            f"body={body!r} could not be made: {error}; expected a factory that takes a RobotConfig"
        ) from error
    wanted = ("actions", "placement", "reset", "sense", "act", "restore", "close")
    missing = [name for name in wanted if not hasattr(type(robot), name) and name not in vars(robot)]
    if missing:
        raise RobotError(
            f"body={body!r} gave a {type(robot).__name__} without {', '.join(missing)};"
            " expected the members of mdb_sim.body.Robot; add them to that class"
        )
    return robot


def _factory(body: str) -> Callable[..., Robot]:
    """Import what the body's name stands for."""
    module_name, colon, attribute = BODIES.get(body, body).partition(":")
    if not (colon and module_name and attribute):
        raise RobotError(
            f"no body named {body!r}; expected {', '.join(map(repr, BODIES))} or 'package.module:Factory'"
        )
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        raise RobotError(_missing_module(body, module_name, error)) from error
    factory = getattr(module, attribute, None)
    if not callable(factory):
        raise RobotError(f"body={body!r}: {module_name} has no callable {attribute!r}; mend the name after the colon")
    made: Callable[..., Robot] = factory
    return made


def _missing_module(body: str, module_name: str, error: ModuleNotFoundError) -> str:
    if body == "pybullet" and error.name == "pybullet":
        return (
            "body='pybullet' needs the package pybullet, which is not installed; run"
            " `pip install 'multilevel-darwinist-brain[pybullet]'`, or use body='kinematic'"
        )
    return f"body={body!r}: importing {module_name} failed: {error}; install it, or mend the name"
