"""What a user does wrong: each is said clearly, and the exit status is not 0."""

import re
from pathlib import Path

import pytest

from mdb_deploy.experiments import experiment_path
from mdb_protocol.zenoh_sessions import Router
from tests.integration.brain import mdb

ROUTER_CONFIG = Path(__file__).parents[2] / "deploy" / "router.json5"


def test_port_in_use_names_the_process_and_the_way_out(tmp_path: Path) -> None:
    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    try:
        result = mdb("up", "--runs", str(tmp_path), "--listen", router.endpoint(), "--no-plot")
    finally:
        router.close()
    assert result.returncode == 2
    assert "router" in result.stderr
    assert "port in use" in result.stderr
    assert "--listen" in result.stderr


def test_no_router_is_said_with_what_to_do() -> None:
    result = mdb("status", "--connect", "tcp/127.0.0.1:1")
    assert result.returncode == 2
    assert "no router answers at tcp/127.0.0.1:1" in result.stderr


UNUSABLE = """
from mdb_sim.bodies.pioneer.twin import KinematicRobot

class Robot(KinematicRobot):
    def __init__(self, **options):
        raise ValueError("the serial line is gone")
"""


def test_failing_process_is_named_with_its_last_lines(tmp_path: Path) -> None:
    """A body beside the experiment file, of which is known what it has, and which then cannot be had."""
    (tmp_path / "unusable_robot.py").write_text(UNUSABLE)
    file = tmp_path / "mine.toml"
    file.write_bytes(experiment_path("paper").read_bytes())
    result = mdb(
        "up", str(file), "--runs", str(tmp_path / "runs"), "--listen", "tcp/127.0.0.1:0", "--no-plot",
        "--set", "robot.body=unusable_robot:Robot",
    )  # fmt: skip
    assert result.returncode == 2
    assert re.search(r"robot ended with status \d+", result.stderr)
    assert "the serial line is gone" in result.stderr


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("robot.body=no_such_package.body:Robot", "No module named 'no_such_package'; install it, put it beside"),
        ("robot.body=kinetic", "no body named 'kinetic'; expected 'kinematic', 'pybullet'"),
        ("robot.options.arena=3", "robot.options: Object contains unknown field `arena`"),
        ("robot.successes=['caught']", "robot.successes has 'caught', which is none of its events"),
        ("channels.light={low=0, high=1}", "channels.light: it has no such sensor or actuator"),
        ("teacher.policy=no_such_package.policy:Wants", "No module named 'no_such_package'"),
        ("teacher.options.turns_deg=[0, 45]", "the teacher's policy has 2 commands, but channels.note 7 notes"),
    ],
)
def test_what_does_not_fit_the_robot_is_said_before_anything_is_begun(
    setting: str, said: str, tmp_path: Path
) -> None:
    runs = tmp_path / "runs"
    place = ("--runs", str(runs), "--listen", "tcp/127.0.0.1:0", "--no-plot", "--set", "robot.body=kinematic")
    result = mdb("up", *place, "--set", setting)
    assert result.returncode == 2
    assert said in result.stderr
    assert "Traceback" not in result.stderr
    assert not runs.exists()


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("evolution.popultion=400", "did you mean 'population'"),
        ("evolution.population=-3", "population"),
        ("experiment.iterations=many", "Expected `int`"),
        (
            "model.objekt.capacity=3",
            "no entry named 'objekt'; there are communication, object, induced; did you mean 'object'?",
        ),
        ("channels.action={encoding='one_hot', size=9}", "channels.action has 9 values, and there are 7 [[choice]]"),
        ("optimizer.actions=7", "unknown field `actions`"),
        ("choice.ahead.values.turn=91", "choice 'ahead': turn = 91.0; expected -90.0 to 90.0"),
        ("actuators.turn.low=90", "actuators.turn: low 90.0 and high 90.0; expected low < high"),
        (
            "actuators.advance={low=0, high=1}",
            "choice 'ahead' has values for turn; expected one for each of turn, advance",
        ),
        ("nonsense", "expected SECTION.NAME=VALUE"),
        ("robbot.body=kinematic", "unknown section 'robbot'"),
        ("teacher.phase.alone.start=0", "phases start at"),
        ("mode.taught.world=communicate", "no world model 'communicate'; did you mean 'communication'"),
    ],
)
def test_wrong_setting_says_where_what_and_how_to_mend(setting: str, said: str, tmp_path: Path) -> None:
    result = mdb("prepare", "--run", str(tmp_path), "--set", setting)
    assert result.returncode == 2
    assert said in result.stderr


def test_missing_and_broken_experiment_files_are_said(tmp_path: Path) -> None:
    missing = mdb("up", str(tmp_path / "none.toml"))
    assert missing.returncode == 2
    assert "cannot read the experiment file" in missing.stderr
    broken = tmp_path / "broken.toml"
    broken.write_text("[experiment\nname = 3")
    result = mdb("up", str(broken))
    assert result.returncode == 2
    assert "not valid TOML" in result.stderr


def test_unknown_option_and_service_are_refused(tmp_path: Path) -> None:
    assert mdb("up", "--sed", "3").returncode == 2
    mdb("prepare", "--run", str(tmp_path))
    result = mdb("run", "cook", "--run", str(tmp_path))
    assert result.returncode == 2
    assert "no service 'cook'" in result.stderr
