"""One of a name: the second is refused and told who it is; of two at once one stays; the dead are not waited for."""

import multiprocessing
import os
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

import pytest

from mdb_protocol import holding
from mdb_protocol.bus import Bus
from mdb_protocol.errors import TakenError
from mdb_protocol.holding import hold
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_protocol.zenoh_sessions import LEASE_MS, Router
from mdb_services.shell.service import announce

ROUTER_CONFIG = Path(__file__).parents[2] / "deploy" / "router.json5"
BRAIN = "pioneer"


class Ready(NamedTuple):
    """A service that is ready and does nothing."""

    bus: Bus
    role: str = "robot"
    instance: str = "body"

    def step(self) -> bool:
        return False

    def values(self) -> dict[str, float]:
        return {}

    def close(self) -> None:
        """Nothing to free."""


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    yield router.endpoint()
    router.close()


def test_the_first_gets_it_and_the_second_is_told_who_lives_and_where() -> None:
    fabric = Fabric()
    first = MemoryBus(fabric, BRAIN)
    assert hold(first, "robot", "body")
    announce(Ready(first), Path("/runs/one"))
    said = rf"its robot/body already: process {os.getpid()} on .*, since 2.*, in /runs/one"
    with pytest.raises(TakenError, match=said):
        hold(MemoryBus(fabric, BRAIN), "robot", "body")
    assert hold(MemoryBus(fabric, BRAIN), "optimizer", "action"), "another service of the same brain"
    assert hold(MemoryBus(fabric, "other"), "robot", "body"), "the same service of another brain"


def test_who_does_not_answer_is_waited_for_and_then_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(holding, "GONE_S", 0.1)
    fabric = Fabric()
    starting = MemoryBus(fabric, BRAIN)
    starting.claim("robot", "body", "a-host.77.00")
    with pytest.raises(TakenError, match="process 77 on a-host, which is starting or does not answer"):
        hold(MemoryBus(fabric, BRAIN), "robot", "body")
    starting.close()
    foreign = MemoryBus(fabric, BRAIN)
    foreign.claim("robot", "body", "5f0fcd4f")
    with pytest.raises(TakenError, match="somebody who calls himself 5f0fcd4f, which is starting"):
        hold(MemoryBus(fabric, BRAIN), "robot", "body")
    foreign.close()
    MemoryBus(fabric, BRAIN).token("robot", "body")
    with pytest.raises(TakenError, match="somebody who does not say who it is"):
        hold(MemoryBus(fabric, BRAIN), "robot", "body")


def test_who_is_told_to_stop_waits_no_longer() -> None:
    fabric = Fabric()
    MemoryBus(fabric, BRAIN).token("robot", "body")
    told = iter([False, True])
    assert not hold(MemoryBus(fabric, BRAIN), "robot", "body", lambda: next(told))


def test_the_wait_for_the_dead_is_longer_than_their_lease() -> None:
    assert holding.GONE_S * 1000 > LEASE_MS


@pytest.mark.parametrize("attempt", range(10))
def test_of_those_who_start_at_the_same_time_one_stays(attempt: int, endpoint: str) -> None:
    """Over a real router; each who gets it is ready a moment later and answers, as services do."""
    buses = [ZenohBus(f"race-{attempt}", endpoint) for _ in range(4)]

    def start(bus: ZenohBus) -> str:
        try:
            hold(bus, "robot", "body")
        except TakenError as error:
            return str(error)
        announce(Ready(bus))
        serve_until_s = time.monotonic() + holding.GONE_S
        while time.monotonic() < serve_until_s and len(ended) < len(buses) - 1:
            bus.wait(0.01)
            bus.serve()
        return ""

    ended: list[str] = []
    with ThreadPoolExecutor(len(buses)) as pool:
        tasks = [pool.submit(start, bus) for bus in buses]
        for task in tasks:
            task.add_done_callback(lambda done: ended.append(done.result()))
        said = [task.result() for task in tasks]
    for bus in buses:
        bus.close()
    assert said.count("") == 1
    assert all(f"process {os.getpid()} on" in words for words in said if words)


def _live(endpoint: str, ready: Connection) -> None:
    bus = ZenohBus("dying", endpoint)
    hold(bus, "robot", "body")
    announce(Ready(bus))
    ready.send("ready")
    while True:
        bus.wait(1.0)


def test_after_a_death_the_successor_starts_at_once(endpoint: str) -> None:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    first = context.Process(target=_live, args=(endpoint, theirs))
    first.start()
    assert ours.poll(30.0)
    with ZenohBus("dying", endpoint) as bus:
        first.kill()
        first.join(10.0)
        began_s = time.monotonic()
        assert hold(bus, "robot", "body")
        assert time.monotonic() - began_s < holding.GONE_S / 2, "its tokens go with it: the lease is not waited for"
