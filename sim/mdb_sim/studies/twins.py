"""How far two bodies agree: motion, sonar, perception and the bounds of what any policy can capture.

Owns: `compare_bodies`, which `mdb compare-bodies` shows, and `captures_per_100`. Sees the simulators' truth,
as only a measurement may. Prints nothing: `SideBySide.table` is text for the caller.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from mdb_sim.bodies.pioneer.arena import ArenaRobot, bearing_rad, clearance_m, surface_distance_m, wrap_rad
from mdb_sim.bodies.pioneer.perceive import unfold
from mdb_sim.body import Placement, Pose, Reading, Robot, RobotConfig, RobotError, Step, make_robot
from mdb_sim.teaching.teacher import wanted_action

PHANTOM_DEG, PHANTOM_M = 45.0, 0.35
"""A reading farther than this from the truth is no bad estimate of the object but something else: a wall."""

TOUCHING_M = 0.01
"""A robot nearer than this to a thing may have been stopped by it."""

Policy = Callable[[Placement], int]


@dataclass(frozen=True, slots=True)
class Spread:
    """One measured quantity: mean, 95th percentile and maximum of its absolute values."""

    mean: float
    p95: float
    max: float
    count: int


@dataclass(frozen=True, slots=True)
class SideBySide:
    """What `compare_bodies` measured; the quantities' names carry body and unit."""

    bodies: tuple[str, str]
    iterations: int
    spreads: dict[str, Spread]
    figures: dict[str, float]

    def table(self) -> str:
        """The measurements as aligned text, one quantity a line."""
        lines = [f"{'':<48}{'mean':>10}{'p95':>10}{'max':>10}{'count':>8}"]
        lines += [
            f"{name:<48}{spread.mean:>10.3f}{spread.p95:>10.3f}{spread.max:>10.3f}{spread.count:>8d}"
            for name, spread in self.spreads.items()
        ]
        lines += [f"{name:<48}{value:>10.3f}" for name, value in self.figures.items()]
        return "\n".join(lines)


@dataclass(slots=True)
class _Samples:
    """Values by quantity, gathered while the bodies run: sizes, and yes-or-no answers."""

    sizes: dict[str, list[float]] = field(default_factory=dict)
    answers: dict[str, list[bool]] = field(default_factory=dict)

    def add(self, quantity: str, *values: float) -> None:
        self.sizes.setdefault(quantity, []).extend(abs(value) for value in values)

    def count(self, quantity: str, *answers: bool) -> None:
        self.answers.setdefault(quantity, []).extend(answers)

    def spreads(self) -> dict[str, Spread]:
        return {
            quantity: Spread(float(np.mean(v)), float(np.percentile(v, 95)), max(v), len(v))
            for quantity, v in self.sizes.items()
            if v
        }

    def shares(self) -> dict[str, float]:
        return {quantity: 100.0 * float(np.mean(v)) for quantity, v in self.answers.items()}


def compare_bodies(
    first: str = "pybullet",
    second: str = "kinematic",
    config: RobotConfig | None = None,
    *,
    iterations: int = 300,
    bound_iterations: int = 1000,
    seed: int = 1,
) -> SideBySide:
    """Run two bodies side by side and measure each against the command, the truth and the other.

    The first body runs freely, half its actions random and half the teacher's; before each the second is put
    where the first is, with the same noise to come. bound_iterations are run for each body and policy; 0
    leaves the bounds out. RobotError when a body is not an `ArenaRobot` or a count is too small.
    """
    if iterations < 1 or bound_iterations < 0:
        raise RobotError(f"iterations={iterations}, bound_iterations={bound_iterations}; expected at least 1 and 0")
    config = config or RobotConfig()
    with _arena_robot(first, config) as one, _arena_robot(second, config) as two:
        samples = _run_side_by_side((one, two), (first, second), iterations, seed)
        figures = samples.shares()
        if bound_iterations:
            figures |= _bounds((one, two), (first, second), bound_iterations, seed)
    return SideBySide((first, second), iterations, samples.spreads(), figures)


def captures_per_100(robot: Robot, policy: Policy, iterations: int, seed: int) -> float:
    """Captures in 100 iterations of a policy that sees the truth."""
    step = robot.reset(seed)
    for _ in range(iterations):
        step = robot.act(policy(step.now))
    return 100.0 * step.captures / iterations


def ideal_policy(config: RobotConfig) -> Policy:
    """Always the action that best faces the object: perfect obedience."""
    turns_rad = config.turns_rad
    return lambda placement: wanted_action(placement, turns_rad)


def random_policy(config: RobotConfig, seed: int) -> Policy:
    """Any action, each as likely."""
    rng = np.random.Generator(np.random.Philox(key=seed))
    return lambda _: int(rng.integers(len(config.turns_deg)))


def _arena_robot(body: str, config: RobotConfig) -> ArenaRobot:
    robot = make_robot(body, config)
    if not isinstance(robot, ArenaRobot):
        robot.close()
        raise RobotError(
            f"body={body!r} has no simulated arena to compare in; expected a body derived from"
            " mdb_sim.bodies.pioneer.arena.ArenaRobot, such as 'kinematic' or 'pybullet'"
        )
    return robot


def _run_side_by_side(
    robots: tuple[ArenaRobot, ArenaRobot], names: tuple[str, str], iterations: int, seed: int
) -> _Samples:
    samples = _Samples()
    one, two = robots
    rng = np.random.Generator(np.random.Philox(key=[seed, 1]))
    random_action, ideal_action = random_policy(one.config, seed), ideal_policy(one.config)
    step = one.reset(seed)
    for _ in range(iterations):
        two.restore(
            step.now, step.iteration, seed=seed, episode=step.episode, captures=step.captures,
            episode_age=step.episode_age, unseen=step.unseen,
        )  # fmt: skip
        _compare_sonar(one, two, samples)
        start = step.now
        action = (random_action if rng.random() < 0.5 else ideal_action)(start)
        steps = []
        for robot, name in zip(robots, names, strict=True):
            began_s = time.process_time()
            steps.append(robot.act(action))
            samples.add(f"{name}: iteration, ms of processor time", 1e3 * (time.process_time() - began_s))
            _measure_motion(robot, name, (start, action, steps[-1]), samples)
            _measure_perception(robot.config, name, steps[-1], samples)
        _compare_steps(one.config, steps, samples)
        step = steps[0]
    return samples


def _compare_sonar(one: ArenaRobot, two: ArenaRobot, samples: _Samples) -> None:
    """Both sonars without noise, from the very same place."""
    ones_m, twos_m = one.clean_ranges_m(), two.clean_ranges_m()
    heard_one, heard_two = np.isfinite(ones_m), np.isfinite(twos_m)
    both = heard_one & heard_two
    samples.add("between: clean range, same place, mm", *(1e3 * (ones_m - twos_m)[both]).tolist())
    samples.count("between: echo heard by one body alone, %", *(heard_one != heard_two).tolist())


def _measure_motion(robot: ArenaRobot, name: str, moved: tuple[Placement, int, Step], samples: _Samples) -> None:
    """What the body did against what the action asks for; being stopped by a thing is no motion error."""
    start, action, step = moved
    config = robot.config
    if clearance_m(step.reached, config) < TOUCHING_M:
        return
    begun, ended = start.robot, step.reached.robot
    wanted_rad = begun.heading_rad + config.turns_rad[action]
    moved_m = math.hypot(ended.x_m - begun.x_m, ended.y_m - begun.y_m)
    samples.add(f"{name}: turn error, deg", math.degrees(wrap_rad(ended.heading_rad - wanted_rad)))
    samples.add(f"{name}: advance error, mm", 1e3 * (moved_m - config.advance_m))


def _measure_perception(config: RobotConfig, name: str, step: Step, samples: _Samples) -> None:
    """The reading against the truth, walls taken for the object counted apart."""
    samples.count(f"{name}: nothing perceived, %", not step.reading)
    if not step.reading:
        return
    angle_deg = math.degrees(wrap_rad(unfold(step.reading) - bearing_rad(step.reached)))
    distance_m = step.reading["distance"] - surface_distance_m(step.reached, config.object_radius_m)
    phantom = abs(angle_deg) > PHANTOM_DEG or abs(distance_m) > PHANTOM_M
    samples.count(f"{name}: something else perceived, %", phantom)
    if not phantom:
        samples.add(f"{name}: perceived angle error, deg", angle_deg)
        samples.add(f"{name}: perceived distance error, mm", 1e3 * distance_m)


def _compare_steps(config: RobotConfig, steps: Sequence[Step], samples: _Samples) -> None:
    one, two = steps
    samples.count("between: same event, %", one.event == two.event)
    if min(clearance_m(step.reached, config) for step in steps) >= TOUCHING_M:
        here, there = one.reached.robot, two.reached.robot
        samples.add("between: heading, deg", math.degrees(wrap_rad(here.heading_rad - there.heading_rad)))
        samples.add("between: place, mm", _apart_mm(here, there))
    if one.event == two.event == "bump":
        samples.add("between: place of a bump, mm", _apart_mm(one.reached.robot, two.reached.robot))
    samples.count("between: both or neither perceive, %", bool(one.reading) == bool(two.reading))
    if one.reading and two.reading:
        _compare_readings(one.reading, two.reading, samples)


def _apart_mm(here: Pose, there: Pose) -> float:
    return 1e3 * math.hypot(here.x_m - there.x_m, here.y_m - there.y_m)


def _compare_readings(one: Reading, two: Reading, samples: _Samples) -> None:
    samples.add("between: read angle, deg", math.degrees(wrap_rad(unfold(one) - unfold(two))))
    samples.add("between: read distance, mm", 1e3 * (one["distance"] - two["distance"]))


def _bounds(
    robots: tuple[ArenaRobot, ArenaRobot], names: tuple[str, str], iterations: int, seed: int
) -> dict[str, float]:
    """Captures of the best and of the blindest policy, for each body."""
    bounds = {}
    for robot, name in zip(robots, names, strict=True):
        for policy_name, policy in (
            ("ideal", ideal_policy(robot.config)),
            ("random", random_policy(robot.config, seed)),
        ):
            captures = captures_per_100(robot, policy, iterations, seed)
            bounds[f"{name}: captures/100, {policy_name} policy"] = captures
    return bounds
