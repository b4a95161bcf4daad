"""Every service dies at random, again and again: in lockstep the run is, pair by pair, the one without deaths."""

import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from mdb_deploy.experiments import experiment_path
from mdb_protocol import codec, keys, messages
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.acting.optimizer import Optimizer
from mdb_services.evolver import Evolver
from mdb_services.experiment.run_folder import MEMORY_FILE
from mdb_services.memory.file import MemoryFile
from mdb_services.memory.store import MemoryStore
from mdb_services.recorder import read_log
from mdb_services.shell.service import Service, announce
from mdb_sim.robot.service import RobotService
from mdb_sim.robot.state_file import StateFile
from mdb_sim.runs.experiment import ROBOT_FILE, Experiment
from tests.integration.brain import SHORT, Brain, mdb, until

ROUNDS = 20_000
"""Bound on rounds of steps; a run takes about a thousand."""
IMPATIENT = ("optimizer.resend_s=0.001", "optimizer.action_valid_s=60.0")
"""What is lost with a service comes again at once: the rounds of a test are shorter than those of processes."""


def robot_service(experiment: Experiment, bus: MemoryBus, run: Path) -> RobotService:
    """A robot that keeps where it is, as its process does, but acts within its step: each round is the same."""
    file = StateFile(run / ROBOT_FILE)
    return RobotService(bus, experiment.body(), experiment.robot.rules, experiment.brain.experiment.seed, file=file)


class Mortal:
    """The services of a brain in one process; each can die between two steps and is built anew."""

    def __init__(self, experiment: Experiment, run: Path) -> None:
        run.mkdir()
        brain, self._fabric = experiment.brain, Fabric()
        self._name = brain.experiment.brain
        self._builders: dict[str, Callable[[MemoryBus], Service]] = {
            "memory": lambda bus: MemoryStore(bus, brain, MemoryFile(run / MEMORY_FILE)),
            **{m.name: lambda bus, m=m: Evolver(bus, brain, m.name) for m in brain.model},  # type: ignore[misc]
            "robot": lambda bus: robot_service(experiment, bus, run),
            "teacher": experiment.teacher_service,
            "optimizer": lambda bus: Optimizer(bus, brain),
        }
        self.services: dict[str, Service] = {}
        for name in self._builders:
            self.start(name)
        self._watcher = MemoryBus(self._fabric, self._name)
        self._finished = self._watcher.subscriber(keys.FINISHED)
        self.reports = self._watcher.subscriber(keys.ITERATION)

    def start(self, name: str) -> None:
        self.services[name] = self._builders[name](MemoryBus(self._fabric, self._name))
        announce(self.services[name])

    def kill(self, name: str) -> None:
        """What the service had in memory is gone, and what it had not yet taken from its inboxes."""
        service = self.services[name]
        service.close()
        service.bus.close()
        self.start(name)

    def finish(self, between: Callable[[], None]) -> None:
        for _ in range(ROUNDS):
            for name in list(self.services):
                self.services[name].step()
            between()
            if self._finished.take() is not None:
                return
        pytest.fail("the run did not come to its end")


def stored_pairs(run: Path) -> list[dict[str, Any]]:
    with sqlite3.connect(run / MEMORY_FILE) as db:
        rows = db.execute("SELECT payload FROM pair ORDER BY iteration").fetchall()
    encoding = codec.encoding_of(messages.Pair)
    return [codec.to_plain(codec.decode(messages.Pair, payload, encoding)) for (payload,) in rows]


def lived(experiment: Experiment, run: Path, deaths: float = 0.0, seed: int = 0) -> tuple[dict[str, Any], int]:
    """Run to the end, each service dying with probability `deaths` in each round; return what came of it."""
    brain, rng, killed = Mortal(experiment, run), np.random.default_rng(seed), 0

    def between() -> None:
        nonlocal killed
        for name in brain.services:
            if rng.random() < deaths:
                brain.kill(name)
                killed += 1

    brain.finish(between)
    with sqlite3.connect(run / MEMORY_FILE) as db:
        changes = db.execute("SELECT * FROM change ORDER BY 1, 2, 3").fetchall()
        models = db.execute("SELECT name, payload FROM model ORDER BY name").fetchall()
    reports = {report.iteration: codec.to_plain(report) for report in iter(brain.reports.take, None)}
    for service in brain.services.values():
        service.close()
    return {
        "pairs": stored_pairs(run),
        "changes": changes,
        "models": models,
        "successes": brain.services["robot"].values()["successes"],
        "reports": reports,
    }, killed


LATE = ("teacher.phase.first teacher.wrong_notes=0.2", "teacher.phase.first teacher.wrong_feedback=0.1")


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_lockstep_run_with_deaths_is_the_one_without(tmp_path: Path, seed: int) -> None:
    settings = [*SHORT, *IMPATIENT, *LATE, f"experiment.seed={seed}", "experiment.pace=lockstep"]
    experiment = Experiment.read(experiment_path("paper"), settings)
    straight, none = lived(experiment, tmp_path / "straight")
    broken, killed = lived(experiment, tmp_path / "broken", deaths=0.03, seed=seed)
    assert (none, killed > 30) == (0, True)
    for what, expected in straight.items():
        assert broken[what] == expected, what
    assert [pair["iteration"] for pair in broken["pairs"]] == list(range(80))


def at_work_in(run: Path) -> list[int]:
    """Processes that have this run folder in their command line, whoever their parent is by now."""
    return [p.pid for p in psutil.process_iter(["cmdline"]) if str(run) in (p.info["cmdline"] or [])]


@pytest.mark.long
def test_a_run_whose_every_process_was_killed_goes_on_to_the_same_end(tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    folder.mkdir()
    with Brain(folder, pace="lockstep") as brain, brain.bus() as bus:
        reports, seen = bus.subscriber(keys.ITERATION), -1
        while seen < 35:
            bus.wait(1.0)
            while (report := reports.take()) is not None:
                seen = report.iteration
        for process in [psutil.Process(brain.process.pid), *brain.children()]:
            process.kill()
        brain.process.wait(10.0)
        until(lambda: not at_work_in(brain.run))
        run = brain.run
    resumed = mdb("up", "--resume", str(run), "--listen", "tcp/127.0.0.1:0", "--no-plot")
    assert resumed.returncode == 0, resumed.stdout + resumed.stderr
    settings = [*SHORT, "experiment.pace=lockstep"]
    straight, _ = lived(Experiment.read(experiment_path("paper"), settings), tmp_path / "straight")
    assert stored_pairs(run) == straight["pairs"]
    assert sorted(p.name for p in run.glob("run*.mcap")) == ["run-1.mcap", "run.mcap"]
    logged = {r.message.iteration: r.message for r in read_log(run) if r.row is keys.ITERATION}  # type: ignore[attr-defined]
    assert {i: codec.to_plain(report) for i, report in logged.items()}.items() <= straight["reports"].items()
    assert 80 - len(logged) <= 2, "of what was on its way to the recorder when it died one report may be missing"


@pytest.mark.long
def test_a_folder_in_which_a_brain_runs_is_not_taken(tmp_path: Path) -> None:
    with Brain(tmp_path, "experiment.iterations=100000") as brain, brain.bus():
        second = mdb("up", "--resume", str(brain.run), "--listen", "tcp/127.0.0.1:0")
    assert second.returncode == 2
    assert "another 'mdb up' works in" in second.stderr
