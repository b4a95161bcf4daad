"""The whole brain in one process over the in-memory bus: for sweeps, tests and machines without a router.

The same services with the same steps; in lockstep the run log is, value by value, that of the processes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mdb_protocol import keys
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_protocol.messages import IterationReport, Scene
from mdb_services.acting.optimizer import Optimizer
from mdb_services.evolver import Evolver
from mdb_services.experiment.run_folder import EXPERIMENT_FILE, MEMORY_FILE
from mdb_services.hearing.ear import Ear
from mdb_services.memory.file import MemoryFile
from mdb_services.memory.store import MemoryStore
from mdb_services.recorder import Recorder
from mdb_services.shell.service import Service, run_inline
from mdb_sim.runs.experiment import Experiment


def run_experiment(
    experiment: Experiment,
    run: Path,
    *,
    on_iteration: Callable[[IterationReport], None] | None = None,
    on_scene: Callable[[Scene], None] | None = None,
    stop: Callable[[], bool] = lambda: False,
    gui: bool = False,
) -> None:
    """Run an experiment to its end, or until `stop`, into a new run folder."""
    run.mkdir(parents=True, exist_ok=True)
    experiment.write(run / EXPERIMENT_FILE)
    brain = experiment.brain
    fabric = Fabric()

    def bus() -> MemoryBus:
        return MemoryBus(fabric, brain.experiment.brain)

    services: list[Service] = [Recorder(bus(), run, keep_bytes=brain.log.keep_bytes)]
    services += [MemoryStore(bus(), brain, MemoryFile(run / MEMORY_FILE))]
    services += [Evolver(bus(), brain, model.name) for model in brain.model]
    services.append(experiment.robot_service(bus(), gui=gui))
    if experiment.teacher is not None:
        services.append(experiment.teacher_service(bus()))
    if brain.ear is not None:
        services.append(Ear(bus(), brain))
    services.append(Optimizer(bus(), brain, expected=experiment.scripted_teachers))
    watcher = bus()
    finished = watcher.subscriber(keys.FINISHED)
    heard = [
        (watcher.subscriber(key), tell)
        for key, tell in ((keys.SCENE, on_scene), (keys.ITERATION, on_iteration))
        if tell
    ]

    def over() -> bool:
        for inbox, tell in heard:
            while (message := inbox.take()) is not None:
                tell(message)
        return finished.take() is not None or stop()

    run_inline(services, over)
    watcher.close()
