"""Both bodies keep the `Robot` contract, and a body is found by its name."""

import builtins
import subprocess
import sys

import pytest

from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.body import RobotConfig, RobotError, make_robot
from tests.conformance.robot_conformance import RobotConformance


class TestKinematicRobot(RobotConformance):
    def make(self, config):
        return make_robot("kinematic", config)


class TestPioneerRobot(RobotConformance):
    iterations = 60

    def make(self, config):
        pytest.importorskip("pybullet")
        return make_robot("pybullet", config)


RUN_IN_A_FRESH_PROCESS = """
import hashlib
from mdb_sim.body import make_robot
robot = make_robot("pybullet")
steps = [robot.reset(11), *(robot.act(index % robot.actions) for index in range(40))]
print(hashlib.sha256(repr(steps).encode()).hexdigest())
"""


def test_pybullet_runs_alike_in_fresh_processes():
    pytest.importorskip("pybullet")
    runs = [
        subprocess.Popen([sys.executable, "-c", RUN_IN_A_FRESH_PROCESS], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    first, second = (run.communicate(timeout=60)[0].splitlines()[-1] for run in runs)
    assert len(first) == 64
    assert first == second


def test_a_body_of_another_make_is_found_by_module_and_factory():
    robot = make_robot("mdb_sim.bodies.pioneer.twin:KinematicRobot", RobotConfig(advance_m=0.1))
    assert isinstance(robot, KinematicRobot)
    assert robot.config.advance_m == 0.1


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("rover", "no body named 'rover'; expected 'kinematic', 'pybullet' or 'package.module:Factory'"),
        ("no.such.module:Robot", "install it, or mend the name"),
        ("mdb_sim.bodies.pioneer.twin:Rover", "no callable 'Rover'"),
        ("mdb_sim.body:RobotConfig", "could not be made"),
        ("builtins:type", "without actions, placement, reset"),
    ],
)
def test_a_body_that_cannot_be_had_says_why(body, says):
    with pytest.raises(RobotError, match=says):
        make_robot(body)


def test_without_pybullet_the_error_names_the_extra_and_the_other_body(monkeypatch):
    real_import = builtins.__import__

    def without_pybullet(name, *args, **kwargs):
        if name == "pybullet":
            raise ModuleNotFoundError("No module named 'pybullet'", name="pybullet")
        return real_import(name, *args, **kwargs)

    monkeypatch.delitem(sys.modules, "mdb_sim.bodies.pioneer.physics", raising=False)
    monkeypatch.delitem(sys.modules, "pybullet", raising=False)
    monkeypatch.setattr(builtins, "__import__", without_pybullet)
    with pytest.raises(RobotError, match=r"pip install .*\[pybullet\].*body='kinematic'"):
        make_robot("pybullet")


def test_only_pybullet_has_a_window():
    with pytest.raises(RobotError, match="has no window"):
        make_robot("kinematic", gui=True)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems need no DISPLAY")
def test_a_window_without_a_display_is_refused_and_the_process_lives_on(monkeypatch):
    pytest.importorskip("pybullet")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(RobotError, match="DISPLAY is not set"):
        make_robot("pybullet", gui=True)
