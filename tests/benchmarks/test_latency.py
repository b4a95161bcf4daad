"""Does learning hold up acting? Perception-to-action times with the evolvers at work and stopped, in one run.

Run by name: `mdb test -m slow tests/benchmarks/test_latency.py -s`
"""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from mdb_protocol import keys, messages
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
        for model in ("communication", "object", "induced"):
            status = brain.status(bus, "evolver", model)
            assert status is not None
            os.kill(status.pid, signal.SIGSTOP)
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
