"""`[robot.options]` of a ROS 2 robot: where it is, what it is told, what it senses, what it has."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from mdb_protocol.converting import convert
from mdb_protocol.endpoints import USUAL
from mdb_sim.bodies.ros2.names import resolved
from mdb_sim.body import Actuator, BodyError, Sensor, Spec

Metres = Annotated[float, Meta(gt=0.0, le=100.0)]
Seconds = Annotated[float, Meta(gt=0.0, le=600.0)]
Speed = Annotated[float, Meta(gt=0.0, le=20.0)]
Name = Annotated[str, Meta(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]

UNITS = {"turn": "deg", "advance": "m", "linear": "m/s", "angular": "deg/s"}
"""What a Twist can be used for: so far by odometry, or so fast for `hold_s`."""


class _Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    pass


class Drive(_Section, frozen=True, kw_only=True):
    """What an actuator stands for: its value times `scale` is degrees, metres, m/s or degrees a second."""

    does: Literal["turn", "advance", "linear", "angular"]
    low: float
    high: float
    scale: float = 1.0


class Topics(_Section, frozen=True, kw_only=True):
    """Names, in the namespace unless they begin with a slash."""

    cmd_vel: str = "cmd_vel"
    scan: str = "scan"
    odom: str = "odom"


class Frames(_Section, frozen=True, kw_only=True):
    """What the messages' headers must name; an empty name: any."""

    odom: str = ""
    base: str = ""
    scan: str = ""


class Laser(_Section, frozen=True, kw_only=True):
    """Where the laser is, seen from the robot's centre of rotation (tf is not read)."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_deg: float = 0.0


class Place(_Section, frozen=True, kw_only=True):
    """Where the object is in the odometry's frame."""

    x_m: float
    y_m: float


def _turns() -> dict[str, Drive]:
    return {"turn": Drive(does="turn", low=-180.0, high=180.0)}


class Ros2Options(_Section, frozen=True, kw_only=True):
    """See the module's docstring. Defaults: the paper's robot as far as it has them, else ours."""

    connect: str = USUAL
    """The ROS 2 router, as `rmw_zenohd` listens."""
    domain: Annotated[int, Meta(ge=0, le=232)] = 0
    """`ROS_DOMAIN_ID`."""
    namespace: str = "/"
    node: Name = "mdb"
    hashes: bool = True
    """Whether keys have hashes of types; Humble's have none."""
    stamped: bool = False
    """Whether the robot is told a TwistStamped."""
    topics: Topics = Topics()
    frames: Frames = Frames()
    laser: Laser = Laser()

    actuators: Annotated[dict[Name, Drive], Meta(min_length=1)] = msgspec.field(default_factory=_turns)
    then_advance_m: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.20
    """After its turn it advances so far, unless an actuator says how far."""
    hold_s: Seconds = 0.5
    """How long it is told `linear` and `angular`, by the robot's own clock."""
    linear_m_s: Speed = 0.20
    angular_deg_s: Annotated[float, Meta(gt=0.0, le=720.0)] = 60.0
    """The fastest it is ever told."""
    rate_hz: Annotated[float, Meta(ge=0.2, le=200.0)] = 20.0
    """How often it is told at least, while it moves."""

    first_s: Seconds = 10.0
    """How long it is waited for at first, ..."""
    stale_s: Seconds = 1.0
    """... and for each scan and odometry later on, by the clock on the wall."""

    object: bool = True
    """Whether the nearest narrow cluster of echoes is an object that is sensed; its place goes into the scene."""
    object_at: Place | None = None
    """Where the object is, when somebody has measured it; otherwise where it was last seen."""
    object_radius_m: Metres = 0.15
    object_width_m: tuple[float, float] = (0.02, 0.60)
    """What is narrower or wider is none: a table's leg, a wall."""
    attention_m: Metres = 2.0
    """Echoes farther than this from the centre of rotation are not taken for the object."""
    sectors: Annotated[int, Meta(ge=0, le=360)] = 0
    """So many ranges all around are sensed as `ranges`, straight ahead first, then to the left."""
    sectors_m: Metres = 3.5

    capture_distance_m: Metres = 0.40
    capture_angle_deg: Annotated[float, Meta(gt=0.0, le=180.0)] = 20.0
    lost_readings: Annotated[int, Meta(ge=1)] = 3
    radius_m: Metres = 0.18
    """Of the circle that the robot needs, around its centre of rotation."""
    bump_m: Metres = 0.05
    """An echo so near to that circle, in the way, stops it."""
    begin: Literal["here", "around"] = "here"
    """Where a new episode begins: where it stands, or at some place around the object, to which it drives."""
    place_min_m: Metres = 0.7
    place_max_m: Metres = 1.5

    def __post_init__(self) -> None:
        """Check what bounds of single fields do not say."""
        for name in (self.topics.cmd_vel, self.topics.scan, self.topics.odom):
            resolved(name, self.namespace)
        done = [drive.does for drive in self.actuators.values()]
        if len(set(done)) < len(done) or ({"turn", "advance"} & set(done) and {"linear", "angular"} & set(done)):
            raise BodyError(
                f"robot.options.actuators do {', '.join(done)}; expected turn and advance, or linear and angular, "
                "each once at most"
            )
        for name, drive in self.actuators.items():
            if not (drive.low < drive.high and math.isfinite(drive.scale) and drive.scale):
                raise BodyError(f"robot.options.actuators.{name}: expected low < high, and a scale other than 0")
            farthest = max(abs(drive.low), abs(drive.high)) * abs(drive.scale)
            most = {"turn": 360.0, "advance": 10.0, "linear": self.linear_m_s, "angular": self.angular_deg_s}
            if farthest > most[drive.does]:
                raise BodyError(
                    f"robot.options.actuators.{name} goes to {farthest:g} {UNITS[drive.does]}; expected "
                    f"{most[drive.does]:g} at most; correct its bounds or the limits"
                )
        for low, high, what in (
            (*self.object_width_m, "object_width_m"),
            (self.place_min_m, self.place_max_m, "place_min_m and place_max_m"),
        ):
            if not low < high:
                raise BodyError(f"robot.options: {what} are {low:g} and {high:g}; expected the lesser first")
        if self.begin == "around" and not self.object:
            raise BodyError("robot.options: begin = 'around' needs an object; set object = true, or begin = 'here'")


def options_of(options: Mapping[str, Any]) -> Ros2Options:
    """Return the options of `[robot.options]`, checked; BodyError names what is wrong."""
    try:
        return convert(dict(options), Ros2Options)
    except (msgspec.ValidationError, ValueError) as error:
        said = str(error)
        raise BodyError(said if said.startswith("robot.options") else f"robot.options: {said}") from error


def spec_of(options: Ros2Options) -> Spec:
    """Return what such a robot has."""
    sensors: list[Sensor] = []
    if options.object:
        sensors += [
            Sensor(name="distance", low=0.0, high=options.attention_m, unit="m"),
            Sensor(name="angle", low=-math.pi / 2, high=math.pi / 2, unit="rad"),
            Sensor(name="continuity", low=0.0, high=1.0),
        ]
    if options.sectors:
        sensors.append(Sensor(name="ranges", low=0.0, high=options.sectors_m, unit="m", numbers=options.sectors))
    scene = ("x_m", "y_m", "heading_rad")
    return Spec(
        sensors=tuple(sensors),
        actuators=tuple(
            Actuator(name=name, low=drive.low, high=drive.high, unit=UNITS[drive.does] if drive.scale == 1.0 else "")
            for name, drive in options.actuators.items()
        ),
        events=("capture", "bump", "lost", "stuck") if options.object else ("bump", "stuck"),
        scene=(*scene, "object_x_m", "object_y_m") if options.object else scene,
    )
