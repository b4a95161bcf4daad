"""Generations of the promoter-based genetic algorithm, shared among threads where there is much to do.

A genome's error depends on no other genome, and a child's numbers on its own stream only: so the bits are the same
whoever breeds and measures which part of a population.
"""

# ruff: noqa: PLR0917 - compiled functions take arrays by position

import os
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mdb_services.mechanism.evolution.compiling import compiled
from mdb_services.mechanism.evolution.kernel import population_errors
from mdb_services.mechanism.evolution.operators import Settings, breed, parents_of
from mdb_services.mechanism.evolution.parts import PUT_UP, is_done, is_open, new_board, put_up, report, take

THREADS = 4
"""At most so many work on one population."""
PART = 64
"""Individuals that a thread takes at once."""
MUCH = 1e7
"""All weights of a population times the pairs, from which on threads help. It pays from a tenth of that on, but where
a population is small, other processes have more use for the cores."""
MANY = 1000
"""So many are sorted faster by comparing not each with every other."""
_MOST = np.int64(2**63 - 1)


class Work(NamedTuple):
    """What the threads know.

    One of two populations (weights, promoters, steps) has the parents of a generation, the other the children, in
    turn; order holds the parents, the best of them first. data: inputs, targets and pairs; part: how many individuals
    make one; first: the number of the first generation.
    """

    populations: Any
    order: Any
    errors: Any
    fitness: Any
    sizes: Any
    data: Any
    key: Any
    first: int
    part: int
    settings: Settings


@compiled
def find_best(fitness: Any, count: int) -> Any:
    """Return the indices of the best, the best of them first; the lower index first among equals.

    They are count or, when the last has equals, more. Whether one number is less than another cannot be foretold, so
    none is compared in a branch: the bits of the last are searched, and each of the best counts those before it.
    """
    keys = fitness.view(np.int64).copy()
    for i in range(keys.size):
        keys[i] ^= (keys[i] >> 63) & _MOST  # integers in the order of the numbers; what is no number is last
    low, high = keys.min(), keys.max()
    while low < high:
        middle, found = (low & high) + ((low ^ high) >> 1), 0
        for key in keys:
            found += key <= middle
        low, high = (middle + 1, high) if found < count else (low, middle)
    best, found = np.empty(keys.size + 1, np.int64), 0
    for i in range(keys.size):
        best[found] = i
        found += keys[i] <= high
    best = best[:found]
    keys, order = keys[best], np.empty(found, np.int64)
    if found > MANY:
        return best[np.argsort(keys, kind="mergesort")]
    for i in range(found):
        key, rank = keys[i], 0
        for before in keys[:i]:
            rank += before <= key
        for after in keys[i:]:
            rank += after < key
        order[rank] = best[i]
    return order


@compiled
def _measure(work: Work, population: Any, begin: int, end: int) -> None:
    """Write errors and fitness (the lower the better): the error plus the penalties on squared weights."""
    penalty, share = work.settings.weight_penalty, work.settings.error_penalty
    inputs, targets, pairs = work.data
    weights, promoters, _ = population
    errors, fitness = work.errors[begin:end], work.fitness[begin:end]
    weighed = penalty > 0 or share > 0
    squares = fitness if weighed else fitness[:0]
    population_errors(weights[begin:end], promoters[begin:end], work.sizes, inputs, targets, pairs, errors, squares)
    for i in range(errors.size):
        fitness[i] = errors[i] + (penalty + share * errors[i]) * fitness[i] if weighed else errors[i]
        if not fitness[i] < np.inf:  # what is no number is nobody's best
            errors[i] = fitness[i] = np.inf


@compiled
def _parts(work: Work) -> Any:
    """Return how many parts a population has."""
    return -(-work.errors.size // work.part)


@compiled
def _do_part(work: Work, number: int) -> None:
    """Measure a part of the first population, or breed and measure one of a generation."""
    step, part = divmod(number, _parts(work))
    begin, end = part * work.part, min((part + 1) * work.part, work.errors.size)
    first, second = work.populations
    parents, children = (first, second) if step % 2 else (second, first)
    if step > 0:
        breed(parents, work.order, work.sizes, work.settings, work.key, work.first + step - 1, children, begin, end)
        begin = max(begin, work.settings.elite)
    _measure(work, children, begin, end)


@compiled
def _do_parts(work: Work, board: Any, leads: bool) -> None:
    """Do parts until all that were put up are done, or, as a helper, until there will be no more."""
    while not is_done(board) if leads else is_open(board):
        number = take(board)
        if number >= 0:
            _do_part(work, number)
            report(board)


@compiled
def _evolve(work: Work, board: Any, generations: int) -> None:
    """Measure the first population and take it through generations; who helps does parts meanwhile."""
    elite, errors, fitness = work.settings.elite, work.errors, work.fitness
    first, second = work.populations
    for step in range(generations + 1):
        if step > 0:
            parents, children = (first, second) if step % 2 else (second, first)
            order = find_best(fitness, work.order.size)
            work.order[:] = order[: work.order.size]
            for place in range(elite):
                children[0][place], children[1][place] = parents[0][order[place]], parents[1][order[place]]
                children[2][place] = parents[2][order[place]]
            errors[:elite], fitness[:elite] = errors[order[:elite]], fitness[order[:elite]]
        put_up(board, _parts(work))
        _do_parts(work, board, True)
    if generations % 2:  # the last generation is in the second population
        first[0][:], first[1][:], first[2][:] = second


def _idle_cores() -> int:
    """Return how many cores nobody uses: on another, a helper would be kept from its part while all wait for it."""
    try:
        running = Path("/proc/loadavg").read_text().split()[3].partition("/")[0]
    except OSError:
        return 0  # another system, which does not say it in this way
    return max(0, len(os.sched_getaffinity(0)) - int(running))


@cache
def _threads() -> ThreadPoolExecutor:
    """Return threads, which start when the first work is for them: after a process has forked."""
    return ThreadPoolExecutor(THREADS - 1, "evolution")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_threads.cache_clear)  # a fork has none of them


def evolve(
    populations: Any,
    errors: Any,
    fitness: Any,
    sizes: Any,
    data: Any,
    key: Any,
    generations: tuple[int, int],
    settings: Settings,
    helpers: int | None = None,
) -> None:
    """Evolve the first of two populations (weights, promoters, steps) in place on data (inputs, targets, pairs).

    The second is room for their children, whatever is in it.

    generations (first, end) count those of this memory. First everyone is measured on the present memory: an old
    fitness says nothing once the memory changed. In a generation the best few stay, and offspring of the better
    part of the population, all of whose members have the same chance, replace the others but for a few immigrants,
    if their share comes to one: neutral operators cannot bring back what all have lost, say every unit of a layer.
    helpers: how many threads help; as many as there are idle cores, if there is much to do, when it is not given.
    """
    first, end = generations
    order = np.zeros(max(settings.elite, parents_of(settings, len(errors))), np.int64)
    if helpers is None:
        helpers = min(_idle_cores(), THREADS - 1) if populations[0][0].size * data[2] >= MUCH else 0
    part, board = PART if helpers else len(errors), new_board()
    work = Work(populations, order, errors, fitness, sizes, data, key, first, part, settings)
    futures = []
    try:
        with suppress(RuntimeError):  # there are no threads to be had
            for _ in range(helpers):
                futures.append(_threads().submit(_do_parts, work, board, False))
        _evolve(work, board, end - first)
    finally:
        board[PUT_UP] = -1
        if futures:
            wait(futures)
