"""Selection, crossover and mutation of the promoter-based genetic algorithm, compiled.

A unit is a neuron with all its inbound weights and its bias, preceded by a promoter gene that says whether it
is expressed (paper, reference 14; the details below are ours, from memory of the literature). Weights that an
expressed unit sends to the outputs cross over with the sending unit, since they say what its signal means;
between hidden layers they stay with the receiving unit.

*Statistically neutral*: crossover and structural mutation leave the expected number of expressed units exactly
as it is, so only selection changes the size of networks.

Each offspring has a stream of its own, a function of (key, generation, offspring), and each of its numbers is a
function of that stream and of the number's index: results depend neither on threads nor on order, and the numbers
of a whole row are drawn at once, in vectors.
"""

# ruff: noqa: PLR0917 - compiled functions take arrays by position

from typing import Any

import numpy as np

from mdb_services.mechanism.evolution.compiled.compiling import compiled
from mdb_services.mechanism.evolution.compiled.rows import (
    GOLDEN,
    MIX,
    SUM_MEAN,
    SUM_SCALE,
    UNITS,
    WEIGHTS,
    cross_units,
    write_weights,
)
from mdb_services.mechanism.evolution.layout import Evolved, Numbers, Rates, Spaces

_GOLDEN, (_MIX1, _MIX2) = np.uint64(GOLDEN), (np.uint64(factor) for _, factor in MIX)
_1, _11, _16, _27, _30, _31, _32 = (np.uint64(n) for n in (1, 11, 16, 27, 30, 31, 32))
_LOW32, _TWO_LOW16 = np.uint64(0xFFFFFFFF), np.uint64(0x0000FFFF0000FFFF)
_UNIT = 2.0**-53
_1F, _LARGE, _LOG_2, _LOG2_E = (np.float32(x) for x in (1.0, 87.0, np.log(2.0), 1 / np.log(2.0)))
_SUM_MEAN, _SUM_SCALE = np.float32(SUM_MEAN), np.float32(SUM_SCALE)

# Indices of an offspring's numbers; hidden and output units have one each, and so has each weight.
_PARENTS, _CROSSOVER, _STEP, _STRUCTURE, _LAYER, _FLIP = range(6)
_UNITS, _WEIGHTS = np.uint64(UNITS), np.uint64(WEIGHTS)


@compiled
def _scramble(z: Any) -> Any:
    """Return the output function of splitmix64: every bit depends on every bit of z."""
    z = (z ^ (z >> _30)) * _MIX1
    z = (z ^ (z >> _27)) * _MIX2
    return z ^ (z >> _31)


@compiled
def stream(key: Any, generation: int, offspring: int) -> Any:
    """Return the beginning of an offspring's own stream."""
    z = _scramble(np.uint64(key) + _GOLDEN * np.uint64(generation + 1))
    return _scramble(z ^ (_GOLDEN * np.uint64(offspring + 1)))


@compiled
def draw(start: Any, index: Any) -> Any:
    """Return 64 random bits of a stream: splitmix64, a counter that is scrambled, with any index at once."""
    return _scramble(start + _GOLDEN * (np.uint64(index) + _1))


@compiled
def uniform(bits: Any) -> Any:
    """Return a double in [0, 1)."""
    return np.int64(bits >> _11) * _UNIT


@compiled
def below(bits: Any, limit: int) -> Any:
    """Return an integer in [0, limit), from the lower 32 bits; its probability is right to 2**-32."""
    return np.int64(((bits & _LOW32) * np.uint64(limit)) >> _32)


@compiled
def normal(bits: Any) -> Any:
    """Return a float32 of mean 0 and variance 1, nearly normal, never beyond 3.47: a sum of four uniforms."""
    two = (bits & _TWO_LOW16) + ((bits >> _16) & _TWO_LOW16)
    return (np.float32(np.int32((two & _LOW32) + (two >> _32))) - _SUM_MEAN) * _SUM_SCALE


@compiled
def mutate_structure(genes: Any, sizes: Any, start: Any) -> None:
    """Switch one unit of one layer on or off, with equal probability, and only where both are possible.

    Hence the expected number of expressed units stays. A layer with all its units or none is left alone: any
    move there would have a direction. genes: as `cross_units` writes them.
    """
    layer = 1 + below(draw(start, _LAYER), sizes.size - 2)
    begin = 0
    for before in range(1, layer):
        begin += sizes[before]
    end, expressed = begin + sizes[layer], 0
    for unit in range(begin, end):
        expressed += genes[unit]
    if expressed in (0, sizes[layer]):
        return
    bits = draw(start, _FLIP)
    old = bits >> np.uint64(63)
    chosen = below(bits, expressed if old else sizes[layer] - expressed)
    for unit in range(begin, end):
        if genes[unit] == old:
            if chosen == 0:
                genes[unit] = 1 - old
                return
            chosen -= 1


@compiled
def immigrate(rates: Rates, start: Any, children: Any, genes: Any, child: int) -> None:
    """Write an individual as the first population had them."""
    for place in range(np.uint64(children.shape[1])):
        children[child, place] = (2.0 * uniform(draw(start, _WEIGHTS + place)) - 1.0) * rates.weight_first
    for unit in range(np.uint64(genes.shape[1])):
        genes[child, unit] = uniform(draw(start, _UNITS + unit)) < rates.expressed_first


@compiled
def exponential(x: Any) -> Any:
    """Return e to the power of a float32, within +-87: a library's would take longer, since it has to be called.

    It is 2**n e**r, r no more than half of log 2, by a power series; n goes to where a float32 has its exponent.
    """
    x = min(max(x, -_LARGE), _LARGE)
    n = np.rint(x * _LOG2_E)
    r, series = x - n * _LOG_2, _1F
    for divisor in (7, 6, 5, 4, 3, 2, 1):
        series = _1F + series * r * np.float32(1 / divisor)
    return series * np.int32((np.int32(n) + 127) << 23).view(np.float32)


@compiled
def new_step(one: Any, other: Any, rates: Rates, start: Any) -> Any:
    """Return a child's mutation step: the mean of its parents', on a logarithmic scale, changed a little."""
    step = np.sqrt(one * other) * exponential(np.float32(rates.step_rate) * normal(draw(start, _STEP)))
    return np.float32(min(max(step, rates.step_min), rates.step_max))


@compiled
def breed(
    population: Any,
    children: Any,
    task: Evolved,
    numbers: Numbers,
    rates: Rates,
    generation: int,
    begin: int,
    end: int,
    spaces: Spaces,
) -> None:
    """Write the children in the places from begin to end, but not in the elite's.

    They are offspring of the first in the order, all of whom have the same chance, but in the last places immigrants.
    population and children: weights, promoters and steps.
    """
    (weights, promoters, steps), (new_weights, new_promoters, new_steps) = population, children
    order, sizes, key, units = task.order, task.sizes, np.uint64(numbers.key), task.sizes[1:].sum()
    genes, chosen, shares, places = spaces.genes, spaces.chosen, spaces.shares, spaces.places
    threshold, limit = np.uint64(rates.mutation_rate * 2.0**32), np.float32(rates.weight_limit)
    for place in range(max(begin, numbers.elite), min(end, steps.size - numbers.immigrants)):
        start = stream(key, generation, place)
        bits = draw(start, _PARENTS)
        a, b = order[below(bits, numbers.parents)], order[below(bits >> _32, numbers.parents)]
        if uniform(draw(start, _CROSSOVER)) >= rates.crossover_rate:
            b = a
        step = new_step(steps[a], steps[b], rates, start)
        cross_units(promoters, a, b, start, threshold, units, genes, shares, chosen)
        if uniform(draw(start, _STRUCTURE)) < rates.structural_rate:
            mutate_structure(genes, sizes, start)
        write_weights(weights, a, b, sizes, genes, shares, chosen, start, step, limit, new_weights, place, places)
        new_steps[place] = step
        for unit in range(promoters.shape[1]):
            new_promoters[place, unit] = genes[unit]
    for place in range(max(begin, steps.size - numbers.immigrants), end):
        immigrate(rates, stream(key, generation, place), new_weights, new_promoters, place)
        new_steps[place] = rates.step_first
