"""The messages of ROS 2 that the body says and hears, between CDR and plain values, by rosbags. Pure.

The definitions and so the hashes of these types are the same from Iron to Rolling (checked with rosbags 0.11).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from mdb_sim.bodies.ros2.names import NO_HASH, Type

TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
_STORE = get_typestore(Stores.ROS2_JAZZY)

Array = np.ndarray[Any, np.dtype[np.float64]]


@dataclass(frozen=True, slots=True)
class Odometry:
    """Where a robot is in its odometry's frame, and how fast: forward, and counter-clockwise about z."""

    stamp_s: float
    frame: str
    child_frame: str
    x_m: float
    y_m: float
    heading_rad: float
    forward_m_s: float
    turning_rad_s: float


@dataclass(frozen=True, slots=True)
class Scan:
    """Echoes in the laser's frame: bearings and ranges of those within its limits, (n,) each."""

    stamp_s: float
    frame: str
    bearings_rad: Array
    ranges_m: Array
    step_rad: float
    """From one ray to the next."""
    most_m: float
    """It sees no farther."""


def type_of(name: str, *, hashed: bool = True) -> Type:
    """Return a type with its hash; without `hashed` as Humble has it."""
    return Type(name, _STORE.hash_rihs01(name) if hashed else NO_HASH)


def definition_of(name: str) -> str:
    """Return a type's definition, and below it those of all types in it, as ROS writes it into bags."""
    text: str = _STORE.generate_msgdef(name, ros_version=2)[0]
    return text


def twist_cdr(linear_m_s: float, angular_rad_s: float, stamped_frame: str | None = None) -> bytes:
    """Return a Twist; with a frame a TwistStamped.

    Its stamp is zero: ros2_controllers' diff_drive_controller then takes its own time, which may be a simulator's.
    """
    types = _STORE.types
    vector, zero = types["geometry_msgs/msg/Vector3"], 0.0
    twist = types[TWIST](linear=vector(x=linear_m_s, y=zero, z=zero), angular=vector(x=zero, y=zero, z=angular_rad_s))
    if stamped_frame is None:
        return bytes(_STORE.serialize_cdr(twist, TWIST))
    stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=stamped_frame)
    return bytes(_STORE.serialize_cdr(types[TWIST_STAMPED](header=header, twist=twist), TWIST_STAMPED))


def odometry_of(cdr: bytes) -> Odometry:
    """Read an Odometry. ValueError when the bytes are none, or their numbers not finite."""
    said = _read(cdr, ODOMETRY)
    place, turned, speed = said.pose.pose.position, said.pose.pose.orientation, said.twist.twist
    heading_rad = math.atan2(
        2.0 * (turned.w * turned.z + turned.x * turned.y), 1.0 - 2.0 * (turned.y**2 + turned.z**2)
    )
    found = Odometry(
        _seconds(said.header.stamp), said.header.frame_id, said.child_frame_id,
        place.x, place.y, heading_rad, speed.linear.x, speed.angular.z,
    )  # fmt: skip
    if not all(map(math.isfinite, (place.x, place.y, heading_rad, speed.linear.x, speed.angular.z))):
        raise ValueError("an odometry whose numbers are not finite")
    return found


def scan_of(cdr: bytes) -> Scan:
    """Read a LaserScan. ValueError when the bytes are none.

    What is out of the laser's own limits, infinite or no number is no echo (REP 117).
    """
    said = _read(cdr, SCAN)
    ranges_m = np.asarray(said.ranges, dtype=np.float64)
    bearings_rad = said.angle_min + np.arange(len(ranges_m)) * said.angle_increment
    with np.errstate(invalid="ignore"):
        heard = np.isfinite(ranges_m) & (ranges_m >= said.range_min) & (ranges_m <= said.range_max)
    heard &= np.isfinite(bearings_rad)
    return Scan(
        _seconds(said.header.stamp), said.header.frame_id, bearings_rad[heard], ranges_m[heard],
        abs(float(said.angle_increment)), float(said.range_max),
    )  # fmt: skip


def _read(cdr: bytes, name: str) -> Any:
    """Rosbags raises what Python raises where it reads beyond the end: one error for all."""
    try:
        return _STORE.deserialize_cdr(cdr, name)
    except Exception as error:
        raise ValueError(f"{len(cdr)} bytes that are no {name}: {type(error).__name__}: {error}") from error


def _seconds(stamp: Any) -> float:
    return float(stamp.sec) + float(stamp.nanosec) * 1e-9
