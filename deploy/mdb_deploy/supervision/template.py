"""The template: a process that has imported what services need, of which each service is a fork.

So a brain imports once, and what was imported is in memory once. Services are processes as before: each dies alone,
and is a child of the runner's. The template is forked from `mdb up` before that has a thread or a session, and has
none itself: a fork has no copies of threads. It is `mdb up` that imports, though it needs little of it: imports write
to what is there already, and a template that imported would no longer share that (20 MB). It is there for speed and
memory only: without it (another system than Linux, or it died, or it is frozen) services are programs as any other.

A service is the child of a child that ends at once; so the system gives it to the runner, which has asked for that
(a "subreaper", see prctl(2)) and does not ask for more: what else loses its parent is not for it.
"""

from __future__ import annotations

import asyncio
import atexit
import ctypes
import errno
import fcntl
import gc
import importlib
import json
import os
import signal
import socket
import sys
import threading
import time
import traceback
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from mdb_services.shell.pages import let_go_of_files, threads

LIBC = ctypes.CDLL(None)
SUBREAPER = 36
"""PR_SET_CHILD_SUBREAPER of <linux/prctl.h>."""
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""How libraries are told so."""
IMPORTED = (
    "mdb_protocol.zenoh_bus",
    "mdb_deploy.supervision.processes",
    "mdb_services.recorder",
    "mdb_services.memory.store",
    "mdb_services.acting.optimizer",
    "mdb_sim.teaching.service",
    "mdb_services.evolver",
)
"""What several services need, or one that is to be back soon; what is missing each imports itself."""
LEARNS = ["run", "evolver"]
"""Evolvers begin with their kernels loaded: else each would take the time and the memory for itself."""
ANSWER_S = 10.0
"""Bound on a fork: kernels may be loaded before it, on a busy machine."""
ADOPTED_S = 2.0
"""Bound on being given to the runner."""
MOST_BYTES, MOST_GIVEN = 2**18, 16
UNKNOWN = 255


@contextmanager
def one_thread() -> Iterator[None]:
    """What is imported meanwhile starts no threads of its own: a fork would lack them."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


@contextmanager
def kept() -> Iterator[None]:
    """Nobody looks for garbage meanwhile, or later in what is there then: what is imported stays."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


class TemplateGoneError(Exception):
    """There is no template any more."""


class Forked:
    """A process that the template has made, and that is this one's child; as `asyncio.subprocess.Process`."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self._ended = asyncio.Event()
        self._watched = os.pidfd_open(pid)
        asyncio.get_running_loop().add_reader(self._watched, self._look)

    def _look(self) -> None:
        asyncio.get_running_loop().remove_reader(self._watched)
        os.close(self._watched)
        try:
            self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        except ChildProcessError:  # somebody else has asked
            self.returncode = UNKNOWN
        self._ended.set()

    async def wait(self) -> int:
        """Return the exit status once it has ended, negative when by a signal."""
        await self._ended.wait()
        assert self.returncode is not None
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.returncode is None:
            os.kill(self.pid, number)


class Template:
    """The runner's side of the template."""

    def __init__(self, channel: socket.socket, pid: int) -> None:
        self._channel, self.pid = channel, pid
        self._one_at_a_time = asyncio.Lock()
        channel.setblocking(False)

    @classmethod
    def begin(cls, main: Callable[[list[str]], int]) -> Template | None:
        """Import what services need, and fork it, before this process has threads; None where that cannot be.

        main: what does as `mdb` does with some words, and returns the exit status.
        """
        if sys.platform != "linux":
            return None
        try:
            os.close(os.pidfd_open(os.getpid()))  # not there before Linux 5.3, and forbidden in some places
            if threads() > 1 or LIBC.prctl(SUBREAPER, 0, 0, 0, 0):
                return None
            loaded = _fill()
            if threads() > 1:
                return None
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        except (AttributeError, OSError):
            return None
        for end in (ours, theirs):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2 * MOST_BYTES)
        sys.stdout.flush()
        sys.stderr.flush()
        try:
            pid = os.fork()
        except OSError:  # no process or no memory left
            ours.close()
            theirs.close()
            return None
        if pid == 0:
            status = 1
            try:
                ours.close()
                status = _Forge(theirs, main, loaded).work()
            finally:
                os._exit(status)
        theirs.close()
        return cls(ours, pid)

    async def fork(self, words: Sequence[str], environment: Mapping[str, str], given: Sequence[int]) -> Forked:
        """Start `mdb` with these words.

        given: descriptors that it gets under the same numbers; the first is its log. Raises OSError when the system
        has no process left, and TemplateGoneError when the template does not answer: then it is ended.
        """
        asked = {"words": list(words), "environment": dict(environment), "numbers": list(given)}
        async with self._one_at_a_time:
            if self._channel.fileno() < 0:
                raise TemplateGoneError
            LIBC.prctl(SUBREAPER, 1, 0, 0, 0)
            exchange = asyncio.ensure_future(self._ask(json.dumps(asked).encode(), list(given)))
            try:
                await asyncio.wait({exchange}, timeout=ANSWER_S)  # `wait_for` of Python 3.11 may lose a cancellation
                if not exchange.done() or exchange.exception() is not None:
                    raise TemplateGoneError
                if (pid := exchange.result()) > 0:
                    return Forked(pid)
            except BaseException:
                if exchange.done() and exchange.exception() is None and exchange.result() > 0:
                    _end(exchange.result())
                else:  # an answer that nobody waits for would be taken for the next one's
                    exchange.cancel()
                    self.close()
                raise
            finally:
                LIBC.prctl(SUBREAPER, 0, 0, 0, 0)
        raise OSError(-pid, os.strerror(-pid))

    async def _ask(self, request: bytes, given: list[int]) -> int:
        socket.send_fds(self._channel, [request], given)
        return int(await asyncio.get_running_loop().sock_recv(self._channel, MOST_BYTES))

    def close(self) -> None:
        """End it, and whom it has made without telling us in time: he would be one too many."""
        if self._channel.fileno() < 0:
            return
        _end(self.pid)
        with suppress(OSError, ValueError):
            self._channel.shutdown(socket.SHUT_RD)  # from here on nobody can tell us
            while (late := int(self._channel.recv(MOST_BYTES))) > 0:
                _end(late)
        self._channel.close()


def _end(pid: int) -> None:
    """Kill a child, and bury it."""
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    with suppress(ChildProcessError):
        os.waitpid(pid, 0)


class _Forge:
    """The template itself."""

    def __init__(self, channel: socket.socket, main: Callable[[list[str]], int], loaded: bool) -> None:
        self._channel, self._main = channel, main
        self._loaded = loaded

    def work(self) -> int:
        """Fork whom is asked for, until the runner is gone."""
        os.setsid()  # Ctrl-C is for the runner
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # who ignores it cannot wait for children
        weakref.finalize._registry.clear()  # type: ignore[attr-defined] # what the runner removes at its end is its own
        self._leave_what_is_the_runners()
        _name("mdb template")
        while self._serve():
            pass
        return 0

    def _leave_what_is_the_runners(self) -> None:
        """Close what whoever started the runner has left open: he may wait for its end."""
        nowhere = os.open(os.devnull, os.O_RDWR)
        for number in range(3):
            os.dup2(nowhere, number)
        os.close(nowhere)
        for number in [int(name) for name in os.listdir("/proc/self/fd")]:
            with suppress(OSError):  # that of the list itself is closed already
                if number > 2 and os.get_inheritable(number):
                    os.close(number)

    def _serve(self) -> bool:
        """Fork for the next request; return False once the runner is gone."""
        request, descriptors, _, _ = socket.recv_fds(self._channel, MOST_BYTES, MOST_GIVEN)
        if not request:
            return False
        asked = json.loads(request)
        if asked["words"][:2] == LEARNS and not self._loaded:  # another evolver may have compiled them
            self._loaded = _load_kernels()
            let_go_of_files()
        try:
            if len(descriptors) != len(asked["numbers"]):
                raise OSError(errno.EMFILE, "")
            self._fork(asked, descriptors)
        except OSError as error:
            self._answer(-(error.errno or errno.EAGAIN))
        for descriptor in descriptors:
            os.close(descriptor)
        return True

    def _answer(self, number: int) -> None:
        """Tell a process id, or of an error its number below 0; OSError when the runner does not wait any more."""
        self._channel.send(str(number).encode())

    def _fork(self, asked: dict[str, Any], descriptors: Sequence[int]) -> None:
        between = os.fork()
        if between == 0:
            status = 70
            try:
                status = self._go_between(asked, descriptors)
            except BaseException:
                with suppress(OSError):
                    os.write(descriptors[0], traceback.format_exc().encode())
            finally:
                os._exit(status)
        if (code := os.waitstatus_to_exitcode(os.waitpid(between, 0)[1])) > 0:
            raise OSError(code, "")

    def _go_between(self, asked: dict[str, Any], descriptors: Sequence[int]) -> int:
        """Fork the service, and be that in the fork; return the exit status, of who is between the error's number."""
        between = os.getpid()
        try:
            if os.fork() > 0:
                return 0
        except OSError as error:
            return error.errno or errno.EAGAIN
        return self._live(asked["words"], asked["environment"], asked["numbers"], descriptors, between)

    def _live(
        self,
        words: list[str],
        environment: Mapping[str, str],
        numbers: Sequence[int],
        descriptors: Sequence[int],
        between: int,
    ) -> int:
        """Be the service; return its exit status."""
        os.setsid()
        until_s = time.monotonic() + ADOPTED_S
        while os.getppid() == between and time.monotonic() < until_s:
            time.sleep(0.0005)
        self._answer(os.getpid())
        self._channel.close()
        free = max(2, *numbers, *descriptors) + 1
        apart = [fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, free) for descriptor in descriptors]
        for descriptor in descriptors:
            os.close(descriptor)
        for number, descriptor in zip(numbers, apart, strict=True):
            os.dup2(descriptor, number)
            os.close(descriptor)
        for number in (1, 2):
            os.dup2(numbers[0], number)
        os.environ.clear()
        os.environ.update(environment)
        gc.freeze()
        if "numpy.random" in sys.modules:
            sys.modules["numpy.random"].seed()  # else all would draw the same
        sys.argv = ["mdb", *words]
        _name(" ".join(sys.argv))
        return _run(self._main, words)


def _run(main: Callable[[list[str]], int], words: list[str]) -> int:
    """Do what `mdb` does with these words, to the end as Python itself ends; return the exit status."""
    try:
        status = main(words)
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
        if not isinstance(end.code, int | None):
            print(end.code, file=sys.stderr)  # noqa: T201 - as Python does
    except BaseException:
        traceback.print_exc()
        status = 1
    threading._shutdown()  # type: ignore[attr-defined] # as in children of `multiprocessing`, which are forks, too
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    return status


def _fill() -> bool:
    """Import what services need and load what learns; return whether that could be loaded.

    It is `kept`: who looks for garbage writes to what he looks at, and then it is no longer shared.
    """
    with kept(), one_thread():
        for module in IMPORTED:
            with suppress(Exception):  # whoever needs it says what is wrong with it
                importlib.import_module(module)
        loaded = _load_kernels()
    let_go_of_files()
    return loaded


def _load_kernels() -> bool:
    """Load what learns, compiled; what is not compiled yet each evolver compiles, and the next one finds it."""
    with suppress(Exception):
        from mdb_services.mechanism.evolution import native

        native.load(compiling=False)
        return True
    return False


def _name(title: str) -> None:
    """Be known by these words in lists of processes, if that can be."""
    with suppress(ImportError):
        from setproctitle import setproctitle

        setproctitle(title)
