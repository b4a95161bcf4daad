"""A real brain for tests: `mdb up` as a user starts it, on an ephemeral port, in a folder of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import psutil

from mdb_deploy.trials.under_test import words_of
from mdb_protocol.messages import Status
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.shell.heartbeat import CLOSE_S

BOUND_S = 60.0
ENDED_S = 2 * CLOSE_S
"""A process whose router goes while it closes may take all of `CLOSE_S`; without a runner nobody ends it sooner."""
BRAIN = "pioneer"

SHORT = (
    "robot.body=kinematic",
    "robot.action_s=0.01",
    "experiment.iterations=80",
    "optimizer.random_iterations=20",
    "teacher.phase.alone.start=30",
    "teacher.phase.second teacher.start=50",
    "teacher.phase.alone again.start=70",
    "evolution.population=60",
    "evolution.generations=2",
)
"""The paper's experiment, shortened: every phase, small populations, the twin of the robot."""

PAPER = ("paper", SHORT)

Condition = Callable[[], object]


def until(condition: Condition, bound_s: float = BOUND_S) -> object:
    """Return what the condition gives once it is true; polls, because it looks at other processes."""
    pause = 0.02
    deadline = time.monotonic() + bound_s
    while not (value := condition()):
        assert time.monotonic() < deadline, "the condition did not come true within the bound"
        select_nothing(pause)
    return value


def select_nothing(seconds: float) -> None:
    """Give the processor to the processes under test for a moment."""
    import select

    select.select([], [], [], seconds)


def mdb(*words: str, timeout_s: float = BOUND_S) -> subprocess.CompletedProcess[str]:
    """Run `mdb` to its end."""
    command = [sys.executable, "-m", "mdb_deploy.cli", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False)


class Brain:
    """`mdb up` in the background; leaves no process behind."""

    def __init__(
        self,
        folder: Path,
        *settings: str,
        pace: str = "concurrent",
        experiment: tuple[str, tuple[str, ...]] = PAPER,
        options: tuple[str, ...] = (),
        listen: str = "tcp/127.0.0.1:0",
        inside: Sequence[str] = (),
    ) -> None:
        """`inside`: words before the command, which lead into another place than this."""
        self._folder = folder
        self._out = folder / "up.out"
        file, short = experiment
        words = ["up", file, "--runs", str(folder), "--listen", listen, "--no-plot", "--pace", pace]
        words += options
        for setting in (*short, *settings):
            words += ["--set", setting]
        with self._out.open("wb") as out:
            self.process = subprocess.Popen(
                [*inside, sys.executable, "-m", "mdb_deploy.cli", *words], stdout=out, stderr=subprocess.STDOUT
            )

    @property
    def run(self) -> Path:
        """The run folder, once it is there."""
        found = until(lambda: [path for path in self._folder.iterdir() if path.is_dir()])
        assert isinstance(found, list)
        return Path(found[0])

    def output(self) -> str:
        """What `mdb up` has said so far."""
        return self._out.read_text(errors="replace")

    def bus(self) -> ZenohBus:
        """Join the brain as one more client."""
        endpoint = self.run / "router.endpoint"

        def text() -> str:
            assert self.process.poll() is None, self.output()
            return endpoint.read_text() if endpoint.exists() else ""

        return ZenohBus(BRAIN, str(until(text)))

    def status(self, bus: ZenohBus, role: str, instance: str) -> Status | None:
        """Ask one service how it does."""
        from mdb_protocol import keys

        answers: list[Status] = bus.query(keys.STATUS, 2.0, role=role, instance=instance)
        return answers[0] if answers else None

    def children(self) -> list[psutil.Process]:
        """All processes of the brain, and the template that they are forks of."""
        return psutil.Process(self.process.pid).children()

    def child(self, word: str) -> psutil.Process | None:
        """The living process with this word in its command line; a dead one not buried yet does not count."""
        for process in self.children():
            try:
                if word in words_of(process):
                    return process
            except psutil.Error:
                continue
        return None

    def wait(self, bound_s: float = BOUND_S) -> int:
        """Wait for the end of the experiment; return the exit status."""
        return self.process.wait(bound_s)

    def interrupt(self) -> None:
        """Press Ctrl-C."""
        os.kill(self.process.pid, signal.SIGINT)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        if self.process.poll() is None:
            children = self.children()
            self.process.terminate()
            try:
                self.process.wait(5.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
            for child in children:
                if child.is_running():
                    child.kill()
        sys.stdout.write(self.output())  # pytest shows it of a test that fails
