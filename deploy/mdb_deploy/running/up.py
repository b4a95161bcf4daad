"""`mdb up`: an experiment from its file to its figures, in processes over Zenoh or inline.

Owns the run folder and what the user sees meanwhile; the processes belong to the runner.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from mdb_deploy.running.progress import Progress
from mdb_deploy.running.watch import JOIN_S, Watch
from mdb_deploy.supervision.compose import (
    OPTIMIZER,
    ROBOT,
    ROUTER,
    TEACHER,
    WEB,
    ProcessSpec,
    elsewhere,
    for_experiment,
    read,
)
from mdb_deploy.supervision.processes import ENDPOINT_FILE
from mdb_deploy.supervision.runner import Runner, StartError
from mdb_deploy.supervision.template import Template
from mdb_protocol import endpoints, files
from mdb_protocol.bundle import Bundle
from mdb_protocol.errors import MdbError
from mdb_protocol.holding import hold
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_services.shell.whole_file import write_whole
from mdb_sim.runs.experiment import Experiment

LOCK_FILE = "lock"
POLL_S = 0.05
STALLED_S = 60.0
"""Without a new iteration for so long, and what the brain waits for a teacher besides, the run is given up."""
ENDED_BY_USER = 130


@dataclass(frozen=True)
class Web:
    """The page of a run: its socket, where that listens, where past runs are, what to say of it at first and when the
    run is over.

    The socket is held here and given to each process that serves the page: nobody else can take the port, and who
    comes while the page is started again waits a moment. When it cannot be started any more the socket is closed.
    """

    listening: socket.socket
    host: str
    port: int
    runs: Path
    on_open: Callable[[], None]
    on_stay: Callable[[], None]

    def end(self) -> None:
        """Serve no more: who comes is refused at once, instead of waiting for ever."""
        self.listening.close()

    @property
    def ended(self) -> bool:
        """Whether it is served no more."""
        return self.listening.fileno() < 0

    @property
    def listen(self) -> str:
        """The place as the console's command line takes it."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


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
    await_robot: bool = False
    """Start no robot: let the experiment begin when one has come."""
    connect: str | None = None
    """Start no router: join this one."""
    web: Web | None = None
    """Serve the page, and go on with that when the run is over."""
    template: Template | None = None
    """Of what services are forks."""


def check_connect(connect: str, keys: Path | None, brain: str) -> None:
    """Raise BusError, before anything is started, when no router answers there, or another runs this brain there."""
    with ZenohBus(brain, connect, credentials=keys, connect_timeout_s=JOIN_S) as bus:
        hold(bus, Watch.role, Watch.instance)


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


def writable(run: Path, name: str = "") -> Path:
    """Return where what is made of a run goes: into its folder, or beside us where that is another's or read-only."""
    if os.access(run, os.W_OK):
        return run / name
    return Path("-".join(part for part in (run.resolve().name, name) if part))


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


def up_processes(
    experiment: Experiment, options: UpOptions, progress: Progress, on_over: Callable[[], None] = lambda: None
) -> int:
    """Run the processes of the compose file; return the exit status. `on_over`: called when the run is over.

    With a page that goes on meanwhile, and then until told to stop.
    """
    with _alone_in(options.run):
        experiment.write(options.run / EXPERIMENT_FILE)
        status = asyncio.run(_up(experiment, options, progress, on_over))
    if options.web is None or status:
        on_over()
    return status


@contextlib.contextmanager
def _alone_in(run: Path) -> Iterator[None]:
    """Hold the run folder; MdbError when another `mdb up` does. The lock ends with its process, however it ends."""
    with files.lock_file(run / LOCK_FILE) as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise MdbError(f"another 'mdb up' works in {run}; stop it first, or give another folder") from None
        yield


def _processes(experiment: Experiment, options: UpOptions) -> tuple[dict[str, ProcessSpec], dict[str, str]]:
    """Return the processes of a run, and what their commands' variables are."""
    variables = {
        "MDB_RUN_INSIDE": str(options.run),
        "MDB_LISTEN": options.listen,
        "MDB_CONNECT": options.connect or "",
        "MDB_KEYS": str(options.keys or ""),
        "MDB_OPEN": "--open-to-everyone" if options.open_to_everyone else "",
        "MDB_WEB_OPEN": "",
    }
    if options.web is not None:
        given = options.web.listening.fileno()
        variables |= {"MDB_WEB": options.web.listen, "MDB_RUNS": str(options.web.runs), "MDB_WEB_SOCKET": str(given)}
    specs = for_experiment(read(), experiment, web=options.web is not None)
    if options.web is not None:
        specs[WEB] = replace(specs[WEB], given=(given,))
    if options.gui and not options.await_robot:
        specs[ROBOT] = replace(specs[ROBOT], command=(*specs[ROBOT].command, "--gui"))
    if options.await_teacher or options.await_robot:
        awaits = ((TEACHER, options.await_teacher), (ROBOT, options.await_robot))
        specs[OPTIMIZER] = replace(specs[OPTIMIZER], awaits=tuple(role for role, wanted in awaits if wanted))
    if options.await_robot:
        specs = elsewhere(specs, ROBOT)
    if options.connect is not None:
        specs = elsewhere(specs, ROUTER)
    return specs, variables


async def _up(experiment: Experiment, options: UpOptions, progress: Progress, on_over: Callable[[], None]) -> int:
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    (options.run / ENDPOINT_FILE).unlink(missing_ok=True)
    watch = Watch(experiment, options.run, options.keys, await_robot=options.await_robot)
    specs, variables = _processes(experiment, options)
    runner = Runner(specs, variables, options.run / "logs", watch.alive, options.template)
    if options.connect is None:
        watch.on_endpoint = lambda found: runner.connect(found, endpoints.with_port_of(options.listen, found))
    watch.on_unheard = runner.replace_router
    if options.web is not None:
        runner.on_given_up = options.web.end
    status = 0
    try:
        if options.connect is not None:
            watch.join(options.connect)
            write_whole(options.run / ENDPOINT_FILE, options.connect.encode())
        with progress:
            if options.web is not None:
                options.web.on_open()
            starting = asyncio.create_task(runner.start(progress.ready))
            stopped = asyncio.create_task(stop.wait())
            await asyncio.wait({starting, stopped}, return_when=asyncio.FIRST_COMPLETED)
            if starting.done():
                starting.result()
                status = await _follow(watch, runner, stop, progress)
            else:
                status = ENDED_BY_USER
                starting.cancel()
        if options.web is not None and status == 0:
            await runner.stop_but(WEB, ROUTER)
            await asyncio.to_thread(on_over)
            if not options.web.ended:
                options.web.on_stay()
                await _serve_on(options.web, watch, runner, stop)
            return 0
    finally:
        await runner.stop()
        watch.close()
    return ENDED_BY_USER if stop.is_set() else status


async def _serve_on(web: Web, watch: Watch, runner: Runner, stop: asyncio.Event) -> None:
    """Go on with the page until told to stop, or until it cannot be served any more."""
    while not (stop.is_set() or web.ended or runner.failed.done()):
        watch.alive()
        await asyncio.sleep(POLL_S)


async def _follow(watch: Watch, runner: Runner, stop: asyncio.Event, progress: Progress) -> int:
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
            raise StartError(f"no iteration for {stalled_s:g} s{watch.lost()}")
        await asyncio.sleep(POLL_S)
    return ENDED_BY_USER
