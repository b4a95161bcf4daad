"""Generations of the promoter-based genetic algorithm, compiled; threads may share them.

A genome's error depends on no other genome, and a child's numbers on its own stream only: so the bits are the same
whoever breeds and measures which part of a population.
"""

# ruff: noqa: PLR0917 - compiled functions take arrays by position

from typing import Any

import numpy as np

from mdb_services.mechanism.evolution.compiled.compiling import compiled
from mdb_services.mechanism.evolution.compiled.kernel import population_errors
from mdb_services.mechanism.evolution.compiled.operators import breed
from mdb_services.mechanism.evolution.compiled.parts import is_done, is_open, put_up, report, take
from mdb_services.mechanism.evolution.layout import Evolved, Numbers, Pairs, Rates, Spaces

MANY = 1000
"""So many are sorted faster by merging than by comparing each with every other."""
_MOST = np.int64(2**63 - 1)


@compiled
def find_best(fitness: Any, count: int, order: Any, keys: Any, best: Any, sorting: Any) -> Any:
    """Write the order of the best, the best of them first; the lower index first among equals; return how many.

    They are count or, when the last has equals, more. Whether one number is less than another cannot be foretold, so
    none is compared in a branch: the bits of the last are searched, and each of the best counts those before it.
    order, keys, best and sorting (population + 1,) int64, all but the first as spaces to work in.
    """
    low, high, numbers = _MOST, ~_MOST, fitness.view(np.int64)
    for i in range(fitness.size):
        key = numbers[i] ^ ((numbers[i] >> 63) & _MOST)  # in the order of the numbers; what is no number is last
        keys[i], low, high = key, min(low, key), max(high, key)
    while low < high:
        middle, found = (low & high) + ((low ^ high) >> 1), 0
        for i in range(fitness.size):
            found += keys[i] <= middle
        low, high = (middle + 1, high) if found < count else (low, middle)
    found = 0
    for i in range(fitness.size):
        best[found] = i
        found += keys[i] <= high
    for i in range(found):
        keys[i] = keys[best[i]]
    if found > MANY:
        _merge(keys, found, order, sorting)
        for i in range(found):
            order[i] = best[order[i]]
        return found
    for i in range(found):
        key, rank = keys[i], 0
        for before in range(i):
            rank += keys[before] <= key
        for after in range(i, found):
            rank += keys[after] < key
        order[rank] = best[i]
    return found


@compiled
def _merge(keys: Any, count: int, order: Any, sorting: Any) -> None:
    """Write the order of the first keys, the lower index first among equals: runs of twice the length each time."""
    for i in range(count):
        order[i] = i
    length = 1
    while length < count:
        for begin in range(0, count, 2 * length):
            middle, end = min(begin + length, count), min(begin + 2 * length, count)
            left, right = begin, middle
            for place in range(begin, end):
                if right == end or (left < middle and keys[order[left]] <= keys[order[right]]):
                    sorting[place], left = order[left], left + 1
                else:
                    sorting[place], right = order[right], right + 1
        for i in range(count):
            order[i] = sorting[i]
        length *= 2


@compiled
def _copy(source: Any, one: int, target: Any, place: int) -> None:
    """Copy an individual (weights, promoters, step) to a place of another population."""
    for i in range(source[0].shape[1]):
        target[0][place, i] = source[0][one, i]
    for i in range(source[1].shape[1]):
        target[1][place, i] = source[1][one, i]
    target[2][place] = source[2][one]


@compiled
def _populations(task: Evolved, step: int) -> Any:
    """Return the parents of a step and their children; the first step measures the first population as children."""
    first = (task.weights, task.promoters, task.steps)
    second = (task.other_weights, task.other_promoters, task.other_steps)
    return (first, second) if step % 2 else (second, first)


@compiled
def _measure(task: Evolved, pairs: Pairs, rates: Rates, step: int, begin: int, end: int, spaces: Spaces) -> None:
    """Write errors and fitness (the lower the better): the error plus the penalties on squared weights."""
    penalty, share = rates.weight_penalty, rates.error_penalty
    weights, promoters, _ = _populations(task, step)[1]
    errors, fitness = task.errors[begin:end], task.fitness[begin:end]
    weighed = penalty > 0 or share > 0
    squares = fitness if weighed else fitness[:0]
    population_errors(weights[begin:end], promoters[begin:end], task.sizes, pairs, errors, squares, spaces)
    for i in range(errors.size):
        fitness[i] = errors[i] + (penalty + share * errors[i]) * fitness[i] if weighed else errors[i]
        if not fitness[i] < np.inf:  # what is no number is nobody's best
            errors[i] = fitness[i] = np.inf


@compiled
def _do_part(task: Evolved, pairs: Pairs, numbers: Numbers, rates: Rates, number: int, spaces: Spaces) -> None:
    """Measure a part of the first population, or breed and measure one of a generation."""
    parts = -(-task.errors.size // numbers.part)
    step, part = number // parts, number % parts
    begin, end = part * numbers.part, min((part + 1) * numbers.part, task.errors.size)
    if step > 0:
        parents, children = _populations(task, step)
        breed(parents, children, task, numbers, rates, numbers.first + step - 1, begin, end, spaces)
        begin = max(begin, numbers.elite)
    if begin < end:
        _measure(task, pairs, rates, step, begin, end, spaces)


@compiled
def do_parts(task: Evolved, pairs: Pairs, numbers: Numbers, rates: Rates, leads: bool, spaces: Spaces) -> None:
    """Do parts until all that were put up are done, or, as a helper, until there will be no more."""
    while not is_done(task.board) if leads else is_open(task.board):
        number = take(task.board)
        if number >= 0:
            _do_part(task, pairs, numbers, rates, number, spaces)
            report(task.board)


@compiled
def evolve(task: Evolved, pairs: Pairs, numbers: Numbers, rates: Rates, spaces: Spaces) -> None:
    """Measure the first population and take it through generations; who helps does parts meanwhile."""
    elite, errors, fitness, few, order = numbers.elite, task.errors, task.fitness, spaces.few, task.order
    for step in range(numbers.generations + 1):
        if step > 0:
            parents, children = _populations(task, step)
            find_best(fitness, max(elite, numbers.parents), order, spaces.keys, spaces.best, spaces.sorting)
            for place in range(elite):
                _copy(parents, order[place], children, place)
                few[0, place], few[1, place] = errors[order[place]], fitness[order[place]]
            for place in range(elite):
                errors[place], fitness[place] = few[0, place], few[1, place]
        put_up(task.board, -(-errors.size // numbers.part))
        do_parts(task, pairs, numbers, rates, True, spaces)
    if numbers.generations % 2:  # the last generation is in the second population
        first, second = _populations(task, 1)
        for place in range(errors.size):
            _copy(second, place, first, place)
