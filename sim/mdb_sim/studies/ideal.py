"""What could have been reached: an ideal policy from where a phase begins, on the same placements.

Owns the bound that a phase's successes are judged by. The ideal policy sees the truth and always does what a teacher
would ask for. The seed gives the same placement to the same episode, so robot and ideal meet the same objects one
after the other; the better one meets more of them.

A body that has changed is foreseen: the choice is taken whose motion the policy judges best, a success before all. It
looks one action ahead: with half turns more can be captured (by 5 %, searched seven actions ahead on
seed 77), with what else can be changed not more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from mdb_protocol import messages
from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.bodies.pioneer.world import Changes, placement_of
from mdb_sim.body import Numbers
from mdb_sim.robot.course import Course
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.measures import Window
from mdb_sim.runs.record import RunRecord
from mdb_sim.teaching.policy import Policy

KNOWN_BODIES = ("kinematic", "pybullet")
"""Bodies whose ideal we can have. PyBullet's is that of its kinematic twin, which is cheap and moves alike."""

ONCE = ("object_x_m", "object_y_m")
"""Changes that are made once and do not stay."""

PLAY_THEMSELVES = ("racecar",)
"""Other bodies whose ideal we can have: they are put where the episode began in which the phase begins."""

Ideal = Callable[[Mapping[str, float]], Numbers]
"""The action that is wanted in a scene."""


def ideal_policy(experiment: Experiment) -> Ideal:
    """Return who takes the choice that the experiment's teacher can be expected to judge best."""
    policy = experiment.schedule().policy
    choices = [choice.values for choice in experiment.brain.choice]
    best = [_best(policy, wanted, choices) for wanted in range(len(policy.commands))]

    def act(scene: Mapping[str, float]) -> Numbers:
        wanted = policy.want(scene)
        return choices[0] if wanted is None else best[wanted]

    return act


def _best(policy: Policy, wanted: int, choices: list[Numbers]) -> Numbers:
    return max(choices, key=lambda values: policy.expected(wanted, values) or 0.0)


def foreseeing_policy(experiment: Experiment, robot: KinematicRobot) -> Ideal:
    """Return who takes the choice whose motion, of this body as it is now, the teacher would judge best."""
    policy, rules = experiment.schedule().policy, experiment.robot.rules
    choices = [choice.values for choice in experiment.brain.choice]

    def act(scene: Mapping[str, float]) -> Numbers:
        wanted = policy.want(scene)

        def worth(values: Numbers) -> tuple[bool, float]:
            after, event = robot.foresee(values)
            judged = None if wanted is None else policy.judge(scene, after, event, wanted)
            return event in rules.successes, judged or 0.0

        return max(choices, key=worth)

    return act


def ideal_successes(record: RunRecord, window: Window) -> float:
    """Return the successes of the ideal policy in a window of a run, begun from that run's scene there.

    nan when the body is not one of ours, nobody teaches, or the log does not hold the window.
    """
    start, stop = window
    scene, experiment = record.scenes.get(start), record.experiment
    body = experiment.robot.body
    if experiment.teacher is None or scene is None or record.iterations < stop:
        return math.nan
    if body in PLAY_THEMSELVES:
        return _played(experiment, scene, stop - start)
    if body not in KNOWN_BODIES:
        return math.nan
    with KinematicRobot(**experiment.robot.options) as robot:
        changes = experiment.robot.changes
        course = Course(robot, experiment.robot.rules, record.seed, changes)
        robot.change(**_in_force(changes, start))
        robot.put(placement_of(scene.now), record.seed, start)
        course.go_on(
            messages.RobotState(
                perception=messages.Perception(iteration=start, outcome={}, reading={}),
                scene=scene,
                age=_age(record, start),
                body=robot.state(),
            )
        )
        plain, foreseeing = ideal_policy(experiment), foreseeing_policy(experiment, robot)
        for _ in range(stop - start):
            act = plain if robot.changes == Changes() else foreseeing
            course.act(act(course.last.now))
        return float(course.last.successes - scene.successes)


def _played(experiment: Experiment, scene: messages.Scene, iterations: int) -> float:
    """Return the successes of the ideal policy with a body of the experiment's own, from an episode's beginning."""
    body, act = experiment.body(), ideal_policy(experiment)
    try:
        course = Course(body, experiment.robot.rules, experiment.brain.experiment.seed)
        course.go_on(
            messages.RobotState(
                perception=messages.Perception(iteration=0, outcome={}, reading={}), scene=scene, age=0, body=None
            )
        )
        course.last = replace(course.last, now=body.scene())
        for _ in range(iterations):
            course.act(act(course.last.now))
        return float(course.last.successes - scene.successes)
    finally:
        body.close()


def _in_force(changes: Mapping[int, Mapping[str, Any]], start: int) -> dict[str, Any]:
    """Return what stays changed of a body at an iteration; where the object was put, the scene tells."""
    made: dict[str, Any] = {}
    for at in sorted(at for at in changes if at <= start):
        made |= changes[at]
    return {name: value for name, value in made.items() if name not in ONCE}


def _age(record: RunRecord, start: int) -> int:
    """Return the actions since the episode began."""
    age = 0
    while age < start and not ((scene := record.scenes.get(start - age)) is not None and scene.ended):
        age += 1
    return age
