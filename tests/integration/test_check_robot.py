"""`mdb check-robot`: the example passes, ours passes, and each broken robot fails at its duty."""

import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest

from mdb_deploy.experiments import experiment_path
from mdb_deploy.trials.robot_check import Report, RobotCheck
from mdb_deploy.trials.robot_link import Link
from mdb_protocol.duties import DUTIES
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_protocol.zenoh_sessions import Router
from mdb_sim.runs.experiment import Experiment
from tests.integration.brain import mdb
from tests.integration.robots import BROKEN, Robot

ROUTER_CONFIG = Path(__file__).parents[2] / "deploy" / "router.json5"
WAIT_S, PATIENCE_S = 30.0, 240.0


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    yield router.endpoint()
    router.close()


def test_the_example_does_all_its_duties(endpoint: str) -> None:
    with Robot(endpoint, "pioneer"):
        result = mdb("check-robot", "--connect", endpoint)
    assert result.returncode == 0, result.stdout + result.stderr
    for number, duty in DUTIES.items():
        assert f"{number:>2} holds     {duty.title}\n" in result.stdout


def test_a_robot_that_does_not_come_holds_nothing(endpoint: str) -> None:
    result = mdb("check-robot", "--connect", endpoint, "--wait", "0.1")
    assert result.returncode == 1
    assert "no robot of brain pioneer came within 0.1 s" in result.stdout
    assert result.stdout.count("not tried") == len(DUTIES) - 1


@pytest.mark.long
def test_our_own_robot_does_all_its_duties(endpoint: str, tmp_path: Path) -> None:
    settings = ("--set", "robot.body=kinematic", "--set", "experiment.brain=ours")
    assert mdb("prepare", "--run", str(tmp_path), *settings).returncode == 0
    words = ["run", "robot", "--run", str(tmp_path), "--connect", endpoint]
    robot = subprocess.Popen([sys.executable, "-m", "mdb_deploy.cli", *words])
    try:
        result = mdb("check-robot", "--connect", endpoint, *settings)
    finally:
        robot.terminate()
        robot.wait(20.0)
    assert result.returncode == 0, result.stdout + result.stderr


def checked(endpoint: str, name: str) -> Report:
    """Try one broken robot, of a brain of its own; in a process of its own, which has one session."""
    brain = f"broken-{[*BROKEN].index(name)}"
    experiment = Experiment.read(experiment_path("paper"), [f"experiment.brain={brain}"])
    with Robot(endpoint, brain, BROKEN[name]), ZenohBus(brain, endpoint) as bus:
        return RobotCheck(Link(bus), experiment, wait_s=WAIT_S, patience_s=2.0).run()


@pytest.mark.long
@pytest.mark.timeout(300)
def test_each_broken_robot_fails_at_its_duty(endpoint: str) -> None:
    """Several at once: trials mostly wait."""
    with ProcessPoolExecutor(9, get_context("spawn")) as pool:
        tasks = {name: pool.submit(checked, endpoint, name) for name in BROKEN}
        reports = {name: task.result(PATIENCE_S) for name, task in tasks.items()}
    for name, report in reports.items():
        broken = BROKEN[name]
        assert broken.duty in report.failed(), f"{name}: {report.text()}"
        assert any(broken.said in words for words in report.against[broken.duty]), f"{name}: {report.text()}"
        assert not report.holds(), name
