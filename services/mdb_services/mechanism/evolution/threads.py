"""Threads that help with what is compiled, which runs without Python's lock."""

import os
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from functools import cache
from pathlib import Path

THREADS = 4
"""At most so many work on one population, or on one's tasks."""

_lent = 0


def lend() -> None:
    """Let `together` use threads, one for each further core: not where several runs share a machine."""
    global _lent  # noqa: PLW0603 - of the process, as threads are
    _lent = min(_cores(), THREADS) - 1


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def idle() -> int:
    """Return how many threads find a core that nobody uses: on another, one would be kept from what all wait for."""
    try:
        running = Path("/proc/loadavg").read_text().split()[3].partition("/")[0]
    except OSError:
        return 0  # another system, which does not say it in this way
    return max(0, min(_cores() - int(running), THREADS - 1))


@cache
def threads() -> ThreadPoolExecutor:
    """Return the threads, which start when the first work is for them: after a process has forked."""
    return ThreadPoolExecutor(THREADS - 1, "evolution")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=threads.cache_clear)  # a fork has none of them


def helping(count: int, work: Callable[..., None], *arguments: object) -> list[Future[None]]:
    """Let so many threads do a work, each; fewer when there are none to be had."""
    helpers: list[Future[None]] = []
    with suppress(RuntimeError):
        for _ in range(count):
            helpers.append(threads().submit(work, *arguments))
    return helpers


def finish(helpers: Iterable[Future[None]]) -> None:
    """Wait for those who help, but not for who has not begun yet. Raises what one of them has raised."""
    begun = [helper for helper in helpers if not helper.cancel()]
    wait(begun)
    for helper in begun:
        helper.result()


def together(tasks: Iterable[Callable[[], None]]) -> None:
    """Do tasks, each once, in any order, with the threads that were lent. Raises what a task raises.

    It pays where a task takes a third of a millisecond or more, nearly all of it in compiled code.
    """
    left = deque(tasks)

    def work() -> None:
        while True:
            try:
                task = left.popleft()
            except IndexError:  # there are no more
                return
            task()

    helpers = helping(min(_lent, len(left) - 1), work)
    try:
        work()
    finally:
        left.clear()
        finish(helpers)
