"""Work for several processes of this machine, so that one which dies takes nothing but its own work with it.

Owns the processes: each is a pool of one and has one piece of work at a time, so its death tells whose it was. They
end with this process, however that ends, and leave no folder behind.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from mdb_sim.studies import running

Item = TypeVar("Item")
Answer = TypeVar("Answer")

ATTEMPTS = 2
"""How often a piece of work is begun whose process died under it."""
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""A process has one core; Dask's workers set the same."""


def answers(
    do: Callable[[Item], Answer], items: Sequence[Item], workers: int
) -> Iterator[tuple[Item, Answer | BaseException]]:
    """Yield what each item gave, or what it failed of, as they come; BrokenProcessPool: its process died twice."""
    waiting = deque((item, 1) for item in items)
    busy: dict[Future[Answer], tuple[Item, int, ProcessPoolExecutor]] = {}
    with _processes() as begin:
        free = [begin() for _ in range(min(workers, len(items)))]
        while waiting or busy:
            while waiting and free:
                item, attempt = waiting.popleft()
                pool = free.pop()
                try:
                    future = pool.submit(do, item)
                except BrokenProcessPool:  # it died while it had nothing to do
                    pool = begin()
                    future = pool.submit(do, item)
                busy[future] = (item, attempt, pool)
            for future in wait(busy, return_when=FIRST_COMPLETED).done:
                item, attempt, pool = busy.pop(future)
                failure = future.exception()
                died = isinstance(failure, BrokenProcessPool)
                free.append(begin() if died else pool)
                if died and attempt < ATTEMPTS:
                    waiting.append((item, attempt + 1))
                else:
                    yield item, failure if failure is not None else future.result()


@contextmanager
def _processes() -> Iterator[Callable[[], ProcessPoolExecutor]]:
    """Give what begins a process; all of them work in one folder, which is deleted at the end."""
    with tempfile.TemporaryDirectory(prefix="mdb-study-", ignore_cleanup_errors=True) as folder:
        yield from _ended_with_this(folder)


def _ended_with_this(folder: str) -> Iterator[Callable[[], ProcessPoolExecutor]]:
    # Ended by SIGTERM without this, it would leave its workers behind.
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    for threads in ONE_THREAD:
        os.environ.setdefault(threads, "1")
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pools: list[ProcessPoolExecutor] = []

    def begin() -> ProcessPoolExecutor:
        pools.append(ProcessPoolExecutor(1, mp_context=context, initializer=_begin_worker, initargs=(folder,)))
        return pools[-1]

    try:
        yield begin
    except BaseException:
        for pool in pools:
            pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        for pool in pools:
            pool.shutdown()
        signal.signal(signal.SIGTERM, before)


def _begin_worker(folder: str) -> None:
    """Leave Ctrl-C to the parent, which ends the runs, and standard output to the table; work in its folder."""
    tempfile.tempdir = folder
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    running.quiet()
