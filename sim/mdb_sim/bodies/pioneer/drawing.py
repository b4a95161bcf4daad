"""The Pioneer's scene as a drawing: arena, robot, its way in this episode, object, and what it perceives of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from mdb_protocol.messages import Drawing, Shape
from mdb_sim.bodies.pioneer.perceive import unfold
from mdb_sim.bodies.pioneer.world import PioneerConfig, Placement

Point = tuple[float, float]

NOSE_M = 0.38
"""The line that tells where the front is goes so far from the centre of rotation."""
MARGIN_M = 0.35
"""Free space around robot and object."""


def draw(
    placement: Placement,
    trail: Sequence[Point],
    reading: Mapping[str, Any],
    config: PioneerConfig,
    hull: tuple[Point, float],
) -> Drawing:
    """Return the drawing; trail: where the robot came through; hull: centre and radius of the circle that touches."""
    robot, thing = placement.robot, (placement.object_x_m, placement.object_y_m)
    here, half_m = (robot.x_m, robot.y_m), config.arena_m / 2
    corners = [(half_m, half_m), (-half_m, half_m), (-half_m, -half_m), (half_m, -half_m), (half_m, half_m)]
    shapes = [Shape(kind="line", points=corners, what="wall")]
    if len(trail) > 1:
        shapes.append(Shape(kind="line", points=list(trail), what="trail"))
    shapes.append(Shape(kind="disc", points=[thing], radius=config.object_radius_m, what="thing"))
    if (heard := echo(placement, reading)) is not None:
        shapes.append(Shape(kind="line", points=[here, heard], what="sensed"))
        shapes.append(Shape(kind="cross", points=[heard], what="sensed"))
    centre, radius_m = hull
    front = (here[0] + NOSE_M * math.cos(robot.heading_rad), here[1] + NOSE_M * math.sin(robot.heading_rad))
    shapes.append(Shape(kind="circle", points=[centre], radius=radius_m, what="robot"))
    shapes.append(Shape(kind="line", points=[here, front], what="robot"))
    box = (
        min(here[0], thing[0]) - MARGIN_M,
        min(here[1], thing[1]) - MARGIN_M,
        max(here[0], thing[0]) + MARGIN_M,
        max(here[1], thing[1]) + MARGIN_M,
    )
    return Drawing(shapes=shapes, box=box, front_rad=robot.heading_rad)


def echo(placement: Placement, reading: Mapping[str, Any]) -> Point | None:
    """Return where in the arena the robot perceives the object's surface, x_m and y_m, or None: it does not."""
    if not {"distance", "angle", "continuity"} <= reading.keys():
        return None
    robot = placement.robot
    towards_rad, distance_m = robot.heading_rad + unfold(reading), float(reading["distance"])
    return robot.x_m + distance_m * math.cos(towards_rad), robot.y_m + distance_m * math.sin(towards_rad)
