"""The shell around every service: it steps, answers, stops, and lets nothing behind."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable

import pytest

from mdb_protocol import keys, messages
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.shell.service import FAILURES_IN_A_ROW, Meter, Stopper, announce, run, run_inline

BRAIN, BOUND_S = "test", 5.0


class Probe:
    """A service that does what a test tells it at each step."""

    role = "probe"

    def __init__(self, fabric: Fabric, on_step: Callable[[int], bool], instance: str = "one") -> None:
        self.bus, self.instance = MemoryBus(fabric, BRAIN), instance
        self._on_step = on_step
        self.steps = self.closed = 0
        self.close_error: Exception | None = None

    def step(self) -> bool:
        self.steps += 1
        self.bus._wake.set()  # no sleep between steps
        return self._on_step(self.steps)

    def values(self) -> dict[str, float]:
        return {"steps": float(self.steps)}

    def close(self) -> None:
        self.closed += 1
        if self.close_error:
            raise self.close_error


def never() -> bool:
    return False


def failing(step: int) -> bool:
    raise ValueError(f"step {step}")


def idle(_step: int) -> bool:
    return False


def test_a_step_that_fails_again_and_again_ends_the_service() -> None:
    fabric = Fabric()
    probe = Probe(fabric, failing)
    with pytest.raises(ValueError, match=f"step {FAILURES_IN_A_ROW}"):
        run(probe, never)
    assert (probe.steps, probe.closed) == (FAILURES_IN_A_ROW, 1)
    assert fabric.tokens == {}


def test_a_step_that_fails_now_and_then_is_tried_again() -> None:
    def now_and_then(step: int) -> bool:
        if step % FAILURES_IN_A_ROW:
            raise ValueError(step)
        return False

    probe = Probe(Fabric(), now_and_then)
    run(probe, lambda: probe.steps >= 40)
    assert probe.steps == 40


@pytest.mark.parametrize("busy", [True, False])
def test_told_to_stop_a_service_closes_everything(busy: bool) -> None:
    fabric = Fabric()
    probe = Probe(fabric, lambda _: busy)
    run(probe, lambda: probe.steps >= 3)
    assert (probe.steps, probe.closed) == (3, 1)
    assert (fabric.tokens, fabric.queryables, fabric.buses) == ({}, {}, [])


def test_a_service_that_cannot_close_still_leaves_the_bus() -> None:
    fabric = Fabric()
    probe = Probe(fabric, idle)
    probe.close_error = OSError("disk is gone")
    with pytest.raises(OSError, match="disk is gone"):
        run(probe, lambda: probe.steps >= 1)
    assert (fabric.tokens, fabric.buses) == ({}, [])


def test_a_service_that_cannot_be_announced_is_closed() -> None:
    fabric = Fabric()
    probe = Probe(fabric, idle, instance="not a name")
    with pytest.raises(Exception, match="instance is 'not a name'"):
        run(probe, never)
    assert probe.closed == 1
    assert fabric.buses == []


def test_sigterm_stops_a_service() -> None:
    stop = Stopper()
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    try:
        stop.install()
        probe = Probe(Fabric(), lambda step: bool(step == 3 and os.kill(os.getpid(), signal.SIGTERM)))
        run(probe, stop)
    finally:
        signal.signal(signal.SIGTERM, before[0])
        signal.signal(signal.SIGINT, before[1])
    assert (probe.steps, probe.closed) == (3, 1)


def test_a_service_whose_parent_is_gone_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    parent = os.getppid()
    stop = Stopper(parent)
    assert not stop()
    monkeypatch.setattr(os, "getppid", lambda: parent + 1)
    assert stop()
    assert Stopper(os.getpid() + 1)(), "it was gone before the service had asked"
    assert not Stopper()()


def test_a_running_service_is_seen_and_says_how_it_does() -> None:
    fabric, told, stepping = Fabric(), threading.Event(), threading.Event()
    probe = Probe(fabric, lambda _: stepping.set() or False)  # type: ignore[func-returns-value]
    thread = threading.Thread(target=run, args=(probe, told.is_set))
    asker = MemoryBus(fabric, BRAIN)
    thread.start()
    try:
        assert stepping.wait(BOUND_S)
        probe.bus.refusals.add(keys.COMMAND.path, "for the test")
        assert asker.alive() == {"probe/one"}
        (status,) = asker.query(keys.STATUS, 1.0, role="probe", instance="one")
    finally:
        told.set()
        thread.join(BOUND_S)
    assert (status.pid, status.refused) == (os.getpid(), {keys.COMMAND.path: 1})
    assert status.values["steps"] >= 1
    assert asker.query(keys.STATUS, 1.0) == []
    assert asker.alive() == frozenset()


def test_a_meter_tells_the_rate_of_the_last_seconds() -> None:
    now, count = 0.0, 0
    meter = Meter(lambda: count, clock=lambda: now)
    assert meter.rate_hz() == 0.0
    for hz in (100, 20):
        for _ in range(200):
            now, count = now + 0.05, count + hz // 20
            meter.tick()
        assert meter.rate_hz() == pytest.approx(hz, rel=0.1)
    now += 1000.0
    assert meter.rate_hz() < 1.0, "and of a service that was not asked for long"


def test_a_status_tells_what_waits_what_was_dropped_and_how_much_memory_there_is() -> None:
    fabric = Fabric()
    probe = Probe(fabric, idle)
    inbox = probe.bus.subscriber(keys.FINISHED)
    announce(probe)
    writer = MemoryBus(fabric, BRAIN)
    for i in range(3):
        writer.publisher(keys.FINISHED).put(messages.Finished(iterations=i))
    probe.bus.refusals.drop(keys.PAIR.path, "for the test")
    (status,) = writer.query(keys.STATUS, 1.0)
    assert isinstance(status, messages.Status)
    assert (status.queued, status.dropped) == (3, {keys.PAIR.path: 1})
    assert status.memory_bytes > 2**20
    assert inbox.take() is not None
    assert probe.bus.taken() == 1


def test_inline_services_step_in_turn_and_close_all_even_when_one_fails() -> None:
    fabric, order = Fabric(), []
    probes = [Probe(fabric, lambda _, i=i: order.append(i) or True, f"p{i}") for i in range(3)]  # type: ignore[misc]
    probes[0].close_error = OSError("disk is gone")
    with pytest.raises(OSError, match="disk is gone"):
        run_inline(probes, lambda: len(order) >= 6)
    assert order == [0, 1, 2, 0, 1, 2]
    assert [probe.closed for probe in probes] == [1, 1, 1]
    assert fabric.buses == []


HANGS = """
import ctypes, time
from mdb_services.shell.service import Stopper
stop = Stopper(bound_s=0.3)
stop.install()
print("ready", flush=True)
while not stop():
    time.sleep(0.01)
ctypes.PyDLL(None).sleep(600)  # with Python's lock held
"""


def test_a_process_that_is_told_to_stop_and_does_not_come_to_its_end_leaves_as_it_is() -> None:
    with subprocess.Popen([sys.executable, "-c", HANGS], stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=30.0)
    assert process.returncode == 1
    assert b"Timeout" in said
