"""What a user does wrong: each is said clearly, and the exit status is not 0."""

from pathlib import Path

import pytest

from mdb_protocol.zenoh_bus import Router
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


def test_failing_process_is_named_with_its_last_lines(tmp_path: Path) -> None:
    result = mdb(
        "up", "--runs", str(tmp_path), "--listen", "tcp/127.0.0.1:0", "--no-plot",
        "--set", "robot.body=no_such_package.body:Robot", "--set", "optimizer.actions=7",
    )  # fmt: skip
    assert result.returncode == 2
    assert "robot ended with status 2" in result.stderr
    assert "no_such_package" in result.stderr


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("evolution.popultion=400", "did you mean 'population'"),
        ("evolution.population=-3", "population"),
        ("experiment.iterations=many", "Expected `int`"),
        ("model.objekt.capacity=3", "no entry named 'objekt'; there are communication, object, induced"),
        ("optimizer.actions=9", "optimizer.actions is 9, but channels.action has 7"),
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
