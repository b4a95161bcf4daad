"""A whole brain under test: `mdb up` in a process of its own, seen from outside like any client sees it.

Owns that process, its children's names, the witness beside it, and an experiment long enough. Kills nothing and
measures nothing: `chaos` and `soak` do.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import psutil

from mdb_deploy.supervision.compose import ROUTER, ProcessSpec, for_experiment, read
from mdb_deploy.supervision.processes import ENDPOINT_FILE
from mdb_protocol import keys
from mdb_protocol.errors import MdbError
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.experiment.reading import read_file
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_sim.runs.experiment import Experiment, placed

START_S = 100.0
STOP_S = 10.0
POLL_S = 0.005


def stop_on_sigterm() -> None:
    """End by SystemExit when told to, so that the brain under test and its witness end, too."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))


class BrainError(MdbError):
    """The brain under test did not do what it must, or ended; the text holds its last words."""


def long_experiment(file: Path, overrides: Iterable[str], iterations: int) -> Experiment:
    """Return an experiment of at least so many iterations: its phases come again and again, in order."""
    content = placed(read_file(file, overrides), file)
    experiment = Experiment(content, file)
    length = experiment.brain.experiment.iterations
    rounds = -(-iterations // length)
    if experiment.teacher is not None:
        content["teacher"]["phase"] = repeated(content["teacher"]["phase"], length, rounds)
    content["experiment"]["iterations"] = length * rounds
    return Experiment(content, file)


def repeated(phases: list[dict[str, Any]], length: int, rounds: int) -> list[dict[str, Any]]:
    """Return the phases of an experiment of `length` iterations, so many times one after the other."""
    once = [phase for phase in phases if phase["start"] < length]
    return [phase | {"start": phase["start"] + length * i} for i in range(rounds) for phase in once]


@dataclass(frozen=True)
class Member:
    """One process of a brain: the words that name it on the command line, and its liveliness token."""

    name: str
    words: tuple[str, ...]
    token: str

    @classmethod
    def of(cls, spec: ProcessSpec) -> Member:
        """Return the member that a row of the process table describes."""
        return cls(spec.name, spec.command[1 : spec.command.index("--run")], spec.token)

    def is_it(self, command: list[str]) -> bool:
        """Whether a process with this command line is it."""
        first = next((i for i, word in enumerate(command) if word in ("mdb", "mdb_deploy.cli")), len(command)) + 1
        return tuple(command[first : first + len(self.words)]) == self.words


def words_of(process: psutil.Process) -> list[str]:
    """Return the command line of a process, word by word: a fork of the template has it in one piece."""
    words = process.cmdline()
    return words if any(words[1:]) else "".join(words).split()


class BrainUnderTest:
    """See the module's docstring; leaves no process behind."""

    def __init__(self, experiment: Experiment, out: Path) -> None:
        """Start the brain and wait until it does iterations; BrainError when it does not."""
        out.mkdir(parents=True, exist_ok=True)
        self.out, self.brain = out, experiment.brain.experiment.brain
        specs = for_experiment(read(), experiment)
        self.members: Mapping[str, Member] = {spec.name: Member.of(spec) for spec in specs.values()}
        self.witness_file = out / "witness.jsonl"
        self.witness_file.unlink(missing_ok=True)
        experiment.write(out / EXPERIMENT_FILE)
        self._said = out / "up.out"
        self._witness: subprocess.Popen[bytes] | None = None
        self.bus: ZenohBus | None = None
        self.finished = False
        self.iteration = self.acted = -1
        """Newest iteration that was reported, and newest count of actions that the robot showed."""
        before = set(out.iterdir())
        words = ["up", str(out / EXPERIMENT_FILE), "--runs", str(out), "--listen", "tcp/127.0.0.1:0", "--no-plot"]
        with self._said.open("wb") as said:
            command = [sys.executable, "-P", "-m", "mdb_deploy.cli", *words]
            self.process = subprocess.Popen(command, stdout=said, stderr=subprocess.STDOUT, env=_environment())
        try:
            self.run = self._find(before)
            self._join()
        except BaseException:
            self.close()
            raise

    def _find(self, before: set[Path]) -> Path:
        """Return the run folder once the router says where it is."""
        deadline = time.monotonic() + START_S
        while True:
            for folder in set(self.out.iterdir()) - before:
                if (folder / ENDPOINT_FILE).exists():
                    return folder
            self.check_alive()
            if time.monotonic() > deadline:
                raise BrainError(f"no router within {START_S:g} s. {self.last_words()}")
            time.sleep(POLL_S)

    def _join(self) -> None:
        endpoint = (self.run / ENDPOINT_FILE).read_text(encoding="utf-8")
        options = [
            "--connect",
            endpoint,
            "--brain",
            self.brain,
            "--out",
            str(self.witness_file),
            f"--with-parent={os.getpid()}",
        ]
        self._witness = subprocess.Popen([sys.executable, "-P", "-m", "mdb_deploy.trials.witness", *options])
        self.bus = ZenohBus(self.brain, endpoint)
        self.bus.alive()
        self._reports = self.bus.subscriber(keys.ITERATION)
        self._scenes = self.bus.subscriber(keys.SCENE)
        self._finished = self.bus.subscriber(keys.FINISHED)
        self.wait_for_iterations(1, START_S)

    def look(self) -> frozenset[str]:
        """Take what has come; return who is alive: nobody while the router is not there."""
        assert self.bus is not None
        while (report := self._reports.take()) is not None:
            self.iteration = max(self.iteration, report.iteration)
        if (scene := self._scenes.take()) is not None:
            self.acted = scene.iteration
        self.finished = self.finished or self._finished.take() is not None or self.process.poll() == 0
        return self.bus.alive() | {ROUTER} if self.bus.connected() else frozenset()

    def wait_for_iterations(self, more: int, bound_s: float) -> None:
        """Wait until so many more iterations are done; BrainError when they are not within the bound."""
        wanted, deadline = self.iteration + more, time.monotonic() + bound_s
        while self.iteration < wanted and not self.finished:
            self.look()
            self.check_alive()
            if time.monotonic() > deadline:
                raise BrainError(f"no {more} iterations within {bound_s:g} s. {self.last_words()}")
            time.sleep(POLL_S)

    def processes(self) -> dict[str, psutil.Process]:
        """Return the living processes by their names in the process table."""
        found: dict[str, psutil.Process] = {}
        try:
            children = psutil.Process(self.process.pid).children()
        except psutil.NoSuchProcess:
            return found
        for child in children:
            try:
                command = words_of(child)
            except psutil.Error:
                continue
            found |= {name: child for name, member in self.members.items() if member.is_it(command)}
        return found

    def check_alive(self) -> None:
        """Raise BrainError when `mdb up` has failed, or the witness has."""
        if self.process.poll() not in (None, 0):
            raise BrainError(f"the brain ended with status {self.process.returncode}. {self.last_words()}")
        if self._witness is not None and self._witness.poll() is not None:
            raise BrainError(f"the witness ended with status {self._witness.returncode}")

    def last_words(self) -> str:
        """Return the end of what `mdb up` said."""
        lines = self._said.read_text(errors="replace").splitlines()[-20:]
        return "\n".join([f"What mdb up said ({self._said}):", *lines])

    def finish(self, *, interrupt: bool, bound_s: float = STOP_S) -> int:
        """Let the experiment come to its end, or interrupt it as Ctrl-C does; then the witness; return the status."""
        if interrupt and self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            status = self.process.wait(bound_s)
        except subprocess.TimeoutExpired as error:
            raise BrainError(f"the brain did not end within {bound_s:g} s. {self.last_words()}") from error
        if self._witness is not None:
            self._witness.terminate()
            self._witness.wait(STOP_S)
        return status

    def close(self) -> None:
        """End every process that is still there."""
        if self.bus is not None:
            self.bus.close()
        children: list[psutil.Process] = []
        if self.process.poll() is None:
            children = psutil.Process(self.process.pid).children(recursive=True)
            self.process.kill()
            self.process.wait()
        if self._witness is not None and self._witness.poll() is None:
            self._witness.kill()
            self._witness.wait()
        for child in children:
            if child.is_running():
                child.kill()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONUNBUFFERED": "1"}
