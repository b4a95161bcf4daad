"""A robot whose commander is gone comes to rest, also in the middle of an action, and never leaves without."""

import os
import shutil
import signal
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mdb_deploy.experiments import experiment_path
from mdb_deploy.supervision.runner import QUICK_S
from mdb_protocol import messages
from tests.integration.brain import Brain, until
from tests.integration.ears import frozen

TAKES_S = 4.0
HOLD_S = 1.0
BUSY_S = 1.0
"""What other work on this machine may cost."""


class Diary:
    """What the body has written down: (monotonic seconds, what)."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def lines(self) -> list[tuple[float, str]]:
        if not self.path.exists():
            return []
        whole = self.path.read_text(encoding="ascii").splitlines()
        return [(float(at_s), what) for at_s, what in (line.split() for line in whole)]

    def first(self, what: str, since_s: float) -> float:
        """Wait until something has happened since then; return when."""
        found = until(lambda: [at_s for at_s, done in self.lines() if done == what and at_s > since_s])
        assert isinstance(found, list)
        return float(found[0])


@contextmanager
def slow_brain(folder: Path, takes_s: float) -> Iterator[tuple[Brain, Diary]]:
    shutil.copy(Path(__file__).with_name("slow_pioneer.py"), folder / "slow_pioneer.py")
    file, diary = folder / "slow.toml", folder / "diary"
    shutil.copy(experiment_path("paper"), file)
    runs = folder / "runs"
    runs.mkdir()
    settings = (
        "robot.body=slow_pioneer:SlowPioneer",
        f'robot.options={{takes_s = {takes_s}, diary = "{diary}"}}',
        f"robot.hold_s={HOLD_S}",
        "experiment.iterations=100000",
        "teacher.phase.alone.start=90000",
        "teacher.phase.second teacher.start=90001",
        "teacher.phase.alone again.start=90002",
    )
    with Brain(runs, *settings, experiment=(str(file), ())) as brain:
        yield brain, Diary(diary)


@pytest.mark.long
def test_a_robot_that_is_told_to_stop_interrupts_its_action_and_halts(tmp_path: Path) -> None:
    with slow_brain(tmp_path, TAKES_S) as (brain, diary), brain.bus() as bus:
        acts_s = diary.first("acts", 0.0)
        status = until(lambda: brain.status(bus, "robot", "body"))
        assert time.monotonic() < acts_s + TAKES_S, "it answers while it acts"
        acts_s = diary.first("acts", acts_s)
        told_s = time.monotonic()
        os.kill(status.pid, signal.SIGTERM)  # type: ignore[attr-defined]
        assert diary.first("halts", acts_s) - told_s < BUSY_S, "long before the action was over"
        assert diary.first("rests", told_s) < acts_s + TAKES_S


@pytest.mark.long
@pytest.mark.slow
def test_without_a_commander_an_action_is_interrupted(tmp_path: Path) -> None:
    with slow_brain(tmp_path, TAKES_S) as (brain, diary):
        took_s = [killed(brain, diary) for _ in range(3)]
    assert max(took_s) < HOLD_S + BUSY_S


def long_alive(status: messages.Status | None) -> messages.Status | None:
    """Return the status of a process whose death would not count as a quick one, of which five end the run."""
    return status if status is not None and status.uptime_s > QUICK_S else None


def killed(brain: Brain, diary: Diary) -> float:
    """Kill the optimizer in the middle of an action, with nobody to start another; return how soon it halts."""
    with brain.bus() as bus:
        status = until(lambda: long_alive(brain.status(bus, "optimizer", "action")))
    acts_s = diary.first("acts", time.monotonic())
    with frozen(brain.process.pid):
        os.kill(status.pid, signal.SIGKILL)  # type: ignore[attr-defined]
        killed_s = time.monotonic()
        halts_s = diary.first("halts", acts_s)
    return halts_s - killed_s


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_fifty_times_without_a_commander(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with slow_brain(tmp_path, TAKES_S) as (brain, diary):
        took_s = sorted(killed(brain, diary) for _ in range(50))
    median_s, worst_s = statistics.median(took_s), took_s[-1]
    with capsys.disabled():
        print(  # noqa: T201
            f"\nkilled in the middle of an action of {TAKES_S:g} s, 50 times: halted after {median_s:.2f} s "
            f"(median), {worst_s:.2f} s (worst); hold_s is {HOLD_S:g}"
        )
    assert took_s[-1] < HOLD_S + BUSY_S
