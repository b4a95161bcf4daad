"""Selection, crossover and mutation of the promoter-based genetic algorithm, compiled.

A unit is a neuron with all its inbound weights and its bias, preceded by a promoter gene that says whether it
is expressed (paper, reference 14; the details below are ours, from memory of the literature). Weights that an
expressed unit sends to the outputs cross over with the sending unit, since they say what its signal means;
between hidden layers they stay with the receiving unit.

*Statistically neutral*: crossover and structural mutation leave the expected number of expressed units exactly
as it is, so only selection changes the size of networks.

Each offspring draws from a stream of its own, a function of (key, generation, offspring), so results depend
neither on threads nor on order.
"""

# ruff: noqa: PLR0917 - compiled functions take arrays by position

from typing import Any, NamedTuple

import numpy as np

from mdb_services.mechanism.kernel import compiled, population_errors

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX1, _MIX2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_27, _30, _31, _11, _16 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(11), np.uint64(16)
_LOW16 = np.uint64(0xFFFF)
_UNIT = 2.0**-53
# The sum of four 16-bit integers has mean 2 * 65535 and standard deviation sqrt((2**32 - 1) / 3).
_SUM_MEAN, _SUM_SCALE = np.float32(131070.0), np.float32((3.0 / (2.0**32 - 1.0)) ** 0.5)


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


@compiled
def _scramble(z: Any) -> Any:
    """Return the output function of splitmix64: every bit depends on every bit of z."""
    z = (z ^ (z >> _30)) * _MIX1
    z = (z ^ (z >> _27)) * _MIX2
    return z ^ (z >> _31)


@compiled
def stream(key: Any, generation: int, offspring: int, state: Any) -> None:
    """Set state (1,) uint64 to the beginning of an offspring's own stream."""
    z = _scramble(np.uint64(key) + _GOLDEN * np.uint64(generation + 1))
    state[0] = _scramble(z ^ (_GOLDEN * np.uint64(offspring + 1)))


@compiled
def draw(state: Any) -> Any:
    """Return the next 64 bits of splitmix64, a counter that is scrambled."""
    state[0] += _GOLDEN
    return _scramble(state[0])


@compiled
def uniform(state: Any) -> Any:
    """Return a double in [0, 1)."""
    return (draw(state) >> _11) * _UNIT


@compiled
def below(state: Any, limit: int) -> Any:
    """Return an integer in [0, limit)."""
    return int(uniform(state) * limit)


@compiled
def normal(state: Any) -> Any:
    """Return a float32 of mean 0 and variance 1, nearly normal, never beyond 3.47: a sum of four uniforms."""
    z = draw(state)
    total = np.float32(z & _LOW16) + np.float32((z >> _16) & _LOW16)
    total += np.float32((z >> np.uint64(32)) & _LOW16) + np.float32(z >> np.uint64(48))
    return (total - _SUM_MEAN) * _SUM_SCALE


@compiled
def cross_promoters(first: Any, second: Any, state: Any, promoters: Any, shares: Any) -> None:
    """Write the child's promoters, and for each unit the first parent's share of its weights.

    Both express it: the weights mix. Neither: one parent's unit as it is. One does: its weights, and the promoter
    of either parent with equal probability, so the expected number of expressed units is the parents' mean.
    """
    for unit in range(first.size):
        if first[unit] == second[unit]:
            promoters[unit] = first[unit]
            shares[unit] = uniform(state) if first[unit] else below(state, 2)
        else:
            promoters[unit] = below(state, 2)
            shares[unit] = first[unit]


@compiled
def cross_weights(first: Any, second: Any, sizes: Any, shares: Any, state: Any, child: Any) -> None:
    """Write the child's weights, given the first parent's share of every hidden unit."""
    offset, gene, sender_gene = 0, 0, 0
    for layer in range(1, sizes.size):
        before, last = sizes[layer - 1], layer == sizes.size - 1
        for unit in range(sizes[layer]):
            own = np.float32(uniform(state)) if last else shares[gene + unit]
            for sender in range(before + 1):
                share = shares[sender_gene + sender] if last and sender < before else own
                child[offset] = second[offset] + share * (first[offset] - second[offset])
                offset += 1
        sender_gene = gene
        gene += sizes[layer]


@compiled
def mutate_structure(promoters: Any, sizes: Any, state: Any) -> None:
    """Switch one unit of one layer on or off, with equal probability, and only where both are possible.

    Hence the expected number of expressed units stays. A layer with all its units or none is left alone: any
    move there would have a direction.
    """
    layer = 1 + below(state, sizes.size - 2)
    start = sizes[1:layer].sum()
    stop = start + sizes[layer]
    expressed = promoters[start:stop].sum()
    if expressed in (0, stop - start):
        return
    old = below(state, 2)
    chosen = below(state, expressed if old else stop - start - expressed)
    for unit in range(start, stop):
        if promoters[unit] == old:
            if chosen == 0:
                promoters[unit] = 1 - old
                return
            chosen -= 1


@compiled
def mutate_weights(child: Any, promoters: Any, sizes: Any, rate: float, step: Any, limit: Any, state: Any) -> None:
    """Choose each expressed unit with the given rate and add normal numbers of the given step to its weights.

    Whatever does not count (units not expressed, weights from them) is left as it is: the memory of old tasks.
    """
    offset, gene, sender_gene = 0, 0, 0
    for layer in range(1, sizes.size):
        before, last = sizes[layer - 1], layer == sizes.size - 1
        for unit in range(sizes[layer]):
            if (last or promoters[gene + unit]) and uniform(state) < rate:
                for sender in range(before + 1):
                    if layer == 1 or sender == before or promoters[sender_gene + sender]:
                        moved = child[offset + sender] + step * normal(state)
                        child[offset + sender] = min(max(moved, -limit), limit)
            offset += before + 1
        sender_gene = gene
        gene += sizes[layer]


@compiled
def _breed(
    population: Any,
    parents: Any,
    sizes: Any,
    settings: Settings,
    state: Any,
    child: Any,
    child_promoters: Any,
    shares: Any,
) -> Any:
    """Write one offspring of two parents, or of one, to child and child_promoters; return its mutation step."""
    weights, promoters, steps = population
    a, b = parents[below(state, parents.size)], parents[below(state, parents.size)]
    if uniform(state) >= settings.crossover_rate:
        b = a
    cross_promoters(promoters[a], promoters[b], state, child_promoters, shares)
    cross_weights(weights[a], weights[b], sizes, shares, state, child)
    step = np.sqrt(steps[a] * steps[b]) * np.exp(np.float32(settings.step_rate) * normal(state))
    step = np.float32(min(max(step, settings.step_min), settings.step_max))
    if uniform(state) < settings.structural_rate:
        mutate_structure(child_promoters, sizes, state)
    limit = np.float32(settings.weight_limit)
    mutate_weights(child, child_promoters, sizes, settings.mutation_rate, step, limit, state)
    return step


@compiled
def immigrate(settings: Settings, state: Any, child: Any, child_promoters: Any) -> Any:
    """Write an individual as the first population had them, and return its mutation step."""
    for gene in range(child.size):
        child[gene] = (2.0 * uniform(state) - 1.0) * settings.weight_first
    for gene in range(child_promoters.size):
        child_promoters[gene] = uniform(state) < settings.expressed_first
    return np.float32(settings.step_first)


@compiled
def _measure(weights: Any, promoters: Any, sizes: Any, data: Any, penalty: float, errors: Any, fitness: Any) -> None:
    """Write errors and fitness (the lower the better): the error plus the penalty on squared weights."""
    inputs, targets, pairs = data
    population_errors(weights, promoters, sizes, inputs, targets, pairs, errors, fitness)
    for i in range(errors.size):
        fitness[i] = errors[i] + penalty * fitness[i]


@compiled
def evolve(
    population: Any, errors: Any, fitness: Any, sizes: Any, data: Any, key: Any, generations: Any, settings: Settings
) -> None:
    """Evolve the population (weights, promoters, steps) in place on data (inputs, targets, pairs).

    generations (first, end) count those of this memory. First everyone is measured on the present memory: an old
    fitness says nothing once the memory changed. In a generation the best few stay, and offspring of the better
    part of the population, all of whose members have the same chance, replace the others but for a few immigrants:
    neutral operators cannot bring back what all have lost, say every unit of a layer.
    """
    weights, promoters, steps = population
    elite, penalty = settings.elite, settings.weight_penalty
    parents = max(1, round(settings.parent_share * steps.size))
    natives = max(elite, steps.size - round(settings.immigrant_share * steps.size))
    _measure(weights, promoters, sizes, data, penalty, errors, fitness)
    new_weights, new_promoters, new_steps = weights.copy(), promoters.copy(), steps.copy()
    shares, state = np.empty(promoters.shape[1], np.float32), np.empty(1, np.uint64)
    for generation in range(generations[0], generations[1]):
        order = np.argsort(fitness, kind="mergesort")
        for place in range(elite):
            kept = order[place]
            new_weights[place], new_promoters[place] = weights[kept], promoters[kept]
            new_steps[place] = steps[kept]
        for place in range(elite, steps.size):
            stream(key, generation, place, state)
            child, genes = new_weights[place], new_promoters[place]
            if place < natives:
                new_steps[place] = _breed(population, order[:parents], sizes, settings, state, child, genes, shares)
            else:
                new_steps[place] = immigrate(settings, state, child, genes)
        errors[:elite], fitness[:elite] = errors[order[:elite]], fitness[order[:elite]]
        weights[:], promoters[:], steps[:] = new_weights, new_promoters, new_steps
        _measure(weights[elite:], promoters[elite:], sizes, data, penalty, errors[elite:], fitness[elite:])
