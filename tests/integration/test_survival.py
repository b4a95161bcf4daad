"""What happens to a running brain: late joiners, killed evolvers, junk on every key, Ctrl-C."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import zenoh

from mdb_protocol import codec, keys, messages
from mdb_protocol.bus import Inbox
from mdb_protocol.zenoh_bus import ZenohBus
from tests.integration.brain import ENDED_S, Brain, mdb, until

LONG = ("experiment.iterations=100000", "teacher.phase.alone.start=90000", "teacher.phase.second teacher.start=90001",
        "teacher.phase.alone again.start=90002")  # fmt: skip

BLOCK = zenoh.CongestionControl.BLOCK


def next_of(bus: ZenohBus, inbox: Inbox) -> object:
    """Return the next message of an inbox, bounded."""

    def take() -> object:
        bus.wait(0.05)
        return inbox.take()

    return until(take)


def iteration_after(bus: ZenohBus, inbox: Inbox, more: int) -> int:
    """Wait until the brain has done `more` iterations from now on; return the newest."""
    first = next_of(bus, inbox)
    assert isinstance(first, messages.IterationReport)
    newest = first.iteration
    while newest < first.iteration + more:
        report = next_of(bus, inbox)
        assert isinstance(report, messages.IterationReport)
        newest = report.iteration
    return newest


@pytest.mark.long
def test_late_joiner_gets_models_from_the_living_and_of_the_dead(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus() as early:
        iteration_after(early, early.subscriber(keys.ITERATION), 5)
        with brain.bus() as late:
            model = next_of(late, late.subscriber(keys.CURRENT_MODEL, model="object"))
            assert isinstance(model, messages.CurrentModel)
        status = brain.status(early, "evolver", "object")
        assert status is not None
        os.kill(status.pid, signal.SIGKILL)

        def kept() -> bool:
            answers = early.query(keys.KEPT_MODEL, 5.0, model="object")
            assert len(answers) <= 1
            return bool(answers) and answers[0].version >= model.version

        until(kept)  # the memory store hears of a model when `late` does, in no order


@pytest.mark.long
def test_killed_evolver_comes_back_and_goes_on(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        reports, models = bus.subscriber(keys.ITERATION), bus.subscriber(keys.CURRENT_MODEL, model="communication")
        iteration_after(bus, reports, 10)
        status = brain.status(bus, "evolver", "communication")
        assert status is not None
        os.kill(status.pid, signal.SIGKILL)
        until(lambda: "evolver/communication" not in bus.alive())
        until(lambda: "evolver/communication" in bus.alive())
        while models.take() is not None:
            pass
        newer = next_of(bus, models)
        assert isinstance(newer, messages.CurrentModel)
        again = brain.status(bus, "evolver", "communication")
        assert again is not None
        assert again.pid != status.pid
        assert newer.generation > 10, "it goes on from the kept model, not from nothing"
        iteration_after(bus, reports, 10)


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="a template needs Linux")
def test_a_killed_evolver_comes_back_without_its_template_too(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        reports, models = bus.subscriber(keys.ITERATION), bus.subscriber(keys.CURRENT_MODEL, model="communication")
        iteration_after(bus, reports, 10)
        template = brain.child("template")
        assert template is not None
        template.kill()
        status = brain.status(bus, "evolver", "communication")
        assert status is not None
        os.kill(status.pid, signal.SIGKILL)
        until(lambda: "the template is gone" in brain.output())
        until(lambda: (now := brain.status(bus, "evolver", "communication")) and now.pid != status.pid)
        assert isinstance(next_of(bus, models), messages.CurrentModel)


@pytest.mark.slow
def test_junk_on_every_key_is_counted_and_survived(tmp_path: Path) -> None:
    junk = [b"", b"\x00", b"\xff" * 100, b"not msgpack at all", b"\x81\xa9iteration\xff", os.urandom(4096)]
    names = {"teacher": "one", "model": "object", "role": "robot", "instance": "body", "holder": "x"}
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        reports = bus.subscriber(keys.ITERATION)
        iteration_after(bus, reports, 3)
        pids = {child.pid for child in brain.children()}
        config = zenoh.Config.from_json5(
            json.dumps({"mode": "client", "connect": {"endpoints": [(brain.run / "router.endpoint").read_text()]}})
        )
        with zenoh.open(config) as session:
            for row in keys.KEYS:
                key = row.at("pioneer", **{name: names[name] for name in row.parameters})
                right = codec.encoding_of(row.message) if row.message else "application/msgpack"
                for payload in junk:
                    for encoding in (right, "text/plain", "application/msgpack;mdb=999;Pair"):
                        session.put(key, payload, encoding=encoding, congestion_control=BLOCK)
            session.put("mdb/pioneer/no/such/key", b"junk")
            session.put("mdb/pioneer/teacher/one/command", codec.encode(messages.Finished(iterations=1)))
        iteration_after(bus, reports, 20)
        assert {child.pid for child in brain.children()} == pids, "no process died"

        def counted() -> bool:
            status = brain.status(bus, "optimizer", "action")
            counts = status.refused if status else {}
            return all(counts.get(row.path, 0) >= len(junk) for row in (keys.COMMAND, keys.CURRENT_MODEL))

        until(counted)


def test_ctrl_c_leaves_no_process(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        iteration_after(bus, bus.subscriber(keys.ITERATION), 3)
        children = brain.children()
        assert len(children) >= 9
        brain.interrupt()
        status = brain.wait(10.0)
        assert status == 130
        assert not [child for child in children if child.is_running()]


@pytest.mark.long
def test_children_stop_when_their_runner_is_killed(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        iteration_after(bus, bus.subscriber(keys.ITERATION), 3)
        children = brain.children()
        brain.process.kill()
        until(lambda: not [child for child in children if child.is_running()], ENDED_S)


@pytest.mark.parametrize("told", ["sigterm", "parent gone"])
def test_a_service_that_waits_for_its_router_stops_when_it_is_told_to(tmp_path: Path, told: str) -> None:
    run = tmp_path / "run"
    assert mdb("prepare", "paper", "--run", str(run)).returncode == 0
    nowhere = f"tcp/127.0.0.1:{free_port()}"
    parent = 1 if told == "parent gone" else os.getpid()
    words = ["run", "robot", "--run", str(run), "--connect", nowhere, f"--with-parent={parent}"]
    with subprocess.Popen(
        [sys.executable, "-m", "mdb_deploy.cli", *words], stderr=subprocess.PIPE, text=True
    ) as robot:
        if told == "sigterm":
            until(lambda: installed(robot.pid))
            robot.send_signal(signal.SIGTERM)
        _, said = robot.communicate(timeout=60.0)
    assert robot.returncode == 0, said
    assert "no router answers" not in said


def free_port() -> int:
    """A port at which nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def installed(pid: int) -> bool:
    """Whether a process handles SIGTERM by now."""
    (caught,) = re.findall(r"SigCgt:\s*(\w+)", Path(f"/proc/{pid}/status").read_text())
    return bool(int(caught, 16) >> (signal.SIGTERM - 1) & 1)


def test_killed_router_comes_back_where_it_was_and_the_run_goes_on(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        reports = bus.subscriber(keys.ITERATION)
        before = iteration_after(bus, reports, 5)
        router = brain.child("router")
        assert router is not None
        router.kill()
        until(lambda: (again := brain.child("router")) is not None and again.pid != router.pid)
        assert iteration_after(bus, reports, 20) > before + 20
