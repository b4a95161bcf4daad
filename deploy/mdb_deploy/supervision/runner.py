"""The runner: starts the processes of a brain in order, restarts what dies or hangs, stops all within two seconds.

Owns the child processes and their logs. Ready is whoever's liveliness token is there; the router is ready
when it answers. What dies comes back at once; what dies quickly again and again comes back later each time, and
soon not at all: then the run ends with its last lines. A process that cannot be started, or whose heart does not beat
(`heartbeat`), has died like any other. Each child is a session of its own, so Ctrl-C reaches only the runner, and
stops by itself when the runner is gone.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import structlog

from mdb_deploy.supervision.compose import ROUTER, ProcessSpec, fill
from mdb_deploy.supervision.template import Forked, Template, TemplateGoneError
from mdb_protocol.errors import UNHEARD, MdbError
from mdb_services.shell.heartbeat import BEAT_S, Pulse

log = structlog.get_logger()
Process = asyncio.subprocess.Process | Forked

READY_S = 90.0
"""Bound on a process becoming ready; the first start on a machine compiles the evolvers' kernels."""
STOP_S = 1.5
"""Between SIGTERM and SIGKILL."""
STALE_S = 0.1
"""A token is not believed before: that of who died is gone in milliseconds, and no successor is ready so soon."""
QUICK_S = 5.0
"""A process that died before it was ready, or sooner than this after its start, died quickly."""
QUICK_DEATHS = 5
"""So many quick deaths in a row end the run."""
BACKOFF_S = 0.2
"""Before the start that follows a second quick death in a row; twice as long after each further one."""
PAUSE_S = 0.02
EXCUSED_S = 1.0
"""After the router is back, others that waited for it have so long to show a sign of life."""
FEEL_S = 0.1
"""So often hearts are listened to."""
LAST_LINES = 15


class StartError(MdbError):
    """A process did not become ready, or died too often; the text holds its last lines."""


@dataclass
class Child:
    """One process of the table, running or being restarted."""

    spec: ProcessSpec
    log_path: Path
    process: Process | None = None
    pulse: Pulse | None = None
    started_s: float = 0.0
    ready: bool = False
    been_ready: bool = False
    """Whether it has ever been."""
    ended_for: str = ""
    """Why the runner itself has ended it, if it has."""
    restarts: int = 0
    quick_deaths: int = 0

    @property
    def backoff_s(self) -> float:
        """How long to wait before the next start."""
        return BACKOFF_S * 2.0 ** (self.quick_deaths - 2) if self.quick_deaths > 1 else 0.0

    @property
    def patience(self) -> float:
        """By how much more silence is borne of a process that died quickly: the machine may be too busy for it."""
        return 2.0**self.quick_deaths

    def last_lines(self) -> str:
        """Return the end of the child's log."""
        try:
            lines = self.log_path.read_text(errors="replace").splitlines()
        except OSError:
            return "(it wrote nothing)"
        return "\n".join(f"    {line}" for line in lines[-LAST_LINES:]) or "(it wrote nothing)"

    def end(self, reason: str) -> None:
        """Kill it, which is a death like any other."""
        self.ended_for = reason
        _signal(self, signal.SIGKILL)


class Runner:
    """Runs the processes of a table; `alive` says who is ready (names of liveliness tokens, and the router)."""

    def __init__(
        self,
        specs: Mapping[str, ProcessSpec],
        variables: Mapping[str, str],
        logs: Path,
        alive: Callable[[], frozenset[str]],
        template: Template | None = None,
    ) -> None:
        self._template = template
        self._variables = dict(variables)
        self._logs, self._alive = logs, alive
        self._stopping = False
        self._tasks: list[asyncio.Task[None]] = []
        self._keeping: dict[str, asyncio.Task[None]] = {}
        self.on_given_up: Callable[[], None] = lambda: None
        """Called when one is given up that is not needed: the page."""
        self.children = {name: Child(spec, logs / f"{name}.log") for name, spec in specs.items()}
        self.failed: asyncio.Future[StartError] = asyncio.get_running_loop().create_future()

    def connect(self, endpoint: str, listen: str) -> None:
        """Tell the processes started from now on where the router is; itself listens there again if it dies."""
        self._variables |= {"MDB_CONNECT": endpoint, "MDB_LISTEN": listen}

    def replace_router(self, why: str) -> None:
        """End a router of ours that does not do what it should; who lives joins the next one."""
        router = self.children.get(ROUTER)
        if router is not None and router.ready and not router.ended_for:
            router.end(why)

    async def start(self, on_ready: Callable[[str], None] = lambda _: None) -> None:
        """Start every process once those it waits for are ready; StartError when one does not become ready."""
        self._keeping = {
            name: asyncio.create_task(self._keep(child, on_ready)) for name, child in self.children.items()
        }
        self._tasks = [asyncio.create_task(self._listen()), *self._keeping.values()]
        for task in self._tasks:
            task.add_done_callback(self._look_at)
        while not all(child.been_ready for child in self.children.values() if child.spec.needed):
            await asyncio.wait({self.failed}, timeout=PAUSE_S)
            if self.failed.done():
                raise self.failed.result()

    def _look_at(self, task: asyncio.Task[None]) -> None:
        """A mistake in the runner itself ends the run, for nobody watches any more."""
        error = None if task.cancelled() else task.exception()
        if error is not None:
            log.error("the runner failed", exc_info=error)
            self._fail(f"the runner itself failed: {type(error).__name__}: {error}")

    async def _keep(self, child: Child, on_ready: Callable[[str], None]) -> None:
        """Start a process whenever it is not there; give up after `QUICK_DEATHS`, or when that is of no use."""
        while not (all(self.children[name].ready for name in child.spec.after) and self._somebody(child.spec)):
            await asyncio.sleep(PAUSE_S)
        while True:
            status, reason = await self._live(child, on_ready)
            if self._stopping:
                return
            how = f"with status {status}: {reason}" if status is not None and reason else reason
            how = how or f"with status {status}"
            quick = not child.ready or time.monotonic() - child.started_s < QUICK_S
            child.ready = False
            child.quick_deaths = child.quick_deaths + 1 if quick else 0
            log.warning("process died", name=child.spec.name, status=status, reason=reason, restarts=child.restarts)
            if status == UNHEARD:
                self.replace_router(f"it gave {child.spec.name} nothing any more")
            if (why := self._why_give_up(child, status, how)) is not None:
                if not child.spec.needed:
                    log.error("the run goes on without it", name=child.spec.name, reason=f"it {why}")
                    self.on_given_up()
                    return
                self._fail(f"{child.spec.name} {why}. Its last lines ({child.log_path}):\n{child.last_lines()}")
                return
            await asyncio.sleep(child.backoff_s)
            child.restarts += 1

    def _why_give_up(self, child: Child, status: int | None, how: str) -> str | None:
        """Return what to say of a process that is not to be started again; None when it is."""
        by_itself = status is not None and status >= 0 and status != UNHEARD  # which is the router's fault
        if not child.been_ready and by_itself:
            return f"ended with status {status}"  # at its first start: it would again
        if not child.spec.restarts:
            return f"ended {how}, and is not to be started again"
        if child.quick_deaths >= QUICK_DEATHS:
            return (
                f"died {child.quick_deaths} times in a row before it was ready or within {QUICK_S:g} s of its start, "
                f"last {how}"
            )
        return None

    async def _live(self, child: Child, on_ready: Callable[[str], None]) -> tuple[int | None, str]:
        """Start a process and follow it until it is dead; return its status and, where it is known, why it died."""
        child.started_s, child.process, child.pulse, child.ended_for = time.monotonic(), None, None, ""
        try:
            child.process = process = await self._spawn(child)
        except (OSError, RuntimeError) as error:  # no log file, no descriptor, no memory, no thread left
            return None, f"for it cannot be started: {error}"
        ending = asyncio.create_task(process.wait())
        try:
            while not ending.done() and not self._is_ready(child):
                if time.monotonic() - child.started_s > READY_S and not child.ended_for:
                    child.end(f"it was not ready within {READY_S:g} s")
                await asyncio.wait({ending}, timeout=PAUSE_S)
            if not ending.done():
                self._welcome(child, on_ready)
            return await ending, child.ended_for
        finally:
            ending.cancel()
            if child.pulse is not None:
                child.pulse.close()
                child.pulse = None  # nobody is left to feel it: of one that is stopped the process may still live

    def _welcome(self, child: Child, on_ready: Callable[[str], None]) -> None:
        child.ready = True
        name, took_s = child.spec.name, round(time.monotonic() - child.started_s, 2)
        if child.been_ready:
            log.info("process is ready again", name=name, start_s=took_s, restarts=child.restarts)
        else:
            on_ready(name)
            child.been_ready = True

    def _is_ready(self, child: Child) -> bool:
        return time.monotonic() - child.started_s > STALE_S and child.spec.token in self._alive()

    def _somebody(self, spec: ProcessSpec) -> bool:
        roles = {name.partition("/")[0] for name in self._alive()} if spec.awaits else set()
        return roles.issuperset(spec.awaits)

    async def _spawn(self, child: Child) -> Process:
        argv = child.spec.argv(self._variables)
        filled = {name: fill(value, self._variables) for name, value in child.spec.environment.items()}
        self._logs.mkdir(exist_ok=True)
        with child.log_path.open("ab") as output:
            child.pulse = pulse = Pulse()
            environment = os.environ | filled | pulse.environment()
            given = (pulse.child_pipe, *child.spec.given)
            try:
                if argv[0] == "mdb":
                    argv.append(f"--with-parent={os.getpid()}")
                    if (forked := await self._fork(argv[1:], environment, (output.fileno(), *given))) is not None:
                        return forked
                    argv[:1] = [sys.executable, "-P", "-m", "mdb_deploy.cli"]
                return await asyncio.create_subprocess_exec(
                    *argv,
                    stdin=asyncio.subprocess.DEVNULL,
                    stdout=output,
                    stderr=asyncio.subprocess.STDOUT,
                    env=environment,
                    pass_fds=given,
                    start_new_session=True,
                )
            except BaseException:
                pulse.close()
                raise
            finally:
                pulse.child_has_it()

    async def _fork(self, words: list[str], environment: dict[str, str], given: tuple[int, ...]) -> Process | None:
        """Start a process from the template; None when there is none any more."""
        if self._template is None:
            return None
        try:
            return await self._template.fork(words, environment, given)
        except TemplateGoneError:
            if self._template is not None:
                log.warning("the template is gone; processes are started without it, which takes longer")
            self._template = None
            return None

    async def _listen(self) -> None:
        """Listen to the hearts, and end who hangs; nobody but the router while others may be waiting for it."""
        router = self.children.get(ROUTER)
        excused_until_s = 0.0
        while True:
            await asyncio.sleep(FEEL_S)
            for child in self.children.values():
                if child.pulse is not None and child.process is not None and child.process.returncode is None:
                    child.pulse.feel()
            if router is not None and not _routes(router):
                excused_until_s = time.monotonic() + EXCUSED_S
            for child in self.children.values():
                excused = child is not router and time.monotonic() < excused_until_s
                if child.pulse and child.pulse.hangs(child.patience) and not (excused or child.ended_for):
                    child.end(f"it hung: no sign of life for {child.pulse.silent_s:.1f} s")

    def _fail(self, why: str) -> None:
        if not self.failed.done():
            self.failed.set_result(StartError(why))

    async def stop_but(self, *names: str) -> None:
        """Stop every process but these, which are looked after as before."""
        stopped = [child for name, child in self.children.items() if name not in names]
        for child in stopped:
            if (keeping := self._keeping.get(child.spec.name)) is not None:
                keeping.cancel()
        for child in reversed(stopped):
            _signal(child, signal.SIGTERM)
        await _wait_all([child.process for child in stopped if child.process], STOP_S)
        for child in stopped:
            _signal(child, signal.SIGKILL)
            child.ready = False

    async def stop(self) -> None:
        """Stop every process, those first that others do not wait for; none is left after two seconds."""
        self._stopping = True
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for child in reversed(self.children.values()):
            if child.spec.name != ROUTER:
                _signal(child, signal.SIGTERM)
        running = [c.process for c in self.children.values() if c.process and c.spec.name != ROUTER]
        await _wait_all(running, STOP_S)
        router = self.children.get(ROUTER)
        if router and router.process:
            _signal(router, signal.SIGTERM)
            await _wait_all([router.process], STOP_S / 5)
        for child in self.children.values():
            _signal(child, signal.SIGKILL)
            if child.process:
                await child.process.wait()


def _routes(router: Child) -> bool:
    return router.ready and (router.pulse is None or router.pulse.silent_s <= 2 * BEAT_S)


async def _wait_all(processes: list[Process], bound_s: float) -> None:
    if processes:
        await asyncio.wait([asyncio.create_task(p.wait()) for p in processes], timeout=bound_s)


def _signal(child: Child, number: signal.Signals) -> None:
    if child.process and child.process.returncode is None:
        try:
            child.process.send_signal(number)
        except ProcessLookupError:
            return
