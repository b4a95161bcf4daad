"""Expected numbers are compared with means over many samples, within four standard errors unless said otherwise."""

from itertools import pairwise

import numpy as np
import pytest

from mdb_services.mechanism.evolution import operators
from mdb_services.mechanism.evolution.genomes import in_blocks
from mdb_services.mechanism.evolution.kernel import VERSION
from mdb_services.mechanism.evolution.operators import ROW, Settings
from mdb_services.mechanism.networks.network import Shape, split_layers
from mdb_services.mechanism.settings import EvolutionConfig

SHAPES = [Shape(3, (4,), 2), Shape(20, (17,), 3), Shape(2, (5, 18, 3), 2)]


def stream(number: int) -> np.uint64:
    return np.uint64(operators.stream(np.uint64(99), 0, number))


def bits(number: int, count: int) -> np.ndarray:
    draws = np.empty(count, dtype=np.uint64)
    operators.draw_units(stream(number), draws)
    return draws


def drawn(shape: Shape, number: int) -> np.ndarray:
    return bits(number, shape.units + shape.outputs)


def settings_of(config: EvolutionConfig) -> Settings:
    return Settings(**{name: getattr(config, name) for name in Settings._fields})


def count_after_crossover(parents: np.ndarray, trials: int) -> np.ndarray:
    units = parents.shape[1]
    genes, shares, counts = np.empty((1, units), np.uint8), np.empty(units + ROW, np.float32), np.empty(trials)
    for trial in range(trials):
        operators.cross_promoters(parents, 0, 1, drawn(Shape(1, (units,), 1), trial), genes, 0, shares)
        counts[trial] = genes.sum()
    return counts


def test_crossover_keeps_the_expected_number_of_expressed_units() -> None:
    random = np.random.default_rng(0)
    for _ in range(5):
        parents = random.integers(0, 2, (2, 12)).astype(np.uint8)
        counts = count_after_crossover(parents, 8000)
        spread = counts.std() / np.sqrt(counts.size) + 1e-9
        assert abs(counts.mean() - parents.sum() / 2) < 4 * spread


@pytest.mark.parametrize("expressed", [0, 1, 3, 7, 8])
def test_structural_mutation_keeps_the_expected_number_of_expressed_units(expressed: int) -> None:
    sizes, counts = np.array([2, 8, 1]), np.empty(8000)
    for trial in range(counts.size):
        genes = (np.arange(8) < expressed).astype(np.uint8)[None]
        operators.mutate_structure(genes, 0, sizes, stream(trial))
        counts[trial] = genes.sum()
    assert counts.min() >= 0
    assert counts.max() <= 8
    assert abs(counts.mean() - expressed) < 4 / np.sqrt(counts.size)
    assert (counts != expressed).any() == (expressed not in (0, 8))


def test_structural_mutation_reaches_every_unit_of_every_layer() -> None:
    sizes, flipped = np.array([2, 4, 3, 1]), np.zeros(7, dtype=bool)
    start = np.array([[1, 0, 1, 0, 1, 0, 0]], dtype=np.uint8)
    for number in range(500):
        genes = start.copy()
        operators.mutate_structure(genes, 0, sizes, stream(number))
        assert (genes != start).sum() == 1
        flipped |= (genes != start)[0]
    assert flipped.all()


def evolved(
    shape: Shape, config: EvolutionConfig, generations: int | tuple[int, ...], seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evolve a random population on pairs that tell nothing; several generations in one call or in several."""
    random = np.random.default_rng(seed)
    weights = random.uniform(-1, 1, (config.population, shape.weights)).astype(np.float32)
    promoters = random.integers(0, 2, (config.population, shape.units)).astype(np.uint8)
    steps = np.full(config.population, config.step_first, np.float32)
    errors, fitness = np.empty(config.population), np.empty(config.population)
    inputs, targets = random.uniform(-1, 1, (20, shape.inputs)), random.uniform(-1, 1, (20, shape.outputs))
    data = (in_blocks(inputs), in_blocks(targets), len(inputs))
    first, sizes, population = 0, np.array(shape.sizes), (weights, promoters, steps)
    for count in (generations,) if isinstance(generations, int) else generations:
        span = (first, first + count)
        operators.evolve(population, errors, fitness, sizes, data, np.uint64(seed), span, settings_of(config))
        first += count
    return population


@pytest.mark.parametrize("shape", SHAPES)
def test_without_selection_the_expected_number_of_expressed_units_stays(shape: Shape) -> None:
    config = EvolutionConfig(
        population=4000, elite=1, parent_share=1.0, immigrant_share=0.0, crossover_rate=0.7, structural_rate=1.0
    )
    before, after = (evolved(shape, config, count)[1].sum(axis=1) for count in (0, 1))
    # The parents are a sample of all, and the operators add some variance to theirs: at most their own again.
    error = np.sqrt(2 * before.var() / config.population)
    assert abs(after.mean() - before.mean()) < 4 * error


def crossed(shape: Shape, parents: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Cross parents whose weights are all 1 and all 0, so that a child's weight is the first parent's share."""
    draws, sizes = drawn(shape, number), np.array(shape.sizes)
    genes, shares = np.empty((1, shape.units), np.uint8), np.zeros(shape.units + ROW, np.float32)
    weight_shares = np.empty(shape.weights + 2 * ROW, np.float32)
    operators.cross_promoters(parents, 0, 1, draws, genes, 0, shares)
    operators.cross_weights(sizes, draws, shares, weight_shares)
    weights = np.stack([np.ones(shape.weights, np.float32), np.zeros(shape.weights, np.float32)])
    child = np.empty((1, shape.weights), dtype=np.float32)
    operators.write_child(weights, 0, 1, weight_shares, np.zeros_like(weight_shares), np.float32(1), child, 0)
    return genes[0], child[0]


def test_unit_of_one_expressing_parent_comes_whole_from_it_with_its_outward_weights() -> None:
    parents = np.array([[1, 0, 1, 0], [0, 1, 1, 0]], np.uint8)
    for number in range(50):
        promoters, child = crossed(SHAPES[0], parents, number)
        hidden, outputs = split_layers(SHAPES[0].sizes, child)
        assert (hidden[0] == 1).all()
        assert (outputs[:, 0] == 1).all()
        assert (hidden[1] == 0).all()
        assert (outputs[:, 1] == 0).all()
        assert np.unique(hidden[2]).size == 1  # both express it: mixed, with one share for the whole unit
        assert (outputs[:, 2] == hidden[2, 0]).all()
        assert hidden[3, 0] in (0, 1)  # neither: a copy of one parent's
        assert promoters[2:].tolist() == [1, 0]


@pytest.mark.parametrize("shape", SHAPES)
def test_each_unit_has_one_share_and_a_last_hidden_unit_takes_its_outward_weights_along(shape: Shape) -> None:
    parents = np.random.default_rng(1).integers(0, 2, (2, shape.units)).astype(np.uint8)
    _, child = crossed(shape, parents, 7)
    *hidden, outputs = split_layers(shape.sizes, child)
    assert ((child >= 0) & (child <= 1)).all()
    for layer in hidden:
        assert (layer == layer[:, :1]).all()
    assert (outputs[:, :-1] == hidden[-1][:, 0]).all()


def test_what_both_parents_share_and_what_comes_from_one_is_copied_exactly() -> None:
    weights = np.random.default_rng(0).normal(size=(2, 50)).astype(np.float32)
    weights[1, :20] = weights[0, :20]
    shares = np.random.default_rng(1).random(50, dtype=np.float32)
    shares[20:30], shares[30:40] = 0, 1
    child = np.empty((1, 50), np.float32)
    operators.write_child(weights, 0, 1, shares, np.zeros(50, np.float32), np.float32(0.1), child, 0)
    assert np.array_equal(child[0, :20], weights[0, :20])
    assert np.array_equal(child[0, 20:30], weights[1, 20:30])
    assert np.array_equal(child[0, 30:40], weights[0, 30:40])


def changed(shape: Shape, genes: np.ndarray, rate: float, step: float, number: int) -> np.ndarray:
    changes, chosen = np.full(shape.weights + 2 * ROW, np.nan, np.float32), np.empty(max(shape.sizes), np.uint64)
    draws, sizes = drawn(shape, number), np.array(shape.sizes)
    operators.mutate_weights(genes[None], 0, sizes, rate, np.float32(step), stream(number), draws, chosen, changes)
    return changes[: shape.weights]


@pytest.mark.parametrize("shape", SHAPES)
def test_parametric_mutation_leaves_what_is_not_expressed_and_changes_all_else(shape: Shape) -> None:
    genes = np.random.default_rng(0).integers(0, 2, shape.units).astype(np.uint8)
    splits = np.split(genes, np.cumsum(shape.hidden)[:-1])
    receivers = [*splits, np.ones(shape.outputs, np.uint8)]
    senders = [np.ones(shape.inputs, np.uint8), *splits]
    total = np.zeros(shape.weights)
    for number in range(20):
        total += np.abs(changed(shape, genes, 1.0, 0.5, number))
    for layer, received, sent in zip(split_layers(shape.sizes, total), receivers, senders, strict=True):
        expected = np.outer(received, np.append(sent, 1))
        assert np.array_equal(layer > 0, expected > 0)


@pytest.mark.parametrize("shape", SHAPES)
def test_parametric_mutation_chooses_whole_units_at_its_rate_with_its_step(shape: Shape) -> None:
    genes, trials, rate, step = np.ones(shape.units, np.uint8), 1000, 0.25, 0.3
    changes = np.stack([changed(shape, genes, rate, step, number) for number in range(trials)])
    starts = np.concatenate([[0], np.cumsum(np.repeat([n + 1 for n in shape.sizes[:-1]], shape.sizes[1:]))])
    chosen = np.stack([(changes[:, start:stop] != 0).any(axis=1) for start, stop in pairwise(starts)], axis=1)
    assert abs(chosen.mean() - rate) < 4 * np.sqrt(rate * (1 - rate) / chosen.size)
    numbers = changes[changes != 0] / step
    assert abs(numbers.mean()) < 4 / np.sqrt(numbers.size)
    assert abs(numbers.var() - 1) < 4 * np.sqrt(2 / numbers.size)


def test_normal_numbers_have_mean_zero_and_variance_one() -> None:
    numbers = np.array([operators.normal(one) for one in bits(5, 40_000)])
    assert abs(numbers.mean()) < 4 / np.sqrt(numbers.size)
    assert abs(numbers.var() - 1) < 4 * np.sqrt(2 / numbers.size)
    assert np.abs(numbers).max() < 3.47


def test_integers_below_a_limit_are_all_alike() -> None:
    numbers = [operators.below(one, 7) for one in bits(6, 14_000)]
    counts = np.bincount(numbers, minlength=7)
    assert counts.size == 7
    assert np.abs(counts - 2000).max() < 4 * np.sqrt(2000)


def test_offspring_and_generations_have_streams_of_their_own() -> None:
    key = np.uint64(99)
    starts = {int(operators.stream(key, generation, place)) for generation in range(30) for place in range(100)}
    assert len(starts) == 3000
    assert np.unique(bits(1, 1000)).size == 1000


@pytest.mark.parametrize("count", [1, 7, 60])
def test_the_best_come_first_and_among_equals_the_lower_index(count: int) -> None:
    fitness = np.round(np.random.default_rng(0).random(60) * 9)
    best = operators.find_best(fitness, count)
    assert best[:count].tolist() == np.argsort(fitness, kind="stable")[:count].tolist()
    fitness[:] = np.nan
    assert operators.find_best(fitness, count).size >= count


@pytest.mark.parametrize("shape", SHAPES)
def test_same_key_gives_the_same_population_in_one_call_or_in_several(shape: Shape) -> None:
    config = EvolutionConfig(population=50)
    once, again, parts = (evolved(shape, config, count) for count in (5, 5, (2, 3)))
    for left, middle, right in zip(once, again, parts, strict=True):
        assert np.array_equal(left, middle)
        assert np.array_equal(left, right)


def test_sizes_and_bounds_of_a_population_are_kept() -> None:
    config = EvolutionConfig(
        population=60, weight_limit=1.5, step_first=0.9, step_max=1.0, step_min=0.5, weight_penalty=1e-3
    )
    for shape in SHAPES:
        weights, promoters, steps = evolved(shape, config, 20)
        assert weights.shape == (60, shape.weights)
        assert np.abs(weights).max() <= 1.5
        assert promoters.max() <= 1
        assert 0.5 <= steps.min() <= steps.max() <= 1.0


def test_compiled_code_is_kept_under_the_version_of_the_kernel_it_contains() -> None:
    evolved(SHAPES[0], EvolutionConfig(population=10), 1)
    assert all(f"omitted(default={VERSION})" in str(signature) for signature in operators.evolve.signatures)
