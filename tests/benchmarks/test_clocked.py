"""A robot at 50 Hz while its brain learns: periods missed, jitter, and how often the brain was in time.

Run by name: `mdb test -m slow tests/benchmarks/test_clocked.py -s`
"""

from pathlib import Path

import pytest

from mdb_protocol import keys
from mdb_protocol.zenoh_bus import ZenohBus
from tests.integration.brain import Brain, until

PERIOD_S = 0.02
PERIODS = 1500
SETTINGS = (
    f"robot.period_s={PERIOD_S}",
    "experiment.brain=pioneer",
    "experiment.iterations=100000",
    "teacher.phase.alone.start=90000",
    "teacher.phase.second teacher.start=90001",
    "teacher.phase.alone again.start=90002",
)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_robot_at_fifty_hertz(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("gymnasium")
    with Brain(tmp_path, *SETTINGS, experiment=("cartpole", ())) as brain, brain.bus() as bus:
        until(lambda: values(brain, bus)["iteration"] > 20, 60.0)
        begun = values(brain, bus)
        until(lambda: values(brain, bus)["periods"] >= begun["periods"] + PERIODS, 120.0)
        ended = values(brain, bus)
    periods = ended["periods"] - begun["periods"]
    missed = (ended["missed_share"] * ended["periods"] - begun["missed_share"] * begun["periods"]) / periods
    in_time = (ended["iteration"] - begun["iteration"]) / periods
    with capsys.disabled():
        print(  # noqa: T201
            f"\n{periods:.0f} periods of {PERIOD_S:g} s: {missed:.2%} missed; they begin "
            f"{1e3 * ended['jitter_p50_s']:.2f} ms late (median), {1e3 * ended['jitter_p99_s']:.2f} ms (99th "
            f"percentile); in {in_time:.1%} the brain's action was there"
        )
    assert in_time > 0.5


def values(brain: Brain, bus: ZenohBus) -> dict[str, float]:
    """What the robot says of itself."""
    del brain
    answers = bus.query(keys.STATUS, 2.0, role="robot", instance="body")
    return answers[0].values if answers else {"iteration": 0.0, "periods": 0.0, "missed_share": 0.0}
