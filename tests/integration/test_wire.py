"""A robot of somebody else's, several brains on one router, and the second of a name."""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from mdb_deploy.experiments import experiment_path
from mdb_deploy.running.progress import Progress
from mdb_deploy.running.watch import Watch
from mdb_protocol import keys, messages
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_protocol.zenoh_sessions import Router
from mdb_sim.runs.experiment import Experiment
from tests.integration.brain import SHORT, Brain, mdb, until
from tests.integration.robots import NEGLECTS, Robot
from tests.integration.test_survival import LONG, iteration_after

ROUTER_CONFIG = Path(__file__).parents[2] / "deploy" / "router.json5"


@pytest.fixture
def endpoint() -> Iterator[str]:
    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    yield router.endpoint()
    router.close()


def up(endpoint: str, runs: Path, *words: str, settings: tuple[str, ...] = ()) -> subprocess.Popen[str]:
    """Start `mdb up` on a router that runs."""
    runs.mkdir(exist_ok=True)
    options = [word for setting in (*SHORT, *settings) for word in ("--set", setting)]
    place = ["--runs", str(runs), "--connect", endpoint]
    command = [sys.executable, "-m", "mdb_deploy.cli", "up", "paper", "--no-plot", *place]
    return subprocess.Popen([*command, *words, *options], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def end(process: subprocess.Popen[str]) -> str:
    """Press Ctrl-C, and return what was said."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=20.0)
    return said


def test_the_brain_waits_for_a_robot_and_learns_with_it(endpoint: str, tmp_path: Path) -> None:
    settings = ("experiment.iterations=30", "teacher.phase.alone.start=20", "teacher.phase.second teacher.start=25",
                "teacher.phase.alone again.start=28", "optimizer.random_iterations=10")  # fmt: skip
    brain = up(endpoint, tmp_path / "runs", "--no-robot", settings=settings)
    try:
        with ZenohBus("pioneer", endpoint) as bus:
            reports, models = bus.subscriber(keys.ITERATION), bus.subscriber(keys.CURRENT_MODEL)
            until(lambda: len([name for name in bus.alive() if name.startswith("evolver/")]) == 3)
            assert "optimizer/action" not in bus.alive(), "it waits"
            assert "robot/body" not in bus.alive(), "no robot of ours was started"
            with Robot(endpoint, "pioneer"):
                assert brain.wait(60.0) == 0, brain.communicate()[0]
            done = [report.iteration for report in iter(reports.take, None)]
            assert done == list(range(30))
            assert {model.model for model in iter(models.take, None)} == {"communication", "object", "induced"}
    finally:
        said = end(brain)
    assert "begins when a robot comes to mdb/pioneer" in said


@pytest.mark.parametrize("attempt", range(3))
def test_of_two_robots_that_start_at_the_same_moment_one_stays(attempt: int, endpoint: str) -> None:
    with (
        ZenohBus(f"pair-{attempt}", endpoint) as bus,
        Robot(endpoint, bus.brain) as one,
        Robot(endpoint, bus.brain) as two,
    ):
        both = one.process, two.process
        until(lambda: any(process.poll() is not None for process in both))
        until(lambda: "robot/body" in bus.alive())
        assert [process.poll() for process in both].count(None) == 1
        assert len(bus.holders("robot", "body")) == 1


def test_who_counts_robots_stops_no_router_to_which_others_come(endpoint: str) -> None:
    came = []

    def come_and_go() -> None:
        for number in range(100):
            with ZenohBus("busy", endpoint) as bus:
                bus.token("teacher", f"t{number}")
                came.append(len(bus.alive()))

    with ZenohBus("busy", endpoint) as bus, ThreadPoolExecutor(2) as others:
        bus.claim("robot", "body", "one")
        coming = [others.submit(come_and_go) for _ in range(2)]
        while not all(one.done() for one in coming):
            assert bus.holders("robot", "body") == {"one"}
    assert len(came) == 200


@pytest.mark.long
def test_a_run_does_not_begin_with_two_robots_that_do_not_ask_and_ends_when_a_second_comes(
    endpoint: str, tmp_path: Path
) -> None:
    brain = up(endpoint, tmp_path / "runs", "--no-robot", settings=LONG)
    try:
        with ZenohBus("pioneer", endpoint) as bus, Robot(endpoint, "pioneer", NEGLECTS):
            reports = bus.subscriber(keys.ITERATION)
            with Robot(endpoint, "pioneer", NEGLECTS):
                until(lambda: len(bus.holders("robot", "body")) == 2)
                until(lambda: "evolver/object" in bus.alive())
                assert not until_not(lambda: "optimizer/action" in bus.alive(), 1.0)
            iteration_after(bus, reports, 3)
            with Robot(endpoint, "pioneer", NEGLECTS):
                assert brain.wait(30.0) == 2
    finally:
        said = end(brain)
    assert "one robot is awaited; stop the others: 2 robots claim to be that of brain pioneer" in said
    assert "Stop all but one, and go on with 'mdb up --resume" in said


@pytest.mark.long
def test_a_robot_of_an_earlier_run_is_awaited_anew(endpoint: str, tmp_path: Path) -> None:
    with ZenohBus("pioneer", endpoint) as bus:
        bus.token("robot", "body")
        shown = bus.publisher(keys.PERCEPTION)
        brain = up(endpoint, tmp_path / "runs", "--no-robot")
        try:
            old = messages.Perception(iteration=57, outcome={}, reading={})
            until(lambda: shown.put(old) or "evolver/object" in bus.alive())
            assert not until_not(lambda: "optimizer/action" in bus.alive(), 1.0)
            shown.put(messages.Perception(iteration=0, outcome={}, reading={}))
            until(lambda: "optimizer/action" in bus.alive())
        finally:
            said = end(brain)
    assert "start it again" in said
    assert "at=57" in re.sub(r"\x1b\[[0-9;]*m", "", said)


def until_not(condition: object, seconds: float) -> bool:
    """Whether a condition comes true within some time in which it must not."""
    try:
        until(condition, seconds)  # type: ignore[arg-type]
    except AssertionError:
        return False
    return True


@pytest.mark.slow
def test_brains_of_different_names_live_on_one_router_and_the_second_of_a_name_is_refused(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as first, first.bus() as bus:
        iteration_after(bus, bus.subscriber(keys.ITERATION), 3)
        run = first.run
        endpoint = (run / "router.endpoint").read_text()
        second = up(endpoint, tmp_path / "other", settings=(*LONG, "experiment.brain=other"))
        try:
            with ZenohBus("other", endpoint) as others:
                iteration_after(others, others.subscriber(keys.ITERATION), 3)
            status = mdb("status", "--json", "--connect", endpoint)
            told = {line["brain"]: line["services"] for line in map(json.loads, status.stdout.splitlines())}
            assert {*told} == {"pioneer", "other"}
            assert all("optimizer/action" in {row["service"] for row in rows} for rows in told.values())
            table = mdb("status", "--connect", endpoint).stdout
            assert f"mdb/other at {endpoint}" in table
            assert f"mdb/pioneer at {endpoint}" in table

            third = mdb("up", "paper", "--connect", endpoint, "--no-plot", "--runs", str(tmp_path / "third"))
            assert third.returncode == 2
            assert f"brain pioneer has its runner/up already: process {first.process.pid} on " in third.stderr
            assert f"in {run}" in third.stderr
            assert not (tmp_path / "third").exists(), "before anything is begun"
            robot = mdb("run", "robot", "--run", str(run), "--connect", endpoint)
            assert robot.returncode == 2
            assert "brain pioneer has its robot/body already" in robot.stderr
        finally:
            end(second)
        iteration_after(bus, bus.subscriber(keys.ITERATION), 3)


@pytest.mark.long
def test_of_two_that_are_started_at_the_same_time_one_runs(endpoint: str, tmp_path: Path) -> None:
    both = [up(endpoint, tmp_path / str(i)) for i in range(2)]
    try:
        until(lambda: any(process.poll() is not None for process in both))
        (refused,) = [process for process in both if process.returncode == 2]
        said = refused.communicate(timeout=10.0)[0]
        assert "brain pioneer has its runner/up already" in said
        (other,) = [process for process in both if process is not refused]
        assert f"process {other.pid}" in said or f".{other.pid}" in said
        assert other.wait(60.0) == 0, other.communicate()[0]
    finally:
        for process in both:
            end(process)


@pytest.mark.long
def test_who_was_killed_is_followed_at_once(endpoint: str, tmp_path: Path) -> None:
    first = up(endpoint, tmp_path / "first", settings=LONG)
    with ZenohBus("pioneer", endpoint) as bus:
        iteration_after(bus, bus.subscriber(keys.ITERATION), 3)
        os.kill(first.pid, signal.SIGKILL)
        first.communicate(timeout=10.0)
        second = up(endpoint, tmp_path / "second", settings=LONG)
        try:
            until(lambda: (tmp_path / "second").is_dir() and "optimizer/action" in bus.alive())
            iteration_after(bus, bus.subscriber(keys.ITERATION), 3)
            assert second.poll() is None
        finally:
            end(second)


def test_of_a_run_whose_router_is_gone_is_said_how_to_go_on(tmp_path: Path) -> None:
    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    watch = Watch(Experiment.read(experiment_path("paper")), tmp_path, None)
    try:
        watch.join(router.endpoint())
        assert watch.lost() == f"; the logs of the processes are in {tmp_path / 'logs'}"
        router.close()
        until(lambda: "is gone. One that 'mdb up' starts ends with it; 'mdb run router'" in watch.lost())
        assert f"mdb up --resume {tmp_path} --connect" in watch.lost()
    finally:
        watch.close()


def test_a_run_that_is_paused_or_waits_for_a_teacher_has_not_stalled(tmp_path: Path) -> None:
    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    experiment = Experiment.read(experiment_path("paper"))
    progress, watch = Progress(Console(file=StringIO()), experiment), Watch(experiment, tmp_path, None)
    try:
        watch.join(router.endpoint())
        with ZenohBus("pioneer", router.endpoint()) as bus:
            control, notes = bus.publisher(keys.CONTROL), bus.publisher(keys.COMMAND, teacher="ann")
            assert not watch.show(progress)
            control.put(messages.Control(iteration=0, paused=True))
            until(lambda: watch.show(progress))
            assert watch.show(progress), "as long as it is paused"
            control.put(messages.Control(iteration=0))
            until(lambda: not watch.show(progress))
            notes.put(messages.Command(teacher="ann", iteration=0, note=None, later=True))
            until(lambda: watch.show(progress))
            assert not watch.show(progress), "she says it once a second"
            control.put(messages.Control(iteration=0, action_s=60.0))
            until(lambda: watch.show(progress))
            assert watch.show(progress), "an action takes long"
    finally:
        watch.close()
        router.close()


def test_connect_says_when_no_router_answers(tmp_path: Path) -> None:
    result = mdb("up", "--connect", "tcp/127.0.0.1:1", "--runs", str(tmp_path / "runs"))
    assert result.returncode == 2
    assert "no router answers at tcp/127.0.0.1:1" in result.stderr
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--connect", "tcp/127.0.0.1:1", "--listen", "tcp/127.0.0.1:0"), "--connect starts no router"),
        (("--inline", "--no-robot"), "--inline runs everything in one process"),
        (("--no-robot", "--gui"), "leave it out with --no-robot"),
    ],
)
def test_options_that_do_not_go_together_are_said(words: tuple[str, ...], said: str) -> None:
    result = mdb("up", *words)
    assert result.returncode == 2
    assert said in result.stderr
