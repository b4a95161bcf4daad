"""Keys as a user works with them: commands, a router process, a whole brain."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mdb_protocol import keys, messages
from mdb_protocol.zenoh_bus import ZenohBus
from tests.integration.brain import BRAIN, ENDED_S, SHORT, mdb, until


@contextmanager
def router_process(run: Path, *words: str) -> Iterator[str]:
    """Run `mdb run router` and give where to connect."""
    command = [
        sys.executable,
        "-m",
        "mdb_deploy.cli",
        "run",
        "router",
        "--run",
        str(run),
        *words,
        f"--with-parent={os.getpid()}",
    ]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    endpoint = run / "router.endpoint"
    try:
        until(lambda: process.poll() is not None or endpoint.exists())
        assert process.poll() is None
        yield endpoint.read_text()
        assert process.poll() is None, "it is still the same process"
    finally:
        process.terminate()
        process.wait(ENDED_S)


def made(*words: str) -> str:
    """Run `mdb keys` and return what it says."""
    result = mdb("keys", *words)
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


def joined(folder: Path, endpoint: str, name: str) -> ZenohBus:
    """Add a teacher to a running router, and wait until it lets him in."""
    bundle = Path(made("add-teacher", name, "--keys", str(folder)))
    bus = ZenohBus(BRAIN, endpoint, credentials=bundle)
    bus.token("teacher", name)
    until(lambda: bus.admitted("teacher", name, 1.0))
    return bus


def test_a_running_router_admits_and_removes_teachers(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    made("init", str(folder))
    with (
        router_process(tmp_path, "--listen", "tls/127.0.0.1:0", "--keys", str(folder)) as endpoint,
        ZenohBus(BRAIN, endpoint, credentials=folder) as brain,
    ):
        commands = brain.subscriber(keys.COMMAND)
        notes: list[messages.Command] = []

        def say(bus: ZenohBus, name: str, iteration: int) -> bool:
            """Say it again until it is heard: what was said while the router began anew may be lost."""
            bus.publisher(keys.COMMAND, teacher=name).put(messages.Command(teacher=name, iteration=iteration, note=1))
            brain.wait(0.1)
            while (note := commands.take()) is not None:
                notes.append(note)
            return any(note.teacher == name and note.iteration == iteration for note in notes)

        buses = {name: joined(folder, endpoint, name) for name in ("anna", "bert")}
        until(lambda: say(buses["anna"], "anna", 1) and say(buses["bert"], "bert", 1))
        assert "no longer admitted" in made("remove", "anna", "--keys", str(folder))
        until(lambda: brain.alive() == {"teacher/bert"})
        assert not buses["anna"].admitted("teacher", "anna", 0.5)
        say(buses["anna"], "anna", 2)
        until(lambda: say(buses["bert"], "bert", 3))
        assert [note for note in notes if note.teacher == "anna" and note.iteration > 1] == []
        for bus in buses.values():
            bus.close()


@pytest.mark.long
def test_a_whole_brain_runs_with_keys_and_goes_on_when_a_teacher_is_added(tmp_path: Path) -> None:
    folder, runs = tmp_path / "keys", tmp_path / "runs"
    made("init", str(folder))
    words = [word for setting in (*SHORT, "robot.action_s=0.05") for word in ("--set", setting)]
    place = ["--listen", "tls/0.0.0.0:0", "--keys", str(folder), "--runs", str(runs)]
    command = [sys.executable, "-m", "mdb_deploy.cli", "up", *place, "--no-plot", *words]
    with (tmp_path / "up.out").open("wb") as out:
        brain = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT)
    try:
        until(lambda: brain.poll() is not None or list(runs.glob("*/router.endpoint")))
        (file,) = runs.glob("*/router.endpoint")
        endpoint = file.read_text()
        assert re.fullmatch(r"tls/127\.0\.0\.1:\d+", endpoint)
        with ZenohBus(BRAIN, endpoint, credentials=folder) as bus:
            reports = bus.subscriber(keys.ITERATION)
            until(lambda: bus.wait(0.1) and reports.take())
            bundle = Path(made("add-teacher", "anna", "--keys", str(folder)))
            with ZenohBus(BRAIN, endpoint, credentials=bundle) as anna:
                scenes = anna.subscriber(keys.SCENE)
                until(lambda: anna.wait(0.1) and scenes.take())
        assert brain.wait(60.0) == 0, (tmp_path / "up.out").read_text()
    finally:
        if brain.poll() is None:
            brain.terminate()
            brain.wait(10.0)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--listen", "tcp/0.0.0.0:0"], "reached from beyond this machine"),
        (["--listen", "tcp/[::]:0"], "--open-to-everyone"),
        (["--listen", "tls/127.0.0.1:0"], "needs keys: 'mdb keys init'"),
        (["--listen", "tcp/0.0.0.0:0", "--keys", "{keys}"], "with keys a router listens on tls/ or quic/"),
        (["--listen", "tls/192.0.2.77:0", "--keys", "{keys}"], "mdb keys renew --keys {keys} --host 192.0.2.77"),
        (["--listen", "tls/127.0.0.1:0", "--keys", "{keys}/none"], "is not a key folder; 'mdb keys init"),
    ],
)
def test_router_and_brain_refuse_to_be_open_by_accident(words: list[str], said: str, tmp_path: Path) -> None:
    folder = str(tmp_path / "keys")
    made("init", folder)
    words = [word.format(keys=folder) for word in words]
    for command in (["run", "router"], ["up", "--no-plot", "--runs", str(tmp_path / "runs")]):
        result = mdb(*command, *words)
        assert result.returncode == 2
        assert said.format(keys=folder) in result.stderr
    assert not (tmp_path / "runs").exists(), "nothing was begun"


def test_open_to_everyone_in_plain_words(tmp_path: Path) -> None:
    with router_process(tmp_path, "--listen", "tcp/0.0.0.0:0", "--open-to-everyone") as endpoint:
        assert endpoint.startswith("tcp/127.0.0.1:")
        with ZenohBus(BRAIN, endpoint) as bus:
            assert bus.alive() == frozenset()


def test_status_and_health_show_their_keys(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    made("init", str(folder))
    with router_process(tmp_path, "--listen", "tls/127.0.0.1:0", "--keys", str(folder)) as endpoint:
        assert mdb("health", "router", "--connect", endpoint, "--keys", str(folder)).returncode == 0
        assert mdb("status", "--connect", endpoint, "--keys", str(folder)).returncode == 1, "nobody is alive"
        refused = mdb("health", "router", "--connect", endpoint)
        assert refused.returncode == 2
        assert "give your bundle with --keys" in refused.stderr
