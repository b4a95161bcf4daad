"""A ROS 2 robot as a body: told by Twist, sensed by LaserScan and Odometry, met through a router of `rmw_zenoh`.

It cannot be put anywhere: an episode begins where it stands, or it drives to some place around the object. It has no
truth: its scene is its own estimate, its place by odometry and the object's where it was measured, or last seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mdb_protocol.messages import Drawing, Shape
from mdb_services.mechanism.networks import streams
from mdb_sim.bodies.pioneer.perceive import fold
from mdb_sim.bodies.ros2 import sight
from mdb_sim.bodies.ros2.drive import Driver, Ended
from mdb_sim.bodies.ros2.messages import Scan
from mdb_sim.bodies.ros2.options import options_of, spec_of
from mdb_sim.body import NOTHING, BodyError, Numbers, Outcome, Reading, Spec, Unrestorable, check, check_episode

TRIES = 60
"""Places around the object that are drawn, until the way to one is free."""
ROOM_M = 0.15
"""The way to such a place must be so much wider than the robot, for it may stray."""
DRAWN = 400
"""Echoes in a drawing at most."""


class Ros2Robot(Unrestorable):
    """See the module's docstring, and `options.Ros2Options`."""

    def __init__(self, **options: Any) -> None:
        """Join the graph; the robot itself is waited for at the first `reset`. BodyError when no router answers."""
        self.options = options_of(options)
        self._spec = spec_of(self.options)
        self._driver = Driver(self.options)
        self._closed = self._begun = False
        self._unseen = 0
        self._object_m: tuple[float, float] | None = None
        if (at := self.options.object_at) is not None:
            self._object_m = at.x_m, at.y_m
        self._scan: Scan | None = None
        self._scene: Numbers = {}
        self._reading: Reading = {}

    @classmethod
    def spec_of(cls, **options: Any) -> Spec:
        """Return what such a robot has, without meeting one."""
        return spec_of(options_of(options))

    @property
    def spec(self) -> Spec:
        """See `Body.spec`."""
        return self._spec

    def reset(self, seed: int, episode: int) -> Reading:
        """See `Body.reset`: it goes on where it stands, or drives to a place around the object before."""
        self._open()
        check_episode(seed, episode)
        self._driver.begin()
        if self._begun and episode > 0 and self.options.begin == "around":
            self._go_around(seed, episode)
        self._unseen = 0
        self._perceive()
        self._begun = True
        return dict(self._reading)

    def act(self, values: Mapping[str, float]) -> Outcome:
        """See `Body.act`."""
        self._stands()
        check(self._spec, values)
        self._driver.begin()
        ended = self._do(values)
        self._perceive()
        return Outcome(self._event(ended), dict(self._reading))

    def _do(self, values: Mapping[str, float]) -> Ended:
        """Turn and advance, or hold speeds."""
        told = {drive.does: values[name] * drive.scale for name, drive in self.options.actuators.items()}
        if {"linear", "angular"} & set(told):
            return self._driver.hold(told.get("linear", 0.0), math.radians(told.get("angular", 0.0)))
        ended = self._driver.turn(math.radians(told.get("turn", 0.0)))
        if ended is not Ended.DONE:
            return ended
        return self._driver.advance(told.get("advance", self.options.then_advance_m))

    def _event(self, ended: Ended) -> str:
        """Return what happened, the best first."""
        near = self._reading.get("distance", math.inf)
        if self.options.object and isinstance(near, float) and near <= self.options.capture_distance_m:
            aside = math.remainder(self._towards_rad() - self._scene["heading_rad"], 2.0 * math.pi)
            if abs(aside) <= math.radians(self.options.capture_angle_deg):
                return "capture"
        if ended in (Ended.BLOCKED, Ended.STUCK):
            return str(ended.value)
        return "lost" if self.options.object and self._unseen >= self.options.lost_readings else NOTHING

    def _towards_rad(self) -> float:
        """Return in which direction the object's middle is, in the odometry's frame."""
        scene = self._scene
        return math.atan2(scene["object_y_m"] - scene["y_m"], scene["object_x_m"] - scene["x_m"])

    def _perceive(self) -> None:
        """Look around at rest: the reading, and the scene."""
        self._scan = scan = self._driver.scan_at_rest()
        at = self._driver.odometry()
        self._reading = {}
        self._scene = {"x_m": at.x_m, "y_m": at.y_m, "heading_rad": at.heading_rad}
        if self.options.sectors:
            self._reading["ranges"] = sight.sectors_of(scan, self.options)
        if self.options.object:
            self._perceive_object(scan)

    def _perceive_object(self, scan: Scan) -> None:
        """A bystander sees the object as far as the laser does, the brain within its attention."""
        options, scene = self.options, self._scene
        seen = sight.nearest_object(scan, options)
        if seen is not None and options.object_at is None:
            middle_m, towards = seen[0] + options.object_radius_m, scene["heading_rad"] + seen[1]
            self._object_m = scene["x_m"] + middle_m * math.cos(towards), scene["y_m"] + middle_m * math.sin(towards)
        if self._object_m is None:
            least_m, most_m = options.object_width_m
            raise BodyError(
                f"the laser sees no object, that is nothing {least_m:g} to {most_m:g} m wide; put one near it, "
                "say where it is with robot.options.object_at, or set object = false"
            )
        scene["object_x_m"], scene["object_y_m"] = self._object_m
        if seen is not None and seen[0] <= options.attention_m:
            self._reading |= fold(*seen)
            self._unseen = 0
        else:
            self._unseen += 1

    def _go_around(self, seed: int, episode: int) -> None:
        """Drive to a place around the object, as a Pioneer is put, if the way to one is free; else stay."""
        rng = streams.generator(seed, "begin", episode)
        scan, at = self._driver.scan_at_rest(), self._driver.odometry()
        assert self._object_m is not None
        for _ in range(TRIES):
            angle, away_m, heading = rng.uniform(
                (-math.pi, self.options.place_min_m, -math.pi), (math.pi, self.options.place_max_m, math.pi)
            ).tolist()
            away_m += self.options.object_radius_m
            dx_m = self._object_m[0] + away_m * math.cos(angle) - at.x_m
            dy_m = self._object_m[1] + away_m * math.sin(angle) - at.y_m
            towards = math.remainder(math.atan2(dy_m, dx_m) - at.heading_rad, 2.0 * math.pi)
            far_m = math.hypot(dx_m, dy_m)
            if sight.free_m(scan, self.options, towards, ROOM_M) >= far_m:
                if self._driver.turn(towards) is Ended.DONE and self._driver.advance(far_m) is Ended.DONE:
                    self._driver.turn(heading)
                return

    def halt(self) -> None:
        """See `Body.halt`: a Twist of zero."""
        if not self._closed:
            self._driver.halt()

    def scene(self) -> Numbers:
        """See `Body.scene`: what was estimated when it perceived last."""
        self._stands()
        return dict(self._scene)

    def draw(self, reading: Reading) -> Drawing:
        """See `Drawable.draw`: the echoes as they were heard last, the robot and the object."""
        del reading
        self._stands()
        scene, radius = self._scene, self.options.radius_m
        here, heading = (scene["x_m"], scene["y_m"]), scene["heading_rad"]
        front = here[0] + 2 * radius * math.cos(heading), here[1] + 2 * radius * math.sin(heading)
        shapes = [Shape(kind="cross", points=[point], what="sensed") for point in self._echoes()]
        seen = [here]
        if self.options.object:
            thing = scene["object_x_m"], scene["object_y_m"]
            shapes.append(Shape(kind="disc", points=[thing], radius=self.options.object_radius_m, what="thing"))
            seen.append(thing)
        shapes.append(Shape(kind="circle", points=[here], radius=radius, what="robot"))
        shapes.append(Shape(kind="line", points=[here, front], what="robot"))
        (left, low), (right, high) = np.min(seen, axis=0) - 3 * radius, np.max(seen, axis=0) + 3 * radius
        return Drawing(shapes=shapes, box=(left, low, right, high), front_rad=heading)

    def _echoes(self) -> list[tuple[float, float]]:
        if self._scan is None:
            return []
        points = sight.points_of(self._scan, self.options)
        points = points[:: max(1, -(-len(points) // DRAWN))]
        heading, at = self._scene["heading_rad"], (self._scene["x_m"], self._scene["y_m"])
        turned = np.array([[math.cos(heading), math.sin(heading)], [-math.sin(heading), math.cos(heading)]])
        return [(x, y) for x, y in (points @ turned + at).tolist()]

    def close(self) -> None:
        """See `Body.close`: a Twist of zero, and it leaves the graph."""
        self._closed = True
        self._driver.close()

    def _stands(self) -> None:
        self._open()
        if not self._begun:
            raise BodyError("no episode has begun; call reset(seed, 0) first")

    def _open(self) -> None:
        if self._closed:
            raise BodyError("the robot is closed; make another one")
