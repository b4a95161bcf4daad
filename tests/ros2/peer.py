"""A differential robot that speaks rmw_zenoh by `zenoh-ros2-sdk`, none of our code: the other side of the ROS 2 body.

A process: `python -m tests.ros2.peer OPTIONS`. It is told Twist, and says LaserScan and Odometry. `--stepped`: its
time goes on by one step with each Twist that moves it, so that a run is the same however fast the machine is;
otherwise by the clock, `--time-scale` times as fast as real time. On each line of its input it answers with a line of
JSON: what it heard, and what is true. Names, hashes, tokens and attachments are the SDK's; the definitions of its
messages are rosbags', for the SDK would clone them from the network.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import threading
import time
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.discovery import get_topic_info
from zenoh_ros2_sdk.qos import QosProfile, QosReliability
from zenoh_ros2_sdk.utils import get_type_hash

STEP_S = 0.05
SCAN_STEPS = 4
"""By the clock a scan comes every so many steps: 5 Hz."""
IDLE_S = 0.05
"""Stepped, it says again where it is after this; with the same stamp."""
RAYS = 360
RANGE_MIN_M, RANGE_MAX_M = 0.12, 3.5
NOISE_M = 0.005
HALF_ARENA_M = 5.0
HULL_M, OBJECT_RADIUS_M = 0.17, 0.15
FASTER_M_S2, FASTER_RAD_S2 = 2.5, 12.0
TWIST, STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"


def parts(name: str) -> tuple[str, dict[str, str], str]:
    """The definition of a type, those of the types in it, and the SDK's hash of both."""
    whole = get_typestore(Stores.ROS2_JAZZY).generate_msgdef(name, ros_version=2)[0]
    first, *rest = whole.split("=" * 80 + "\nMSG: ")
    inside = {}
    for text in rest:
        short, definition = text.split("\n", 1)
        inside[short.replace("/", "/msg/")] = definition
    return whole, inside, get_type_hash(name, first, inside)


class World:
    """A robot on a floor with four walls, and a pillar."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.x_m, self.y_m, self.heading = options.at
        self.pillar = options.pillar
        self.linear = self.angular = 0.0
        self.told = (0.0, 0.0)
        self.stamp_s = 100.0
        self.moves = self.touches = 0
        self._seed = options.seed
        angles = np.arange(RAYS) * (2.0 * math.pi / RAYS)
        self.angles = angles

    @property
    def rests(self) -> bool:
        return (self.linear, self.angular) == (0.0, 0.0)

    def step(self) -> None:
        """One step of time, with bounded acceleration, up to what is in the way."""
        self.stamp_s += STEP_S
        self.linear += float(np.clip(self.told[0] - self.linear, -FASTER_M_S2 * STEP_S, FASTER_M_S2 * STEP_S))
        self.angular += float(np.clip(self.told[1] - self.angular, -FASTER_RAD_S2 * STEP_S, FASTER_RAD_S2 * STEP_S))
        if self.rests:
            return
        self.moves += 1
        middle = self.heading + self.angular * STEP_S / 2.0
        x_m = self.x_m + self.linear * STEP_S * math.cos(middle)
        y_m = self.y_m + self.linear * STEP_S * math.sin(middle)
        self.heading = math.remainder(self.heading + self.angular * STEP_S, 2.0 * math.pi)
        if self.clear(x_m, y_m):
            self.x_m, self.y_m = x_m, y_m
        else:
            self.touches += 1

    def clear(self, x_m: float, y_m: float) -> bool:
        pillar = math.hypot(x_m - self.pillar[0], y_m - self.pillar[1]) > HULL_M + OBJECT_RADIUS_M
        return pillar and max(abs(x_m), abs(y_m)) < HALF_ARENA_M - HULL_M

    def ranges(self) -> np.ndarray:
        """What the laser reads, with noise that depends on how often it moved alone; infinite where nothing is."""
        directions = np.stack([np.cos(self.angles + self.heading), np.sin(self.angles + self.heading)], axis=1)
        with np.errstate(divide="ignore"):
            walls = ((np.copysign(HALF_ARENA_M, directions) - (self.x_m, self.y_m)) / directions).min(axis=1)
        to = np.array([self.pillar[0] - self.x_m, self.pillar[1] - self.y_m])
        foot = directions @ to
        chord_sq = OBJECT_RADIUS_M**2 - (to @ to - foot**2)
        hit = (chord_sq > 0.0) & (foot > 0.0)
        pillar = np.where(hit, foot - np.sqrt(np.maximum(chord_sq, 0.0)), np.inf)
        rng = np.random.default_rng([self._seed, self.moves])
        ranges = np.minimum(walls, pillar) + rng.normal(0.0, NOISE_M, RAYS)
        return np.where((ranges >= RANGE_MIN_M) & (ranges <= RANGE_MAX_M), ranges, np.inf).astype(np.float32)


class Peer:
    """See the module's docstring."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options, self.world = options, World(options)
        self.lock = threading.Lock()
        self.twists: list[tuple[float, float]] = []
        self.attachments: list[Attachment] = []
        self.raw: bytes = b""
        self.quiet: set[str] = set()
        router = {"router_port": options.port, "domain_id": options.domain}
        twist = STAMPED if options.stamped else TWIST
        self.twist_definition, _, self.twist_hash = parts(twist)
        definition, _, type_hash = parts(SCAN)
        self.scan = ROS2Publisher(
            "/scan", SCAN, definition, "laser", type_hash=type_hash,
            qos=QosProfile(reliability=QosReliability.BEST_EFFORT, history_depth=5), **router,
        )  # fmt: skip
        definition, _, type_hash = parts(ODOMETRY)
        self.odom = ROS2Publisher("/odom", ODOMETRY, definition, "base", type_hash=type_hash, **router)
        self.types = self.odom.session_mgr.store.types
        self.cmd = ROS2Subscriber(
            "/cmd_vel", twist, self.on_twist, self.twist_definition, "base", type_hash=self.twist_hash, **router
        )
        self.as_sent = self.cmd.session_mgr.session.declare_subscriber(self.cmd.keyexpr, self.on_sample)

    def on_sample(self, sample: Any) -> None:
        """The same samples as they were sent."""
        with self.lock:
            self.raw = sample.payload.to_bytes()
            self.attachments.append(Attachment.from_bytes(sample.attachment.to_bytes()))

    def on_twist(self, message: Any) -> None:
        with self.lock:
            twist = message.twist if self.options.stamped else message
            self.world.told = twist.linear.x, twist.angular.z
            self.twists.append(self.world.told)
            if self.options.stepped and not (self.world.told == (0.0, 0.0) and self.world.rests):
                self.world.step()
                self.say(scan=True)

    def run(self) -> None:
        """By the clock: step, and say; stepped: say again."""
        pause_s = IDLE_S if self.options.stepped else STEP_S / self.options.time_scale
        steps, due_s = 0, time.monotonic()
        while True:
            due_s = max(due_s + pause_s, time.monotonic() - 1.0)
            time.sleep(max(0.0, due_s - time.monotonic()))
            with self.lock:
                if not self.options.stepped:
                    self.world.step()
                    steps += 1
                self.say(scan=steps % SCAN_STEPS == 0)

    def say(self, *, scan: bool) -> None:
        """Publish the scan first: whoever has the odometry has the scan of the same instant."""
        if scan and "scan" not in self.quiet:
            self.scan.publish(
                header=self.header("base_scan"), angle_min=0.0, angle_max=2.0 * math.pi * (RAYS - 1) / RAYS,
                angle_increment=2.0 * math.pi / RAYS, time_increment=0.0, scan_time=STEP_S * SCAN_STEPS,
                range_min=RANGE_MIN_M, range_max=RANGE_MAX_M, ranges=self.world.ranges(),
                intensities=np.zeros(0, np.float32),
            )  # fmt: skip
        if "odom" not in self.quiet:
            self.odom.publish(
                header=self.header("odom"), child_frame_id="base_footprint", pose=self.pose(), twist=self.speed()
            )

    def header(self, frame: str) -> Any:
        seconds = int(self.world.stamp_s)
        nanos = round((self.world.stamp_s - seconds) * 1e9)
        stamp = self.types["builtin_interfaces/msg/Time"](sec=seconds + nanos // 10**9, nanosec=nanos % 10**9)
        return self.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)

    def pose(self) -> Any:
        world, types = self.world, self.types
        half = world.heading / 2.0
        pose = types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](x=world.x_m, y=world.y_m, z=0.0),
            orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)),
        )
        return types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36))

    def speed(self) -> Any:
        vector = self.types["geometry_msgs/msg/Vector3"]
        twist = self.types[TWIST](
            linear=vector(x=self.world.linear, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=self.world.angular)
        )
        return self.types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36))

    def answer(self, words: list[str]) -> dict[str, Any]:
        if words[0] == "quiet":
            with self.lock:
                self.quiet = set(words[1:])
            return {}
        if words[0] == "graph":
            info = None  # as long as the router has not answered in time
            while info is None:
                info = get_topic_info(
                    words[1], self.options.domain, router_port=self.options.port, timeout=2.0, verbose=True
                )
            ends = {"publishers": info.publishers, "subscribers": info.subscribers}
            return {"types": info.topic_types} | {
                kind: [[one.node_name, one.topic_type, one.type_hash, one.qos] for one in several]
                for kind, several in ends.items()
            }
        with self.lock:
            world = self.world
            last = self.attachments[-1] if self.attachments else None
            numbers = [one.sequence_id for one in self.attachments]
            return {
                "twists": len(self.twists), "last": self.twists[-1] if self.twists else None,
                "fastest": [max((abs(twist[place]) for twist in self.twists), default=0.0) for place in (0, 1)],
                "rests": world.rests, "at": [world.x_m, world.y_m, world.heading], "touches": world.touches,
                "raw": list(self.raw), "key": self.cmd.keyexpr,
                "sequence": last and last.sequence_id, "gid": last and last.gid.hex(),
                "in_order": numbers == list(range(1, len(numbers) + 1)),
            }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--domain", type=int, default=0)
    parser.add_argument("--stepped", action="store_true")
    parser.add_argument("--stamped", action="store_true")
    parser.add_argument("--time-scale", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--at", type=float, nargs=3, default=(0.0, 0.0, 0.0))
    parser.add_argument("--pillar", type=float, nargs=2, default=(1.0, 0.4))
    peer = Peer(parser.parse_args())
    threading.Thread(target=peer.run, daemon=True).start()
    print(json.dumps({"ready": True}), flush=True)  # noqa: T201
    for line in sys.stdin:
        print(json.dumps(peer.answer(line.split())), flush=True)  # noqa: T201
    peer.cmd.session_mgr.close()


if __name__ == "__main__":
    main()
