"""Does learning hold up acting? Perception-to-action times with the evolvers at work and stopped, in one run.

And how much slower is it than bare Zenoh? In one run, over one router, a ping-pong beside the brain.

Run by name: `mdb test -m slow tests/benchmarks/test_latency.py -s`
"""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus, Inbox
from mdb_protocol.zenoh_bus import ZenohBus
from tests.benchmarks.pingpong import Bare
from tests.integration.brain import Brain, until

ITERATIONS = 400
SETTINGS = (
    "experiment.iterations=100000",
    "evolution.population=200",
    "evolution.generations=6",
    "teacher.phase.alone.start=90000",
    "teacher.phase.second teacher.start=90001",
    "teacher.phase.alone again.start=90002",
)


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("action_s", [0.0, 0.05])
def test_acting_does_not_wait_for_learning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], action_s: float
) -> None:
    with Brain(tmp_path, *SETTINGS, f"robot.action_s={action_s}") as brain, brain.bus() as bus:
        timings = bus.subscriber(keys.TIMING)

        def collect() -> np.ndarray:
            times: list[float] = []

            def enough() -> bool:
                bus.wait(0.05)
                while (timing := timings.take()) is not None:
                    assert isinstance(timing, messages.Timing)
                    times.append(timing.perception_to_action_s)
                return len(times) >= ITERATIONS

            until(enough, 120.0)
            return np.array(times[20:]) * 1e3

        working = collect()
        stop_evolvers(brain, bus)
        while timings.take() is not None:
            pass
        stopped = collect()
    with capsys.disabled():
        lines = [
            f"\nperception to action, ms, an action every {action_s:g} s",
            "| evolvers | p50 | p95 | p99 | max |",
        ]
        lines.append("|---|--:|--:|--:|--:|")
        for name, times in (("at work", working), ("stopped", stopped)):
            p50, p95, p99 = np.percentile(times, [50, 95, 99])
            lines.append(f"| {name} | {p50:.1f} | {p95:.1f} | {p99:.1f} | {times.max():.1f} |")
        lines.append(f"ratio of medians: {np.median(working) / np.median(stopped):.2f}")
        os.write(1, ("\n".join(lines) + "\n").encode())
    assert len(working) >= ITERATIONS - 20, "it acted all the while"


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_from_perception_to_action_beside_a_bare_ping_pong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = ["", "| evolvers | ms | p50 | p95 | p99 |", "|---|---|--:|--:|--:|"]
    with Brain(tmp_path, *SETTINGS, "robot.action_s=0.01") as brain, brain.bus() as bus:
        timings = bus.subscriber(keys.TIMING)
        until(lambda: bus.wait(0.05) and timings.take() is not None, 60.0)
        router = (brain.run / "router.endpoint").read_text().strip()
        for evolvers in ("at work", "stopped"):
            if evolvers == "stopped":
                stop_evolvers(brain, bus)
            acting = beside(router, lines, evolvers, bus, timings)
            assert len(acting) >= ITERATIONS, "it acted all the while"
    with capsys.disabled():
        os.write(1, ("\n".join(lines) + "\n").encode())


def beside(router: str, lines: list[str], evolvers: str, bus: Bus, timings: Inbox) -> list[float]:
    """Collect times of the brain while a ping-pong goes on; add what they were, and their ratio, to `lines`."""
    acting: list[float] = []

    def enough() -> bool:
        bus.wait(0.05)
        acting.extend(timing.perception_to_action_s for timing in timings.some())
        return len(acting) >= 4 * ITERATIONS

    with Bare(router, every_s=0.01) as bare:
        while timings.take() is not None:
            pass
        until(enough, 120.0)
        times = bare.times()[20:]
    brains, bares = (np.percentile(np.array(x) * 1e3, [50, 95, 99]) for x in (acting[20:], times))
    for name, found in (("perception to action", brains), ("bare ping-pong", bares), ("ratio", brains / bares)):
        lines.append(f"| {evolvers} | {name} | {' | '.join(f'{value:.2f}' for value in found)} |")
    return acting


def stop_evolvers(brain: Brain, bus: ZenohBus) -> None:
    for model in ("communication", "object", "induced"):
        status = brain.status(bus, "evolver", model)
        assert status is not None
        os.kill(status.pid, signal.SIGSTOP)
