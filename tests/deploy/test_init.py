"""`mdb init`: what it writes runs at once, whatever the environment; what cannot be done is refused with a reason."""

import re
from pathlib import Path

import numpy as np
import pytest
import structlog

gymnasium = pytest.importorskip("gymnasium")

from mdb_deploy import Run, run  # noqa: E402
from mdb_deploy.begin.folder import TEMPLATE_KINDS, begin  # noqa: E402
from mdb_deploy.cli.main import main  # noqa: E402
from mdb_deploy.experiments import EXPERIMENTS, default_experiment, experiment_path  # noqa: E402
from mdb_protocol.errors import MdbError  # noqa: E402
from mdb_sim.body import BodyError  # noqa: E402
from mdb_sim.runs.experiment import Experiment  # noqa: E402
from tests.deploy import spaces  # noqa: E402

spaces.register()
OWN = ("CartPole-v1", "MountainCarContinuous-v0", "Pendulum-v1", "Acrobot-v1", "FrozenLake-v1", "CliffWalking-v1",
       "Taxi-v4", "Blackjack-v1")  # fmt: skip
MORE = ("LunarLander-v3", "BipedalWalker-v3", "CarRacing-v3", "Reacher-v5", "Ant-v5")
ITERATIONS = 30
QUICK = {"optimizer.random_iterations": 15, "model.direct.members": 1, "model.direct.capacity": 40}


def begun(folder: Path, env: str) -> Run:
    """A short run of what init writes for an environment."""
    begin(folder, f"gymnasium:{env}")
    return run(folder, iterations=ITERATIONS, folder=folder / "run", settings=QUICK)


def check(done: Run) -> None:
    """Every action was judged and learnt from, and for as long as it was to be the robot acted by its models."""
    table = done.iterations
    assert len(table["iteration"]) == ITERATIONS
    assert np.isfinite(table["feedback"]).all()
    assert set(table["mode"][16:]) == {"alone"}
    assert done.models["version"][done.models["model"] == "direct"].max() >= ITERATIONS - 2
    assert np.isfinite(table["prequential.direct"][5:]).all()


@pytest.mark.parametrize("env", OWN)
def test_an_environment_of_gymnasium_runs_at_once(env: str, tmp_path: Path) -> None:
    check(begun(tmp_path / env, env))


@pytest.mark.long
@pytest.mark.parametrize("env", MORE)
def test_one_that_needs_another_package_runs_at_once(env: str, tmp_path: Path) -> None:
    try:
        gymnasium.make(env).close()
    except Exception as error:
        pytest.skip(f"{env} is not to be had: {error}")
    check(begun(tmp_path / env, env))


@pytest.mark.parametrize("name", [*(f"See{name}" for name in spaces.SEEN), *(f"Do{name}" for name in spaces.DONE)])
def test_every_kind_of_space_runs_at_once(name: str, tmp_path: Path) -> None:
    done = begun(tmp_path / name, f"{name}-v0")
    check(done)
    assert done.record.experiment.robot.options["env"] == f"{name}-v0"


def test_parts_that_cannot_be_sensed_are_left_out_and_named(tmp_path: Path) -> None:
    experiment, _ = begin(tmp_path / "new", "gymnasium:SeeMission-v0")
    assert "# not sensed, since its length or kind changes: goal, mission, pose_1\n" in experiment.read_text()


@pytest.mark.parametrize("name", spaces.REFUSED)
def test_what_cannot_be_done_is_refused_with_a_reason_and_nothing_is_written(name: str, tmp_path: Path) -> None:
    with pytest.raises(MdbError, match=spaces.REFUSED[name][2]):
        begin(tmp_path / "new", f"gymnasium:Not{name}-v0")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("like", "says"),
    [
        ("gymnasium:NoSuch-v0", r"doesn't exist.*registry\(\)'` lists those that there are"),
        (
            "gymnasium:no_such_module:Env-v0",
            "No module named 'no_such_module'.*put it into the folder if it is yours",
        ),
        ("gymnasium:ALE/Pong-v5", r"gymnasium:MODULE:ENV, as gymnasium:ale_py:ALE/Pong-v5"),
        ("gymnasium", "no kind of robot; expected one of gymnasium:ENV"),
        ("arms", "no kind of robot; expected one of gymnasium:ENV"),
    ],
)
def test_a_kind_that_there_is_not(like: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", str(tmp_path / "new"), "--like", like]) == 2
    assert re.search(says, capsys.readouterr().err)


def test_what_is_next_for_a_ros2_robot_is_to_start_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["init", str(tmp_path / "turtle"), "--like", "ros2"]) == 0
    printed = capsys.readouterr().out
    assert "next: start ROS 2's router (ros2 run rmw_zenoh_cpp rmw_zenohd) and the robot" in printed
    assert "--inline" not in printed


def test_what_is_there_already_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mine = str(tmp_path / "my robot")
    assert main(["init", mine, "--like", "wheeled"]) == 0
    assert f"next: mdb up '{mine}' --inline" in capsys.readouterr().out
    assert main(["init", mine, "--like", "wheeled"]) == 2
    assert "already; give another folder" in capsys.readouterr().err


@pytest.mark.parametrize("folder", ["taken", "taken/new"])
def test_a_folder_that_cannot_be_made_is_said(
    folder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken").write_text("a file")
    assert main(["init", str(tmp_path / folder), "--like", "arm"]) == 2
    assert f"mdb: {tmp_path / folder}: " in capsys.readouterr().err


def test_the_experiment_in_this_folder_is_the_one_that_nobody_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert experiment_path(default_experiment()) == EXPERIMENTS / "demo.toml"
    begin(tmp_path, "wheeled")
    assert experiment_path(default_experiment()) == Path("experiment.toml")


def test_an_environment_that_fails_without_a_word_is_named_with_the_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(**_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(gymnasium, "make", lambda *_, **options: broken(**options))
    with pytest.raises(MdbError, match=r"'Bad-v0' cannot be made: AssertionError in .*test_init.py, line \d+: raise"):
        begin(tmp_path / "new", "gymnasium:Bad-v0")


def test_what_gymnasium_warns_of_is_one_line(tmp_path: Path) -> None:
    with structlog.testing.capture_logs() as said:
        begin(tmp_path / "old", "gymnasium:CartPole-v0")
    assert {line["event"] for line in said} == {
        "The environment CartPole-v0 is out of date. You should consider upgrading to version `v1`."
    }


def test_an_environment_of_one_s_own_lies_in_the_folder(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "my_mines.py").write_text(
        "import gymnasium\n"
        "from gymnasium.envs.toy_text import FrozenLakeEnv\n"
        "gymnasium.register('Mine-v0', FrozenLakeEnv, max_episode_steps=20)\n"
    )
    check(begun(folder, "my_mines:Mine-v0"))


@pytest.mark.parametrize("kind", TEMPLATE_KINDS)
def test_a_template_s_robot_acts_by_what_it_was_taught(kind: str, tmp_path: Path) -> None:
    begin(tmp_path / kind, kind)
    done = run(tmp_path / kind, iterations=150, folder=tmp_path / "run", settings={"optimizer.random_iterations": 60})
    table = done.iterations
    assert np.isfinite(table["feedback"]).all()
    assert np.nanmean(table["feedback"][100:]) > np.nanmean(table["feedback"][:60]) + 0.2


def test_a_ros2_robot_s_file_is_the_shipped_one_under_another_name(tmp_path: Path) -> None:
    if not (EXPERIMENTS / "ros2.toml").exists():
        pytest.skip("no ros2.toml is shipped")
    (path,) = begin(tmp_path / "turtle", "ros2")
    section = Experiment.read(path).brain.experiment
    assert (section.name, section.brain) == ("turtle", "turtle")


@pytest.mark.parametrize("seen", [*spaces.SEEN.values(), *spaces.DONE.values()], ids=str)
def test_numbers_and_values_of_a_space_go_both_ways(seen: gymnasium.Space) -> None:
    from mdb_sim.bodies.spaces import ends, leaves, left_out, numbers_of, value_of

    seen.seed(3)
    found = leaves(seen, "x", 12)
    numbers = list(numbers_of(seen, seen.sample(), 12))
    assert len(numbers) == sum(leaf.numbers for leaf in found)
    for leaf in found:
        (mine, numbers) = (numbers[: leaf.numbers], numbers[leaf.numbers :])
        low, high = (leaf.low - leaf.low, leaf.high - leaf.low) if leaf.index else (leaf.low, leaf.high)
        assert (low <= mine).all()
        assert (mine <= high).all()
    if all(leaf.shape is None for leaf in found) and not left_out(seen):
        told = [number for leaf in found for number in (ends(leaf, 1.0)[0] * 0.4 + ends(leaf, 1.0)[1] * 0.6).tolist()]
        assert seen.contains(value_of(seen, iter(told)))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"grid": 40}, "grid 40; expected repeat of 1 or more, limit above 0, grid of 1 to 32"),
        ({"names": ["x"]}, "names has 1 names; an observation has 4 numbers"),
        ({"rates": ["x"]}, r"rates is \['x'\]; expected some of robot.options.names \(none\)"),
        ({"names": ["x", "x_rate", "angle", "swing"], "rates": ["x"]}, "none of which NAME_rate is there, too"),
        ({"actuators": ["left", "right"]}, r"an action has 1 numbers \(motor\), and each is an actuator"),
    ],
)
def test_options_that_do_not_fit_an_environment(options: dict[str, object], says: str) -> None:
    from mdb_sim.bodies.environment import GymnasiumBody

    with pytest.raises(BodyError, match=says):
        GymnasiumBody("CartPole-v1", **options)


def test_a_rate_is_what_a_number_changed_by_in_the_last_step() -> None:
    from mdb_sim.bodies.environment import GymnasiumBody

    names = ["x", "x_speed", "angle", "angle_speed"]
    body = GymnasiumBody("CartPole-v1", names=names, rates=["angle", "x"], repeat=3)
    single = GymnasiumBody("CartPole-v1", names=names)
    first = body.reset(1, 0)
    assert (first["angle_rate"], first["x_rate"]) == (0.0, 0.0)
    single.reset(1, 0)
    _, before, last = (single.act({"motor": 1.0}).reading for _ in range(3))
    held = body.act({"motor": 1.0}).reading
    assert held == last | {f"{name}_rate": last[name] - before[name] for name in ("angle", "x")}
    body.close()
    single.close()
