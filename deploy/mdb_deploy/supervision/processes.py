"""One process of a brain: builds the service that `mdb run SERVICE` names and runs it until told to stop.

Imports what a service needs only when it is run: started as a program, an optimizer has no compiler in memory, a
teacher no physics.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import structlog

from mdb_deploy.keys.access import ACCESS_FILE
from mdb_deploy.shipped import shipped
from mdb_deploy.supervision.unattended import FINISHED_FILE, or_finished
from mdb_protocol import endpoints
from mdb_protocol.bus import Bus
from mdb_protocol.errors import BusError, ConfigError, DamageError
from mdb_protocol.holding import hold
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_protocol.zenoh_sessions import Router, RouterKeys
from mdb_services.experiment.run_folder import EXPERIMENT_FILE, MEMORY_FILE
from mdb_services.shell.heartbeat import BEAT_S, CLOSE_S, COMPILE_S, START_S, Heart
from mdb_services.shell.service import Service, Stopper, run
from mdb_services.shell.whole_file import write_whole
from mdb_sim.runs.experiment import Experiment

log = structlog.get_logger()

ROUTER_CONFIG = shipped("router.json5")
ENDPOINT_FILE = "router.endpoint"
EVOLVER_NICE = 5
"""Learning gives way to acting when both want the same core."""
GATHER_S = 0.003
"""The recorder lets as much time pass before it writes: those who act have the processor first, and a log's messages
come in bursts. Their times are those at which they came."""
EVOLVER = "evolver"
INSTANCES = {
    "recorder": "log", "memory": "store", "optimizer": "action", "robot": "body", "teacher": "script", "ear": "notes",
}  # fmt: skip
"""The only instance of each role, as its class says; an evolver's is its model. Known before a class is imported."""
WEB = "web"
SERVICES = ("router", EVOLVER, *INSTANCES, WEB)
CONNECT_S = 10.0
PORT_FREE_S = 5.0
LEAVE_S, FAREWELL_S = 15.0, 1.0
"""So long the router of a finished run waits for the others to leave, and after the last token for its session."""


@dataclass(frozen=True)
class RouterOptions:
    """What the command line says of the router: run folder, endpoint, key folder, whether it is open to everyone."""

    run: Path | None
    listen: str | None
    keys: Path | None = None
    open_to_everyone: bool = False
    until_finished: bool = False
    """End when the run in the run folder is finished, and those who took part have left."""


def run_router(options: RouterOptions, stop: Stopper, heart: Heart) -> None:
    """Route until told to stop; writes where this machine's clients connect into the run folder.

    The heart beats as long as the router itself answers, for its work is done in threads of Zenoh's.

    When the access control has changed it begins anew on the same port: Zenoh reads it only at the start. Clients
    come back by themselves, within half a second; who is no longer admitted stays out.
    """
    listen, changed = options.listen, _changes(options.keys)
    bound_s = 0.0
    while not stop():
        heart.beat(START_S)
        router = open_router(options, listen, bound_s)
        endpoint = router.endpoint()
        listen, bound_s = endpoints.with_port_of(router.listen, endpoint), PORT_FREE_S
        heart.ready()
        _say_where(options.run, endpoint)
        log.info("routing", endpoint=endpoint, listen=listen)
        asked_s, over = 0.0, _over(options, endpoint)  # anew each time: the session before went with its router
        while not stop() and not changed():
            if over():
                log.info("the run is finished")
                heart.beat(CLOSE_S)
                router.close()
                return
            if (now_s := time.monotonic()) - asked_s >= BEAT_S and router.answers():
                asked_s = now_s
                heart.beat()
                router.give_memory_back()
            time.sleep(0.05)
        heart.beat(CLOSE_S)
        router.close()


def _over(options: RouterOptions, endpoint: str) -> Callable[[], bool]:
    """Return a function that says whether the run is finished and nobody takes part any more."""
    if not options.until_finished or options.run is None:
        return lambda: False
    brain = Experiment.read(options.run / EXPERIMENT_FILE).brain.experiment.brain
    bus = ZenohBus(brain, endpoint, credentials=options.keys, connect_timeout_s=CONNECT_S)
    finished, until_s = or_finished(lambda: False, bus, options.run), math.inf

    def over() -> bool:
        nonlocal until_s
        if finished():
            until_s = min(until_s, time.monotonic() + (LEAVE_S if bus.alive() else FAREWELL_S))
        return time.monotonic() > until_s

    return over


def open_router(options: RouterOptions, listen: str | None = None, bound_s: float = 0.0) -> Router:
    """Start a router at `listen`, or where the options say.

    Tries again within the bound: its predecessor's port is free a moment after it has closed.
    """
    listen, deadline = listen or options.listen, time.monotonic() + bound_s
    while True:
        try:
            return Router(
                ROUTER_CONFIG, listen, keys=_keys(options, listen), open_to_everyone=options.open_to_everyone
            )
        except BusError:
            if time.monotonic() >= deadline:
                raise
            time.sleep(0.05)


def _keys(options: RouterOptions, listen: str | None) -> RouterKeys | None:
    if options.keys is None:
        return None
    if listen is None:
        raise ConfigError("a router with --keys needs --listen tls/HOST:PORT, as in tls/0.0.0.0:7447")
    from mdb_deploy.keys.credentials import KeyFolder

    return KeyFolder(options.keys).router_keys(listen)


def _changes(folder: Path | None) -> Callable[[], bool]:
    """Return a function that says whether a key folder's access control has changed since the last call."""
    if folder is None:
        return lambda: False
    path = folder / ACCESS_FILE
    seen = path.stat().st_mtime_ns if path.exists() else 0

    def changed() -> bool:
        nonlocal seen
        before, seen = seen, path.stat().st_mtime_ns if path.exists() else seen
        return seen != before

    return changed


def _say_where(run_folder: Path | None, endpoint: str) -> None:
    if run_folder is not None:
        run_folder.mkdir(parents=True, exist_ok=True)
        write_whole(run_folder / ENDPOINT_FILE, endpoint.encode())


@dataclass(frozen=True)
class ServiceOptions:
    """What the command line says of a service: run folder, router, an evolver's model, a robot's window, keys."""

    run: Path
    connect: str
    model: str | None = None
    gui: bool = False
    keys: Path | None = None
    until_finished: bool = False
    """End when the run is finished."""


def run_service(name: str, options: ServiceOptions, stop: Stopper, heart: Heart) -> None:
    """Build and run one service of the experiment in the run folder."""
    heart.beat(COMPILE_S if name == EVOLVER else START_S)
    run_folder = options.run
    if options.until_finished and (run_folder / FINISHED_FILE).exists():
        return  # it died as the run ended
    experiment = Experiment.read(run_folder / EXPERIMENT_FILE)
    builders: dict[str, Callable[[Bus], Service]] = {
        "recorder": lambda bus: _recorder(bus, experiment, run_folder),
        "memory": lambda bus: _memory(bus, experiment, run_folder),
        EVOLVER: lambda bus: _evolver(bus, experiment, options.model),
        "optimizer": lambda bus: _optimizer(bus, experiment),
        "robot": lambda bus: experiment.robot_service(bus, run_folder, gui=options.gui),
        "teacher": experiment.teacher_service,
        "ear": lambda bus: _ear(bus, experiment),
    }
    if name == "robot" and not options.gui:
        experiment.get_ready()
    instance = options.model or "" if name == EVOLVER else INSTANCES[name]
    try:
        bus = ZenohBus(
            experiment.brain.experiment.brain,
            options.connect,
            credentials=options.keys,
            connect_timeout_s=CONNECT_S,
            give_up=stop,
            lossless=experiment.brain.lockstep,
        )
    except BusError:
        if stop():
            return
        raise
    try:
        if instance and not hold(bus, name, instance, stop):  # before it is built: a robot shows itself then
            bus.close()
            return
        service = builders[name](bus)
    except BaseException:
        bus.close()
        raise
    run(service, or_finished(stop, bus, run_folder) if options.until_finished else stop, run_folder, heart)


def _recorder(bus: Bus, experiment: Experiment, run_folder: Path) -> Service:
    from mdb_services.recorder import Recorder

    return Recorder(bus, run_folder, keep_bytes=experiment.brain.log.keep_bytes, gather_s=GATHER_S)


def _memory(bus: Bus, experiment: Experiment, run_folder: Path) -> Service:
    from mdb_services.memory.file import MemoryFile
    from mdb_services.memory.rescue import survey
    from mdb_services.memory.store import MemoryStore

    brain, path = experiment.brain, run_folder / MEMORY_FILE
    try:
        return MemoryStore(bus, brain, MemoryFile(path, power_safe=brain.store.durability == "power"))
    except DamageError as error:
        raise DamageError(f"{error}. What can be read: {survey(path, brain).words()}") from error


def _evolver(bus: Bus, experiment: Experiment, model: str | None) -> Service:
    from mdb_services.evolver import Evolver
    from mdb_services.mechanism.evolution import threads

    if model is None:
        names = ", ".join(m.name for m in experiment.brain.model)
        raise ConfigError(f"an evolver needs --model; this experiment has {names}")
    evolver = Evolver(bus, experiment.brain, model)
    threads.lend()
    os.nice(EVOLVER_NICE)  # from now on: one that comes back after its death is soon there
    return evolver


def _ear(bus: Bus, experiment: Experiment) -> Service:
    from mdb_services.hearing.ear import Ear

    return Ear(bus, experiment.brain)


def _optimizer(bus: Bus, experiment: Experiment) -> Service:
    from mdb_services.acting.optimizer import Optimizer

    return Optimizer(bus, experiment.brain, expected=experiment.scripted_teachers)
