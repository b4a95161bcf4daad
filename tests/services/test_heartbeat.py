"""The heartbeat: who is silent for longer than said hangs; who slept with the machine does not."""

import os
from collections.abc import Iterator

import pytest

from mdb_protocol.memory_bus import Fabric
from mdb_services.shell.heartbeat import BEAT_S, CLOSE_S, READ_BYTES, SILENT_S, TURN_S, VARIABLE, Heart, Pulse
from mdb_services.shell.service import run
from tests.services.test_service import Probe, idle


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class Pair:
    """A heart and the pulse that is felt of it, with one clock."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.pulse = Pulse(self.clock)
        self.heart = Heart(os.dup(self.pulse.child_pipe), self.clock)

    def wait(self, seconds: float) -> None:
        """Let time go by, in turns of the supervisor."""
        while seconds > 1e-9:
            self.clock.now_s += min(seconds, 0.1)
            seconds -= 0.1
            self.pulse.feel()


@pytest.fixture
def pair() -> Iterator[Pair]:
    made = Pair()
    yield made
    made.pulse.close()


def test_who_is_silent_for_longer_than_said_hangs(pair: Pair) -> None:
    pair.heart.beat()
    pair.wait(SILENT_S - 0.2)
    assert not pair.pulse.hangs()
    pair.wait(0.5)
    assert pair.pulse.hangs()
    assert not pair.pulse.hangs(patience=2.0)
    pair.heart.beat()
    pair.wait(0.1)
    assert not pair.pulse.hangs()


def test_who_says_that_it_takes_long_is_given_that_time_and_afterwards_no_longer(pair: Pair) -> None:
    pair.heart.beat(30.0)
    pair.wait(29.0)
    assert not pair.pulse.hangs()
    pair.heart.beat()
    pair.wait(SILENT_S + 0.3)
    assert pair.pulse.hangs()


def test_what_was_just_said_is_not_said_again_but_something_else_is(pair: Pair) -> None:
    for _ in range(1000):
        pair.heart.beat()
    pair.heart.beat(9.0)
    assert os.read(pair.pulse._pipe, READ_BYTES) == b"2.500\n9.000\n"
    pair.clock.now_s += BEAT_S
    pair.heart.beat(9.0)
    assert os.read(pair.pulse._pipe, READ_BYTES) == b"9.000\n"


def test_who_says_zero_keeps_silent(pair: Pair) -> None:
    pair.heart.beat()
    for _ in range(40):
        pair.heart.beat(0.0)
        pair.wait(0.1)
    assert pair.pulse.hangs()


def test_who_is_ready_says_so_once(pair: Pair) -> None:
    pair.heart.beat(30.0)
    pair.wait(0.1)
    assert not pair.pulse.ready
    pair.heart.ready()
    pair.wait(0.1)
    pair.heart.beat()
    pair.wait(SILENT_S + 0.3)
    assert pair.pulse.ready
    assert pair.pulse.hangs()


def test_who_never_beat_is_not_supervised(pair: Pair) -> None:
    pair.wait(1000.0)
    assert not pair.pulse.hangs()


def test_after_a_sleep_of_the_machine_nobody_hangs(pair: Pair) -> None:
    pair.heart.beat()
    pair.wait(0.1)
    pair.clock.now_s += 8 * 3600.0
    pair.pulse.feel()
    assert pair.pulse.silent_s <= TURN_S
    assert not pair.pulse.hangs()
    pair.wait(SILENT_S)
    assert pair.pulse.hangs(), "but who does not wake up does"


def test_a_supervisor_that_was_frozen_finds_the_beats_of_meanwhile_and_those_never_waited(pair: Pair) -> None:
    for _ in range(READ_BYTES):  # more than the pipe holds
        pair.clock.now_s += BEAT_S
        pair.heart.beat()
    pair.pulse.feel()
    assert pair.pulse.silent_s == 0.0


def test_a_supervisor_that_is_gone_hurts_nobody(pair: Pair) -> None:
    pair.pulse.close()
    pair.heart.beat()
    pair.heart.beat(7.0)


def test_without_a_supervisor_nothing_is_said() -> None:
    environment = {VARIABLE: "not a number"}
    Heart.inherited(environment).beat()
    Heart.inherited({}).beat()
    assert environment == {}, "children of its own are not to beat for it"


def test_the_loop_of_a_service_beats_as_long_as_its_steps_come_back() -> None:
    beats: list[float] = []

    class Told(Heart):
        def beat(self, next_s: float = SILENT_S) -> None:
            beats.append(next_s)

    probe = Probe(Fabric(), idle)
    run(probe, lambda: probe.steps >= 3, heart=Told())
    assert beats == [SILENT_S] * 3 + [CLOSE_S]

    class Slow(Probe):
        def next_s(self) -> float:
            return 60.0 if self.steps == 0 else 0.0

    beats.clear()
    slow = Slow(Fabric(), idle)
    run(slow, lambda: slow.steps >= 2, heart=Told())
    assert beats == [60.0, 0.0, CLOSE_S]
