"""Something of a robot is to be another: says so, and hears from the robot whether it is."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from typing import Any

from mdb_protocol import keys
from mdb_protocol.bus import Bus, Publisher
from mdb_protocol.errors import MdbError
from mdb_protocol.messages import Change, Status
from mdb_services.experiment.reading import nearest

ANSWER_S = 3.0
"""Bound on waiting for the robot."""
LOOK_S = 0.05
ROBOT = "robot/body"


def change_robot(bus: Bus, changes: Publisher, settings: Mapping[str, Any], known: Collection[str] = ()) -> None:
    """Change something of the robot; MdbError when it is not there, refuses, or does not answer in time.

    `changes`: the bus's publisher on that key. `known`: what of it can be changed; nothing: that is not known.
    """
    if ROBOT not in bus.alive():
        raise MdbError(f"no robot of brain {bus.brain} is there; 'mdb status' shows who is")
    if known and (unknown := [name for name in settings if name not in known]):
        raise MdbError(f"the robot has no {unknown[0]!r} to be changed{nearest(unknown[0], known)}")
    made, refused = _counts(bus)
    changes.put(Change(settings=dict(settings)))
    until_s = time.monotonic() + ANSWER_S
    while (now := _counts(bus)) == (made, refused):
        if time.monotonic() > until_s:
            raise MdbError(f"the robot has not changed within {ANSWER_S:g} s; may you change it? ('mdb keys roles')")
        bus.wait(LOOK_S)
    if now[1] > refused:
        said = ", ".join(f"{name} = {value}" for name, value in settings.items())
        why = "it takes no such value" if known else "'mdb change --help' says what robots have"
        raise MdbError(f"the robot refused {said}: {why}; its log says more")


def _counts(bus: Bus) -> tuple[float, int]:
    """Return how many changes the robot has made, and how many it has refused."""
    role, _, instance = ROBOT.partition("/")
    answers: list[Status] = bus.query(keys.STATUS, ANSWER_S, role=role, instance=instance)
    if not answers:
        raise MdbError(f"the robot does not say how it is within {ANSWER_S:g} s; see 'mdb status'")
    return answers[0].values.get("changes", 0.0), answers[0].refused.get(keys.CHANGE.path, 0)
