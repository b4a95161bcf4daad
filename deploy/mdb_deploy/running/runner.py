"""The runner: starts the processes of a brain in order, restarts what dies, stops all within two seconds.

Owns the child processes and their logs. Ready is whoever's liveliness token is there; the router is ready
when it answers. What dies comes back at once; what dies quickly again and again comes back later each time, and
soon not at all: then the run ends with its last lines. Each child is a session of its own, so Ctrl-C reaches only
the runner, and stops by itself when the runner is gone.
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
from typing import IO

import structlog

from mdb_deploy.running.compose import ROUTER, ProcessSpec
from mdb_protocol.errors import MdbError

log = structlog.get_logger()

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
LAST_LINES = 15


class StartError(MdbError):
    """A process did not become ready, or died too often; the text holds its last lines."""


@dataclass
class Child:
    """One process of the table, running or being restarted."""

    spec: ProcessSpec
    log_path: Path
    process: asyncio.subprocess.Process | None = None
    started_s: float = 0.0
    ready: bool = False
    restarts: int = 0
    quick_deaths: int = 0

    @property
    def backoff_s(self) -> float:
        """How long to wait before the next start."""
        return BACKOFF_S * 2.0 ** (self.quick_deaths - 2) if self.quick_deaths > 1 else 0.0

    def last_lines(self) -> str:
        """Return the end of the child's log."""
        try:
            lines = self.log_path.read_text(errors="replace").splitlines()
        except OSError:
            return "(it wrote nothing)"
        return "\n".join(f"    {line}" for line in lines[-LAST_LINES:]) or "(it wrote nothing)"


class Runner:
    """Runs the processes of a table; `alive` says who is ready (names of liveliness tokens, and the router)."""

    def __init__(
        self,
        specs: Mapping[str, ProcessSpec],
        variables: Mapping[str, str],
        logs: Path,
        alive: Callable[[], frozenset[str]],
    ) -> None:
        logs.mkdir(parents=True, exist_ok=True)
        self._variables = dict(variables)
        self._alive = alive
        self._stopping = False
        self._watchers: list[asyncio.Task[None]] = []
        self.children = {name: Child(spec, logs / f"{name}.log") for name, spec in specs.items()}
        self.failed: asyncio.Future[StartError] = asyncio.get_running_loop().create_future()

    def connect(self, endpoint: str, listen: str) -> None:
        """Tell the processes started from now on where the router is; itself listens there again if it dies."""
        self._variables |= {"MDB_CONNECT": endpoint, "MDB_LISTEN": listen}

    async def start(self, on_ready: Callable[[str], None] = lambda _: None) -> None:
        """Start every process once those it waits for are ready; StartError when one is not in time."""
        await asyncio.gather(*(self._start(child, on_ready) for child in self.children.values()))

    async def _start(self, child: Child, on_ready: Callable[[str], None]) -> None:
        while not (all(self.children[name].ready for name in child.spec.after) and self._somebody(child.spec)):
            await self._pause(child)
        await self._spawn(child)
        await self._until_ready(child)
        on_ready(child.spec.name)
        self._watchers.append(asyncio.create_task(self._watch(child)))

    async def _until_ready(self, child: Child) -> None:
        """Return when a process is ready; StartError when it ends before, or is not in time."""
        while not self._is_ready(child):
            assert child.process is not None
            if child.process.returncode is not None:
                raise StartError(self._report(child, f"ended with status {child.process.returncode}"))
            if time.monotonic() - child.started_s > READY_S:
                raise StartError(self._report(child, f"was not ready within {READY_S:g} s"))
            await self._pause(child)
        child.ready = True

    def _is_ready(self, child: Child) -> bool:
        return time.monotonic() - child.started_s > STALE_S and child.spec.token in self._alive()

    def _somebody(self, spec: ProcessSpec) -> bool:
        roles = {name.partition("/")[0] for name in self._alive()} if spec.awaits else set()
        return roles.issuperset(spec.awaits)

    async def _pause(self, child: Child) -> None:
        if self._stopping:
            raise StartError(f"{child.spec.name}: stopped while starting")
        await asyncio.sleep(0.02)

    async def _spawn(self, child: Child) -> None:
        argv = child.spec.argv(self._variables)
        if argv[0] == "mdb":
            argv = [sys.executable, "-P", "-m", "mdb_deploy.cli", *argv[1:], f"--with-parent={os.getpid()}"]
        output: IO[bytes] = child.log_path.open("ab")
        child.process = await asyncio.create_subprocess_exec(
            *argv,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=output,
            stderr=asyncio.subprocess.STDOUT,
            env=os.environ | child.spec.environment,
            start_new_session=True,
        )
        output.close()
        child.started_s = time.monotonic()

    async def _watch(self, child: Child) -> None:
        """Restart a process whenever it dies; give up after `QUICK_DEATHS`."""
        while True:
            assert child.process is not None
            status = await child.process.wait()
            if self._stopping:
                return
            quick = not child.ready or time.monotonic() - child.started_s < QUICK_S
            child.ready = False
            child.quick_deaths = child.quick_deaths + 1 if quick else 0
            log.warning("process died", name=child.spec.name, status=status, restarts=child.restarts)
            if not child.spec.restarts or child.quick_deaths >= QUICK_DEATHS:
                self._give_up(child, status)
                return
            await asyncio.sleep(child.backoff_s)
            if self._stopping:
                return
            await self._restart(child)

    async def _restart(self, child: Child) -> None:
        """Start a process again and wait until it is ready; one that is not in time is ended, which is a death."""
        child.restarts += 1
        await self._spawn(child)
        try:
            await self._until_ready(child)
        except StartError as error:
            if not self._stopping:
                log.warning("process did not come back", reason=str(error).partition("\n")[0])
            _signal(child, signal.SIGKILL)
            return
        took_s = time.monotonic() - child.started_s
        log.info("process is ready again", name=child.spec.name, start_s=round(took_s, 2), restarts=child.restarts)

    def _give_up(self, child: Child, status: int) -> None:
        reason = f"ended with status {status}, and is not to be started again"
        if child.spec.restarts:
            reason = (
                f"died {child.quick_deaths} times in a row before it was ready or within {QUICK_S:g} s of its start, "
                f"last with status {status}"
            )
        if not self.failed.done():
            self.failed.set_result(StartError(self._report(child, reason)))

    def _report(self, child: Child, what: str) -> str:
        return f"{child.spec.name} {what}. Its last lines ({child.log_path}):\n{child.last_lines()}"

    async def stop(self) -> None:
        """Stop every process, those first that others do not wait for; none is left after two seconds."""
        self._stopping = True
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
        for watcher in self._watchers:
            watcher.cancel()


async def _wait_all(processes: list[asyncio.subprocess.Process], bound_s: float) -> None:
    if processes:
        await asyncio.wait([asyncio.create_task(p.wait()) for p in processes], timeout=bound_s)


def _signal(child: Child, number: signal.Signals) -> None:
    if child.process and child.process.returncode is None:
        try:
            child.process.send_signal(number)
        except ProcessLookupError:
            return
