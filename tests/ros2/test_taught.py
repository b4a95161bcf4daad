"""The robot of another make is taught to reach, over its own topics, by the scripted teacher."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rosbags")
pytest.importorskip("zenoh_ros2_sdk")

from mdb_deploy.experiments import experiment_path
from mdb_protocol.messages import Scene
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment
from tests.ros2.other_side import robot

TAUGHT, ITERATIONS = 150, 250
SHORT = (
    "experiment.pace=lockstep",
    f"experiment.iterations={ITERATIONS}",
    "optimizer.random_iterations=60",
    f"teacher.phase.alone.start={TAUGHT}",
    f"teacher.phase.second teacher.start={ITERATIONS}",
    f"teacher.phase.alone again.start={ITERATIONS + 1}",
    "robot.options.rate_hz=0.5",
    "robot.options.stale_s=10.0",
    "robot.options.linear_m_s=1.0",
    "robot.options.angular_deg_s=300.0",
)
"""The shipped experiment with one teacher; a robot whose time goes by with what it is told is told once each time."""
IDEAL = 0.24
"""Captures an action with the best turn each time; at random there are 0.01 (sim/README.md, "Bounds")."""


def taught(folder: Path, iterations: int) -> tuple[list[Scene], dict[str, int]]:
    scenes: dict[int, Scene] = {}
    with robot("--stepped") as other:
        settings = [*SHORT, f"experiment.iterations={iterations}", f"robot.options.connect={other.connect}"]
        experiment = Experiment.read(experiment_path("ros2"), settings)
        experiment.check_machine()
        run_experiment(experiment, folder, on_scene=lambda scene: scenes.__setitem__(scene.iteration, scene))
        heard = other.ask()
    return [scenes[iteration] for iteration in sorted(scenes)], heard


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_robot_of_another_make_is_taught_to_reach(tmp_path: Path) -> None:
    scenes, heard = taught(tmp_path / "run", ITERATIONS)
    assert len(scenes) == ITERATIONS + 1
    alone = sum(scene.success for scene in scenes[TAUGHT + 1 :])
    assert alone >= 0.6 * IDEAL * (ITERATIONS - TAUGHT), "at random it would be one or two"
    assert heard["touches"] == 0, "it never ran into anything"
    assert heard["in_order"], "no Twist was lost"
    assert heard["rests"], "at the end it rests"


@pytest.mark.long
@pytest.mark.timeout(300)
def test_two_runs_over_the_wire_are_the_same_value_by_value(tmp_path: Path) -> None:
    first, second = ([timeless(scene) for scene in taught(tmp_path / name, 40)[0]] for name in ("a", "b"))
    assert first == second


def timeless(scene: Scene) -> tuple[object, ...]:
    return scene.iteration, scene.event, scene.action, scene.reached, scene.now
