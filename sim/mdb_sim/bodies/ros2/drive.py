"""Moves the robot by Twist, closed over its odometry, and waits for what it perceives at rest.

Motions are bounded by the robot's own clock, that of its odometry's stamps, so that a simulator may be slow or fast;
waits for messages by the clock on the wall. Every wait has a bound. Whatever ends a motion, a Twist of zero is said.
"""

from __future__ import annotations

import enum
import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress

from mdb_sim.bodies.ros2 import messages, sight
from mdb_sim.bodies.ros2.messages import Odometry, Scan
from mdb_sim.bodies.ros2.names import PUBLISHER, SUBSCRIPTION, Topic
from mdb_sim.bodies.ros2.node import Ros2Node
from mdb_sim.bodies.ros2.options import Ros2Options
from mdb_sim.body import BodyError

TURN_GAIN_PER_S, ADVANCE_GAIN_PER_S = 4.0, 4.0
"""So much of what is left is done in a second, near the end (ours)."""
SLOWEST_RAD_S, SLOWEST_M_S = 0.08, 0.02
"""Slower than this many robots do not move at all (ours)."""
ARRIVED_RAD, ARRIVED_M = math.radians(1.0), 0.005
REST_RAD_S, REST_M_S = 0.05, 0.02
"""Slower than this it rests."""
REST_S = 3.0
"""Bound on coming to rest, by the robot's clock."""
SLACK, SLACK_S = 3.0, 3.0
"""A motion may take so many times as long as at full speed, and so much more, before the robot is stuck."""

Speeds = tuple[float, float]
"""Metres and radians a second."""


class Ended(enum.Enum):
    """How a motion ended."""

    DONE = "done"
    BLOCKED = "bump"
    STUCK = "stuck"
    HALTED = "halted"


class Driver:
    """See the module's docstring. One thread uses it at a time, but for `halt` and `close`."""

    def __init__(self, options: Ros2Options) -> None:
        """Join the graph. BodyError when no router answers."""
        self._options, self._node = options, Ros2Node(options)
        self._halted = threading.Event()
        self._closed = self._met = False
        self._read: dict[str, tuple[int, Odometry | Scan | None]] = {}
        self._last: Odometry | None = None
        """The odometry that was looked at last."""

    # ---- what is heard ----

    def _newest(self, which: str) -> Odometry | Scan | None:
        """Return the newest odometry or scan; None before the first. BodyError when its bytes are none."""
        count, cdr = getattr(self._node, which)
        if count == 0:
            return None
        if self._read.get(which, (0, None))[0] != count:
            try:
                found = messages.odometry_of(cdr) if which == "odometry" else messages.scan_of(cdr)
            except ValueError as error:
                raise BodyError(f"the robot's {which}: {error}; expected what its type's definition says") from error
            self._check_frames(found)
            self._read[which] = count, found
        return self._read[which][1]

    def _check_frames(self, found: Odometry | Scan) -> None:
        frames = self._options.frames
        if isinstance(found, Scan):
            pairs = [("scan", frames.scan, found.frame)]
        else:
            pairs = [("odom", frames.odom, found.frame), ("base", frames.base, found.child_frame)]
        for name, expected, frame in pairs:
            if expected and frame.lstrip("/") != expected.lstrip("/"):
                raise BodyError(f"the robot's frame is {frame!r}; robot.options.frames.{name} says {expected!r}")

    def _await(self, heard: Callable[[], bool], bound_s: float, again: Speeds | None = None) -> bool:
        """Wait until something was heard, within a bound; meanwhile say `again` at the rate. Whether it was."""
        deadline = time.monotonic() + bound_s
        said = time.monotonic()
        while True:
            seen = self._node.scan[0], self._node.odometry[0]
            self._check_open()
            if heard():
                return True
            now = time.monotonic()
            if now >= deadline or (again is not None and self._halted.is_set() and again != (0.0, 0.0)):
                return False
            due_s = said + 1.0 / self._options.rate_hz - now if again is not None else 1.0
            if again is not None and due_s <= 0.0:
                self._node.drive(*again)
                said, due_s = now, 1.0 / self._options.rate_hz
            self._node.wait(seen, max(0.0, min(due_s, deadline - now)))

    def _check_open(self) -> None:
        if self._closed:
            raise BodyError("the robot is closed; make another one")

    def meet(self) -> None:
        """Wait until the robot is there: it listens, and scan and odometry come. BodyError says what is amiss."""
        if self._met:
            return
        deadline = time.monotonic() + self._options.first_s
        heard = self._await(lambda: bool(self._node.scan[0] and self._node.odometry[0]), self._options.first_s)
        if not heard:
            missing = self._node.odom_topic if self._node.scan[0] else self._node.scan_topic
            raise BodyError(self._nobody(missing, PUBLISHER, "comes"))
        while not any(self._fits(self._node.cmd_vel, SUBSCRIPTION)):
            if time.monotonic() >= deadline:
                raise BodyError(self._nobody(self._node.cmd_vel, SUBSCRIPTION, "is listened to"))
            self._await(lambda: False, 0.1)
        self._met = True

    def _fits(self, topic: Topic, kind: str) -> list[bool]:
        """For each who says or hears a topic whether it is by our type."""
        there = [one for one in self._node.graph() if (one.kind, one.topic) == (kind, topic.name)]
        return [(one.type, one.hash) == (topic.type.dds, topic.type.hash) for one in there]

    def _nobody(self, topic: Topic, kind: str, what: str) -> str:
        others = [one for one in self._node.graph() if (one.kind, one.topic) == (kind, topic.name)]
        said = f"nothing {what} on {topic.name} as {topic.type.name} within {self._options.first_s:g} s"
        if not others:
            options = self._options
            return (
                f"{said}, and nobody is there for it in domain {options.domain} at {options.connect}; is the robot "
                "on, with RMW_IMPLEMENTATION=rmw_zenoh_cpp? Mend robot.options: topics, namespace, domain or connect"
            )
        there = "; ".join(f"node {one.node} has {one.type} {one.hash}" for one in others)
        return (
            f"{said}: {there}; expected {topic.type.dds} {topic.type.hash}. Mend robot.options: stamped for a "
            "TwistStamped, hashes = false for Humble"
        )

    # ---- where it is ----

    def odometry(self) -> Odometry:
        """Return the newest odometry."""
        found = self._newest("odometry")
        assert isinstance(found, Odometry)
        self._last = found
        return found

    def _next(self, told: Speeds) -> Odometry:
        """Return the first odometry that is newer than the last; BodyError when none comes."""
        last = self._last
        assert last is not None

        def newer() -> bool:
            found = self._newest("odometry")
            return found is not None and found.stamp_s != last.stamp_s

        if self._await(newer, self._options.stale_s, again=told):
            return self.odometry()
        if self._halted.is_set() and told != (0.0, 0.0):
            return last
        raise BodyError(self._silent("odometry", self._node.odom_topic))

    def scan_at_rest(self) -> Scan:
        """Return a scan that was begun no earlier than the last odometry; BodyError when none comes."""
        rest = self._last or self.odometry()

        def fresh() -> bool:
            found = self._newest("scan")
            return isinstance(found, Scan) and found.stamp_s >= rest.stamp_s - 1e-6

        if not self._await(fresh, self._options.stale_s):
            newest = self._newest("scan")
            behind = "none" if newest is None else f"the newest is {rest.stamp_s - newest.stamp_s:.2f} s older"
            raise BodyError(
                f"no scan on {self._node.scan_topic.name} since the robot rests, for {self._options.stale_s:g} s "
                f"({behind}); is the laser on, and do both stamps come from one clock?"
            )
        found = self._newest("scan")
        assert isinstance(found, Scan)
        return found

    # ---- motions ----

    def begin(self) -> None:
        """Meet the robot, and forget an earlier `halt`.

        A robot that still moves is stopped: who told it last is dead, or was not heard while the router was.
        """
        self._halted.clear()
        self.meet()
        self._check_news(self._options.stale_s)
        if not _slow(self.odometry()):
            self._rest()

    def turn(self, angle_rad: float) -> Ended:
        """Turn on the spot, left positive, at most once around."""
        fastest = math.radians(self._options.angular_deg_s)
        before, turned = self.odometry().heading_rad, 0.0

        def speeds(odometry: Odometry) -> Speeds | Ended:
            nonlocal before, turned
            turned += math.remainder(odometry.heading_rad - before, 2.0 * math.pi)
            before = odometry.heading_rad
            left = angle_rad - turned
            if abs(left) <= ARRIVED_RAD:
                return Ended.DONE
            return 0.0, math.copysign(_between(TURN_GAIN_PER_S * abs(left), SLOWEST_RAD_S, fastest), left)

        return self._move(speeds, abs(angle_rad) / fastest)

    def advance(self, distance_m: float) -> Ended:
        """Go straight on, backwards when it is negative; forwards only as far as the way is free."""
        start, fastest = self.odometry(), self._options.linear_m_s
        looked: Scan | None = None
        looked_at_m = 0.0
        free_m = math.inf

        def speeds(odometry: Odometry) -> Speeds | Ended:
            nonlocal looked, looked_at_m, free_m
            dx_m, dy_m = odometry.x_m - start.x_m, odometry.y_m - start.y_m
            gone_m = dx_m * math.cos(start.heading_rad) + dy_m * math.sin(start.heading_rad)
            left_m = distance_m - gone_m
            if abs(left_m) <= ARRIVED_M:
                return Ended.DONE
            scan = self._newest("scan")
            if isinstance(scan, Scan) and scan is not looked:
                looked, looked_at_m, free_m = scan, gone_m, sight.free_m(scan, self._options)
            to_go_m = abs(left_m)
            if left_m > 0.0:
                to_go_m = min(left_m, free_m - (gone_m - looked_at_m) - self._options.bump_m)
                if to_go_m <= 0.0:
                    return Ended.BLOCKED
            aside = math.remainder(odometry.heading_rad - start.heading_rad, 2.0 * math.pi)
            linear = math.copysign(_between(ADVANCE_GAIN_PER_S * to_go_m, SLOWEST_M_S, fastest), left_m)
            return linear, -TURN_GAIN_PER_S / 2.0 * aside

        return self._move(speeds, abs(distance_m) / fastest)

    def hold(self, linear_m_s: float, angular_rad_s: float) -> Ended:
        """Go at these speeds for `hold_s`; not into what is in the way."""
        start = self.odometry()

        def speeds(odometry: Odometry) -> Speeds | Ended:
            if odometry.stamp_s - start.stamp_s >= self._options.hold_s:
                return Ended.DONE
            scan = self._newest("scan") if linear_m_s > 0.0 else None
            if isinstance(scan, Scan) and sight.free_m(scan, self._options) <= self._options.bump_m:
                return Ended.BLOCKED
            return linear_m_s, angular_rad_s

        return self._move(speeds, self._options.hold_s)

    def _move(self, speeds: Callable[[Odometry], Speeds | Ended], nominal_s: float) -> Ended:
        """Say what is to be said after each odometry, then rest."""
        odometry = start = self.odometry()
        moved, over = False, False
        try:
            while True:
                told = Ended.HALTED if self._halted.is_set() else speeds(odometry)
                if not isinstance(told, Ended) and odometry.stamp_s - start.stamp_s > SLACK * nominal_s + SLACK_S:
                    told = Ended.STUCK
                if isinstance(told, Ended):
                    if moved:
                        self._rest()
                    over = True
                    return told
                self._check_news(0.0)
                moved = True
                self._node.drive(*told)
                odometry = self._next(told)
        finally:
            if moved and not over:
                self._node.drive(0.0, 0.0)

    def _check_news(self, bound_s: float) -> None:
        """Raise BodyError when odometries or scans come no more: it drives neither lost nor blind."""
        for which, topic in (("odometry", self._node.odom_topic), ("scan", self._node.scan_topic)):

            def recent(which: str = which) -> bool:
                return time.monotonic() - self._node.heard_s[which] <= self._options.stale_s

            if not self._await(recent, bound_s, again=(0.0, 0.0)):
                raise BodyError(self._silent(which, topic))

    def _silent(self, which: str, topic: Topic) -> str:
        return (
            f"no {which} on {topic.name} for {self._options.stale_s:g} s: the robot was told to stop; is it on, and "
            "the router?"
        )

    def _rest(self) -> None:
        """Come to rest, bounded; the last odometry is then one at rest."""
        assert self._last is not None
        since_s = self._last.stamp_s
        while True:
            self._node.drive(0.0, 0.0)
            odometry = self._next((0.0, 0.0))
            if _slow(odometry) or odometry.stamp_s - since_s > REST_S:
                return

    def halt(self) -> None:
        """Say zero now, and end the motion that is under way."""
        self._halted.set()
        with suppress(BodyError):  # closed meanwhile, which has said zero
            self._node.drive(0.0, 0.0)
        self._node.wake()

    def close(self) -> None:
        """Say zero, and leave the graph."""
        if self._closed:
            return
        self.halt()
        self._closed = True
        with suppress(BodyError):
            self._node.drive(0.0, 0.0)  # what was said by a motion since is taken back
        self._node.close()


def _slow(odometry: Odometry) -> bool:
    return abs(odometry.forward_m_s) <= REST_M_S and abs(odometry.turning_rad_s) <= REST_RAD_S


def _between(value: float, low: float, high: float) -> float:
    return min(high, max(low, value))
