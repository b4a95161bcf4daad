"""One process of a brain: builds the service that `mdb run SERVICE` names and runs it until told to stop.

Imports what a service needs only when it is run: an optimizer has no compiler in memory, a teacher no physics.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import structlog

from mdb_protocol.bus import Bus
from mdb_protocol.errors import ConfigError
from mdb_protocol.zenoh_bus import Router, ZenohBus
from mdb_services.config import EXPERIMENT_FILE, MEMORY_FILE
from mdb_services.service import Service, Stopper, run
from mdb_sim.experiment import Experiment

log = structlog.get_logger()

ROUTER_CONFIG = Path(__file__).parents[1] / "router.json5"
ENDPOINT_FILE = "router.endpoint"
EVOLVER_NICE = 5
"""Learning gives way to acting when both want the same core."""
CONNECT_S = 10.0


def run_router(run_folder: Path | None, listen: str | None, stop: Stopper) -> None:
    """Route until told to stop; writes the endpoint, with the port it got, into the run folder."""
    router = Router(ROUTER_CONFIG, listen)
    endpoint = router.endpoint()
    if run_folder is not None:
        run_folder.mkdir(parents=True, exist_ok=True)
        partial = run_folder / f"{ENDPOINT_FILE}.part"
        partial.write_text(endpoint, encoding="utf-8")
        partial.replace(run_folder / ENDPOINT_FILE)
    log.info("routing", endpoint=endpoint)
    while not stop():
        time.sleep(0.05)
    router.close()


@dataclass(frozen=True)
class ServiceOptions:
    """What the command line says of a service: run folder, router, an evolver's model, a robot's window."""

    run: Path
    connect: str
    model: str | None = None
    gui: bool = False


def run_service(name: str, options: ServiceOptions, stop: Stopper) -> None:
    """Build and run one service of the experiment in the run folder."""
    run_folder = options.run
    experiment = Experiment.read(run_folder / EXPERIMENT_FILE)
    builders: dict[str, Callable[[Bus], Service]] = {
        "recorder": lambda bus: _recorder(bus, run_folder),
        "memory": lambda bus: _memory(bus, experiment, run_folder),
        "evolver": lambda bus: _evolver(bus, experiment, options.model),
        "optimizer": lambda bus: _optimizer(bus, experiment),
        "robot": lambda bus: experiment.robot_service(bus, gui=options.gui),
        "teacher": experiment.teacher_service,
    }
    if name not in builders:
        raise ConfigError(f"no service {name!r}; there are router, {', '.join(builders)}")
    bus = ZenohBus(
        experiment.brain.experiment.brain,
        options.connect,
        connect_timeout_s=CONNECT_S,
        lossless=experiment.brain.lockstep,
    )
    try:
        service = builders[name](bus)
    except BaseException:
        bus.close()
        raise
    run(service, stop)


def _recorder(bus: Bus, run_folder: Path) -> Service:
    from mdb_services.recorder import Recorder

    return Recorder(bus, run_folder)


def _memory(bus: Bus, experiment: Experiment, run_folder: Path) -> Service:
    from mdb_services.memory_file import MemoryFile
    from mdb_services.memory_store import MemoryStore

    return MemoryStore(bus, experiment.brain, MemoryFile(run_folder / MEMORY_FILE))


def _evolver(bus: Bus, experiment: Experiment, model: str | None) -> Service:
    from mdb_services.evolver import Evolver

    if model is None:
        names = ", ".join(m.name for m in experiment.brain.model)
        raise ConfigError(f"an evolver needs --model; this experiment has {names}")
    os.nice(EVOLVER_NICE)
    return Evolver(bus, experiment.brain, model)


def _optimizer(bus: Bus, experiment: Experiment) -> Service:
    from mdb_services.optimizer import Optimizer

    return Optimizer(bus, experiment.brain)
