"""`mdb check-robot`: the example passes, ours passes, and each broken robot fails at its duty."""

import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from mdb_deploy.experiments import experiment_path
from mdb_deploy.trials.robot_check import Report, RobotCheck
from mdb_deploy.trials.robot_link import ROBOTS, Link
from mdb_protocol import codec, messages
from mdb_protocol.bus import Raw, read
from mdb_protocol.duties import DUTIES
from mdb_protocol.errors import DecodeError
from mdb_protocol.keys import Key
from mdb_protocol.zenoh_bus import Router, ZenohBus
from mdb_sim.runs.experiment import Experiment
from tests.integration.brain import mdb
from tests.integration.robots import BROKEN, Broken, Robot

ROUTER_CONFIG = Path(__file__).parents[2] / "deploy" / "router.json5"
WAIT_S = 30.0


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
        robot.wait(10.0)
    assert result.returncode == 0, result.stdout + result.stderr


def encoding(row: Key) -> str:
    assert row.message is not None
    return codec.encoding_of(row.message)


@pytest.fixture(scope="module")
def reports(endpoint: str) -> dict[str, Report]:
    """All broken robots at once, each of a brain of its own: trials mostly wait."""

    def check(experiment: Experiment, broken: Broken) -> Report:
        brain = experiment.brain.experiment.brain
        with Robot(endpoint, brain, broken), ZenohBus(brain, endpoint) as bus:
            return RobotCheck(Link(bus), experiment, wait_s=WAIT_S, patience_s=2.0).run()

    # msgspec looks at a class when it first needs it, and two threads must not do that at once.
    experiments = [
        Experiment.read(experiment_path("paper"), [f"experiment.brain=broken-{i}"]) for i in range(len(BROKEN))
    ]
    for row in ROBOTS:
        with pytest.raises(DecodeError):
            read(row, "any", Raw(row.at("any"), codec.encode(messages.Finished(iterations=1)), encoding(row)))
    with ThreadPoolExecutor(len(BROKEN)) as pool:
        trials = zip(BROKEN.items(), experiments, strict=True)
        tasks = {name: pool.submit(check, experiment, broken) for (name, broken), experiment in trials}
        return {name: task.result() for name, task in tasks.items()}


@pytest.mark.long
@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_robot_fails_at_its_duty(name: str, reports: dict[str, Report]) -> None:
    report, broken = reports[name], BROKEN[name]
    assert broken.duty in report.failed(), report.text()
    assert any(broken.said in words for words in report.against[broken.duty]), report.text()
    assert not report.holds()
