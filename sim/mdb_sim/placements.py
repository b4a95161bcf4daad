"""Placements on the wire and placements of the simulation: the same thing in two types, and the way between them."""

from __future__ import annotations

from mdb_protocol import messages
from mdb_sim.body import Placement, Pose


def placement_of(seen: messages.Placement) -> Placement:
    """Return where robot and object are, from the message that says so."""
    return Placement(Pose(seen.x_m, seen.y_m, seen.heading_rad), seen.object_x_m, seen.object_y_m)


def message_of(placement: Placement) -> messages.Placement:
    """Return the message that says where robot and object are."""
    return messages.Placement(
        x_m=placement.robot.x_m,
        y_m=placement.robot.y_m,
        heading_rad=placement.robot.heading_rad,
        object_x_m=placement.object_x_m,
        object_y_m=placement.object_y_m,
    )
