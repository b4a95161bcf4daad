"""The Pioneer's world: where robot and object are, what can be set, what the body has.

Frames: x forward, y left, angles counter-clockwise in radians, the robot's origin half-way between the driven wheels
(its centre of rotation). World: the arena's centre is the origin.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from mdb_protocol.converting import convert
from mdb_sim.body import Actuator, BodyError, Numbers, Sensor, Spec

TRACK_M = 0.3206
"""From wheel to wheel."""


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


Metres = Annotated[float, Meta(gt=0.0, le=100.0)]
Share = Annotated[float, Meta(ge=0.0, lt=1.0)]


class PioneerConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`[robot.options]` of a Pioneer: body and world. Defaults: paper, section 3, and ours.

    What they mean is in sim/README.md, "Actions, episodes, captures", and where they come from in
    sim/README.md, "Which seeds chose which constant".

    Bounds are checked however it is made (decoded or constructed): msgspec.ValidationError or BodyError,
    both ValueErrors.
    """

    advance_m: Annotated[float, Meta(ge=0.0, le=2.0)] = 0.20

    arena_m: Annotated[float, Meta(gt=1.0, le=100.0)] = 10.0
    """Side of the square that the walls enclose."""
    start: Literal["object", "wall"] = "object"
    """Where an episode begins: in the centre with the object around it, or beside a wall with the object far away."""
    object_radius_m: Annotated[float, Meta(gt=0.0, le=2.0)] = 0.15
    place_min_m: Metres = 0.7
    """Nearest and farthest the object is placed, counted as the capture distance is."""
    place_max_m: Metres = 1.5

    capture_distance_m: Metres = 0.40
    """Centre of rotation to the object's surface; see `arena.is_captured`."""
    capture_angle_deg: Annotated[float, Meta(gt=0.0, le=180.0)] = 20.0
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
                raise BodyError(f"robot.options: {field.name}={value!r}: {error}; correct that value") from None
        self._check_order("place_min_m", "place_max_m")
        self._check_order("sonar_min_m", "sonar_max_m")
        needed_m = 2.0 * (self.place_max_m + 2.0 * self.object_radius_m + 0.5)
        if self.arena_m < needed_m:
            raise BodyError(
                f"robot.options: arena_m={self.arena_m} has no room for an object {self.place_max_m} m"
                f" from the centre; expected at least {needed_m:.2f}; enlarge arena_m or lower place_max_m"
            )

    def _check_order(self, low: str, high: str) -> None:
        if getattr(self, low) > getattr(self, high):
            values = f"{low}={getattr(self, low)} exceeds {high}={getattr(self, high)}"
            raise BodyError(f"robot.options: {values}; expected the lesser first; swap or correct them")


class Changes(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What can be changed of a Pioneer while it runs (`Body.change`). All ours; nothing is changed at first."""

    swapped: bool = False
    """Left is right: the motors' wires are swapped."""
    turn_share: Annotated[float, Meta(ge=0.0, le=2.0)] = 1.0
    """It turns so much of what it is told."""
    left_wheel: Annotated[float, Meta(gt=0.0, le=2.0)] = 1.0
    """The wheel rolls so much of what its motor is told, ..."""
    right_wheel: Annotated[float, Meta(gt=0.0, le=2.0)] = 1.0
    """... and the other one."""
    blind: Annotated[tuple[Annotated[int, Meta(ge=0, le=15)], ...], Meta(max_length=16)] = ()
    """Sonars that hear nothing, by their place in the ring."""
    object_x_m: float | None = None
    """Where the object is put, once; not part of what stays changed."""
    object_y_m: float | None = None


def changed(changes: Changes, settings: Mapping[str, Any]) -> Changes:
    """Return changes with some more; BodyError names what is wrong."""
    try:
        return convert(msgspec.structs.asdict(changes) | dict(settings), Changes)
    except (msgspec.ValidationError, ValueError) as error:
        raise BodyError(f"change {dict(settings)!r}: {error}; there are {', '.join(CHANGES)}") from error


CHANGES = tuple(field.name for field in msgspec.structs.fields(Changes))
"""The names of what can be changed."""


def config_of(options: Mapping[str, Any]) -> PioneerConfig:
    """Return the options of `[robot.options]`, checked; BodyError names what is wrong."""
    try:
        return convert(dict(options), PioneerConfig)
    except (msgspec.ValidationError, ValueError) as error:
        raise BodyError(f"robot.options: {error}") from error


def spec_of(config: PioneerConfig) -> Spec:
    """Return what a Pioneer has."""
    return Spec(
        sensors=(
            Sensor(name="distance", low=0.0, high=config.attention_m, unit="m"),
            Sensor(name="angle", low=-1.5707963267948966, high=1.5707963267948966, unit="rad"),
            Sensor(name="continuity", low=0.0, high=1.0),
        ),
        actuators=(Actuator(name="turn", low=-180.0, high=180.0, unit="deg"),),
        events=("capture", "bump", "lost"),
        scene=("x_m", "y_m", "heading_rad", "object_x_m", "object_y_m"),
        changes=CHANGES,
    )


def scene_of(placement: Placement) -> Numbers:
    """Return a placement as the numbers of a scene."""
    robot = placement.robot
    return {
        "x_m": robot.x_m,
        "y_m": robot.y_m,
        "heading_rad": robot.heading_rad,
        "object_x_m": placement.object_x_m,
        "object_y_m": placement.object_y_m,
    }


def placement_of(scene: Mapping[str, float]) -> Placement:
    """Return the placement that a scene's numbers stand for."""
    robot = Pose(scene["x_m"], scene["y_m"], scene["heading_rad"])
    return Placement(robot, scene["object_x_m"], scene["object_y_m"])
