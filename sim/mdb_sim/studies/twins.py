"""How far two bodies agree: motion, sonar, perception and the bounds of what any policy can capture.

Owns: `compare_bodies`, which `mdb compare-bodies` shows, and `captures_per_100`. Sees the simulators' truth,
as only a measurement may. Prints nothing: `SideBySide.table` is text for the caller.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from mdb_sim.bodies.finding import make_body
from mdb_sim.bodies.pioneer.arena import ArenaRobot, bearing_rad, clearance_m, surface_distance_m, wrap_rad
from mdb_sim.bodies.pioneer.perceive import unfold
from mdb_sim.bodies.pioneer.world import PioneerConfig, Placement, Pose, placement_of
from mdb_sim.body import NOTHING, BodyError, Numbers, Outcome
from mdb_sim.robot.course import TIMEOUT, Course, Rules, Step
from mdb_sim.teaching.policies.pioneer import PAPERS_TURNS_DEG, Reach

PHANTOM_DEG, PHANTOM_M = 45.0, 0.35
"""A reading farther than this from the truth is no bad estimate of the object but something else: a wall."""

TOUCHING_M = 0.01
"""A robot nearer than this to a thing may have been stopped by it."""

Policy = Callable[[Numbers], Numbers]

PAPERS_RULES = Rules(frozenset({"capture"}), frozenset({"capture", "bump", "lost"}), 40)
"""Those of the shipped experiment of the paper."""


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
    options: Mapping[str, Any] | None = None,
    *,
    iterations: int = 300,
    bound_iterations: int = 1000,
    seed: int = 1,
) -> SideBySide:
    """Run two bodies side by side and measure each against the command, the truth and the other.

    The first body runs freely, half its actions random and half the teacher's; before each the second is put
    where the first is, with the same noise to come. bound_iterations are run for each body and policy; 0
    leaves the bounds out. BodyError when a body is not an `ArenaRobot` or a count is too small.
    """
    if iterations < 1 or bound_iterations < 0:
        raise BodyError(f"iterations={iterations}, bound_iterations={bound_iterations}; expected at least 1 and 0")
    options = options or {}
    with _arena_robot(first, options) as one, _arena_robot(second, options) as two:
        samples = _run_side_by_side((one, two), (first, second), iterations, seed)
        figures = samples.shares()
        if bound_iterations:
            figures |= _bounds((one, two), (first, second), bound_iterations, seed)
    return SideBySide((first, second), iterations, samples.spreads(), figures)


def captures_per_100(robot: ArenaRobot, policy: Policy, iterations: int, seed: int) -> float:
    """Captures in 100 iterations of a policy that sees the truth."""
    course = Course(robot, PAPERS_RULES, seed)
    for _ in range(iterations):
        course.act(policy(course.last.now))
    return 100.0 * course.last.successes / iterations


def facing() -> Policy:
    """Always the turn of the paper's seven that best faces the object: perfect obedience."""
    reach = Reach()
    return lambda scene: {"turn": reach.turns_deg[reach.want(scene)]}


def random_policy(seed: int) -> Policy:
    """Any of the paper's seven turns, each as likely."""
    rng = np.random.Generator(np.random.Philox(key=seed))
    return lambda _: {"turn": PAPERS_TURNS_DEG[int(rng.integers(len(PAPERS_TURNS_DEG)))]}


def _arena_robot(body: str, options: Mapping[str, Any]) -> ArenaRobot:
    robot = make_body(body, options)
    if not isinstance(robot, ArenaRobot):
        robot.close()
        raise BodyError(
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
    random_action, ideal_action = random_policy(seed), facing()
    course = Course(one, PAPERS_RULES, seed)
    for _ in range(iterations):
        start, scene = one.placement, course.last.now
        state = one.state()
        assert state is not None
        two.restore(state)
        _compare_sonar(one, two, samples)
        action = (random_action if rng.random() < 0.5 else ideal_action)(scene)
        moves: list[_Move] = []
        for robot, name in zip(robots, names, strict=True):
            began_s = time.process_time()
            outcome, reached = _done(course.act(action)) if robot is one else (two.act(action), two.placement)
            samples.add(f"{name}: iteration, ms of processor time", 1e3 * (time.process_time() - began_s))
            moves.append(_Move(start, math.radians(action["turn"]), reached, outcome))
            _measure_motion(one.config, name, moves[-1], samples)
            _measure_perception(one.config, name, moves[-1], samples)
        _compare_moves(one.config, moves, samples)
    return samples


def _done(step: Step) -> tuple[Outcome, Placement]:
    """Return what the body itself said of a step, and where it had come."""
    return Outcome(NOTHING if step.event == TIMEOUT else step.event, step.outcome), placement_of(step.reached)


def _compare_sonar(one: ArenaRobot, two: ArenaRobot, samples: _Samples) -> None:
    """Both sonars without noise, from the very same place."""
    ones_m, twos_m = one.clean_ranges_m(), two.clean_ranges_m()
    heard_one, heard_two = np.isfinite(ones_m), np.isfinite(twos_m)
    both = heard_one & heard_two
    samples.add("between: clean range, same place, mm", *(1e3 * (ones_m - twos_m)[both]).tolist())
    samples.count("between: echo heard by one body alone, %", *(heard_one != heard_two).tolist())


class _Move(NamedTuple):
    """A motion: from where, how far it was to turn, to where, what came of it."""

    start: Placement
    turn_rad: float
    reached: Placement
    outcome: Outcome


def _measure_motion(config: PioneerConfig, name: str, move: _Move, samples: _Samples) -> None:
    """What the body did against what the action asks for; being stopped by a thing is no motion error."""
    if clearance_m(move.reached, config) < TOUCHING_M:
        return
    begun, ended = move.start.robot, move.reached.robot
    wanted_rad = begun.heading_rad + move.turn_rad
    moved_m = math.hypot(ended.x_m - begun.x_m, ended.y_m - begun.y_m)
    samples.add(f"{name}: turn error, deg", math.degrees(wrap_rad(ended.heading_rad - wanted_rad)))
    samples.add(f"{name}: advance error, mm", 1e3 * (moved_m - config.advance_m))


def _measure_perception(config: PioneerConfig, name: str, move: _Move, samples: _Samples) -> None:
    """The reading against the truth, walls taken for the object counted apart."""
    reading: Mapping[str, Any] = move.outcome.reading
    samples.count(f"{name}: nothing perceived, %", not reading)
    if not reading:
        return
    angle_deg = math.degrees(wrap_rad(unfold(reading) - bearing_rad(move.reached)))
    distance_m = reading["distance"] - surface_distance_m(move.reached, config.object_radius_m)
    phantom = abs(angle_deg) > PHANTOM_DEG or abs(distance_m) > PHANTOM_M
    samples.count(f"{name}: something else perceived, %", phantom)
    if not phantom:
        samples.add(f"{name}: perceived angle error, deg", angle_deg)
        samples.add(f"{name}: perceived distance error, mm", 1e3 * distance_m)


def _compare_moves(config: PioneerConfig, moves: Sequence[_Move], samples: _Samples) -> None:
    one, two = moves
    samples.count("between: same event, %", one.outcome.event == two.outcome.event)
    if min(clearance_m(move.reached, config) for move in moves) >= TOUCHING_M:
        here, there = one.reached.robot, two.reached.robot
        samples.add("between: heading, deg", math.degrees(wrap_rad(here.heading_rad - there.heading_rad)))
        samples.add("between: place, mm", _apart_mm(here, there))
    if one.outcome.event == two.outcome.event == "bump":
        samples.add("between: place of a bump, mm", _apart_mm(one.reached.robot, two.reached.robot))
    ones, twos = one.outcome.reading, two.outcome.reading
    samples.count("between: both or neither perceive, %", bool(ones) == bool(twos))
    if ones and twos:
        _compare_readings(ones, twos, samples)


def _apart_mm(here: Pose, there: Pose) -> float:
    return 1e3 * math.hypot(here.x_m - there.x_m, here.y_m - there.y_m)


def _compare_readings(one: Mapping[str, Any], two: Mapping[str, Any], samples: _Samples) -> None:
    samples.add("between: read angle, deg", math.degrees(wrap_rad(unfold(one) - unfold(two))))
    samples.add("between: read distance, mm", 1e3 * (one["distance"] - two["distance"]))


def _bounds(
    robots: tuple[ArenaRobot, ArenaRobot], names: tuple[str, str], iterations: int, seed: int
) -> dict[str, float]:
    """Captures of the best and of the blindest policy, for each body."""
    bounds = {}
    for robot, name in zip(robots, names, strict=True):
        for policy_name, policy in (
            ("ideal", facing()),
            ("random", random_policy(seed)),
        ):
            captures = captures_per_100(robot, policy, iterations, seed)
            bounds[f"{name}: captures/100, {policy_name} policy"] = captures
    return bounds
