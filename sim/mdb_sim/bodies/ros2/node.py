"""The body's node in the ROS 2 graph: a Zenoh session of its own, one publisher, two subscriptions, their tokens.

Beside the protocol's bus the only module that imports zenoh, for these keys are none of a brain's. Callbacks run on
Zenoh's threads and only hand over the newest bytes.
"""

from __future__ import annotations

import threading
import time
from typing import Any

import zenoh
from zenoh.handlers import Callback

from mdb_protocol.errors import BusError
from mdb_protocol.zenoh_sessions import leave, open_client
from mdb_sim.bodies.ros2 import messages, names
from mdb_sim.bodies.ros2.names import Endpoint, Topic
from mdb_sim.bodies.ros2.options import Ros2Options
from mdb_sim.body import BodyError

GRAPH_S = 2.0
"""Bound on asking who is in the graph."""


class Ros2Node:
    """See the module's docstring. `scan`, `odometry`: how many have come, and the newest's bytes; `heard_s`: when."""

    def __init__(self, options: Ros2Options) -> None:
        """Join the graph. BodyError when no router answers."""
        self._options = options
        try:
            self._session = open_client(options.connect, None, options.first_s)
        except BusError as error:
            raise BodyError(
                f"no router answers at robot.options.connect = {options.connect!r} within {options.first_s:g} s; "
                "start one with `ros2 run rmw_zenoh_cpp rmw_zenohd`, or say where it is"
            ) from error
        topics, hashed = options.topics, options.hashes
        twist = messages.TWIST_STAMPED if options.stamped else messages.TWIST
        self.cmd_vel, self.scan_topic, self.odom_topic = (
            Topic(names.resolved(name, options.namespace), messages.type_of(kind, hashed=hashed))
            for name, kind in (
                (topics.cmd_vel, twist),
                (topics.scan, messages.SCAN),
                (topics.odom, messages.ODOMETRY),
            )
        )
        self._changed = threading.Condition()
        self._saying = threading.Lock()
        self._said = 0
        self._closed = False
        self.scan: tuple[int, bytes] = (0, b"")
        self.odometry: tuple[int, bytes] = (0, b"")
        self.heard_s = {"scan": 0.0, "odometry": 0.0}
        self.graph_name = names.Node(options.domain, str(self._session.zid()), options.namespace, options.node)
        token = self.graph_name.endpoint_token(1, names.PUBLISHER, self.cmd_vel, names.RELIABLE)
        self._gid = names.gid_of(token)
        self._declared: list[Any] = []
        self._publisher = self._session.declare_publisher(
            self.cmd_vel.key(options.domain), congestion_control=zenoh.CongestionControl.BLOCK, express=True
        )
        self._subscribe(self.scan_topic, "scan")
        self._subscribe(self.odom_topic, "odometry")
        self._declared.append(self._publisher)
        for said in (
            self.graph_name.token(),
            token,
            self.graph_name.endpoint_token(2, names.SUBSCRIPTION, self.scan_topic, names.SENSOR_DATA),
            self.graph_name.endpoint_token(3, names.SUBSCRIPTION, self.odom_topic, names.RELIABLE),
        ):
            self._declared.append(self._session.liveliness().declare_token(said))

    def _subscribe(self, topic: Topic, into: str) -> None:
        def hand_over(sample: zenoh.Sample) -> None:
            payload = sample.payload.to_bytes()
            with self._changed:
                setattr(self, into, (getattr(self, into)[0] + 1, payload))
                self.heard_s[into] = time.monotonic()
                self._changed.notify_all()

        key = topic.key(self._options.domain)
        self._declared.append(self._session.declare_subscriber(key, Callback(hand_over, indirect=False)))

    def drive(self, linear_m_s: float, angular_rad_s: float) -> None:
        """Say how fast the robot is to go and turn. BodyError when it cannot be said."""
        frame = self._options.frames.base if self._options.stamped else None
        cdr = messages.twist_cdr(linear_m_s, angular_rad_s, frame)
        with self._saying:
            if self._closed:
                raise BodyError("the robot is closed; make another one")
            self._said += 1
            with_it = names.attachment(self._said, time.time_ns(), self._gid)
            try:
                self._publisher.put(cdr, attachment=with_it)
            except zenoh.ZError as error:
                raise BodyError(f"nothing can be said on {self.cmd_vel.name}: {error}") from error

    def wait(self, seen: tuple[int, int], timeout_s: float) -> None:
        """Wait until more scans or odometries have come than were seen, or `wake` is called, within a bound."""
        with self._changed:
            if (self.scan[0], self.odometry[0]) == seen:
                self._changed.wait(timeout_s)

    def wake(self) -> None:
        """End the wait of another thread."""
        with self._changed:
            self._changed.notify_all()

    def graph(self) -> list[Endpoint]:
        """Return the publishers and subscriptions of others that are in the graph now."""
        found = []
        for reply in self._session.liveliness().get(names.endpoints_key(self._options.domain), timeout=GRAPH_S):
            if reply.ok is not None and self.graph_name.session not in str(reply.ok.key_expr):
                found.append(names.endpoint_of(str(reply.ok.key_expr)))
        return [endpoint for endpoint in found if endpoint is not None]

    def close(self) -> None:
        """Leave the graph; calling it twice is harmless."""
        with self._saying:
            if self._closed:
                return
            self._closed = True
        self.wake()
        leave(self._session, self._declared[::-1])
