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

from typing import Any, NamedTuple

import numpy as np

from mdb_services.mechanism.evolution.compiling import compiled
from mdb_services.mechanism.evolution.kernel import VERSION, population_errors

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX1, _MIX2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_0, _1, _8, _11, _16, _27, _30, _31, _32, _40 = (np.uint64(n) for n in (0, 1, 8, 11, 16, 27, 30, 31, 32, 40))
_LOW32, _TWO_LOW16 = np.uint64(0xFFFFFFFF), np.uint64(0x0000FFFF0000FFFF)
_UNIT, _UNIT24 = 2.0**-53, np.float32(2.0**-24)
# The sum of four 16-bit integers has mean 2 * 65535 and standard deviation sqrt((2**32 - 1) / 3).
_SUM_MEAN, _SUM_SCALE = np.float32(131070.0), np.float32((3.0 / (2.0**32 - 1.0)) ** 0.5)
_ZERO, _ONE = np.float32(0), np.float32(1)

# Indices of an offspring's numbers; hidden and output units have one each, and so has each weight.
_PARENTS, _CROSSOVER, _STEP, _STRUCTURE, _LAYER, _FLIP = range(6)
_UNITS, _WEIGHTS = np.uint64(16), np.uint64(2**32)

ROW = 16
"""Numbers written at once: a loop of known length becomes vector instructions throughout."""
_ROW = np.uint64(ROW)


class Settings(NamedTuple):
    """The numbers of `settings.EvolutionConfig` that the compiled code needs."""

    elite: int
    parent_share: float
    crossover_rate: float
    mutation_rate: float
    structural_rate: float
    immigrant_share: float
    expressed_first: float
    weight_first: float
    step_first: float
    step_rate: float
    step_min: float
    step_max: float
    weight_limit: float
    weight_penalty: float
    error_penalty: float


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
def draw_units(start: Any, draws: Any) -> None:
    """Write the bits of each hidden and output unit: the upper half is for crossover, the lower for mutation."""
    for unit in range(np.uint64(draws.size)):
        draws[unit] = draw(start, _UNITS + unit)


@compiled
def cross_promoters(promoters: Any, first: int, second: int, draws: Any, genes: Any, child: int, shares: Any) -> None:
    """Write the promoters of a child, a row of genes, and for each unit the first parent's share of its weights.

    Both parents, rows of promoters, express it: the weights mix. Neither: one parent's unit as it is. One does: its
    weights, and the promoter of either with equal probability, so the expected number of expressed units is the
    parents' mean.
    """
    for unit in range(np.uint64(promoters.shape[1])):
        one, other, bits = promoters[first, unit], promoters[second, unit], draws[unit] >> _32
        coin, part = np.uint8(bits & _1), np.float32(np.int32(bits >> _8)) * _UNIT24
        genes[child, unit] = one if one == other else coin
        alike = part if one else np.float32(coin)
        shares[unit] = alike if one == other else np.float32(one)


@compiled
def cross_weights(sizes: Any, draws: Any, shares: Any, weight_shares: Any) -> None:
    """Write the first parent's share of each weight, given that of every hidden unit; both have `ROW` to spare."""
    place, gene, last = _0, _0, sizes.size - 1
    for layer in range(1, last):
        row = np.uint64(sizes[layer - 1] + 1)
        for _ in range(sizes[layer]):
            for part in range(place, place + row, _ROW):
                for i in range(_ROW):  # what is too many belongs to the next unit, which writes it anew
                    weight_shares[part + i] = shares[gene]
            place += row
            gene += _1
    before = np.uint64(sizes[last - 1])
    for output in range(gene, gene + np.uint64(sizes[last])):
        for part in range(_0, before, _ROW):
            for i in range(_ROW):
                weight_shares[place + part + i] = shares[gene - before + part + i]
        weight_shares[place + before] = np.float32(np.int32(draws[output] >> _40)) * _UNIT24
        place += before + _1


@compiled
def mutate_structure(genes: Any, child: int, sizes: Any, start: Any) -> None:
    """Switch one unit of one layer on or off, with equal probability, and only where both are possible.

    Hence the expected number of expressed units stays. A layer with all its units or none is left alone: any
    move there would have a direction.
    """
    layer = 1 + below(draw(start, _LAYER), sizes.size - 2)
    begin = 0
    for before in range(1, layer):
        begin += sizes[before]
    end, expressed = begin + sizes[layer], 0
    for unit in range(begin, end):
        expressed += genes[child, unit]
    if expressed in (0, sizes[layer]):
        return
    bits = draw(start, _FLIP)
    old = bits >> np.uint64(63)
    chosen = below(bits, expressed if old else sizes[layer] - expressed)
    for unit in range(begin, end):
        if genes[child, unit] == old:
            if chosen == 0:
                genes[child, unit] = 1 - old
                return
            chosen -= 1


@compiled
def mutate_weights(
    genes: Any, child: int, sizes: Any, rate: float, step: Any, start: Any, draws: Any, chosen: Any, changes: Any
) -> None:
    """Choose each expressed unit with the given rate; write what is added to each weight, with `ROW` twice to spare.

    That is a normal number times the step for the weights of chosen units, zero for all others, and zero for weights
    from units that are not expressed: what does not count stays as it is, the memory of old tasks.
    chosen (units of the largest layer,): space to work in.
    """
    changes[:] = _ZERO
    place, gene, last = _0, _0, sizes.size - 1
    threshold = np.uint64(rate * 2.0**32)
    for layer in range(1, sizes.size):
        before, count = np.uint64(sizes[layer - 1]), np.int64(0)
        senders = gene - before
        for _ in range(sizes[layer]):
            chosen[count] = place  # no branch: nobody could foretell it
            expressed = layer == last or genes[child, gene] != 0
            count += np.int64(((draws[gene] & _LOW32) < threshold) & expressed)
            place += before + _1
            gene += _1
        for k in range(count):
            row = chosen[k]
            for part in range(row, row + before + _1, _ROW):
                for i in range(_ROW):
                    changes[part + i] = step * normal(draw(start, _WEIGHTS + part + i))
            for i in range(_ROW):  # what was too many
                changes[row + before + _1 + i] = _ZERO
            if layer > 1:
                for sender in range(before):
                    changes[row + sender] *= np.float32(genes[child, senders + sender])


@compiled
def write_child(
    weights: Any, first: int, second: int, weight_shares: Any, changes: Any, limit: Any, children: Any, child: int
) -> None:
    """Mix the parents' weights and add the changes, within the limit; what is neither is copied exactly."""
    for place in range(np.uint64(children.shape[1])):
        mine, its = weights[first, place], weights[second, place]
        share, change = weight_shares[place], changes[place]
        mixed = mine if share == _ONE else its + share * (mine - its)
        changed = min(max(mixed + change, -limit), limit)
        children[child, place] = changed if change != _ZERO else mixed


@compiled
def immigrate(settings: Settings, start: Any, children: Any, genes: Any, child: int) -> None:
    """Write an individual as the first population had them."""
    for place in range(np.uint64(children.shape[1])):
        children[child, place] = (2.0 * uniform(draw(start, _WEIGHTS + place)) - 1.0) * settings.weight_first
    for unit in range(np.uint64(genes.shape[1])):
        genes[child, unit] = uniform(draw(start, _UNITS + unit)) < settings.expressed_first


@compiled
def _measure(
    weights: Any,
    promoters: Any,
    sizes: Any,
    data: Any,
    penalties: tuple[float, float],
    errors: Any,
    fitness: Any,
    kernel: int = VERSION,  # noqa: ARG001 - see `compiled`
) -> None:
    """Write errors and fitness (the lower the better): the error plus the penalties on squared weights."""
    penalty, share = penalties
    inputs, targets, pairs = data
    weighed = penalty > 0 or share > 0
    squares = fitness if weighed else fitness[:0]
    population_errors(weights, promoters, sizes, inputs, targets, pairs, errors, squares)
    for i in range(errors.size):
        fitness[i] = errors[i] + (penalty + share * errors[i]) * fitness[i] if weighed else errors[i]


@compiled
def find_best(fitness: Any, count: int) -> Any:
    """Return the indices of the best, the best of them first; the lower index first among equals.

    They are count or, when the last has equals, more. Sorting only them takes half the time of sorting all.
    """
    bound = np.partition(fitness, count - 1)[count - 1]
    best = np.flatnonzero(~(fitness > bound))  # so that there are enough even if some are not a number
    return best[np.argsort(fitness[best], kind="mergesort")]


@compiled
def new_step(one: Any, other: Any, settings: Settings, start: Any) -> Any:
    """Return a child's mutation step: the mean of its parents', on a logarithmic scale, changed a little."""
    step = np.sqrt(one * other) * np.exp(np.float32(settings.step_rate) * normal(draw(start, _STEP)))
    return np.float32(min(max(step, settings.step_min), settings.step_max))


@compiled
def _parents(settings: Settings, population: int) -> Any:
    """Return how many of the best may become parents."""
    return max(1, round(settings.parent_share * population))


@compiled
def _breed(
    population: Any, order: Any, sizes: Any, settings: Settings, key: Any, generation: int, children: Any
) -> None:
    """Write offspring of the first in the order, and immigrants in the last places; the elite's places stay."""
    (weights, promoters, steps), (new_weights, genes, new_steps) = population, children
    hidden, room = promoters.shape[1], weights.shape[1] + 2 * ROW
    draws, shares = np.empty(hidden + sizes[-1], np.uint64), np.empty(hidden + ROW, np.float32)
    weight_shares, changes = np.empty(room, np.float32), np.empty(room, np.float32)
    chosen = np.empty(sizes.max(), np.uint64)
    parents = _parents(settings, steps.size)
    immigrants = min(steps.size - settings.elite, round(settings.immigrant_share * steps.size))
    rate, limit = settings.mutation_rate, np.float32(settings.weight_limit)
    for place in range(settings.elite, steps.size - immigrants):
        start = stream(key, generation, place)
        draw_units(start, draws)
        bits = draw(start, _PARENTS)
        a, b = order[below(bits, parents)], order[below(bits >> _32, parents)]
        if uniform(draw(start, _CROSSOVER)) >= settings.crossover_rate:
            b = a
        new_steps[place] = new_step(steps[a], steps[b], settings, start)
        cross_promoters(promoters, a, b, draws, genes, place, shares)
        cross_weights(sizes, draws, shares, weight_shares)
        if uniform(draw(start, _STRUCTURE)) < settings.structural_rate:
            mutate_structure(genes, place, sizes, start)
        mutate_weights(genes, place, sizes, rate, new_steps[place], start, draws, chosen, changes)
        write_child(weights, a, b, weight_shares, changes, limit, new_weights, place)
    for place in range(steps.size - immigrants, steps.size):
        immigrate(settings, stream(key, generation, place), new_weights, genes, place)
        new_steps[place] = settings.step_first


@compiled
def evolve(
    population: Any,
    errors: Any,
    fitness: Any,
    sizes: Any,
    data: Any,
    key: Any,
    generations: Any,
    settings: Settings,
    kernel: int = VERSION,  # noqa: ARG001 - see `compiled`
) -> None:
    """Evolve the population (weights, promoters, steps) in place on data (inputs, targets, pairs).

    generations (first, end) count those of this memory. First everyone is measured on the present memory: an old
    fitness says nothing once the memory changed. In a generation the best few stay, and offspring of the better
    part of the population, all of whose members have the same chance, replace the others but for a few immigrants,
    if their share comes to one: neutral operators cannot bring back what all have lost, say every unit of a layer.
    """
    elite, (first, end) = settings.elite, generations
    penalties = settings.weight_penalty, settings.error_penalty
    _measure(population[0], population[1], sizes, data, penalties, errors, fitness)
    children = population[0].copy(), population[1].copy(), population[2].copy()
    for generation in range(first, end):
        order = find_best(fitness, max(elite, _parents(settings, fitness.size)))
        for place in range(elite):
            children[0][place], children[1][place] = population[0][order[place]], population[1][order[place]]
            children[2][place] = population[2][order[place]]
        _breed(population, order, sizes, settings, key, generation, children)
        errors[:elite], fitness[:elite] = errors[order[:elite]], fitness[order[:elite]]
        population, children = children, population
        _measure(
            population[0][elite:], population[1][elite:], sizes, data, penalties, errors[elite:], fitness[elite:]
        )
    if (end - first) % 2:  # the last generation is in the arrays of this function
        children[0][:], children[1][:], children[2][:] = population
