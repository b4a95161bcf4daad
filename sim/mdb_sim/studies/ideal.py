"""What could have been captured: an ideal policy from where a phase begins, on the same placements.

Owns the bound that a phase's captures are judged by. The ideal policy sees the truth and always takes the
action that a teacher would ask for. The seed gives the same placement to the same episode, so robot and ideal
meet the same objects one after the other; the better one meets more of them.
"""

from __future__ import annotations

import math

from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.placements import placement_of
from mdb_sim.runs.measures import Window
from mdb_sim.runs.record import RunRecord
from mdb_sim.studies.twins import ideal_policy

KNOWN_BODIES = ("kinematic", "pybullet")
"""Bodies whose ideal we can have. PyBullet's is that of its kinematic twin, which is cheap and moves alike."""


def ideal_captures(record: RunRecord, window: Window) -> float:
    """Return the captures of the ideal policy in a window of a run, begun from that run's scene there.

    nan when the body is not one of ours, or the log does not hold the window.
    """
    start, stop = window
    scene = record.scenes.get(start)
    if record.experiment.robot.body not in KNOWN_BODIES or scene is None or record.iterations < stop:
        return math.nan
    with KinematicRobot(record.experiment.robot.world) as robot:
        robot.restore(
            placement_of(scene.now),
            start,
            seed=record.seed,
            episode=scene.episode,
            captures=0,
            episode_age=_episode_age(record, start),
        )
        return float(_captures(robot, stop - start))


def _episode_age(record: RunRecord, start: int) -> int:
    """Return the actions since the object was last placed anew."""
    age = 0
    while age < start and record.event[start - 1 - age] == "none":
        age += 1
    return age


def _captures(robot: KinematicRobot, iterations: int) -> int:
    policy = ideal_policy(robot.config)
    captures = 0
    for _ in range(iterations):
        captures = robot.act(policy(robot.placement)).captures
    return captures
