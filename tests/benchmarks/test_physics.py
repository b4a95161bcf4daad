"""What a motion in PyBullet costs and errs, under the shipped settings of the engine and others, turn by turn.

Run by name: `mdb test -m slow tests/benchmarks/test_physics.py -s`

All bodies do each motion in turn, from the same place, so that whatever else the machine does falls on all of them.
"""

import math
import sys
import time
from dataclasses import dataclass, field

import numpy as np
import pytest

from mdb_sim.bodies.pioneer.arena import clearance_m, wrap_rad
from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.bodies.pioneer.world import PioneerConfig, Placement, placement_of
from mdb_sim.body import Numbers
from mdb_sim.robot.course import Course, Step
from mdb_sim.studies.twins import PAPERS_RULES, TOUCHING_M, facing
from mdb_sim.teaching.policies.pioneer import PAPERS_TURNS_DEG

pybullet = pytest.importorskip("pybullet")
from mdb_sim.bodies.pioneer import physics as pioneer  # noqa: E402  it needs pybullet

SEEDS, ITERATIONS = (204, 205, 206), 150


class Tried(pioneer.PioneerRobot):
    """The shipped body with other settings of the engine."""

    def __init__(self, hz: int, solver_iterations: int, *, cone: bool = False) -> None:
        super().__init__(physics_hz=hz)
        pybullet.setPhysicsEngineParameter(
            numSolverIterations=solver_iterations, enableConeFriction=int(cone), physicsClientId=self._client
        )

    def move(self, turn_rad: float) -> bool:
        """Do one action's motion, nothing else."""
        return self._move(turn_rad, self.config.advance_m)


class AsItWas(Tried):
    """With the drive and the feeling of the first version: slow at the goal, stopped once it is inside a thing."""

    def _speed(self, last_m_s: float, remaining_m: float, top_m_s: float) -> float:
        wanted_m_s = min(max(12.0 * remaining_m, -top_m_s), top_m_s)
        change_m_s = pioneer.ACCELERATION_M_S2 * self._step_s
        return min(max(wanted_m_s, last_m_s - change_m_s), last_m_s + change_m_s)

    def _touches(self) -> bool:
        contacts = pybullet.getContactPoints(bodyA=self._robot, linkIndexA=2, physicsClientId=self._client)
        return any(contact[8] <= 0.0 for contact in contacts or ())

    def move(self, turn_rad: float) -> bool:
        shipped, pioneer.ARRIVED_M = pioneer.ARRIVED_M, 0.0005
        bumped = super().move(turn_rad)
        pioneer.ARRIVED_M = shipped
        return bumped


@dataclass
class Measured:
    """What one body's motions took and erred; errors are sizes."""

    took_s: list[float] = field(default_factory=list)
    turn_deg: list[float] = field(default_factory=list)
    advance_mm: list[float] = field(default_factory=list)
    place_mm: list[float] = field(default_factory=list)
    bump_mm: list[float] = field(default_factory=list)


def measure(body: Tried, start: Placement, turn_rad: float, twin: Step, measured: Measured) -> None:
    """Let the body move from there, and compare with what was asked for and with where the twin came to."""
    body.put(start, 0)
    began_s = time.process_time()
    bumped = body.move(turn_rad)
    measured.took_s.append(time.process_time() - began_s)
    asked = placement_of(twin.reached)
    reached, begun, wanted = body.placement, start.robot, asked.robot
    robot = reached.robot
    apart_mm = 1e3 * math.hypot(robot.x_m - wanted.x_m, robot.y_m - wanted.y_m)
    if bumped and twin.event == "bump":
        measured.bump_mm.append(apart_mm)
    if min(clearance_m(place, body.config) for place in (reached, asked)) < TOUCHING_M:
        return
    measured.turn_deg.append(abs(math.degrees(wrap_rad(robot.heading_rad - begun.heading_rad - turn_rad))))
    advance_m = math.hypot(robot.x_m - begun.x_m, robot.y_m - begun.y_m)
    measured.advance_mm.append(1e3 * abs(advance_m - body.config.advance_m))
    measured.place_mm.append(apart_mm)


def any_turn(rng: np.random.Generator) -> Numbers:
    """Return one of the paper's turns, each as likely."""
    return {"turn": PAPERS_TURNS_DEG[int(rng.integers(len(PAPERS_TURNS_DEG)))]}


def line(name: str, measured: Measured, ratio: float) -> str:
    """One row of the table: median processor time, how many times faster than the first, mean and greatest errors."""
    sizes = (measured.turn_deg, measured.advance_mm, measured.place_mm, measured.bump_mm)
    errors = " | ".join(f"{np.mean(size):.3f}, {np.max(size):.3f}" for size in sizes)
    return f"| {name} | {1e3 * np.median(measured.took_s):.2f} | {ratio:.2f} | {errors} |"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_shipped_physics_costs_less_and_errs_less_than_the_first(capsys: pytest.CaptureFixture[str]) -> None:
    shipped = f"{PioneerConfig().physics_hz} Hz, {pioneer.SOLVER_ITERATIONS}"
    bodies = {
        "as it was: 240 Hz, 50": AsItWas(240, 50, cone=True),
        "as it was: 120 Hz, 30": AsItWas(120, 30, cone=True),
        "240 Hz, 50": Tried(240, 50),
        "120 Hz, 50": Tried(120, 50),
        "120 Hz, 30": Tried(120, 30),
        "90 Hz, 50, cone": Tried(90, 50, cone=True),
        "90 Hz, 50": Tried(90, 50),
        "90 Hz, 30": Tried(90, 30),
        "60 Hz, 60": Tried(60, 60),
        "60 Hz, 30": Tried(60, 30),
    }
    results = {name: Measured() for name in bodies}
    twin, ideal = KinematicRobot(), facing()
    for seed in SEEDS:
        course, rng = Course(twin, PAPERS_RULES, seed), np.random.default_rng(seed)
        for _ in range(ITERATIONS):
            scene = course.last.now
            anything = rng.random() < 0.5
            action = (
                {"turn": PAPERS_TURNS_DEG[int(rng.integers(len(PAPERS_TURNS_DEG)))]} if anything else ideal(scene)
            )
            step = course.act(action)
            for name, body in bodies.items():
                measure(body, placement_of(scene), math.radians(action["turn"]), step, results[name])
    first, best = results["as it was: 240 Hz, 50"], results[shipped]
    ratios = {name: np.median(np.divide(first.took_s, measured.took_s)) for name, measured in results.items()}
    with capsys.disabled():
        errors = "turn, deg | advance, mm | place, mm | place of a bump, mm"
        head = f"| settings | ms of processor time | times faster | {errors} |"
        rows = [line(name, measured, ratios[name]) for name, measured in results.items()]
        lines = ["", head, "|---|--:|--:|--:|--:|--:|--:|", *rows, f"bumps: {len(best.bump_mm)}", ""]
        sys.stdout.write("\n".join(lines))
    assert ratios[shipped] > 1.5
    for quantity in ("turn_deg", "advance_mm", "place_mm"):
        assert np.mean(getattr(best, quantity)) <= np.mean(getattr(first, quantity))
        assert np.max(getattr(best, quantity)) <= np.max(getattr(first, quantity))
