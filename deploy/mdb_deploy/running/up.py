"""`mdb up`: an experiment from its file to its figures, in processes over Zenoh or inline.

Owns the run folder and what the user sees meanwhile; the processes belong to the runner.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from mdb_deploy.running.compose import OPTIMIZER, ROBOT, ROUTER, TEACHER, for_experiment, read
from mdb_deploy.running.processes import ENDPOINT_FILE
from mdb_deploy.running.progress import Progress
from mdb_deploy.running.runner import Runner, StartError
from mdb_protocol import endpoints, keys
from mdb_protocol.bundle import Bundle
from mdb_protocol.errors import BusError, MdbError
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.experiment.brain import EXPERIMENT_FILE
from mdb_sim.runs.experiment import Experiment

LOCK_FILE = "lock"
POLL_S = 0.05
STALLED_S = 60.0
"""Without a new iteration for so long, and what the brain waits for a teacher besides, the run is given up."""
ENDED_BY_USER = 130


@dataclass(frozen=True)
class UpOptions:
    """What the command line says of a run."""

    run: Path
    listen: str
    gui: bool = False
    keys: Path | None = None
    open_to_everyone: bool = False
    await_teacher: bool = False
    """Let the experiment begin when somebody has come to teach."""


def check_listen(listen: str, keys: Path | None, brain: str, *, open_to_everyone: bool) -> None:
    """Raise, before anything is started, what router and services would: who may listen where, with which keys."""
    endpoints.check_listen(listen, has_keys=keys is not None, open_to_everyone=open_to_everyone)
    if keys is not None:
        from mdb_deploy.keys.credentials import KeyFolder

        KeyFolder(keys).router_keys(listen)
        Bundle.find(keys, brain)


def new_run_folder(base: Path, name: str, seed: int) -> Path:
    """Create and return a folder of its own for a run."""
    stamp = time.strftime("%Y%m%d-%H%M%S")
    for number in range(1000):
        folder = base / f"{name}-{stamp}-seed{seed}{f'-{number}' if number else ''}"
        with contextlib.suppress(FileExistsError):
            folder.mkdir(parents=True)
            return folder
    raise MdbError(f"cannot make a new run folder in {base}: a thousand of this second exist")


def up_inline(experiment: Experiment, options: UpOptions, progress: Progress) -> int:
    """Run everything in this process (lockstep); return the exit status."""
    from mdb_sim.runs.inline import run_experiment

    told: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: told.append(1))
    signal.signal(signal.SIGINT, lambda *_: told.append(1))
    with progress:
        run_experiment(
            experiment,
            options.run,
            on_iteration=progress.report,
            on_scene=progress.scene,
            stop=lambda: bool(told),
            gui=options.gui,
        )
    return ENDED_BY_USER if told else 0


def up_processes(experiment: Experiment, options: UpOptions, progress: Progress) -> int:
    """Run the processes of the compose file; return the exit status."""
    with _alone_in(options.run):
        experiment.write(options.run / EXPERIMENT_FILE)
        return asyncio.run(_up(experiment, options, progress))


@contextlib.contextmanager
def _alone_in(run: Path) -> Iterator[None]:
    """Hold the run folder; MdbError when another `mdb up` does. The lock ends with its process, however it ends."""
    with (run / LOCK_FILE).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise MdbError(f"another 'mdb up' works in {run}; stop it first, or give another folder") from None
        yield


async def _up(experiment: Experiment, options: UpOptions, progress: Progress) -> int:
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    watch = _Watch(experiment, options)
    variables = {
        "MDB_RUN_INSIDE": str(options.run),
        "MDB_LISTEN": options.listen,
        "MDB_CONNECT": "",
        "MDB_KEYS": str(options.keys or ""),
        "MDB_OPEN": "--open-to-everyone" if options.open_to_everyone else "",
    }
    specs = for_experiment(read(), experiment)
    if options.gui:
        specs[ROBOT] = replace(specs[ROBOT], command=(*specs[ROBOT].command, "--gui"))
    if options.await_teacher:
        specs[OPTIMIZER] = replace(specs[OPTIMIZER], awaits=TEACHER)
    runner = Runner(specs, variables, options.run / "logs", watch.alive)
    watch.on_endpoint = lambda found: runner.connect(found, endpoints.with_port_of(options.listen, found))
    status = 0
    try:
        with progress:
            starting = asyncio.create_task(runner.start(progress.ready))
            stopped = asyncio.create_task(stop.wait())
            await asyncio.wait({starting, stopped}, return_when=asyncio.FIRST_COMPLETED)
            if starting.done():
                starting.result()
                status = await _follow(watch, runner, stop, progress)
            else:
                status = ENDED_BY_USER
                starting.cancel()
    finally:
        await runner.stop()
        watch.close()
    return ENDED_BY_USER if stop.is_set() else status


async def _follow(watch: _Watch, runner: Runner, stop: asyncio.Event, progress: Progress) -> int:
    """Show the run until it is finished, stopped or stalled."""
    moved_s, stalled_s = time.monotonic(), STALLED_S + watch.patience_s
    while not stop.is_set():
        if runner.failed.done():
            raise runner.failed.result()
        if watch.show(progress):
            moved_s = time.monotonic()
        if watch.finished():
            return 0
        if time.monotonic() - moved_s > stalled_s:
            raise StartError(f"no iteration for {stalled_s:g} s; the logs of the processes are beside the run's log")
        await asyncio.sleep(POLL_S)
    return ENDED_BY_USER


class _Watch:
    """What the runner's own process hears of the brain: who is alive, and the progress."""

    def __init__(self, experiment: Experiment, options: UpOptions) -> None:
        self._brain = experiment.brain.experiment.brain
        settings = experiment.brain.optimizer
        self.patience_s = settings.command_patience_s + settings.feedback_patience_s
        """How long a teacher who hesitates may hold up an iteration."""
        self._keys = options.keys
        self._endpoint = options.run / ENDPOINT_FILE
        self._endpoint.unlink(missing_ok=True)
        self._bus: ZenohBus | None = None
        self.on_endpoint: Callable[[str], None] = lambda _: None

    def alive(self) -> frozenset[str]:
        """Return the liveliness tokens, and the router's name once it answers."""
        if self._bus is None and self._endpoint.exists():
            self._join(self._endpoint.read_text(encoding="utf-8"))
        if self._bus is None or not self._bus.connected():
            return frozenset()
        return self._bus.alive() | {ROUTER}

    def _join(self, endpoint: str) -> None:
        try:
            self._bus = ZenohBus(self._brain, endpoint, credentials=self._keys, connect_timeout_s=0.0)
        except BusError:
            return
        self._reports = self._bus.subscriber(keys.ITERATION)
        self._scenes = self._bus.subscriber(keys.SCENE)
        self._phases = self._bus.subscriber(keys.PHASE)
        self._models = self._bus.subscriber(keys.CURRENT_MODEL)
        self._finished = self._bus.subscriber(keys.FINISHED)
        self.on_endpoint(endpoint)

    def show(self, progress: Progress) -> bool:
        """Hand what has come to the display; return whether an iteration was among it."""
        moved = False
        while (phase := self._phases.take()) is not None:
            progress.phase(phase)
        while (model := self._models.take()) is not None:
            progress.model(model)
        while (scene := self._scenes.take()) is not None:
            progress.scene(scene)
        while (report := self._reports.take()) is not None:
            progress.report(report)
            moved = True
        return moved

    def finished(self) -> bool:
        """Whether the optimizer has said that the experiment is over."""
        return self._finished.take() is not None

    def close(self) -> None:
        if self._bus is not None:
            self._bus.close()
