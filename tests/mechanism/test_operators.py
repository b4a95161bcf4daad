"""Expected numbers are compared with means over many samples, within four standard errors unless said otherwise."""

from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from itertools import pairwise
from time import sleep

import numpy as np
import pytest

from mdb_services.mechanism.evolution.compiled import operators
from mdb_services.mechanism.evolution.compiled.generations import MANY, find_best
from mdb_services.mechanism.evolution.compiled.parts import is_done, is_open, put_up, report, take
from mdb_services.mechanism.evolution.compiled.rows import WEIGHTS, cross_units, write_weights
from mdb_services.mechanism.evolution.genomes import as_pairs
from mdb_services.mechanism.evolution.layout import PUT_UP, ROW, new_board
from mdb_services.mechanism.evolution.population import Population
from mdb_services.mechanism.learners.pbga import PromoterGA
from mdb_services.mechanism.networks.network import Network, Shape, split_layers
from mdb_services.mechanism.settings import EvolutionConfig

SHAPES = [
    Shape(3, (4,), 2),
    Shape(20, (17,), 3),
    Shape(2, (5, 18, 3), 2),
    Shape(15, (16,), 1),
    Shape(1, (33, 35), 17),
    Shape(8, (32, 16, 9), 1),
]


def stream(number: int) -> np.uint64:
    return np.uint64(operators.stream(np.uint64(99), 0, number))


def bits(number: int, count: int) -> list[np.uint64]:
    return [np.uint64(operators.draw(stream(number), index)) for index in range(count)]


def units_of_child(
    shape: Shape, parents: np.ndarray, number: int, rate: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cross two rows of promoters; return genes, shares and chosen as `write_weights` needs them."""
    room, units = sum(shape.sizes) + 2 * ROW, shape.units + shape.outputs
    genes, shares, chosen = np.ones(room, np.uint8), np.zeros(room, np.float32), np.zeros(room, np.uint8)
    cross_units(parents, 0, 1, stream(number), np.uint64(rate * 2**32), units, genes, shares, chosen)
    return genes, shares, chosen


def count_after_crossover(parents: np.ndarray, trials: int) -> np.ndarray:
    shape, counts = Shape(1, (parents.shape[1],), 1), np.empty(trials)
    for trial in range(trials):
        counts[trial] = units_of_child(shape, parents, trial)[0][: shape.units].sum()
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
        genes = (np.arange(8) < expressed).astype(np.uint8)
        operators.mutate_structure(genes, sizes, stream(trial))
        counts[trial] = genes.sum()
    assert counts.min() >= 0
    assert counts.max() <= 8
    assert abs(counts.mean() - expressed) < 4 / np.sqrt(counts.size)
    assert (counts != expressed).any() == (expressed not in (0, 8))


def test_structural_mutation_reaches_every_unit_of_every_layer() -> None:
    sizes, flipped = np.array([2, 4, 3, 1]), np.zeros(7, dtype=bool)
    start = np.array([1, 0, 1, 0, 1, 0, 0], dtype=np.uint8)
    for number in range(500):
        genes = start.copy()
        operators.mutate_structure(genes, sizes, stream(number))
        assert (genes != start).sum() == 1
        flipped |= genes != start
    assert flipped.all()


def evolved(
    shape: Shape,
    config: EvolutionConfig,
    generations: int | tuple[int, ...],
    seed: int = 0,
    helpers: int | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evolve a random population on pairs that tell nothing; several generations in one call or in several."""
    random = np.random.default_rng(seed)
    weights = random.uniform(-1, 1, (config.population, shape.weights)).astype(np.float32)
    promoters = random.integers(0, 2, (config.population, shape.units)).astype(np.uint8)
    steps = np.full(config.population, config.step_first, np.float32)
    errors, fitness = np.empty(config.population), np.empty(config.population)
    inputs, targets = random.uniform(-1, 1, (20, shape.inputs)), random.uniform(-1, 1, (20, shape.outputs))
    first, pairs = 0, as_pairs(inputs, targets)
    population = Population(shape, config, (weights, promoters, steps), errors, fitness)
    for count in (generations,) if isinstance(generations, int) else generations:
        population.evolve(pairs, seed, range(first, first + count), helpers)
        first += count
    return weights, promoters, steps


@pytest.mark.parametrize("shape", SHAPES)
def test_without_selection_the_expected_number_of_expressed_units_stays(shape: Shape) -> None:
    config = EvolutionConfig(
        population=4000, elite=1, parent_share=1.0, immigrant_share=0.0, crossover_rate=0.7, structural_rate=1.0
    )
    before, after = (evolved(shape, config, count)[1].sum(axis=1) for count in (0, 1))
    # The parents are a sample of all, and the operators add some variance to theirs: at most their own again.
    error = np.sqrt(2 * before.var() / config.population)
    assert abs(after.mean() - before.mean()) < 4 * error


def test_the_exponential_is_right_to_a_few_roundings_of_its_argument() -> None:
    for x in np.linspace(-87, 87, 20_001, dtype=np.float32):
        assert operators.exponential(x) == pytest.approx(np.exp(float(x)), rel=1e-7 * (4 + abs(float(x))))
    assert operators.exponential(np.float32(0)) == 1
    assert np.isfinite(operators.exponential(np.float32(1e9)))


def child_of(
    shape: Shape,
    weights: np.ndarray,
    units: tuple[np.ndarray, ...],
    number: int = 0,
    *,
    step: float = 0,
    limit: float = 9,
) -> np.ndarray:
    """Return the weights of a child; nothing is written beyond them."""
    children, places = np.full((3, shape.weights), 77, np.float32), np.empty(max(shape.sizes), np.uint64)
    sizes, numbers = np.array(shape.sizes), (stream(number), np.float32(step), np.float32(limit))
    write_weights(weights, 0, 1, sizes, *units, *numbers, children, 1, places)
    assert (children[[0, 2]] == 77).all()
    return children[1]


def crossed(shape: Shape, parents: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Cross parents whose weights are all 1 and all 0, so that a child's weight is the first parent's share."""
    weights = np.stack([np.ones(shape.weights, np.float32), np.zeros(shape.weights, np.float32)])
    units = units_of_child(shape, parents, number)
    return units[0][: shape.units], child_of(shape, weights, units)


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


@pytest.mark.parametrize("shape", SHAPES)
def test_what_both_parents_share_and_what_comes_from_one_is_copied_exactly(shape: Shape) -> None:
    random = np.random.default_rng(0)
    weights = random.normal(size=(2, shape.weights)).astype(np.float32)
    weights[1, ::3] = weights[0, ::3]
    units = units_of_child(shape, random.integers(0, 2, (2, shape.units)).astype(np.uint8), 3)
    child = child_of(shape, weights, units)
    assert np.array_equal(child[::3], weights[0, ::3])
    for first in (0, 1):
        units[1][:] = first
        assert np.array_equal(child_of(shape, weights, units), weights[1 - first])


def changed(shape: Shape, genes: np.ndarray, rate: float, step: float, number: int) -> np.ndarray:
    """Return what is added to the weights of a child whose parents are alike and have weights of zero."""
    units = units_of_child(shape, np.stack([genes, genes]), number, rate)
    return child_of(shape, np.zeros((2, shape.weights), np.float32), units, number, step=step)


@pytest.mark.parametrize("shape", SHAPES)
def test_each_weight_has_a_number_of_its_own_that_does_not_lead_beyond_the_limit(shape: Shape) -> None:
    genes, zeros = np.ones(shape.units, np.uint8), np.zeros((2, shape.weights), np.float32)
    indices = np.uint64(WEIGHTS) + np.arange(shape.weights, dtype=np.uint64)
    drawn = [operators.normal(np.uint64(operators.draw(stream(5), index))) for index in indices]
    np.testing.assert_allclose(changed(shape, genes, 1.0, 0.5, 5), 0.5 * np.array(drawn), rtol=1e-6, atol=1e-7)
    units = units_of_child(shape, np.stack([genes, genes]), 5, 1.0)
    limited = child_of(shape, zeros, units, 5, step=0.5, limit=0.25)
    np.testing.assert_allclose(limited, np.clip(0.5 * np.array(drawn), -0.25, 0.25), rtol=1e-6, atol=1e-7)


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


def best_of(fitness: np.ndarray, count: int) -> list[int]:
    order, *spaces = (np.zeros(fitness.size + 1, np.int64) for _ in range(4))
    found = find_best(fitness, count, order, *spaces)
    assert count <= found <= fitness.size
    return order[:found].tolist()


@pytest.mark.parametrize("count", [1, 7, 60])
def test_the_best_come_first_and_among_equals_the_lower_index(count: int) -> None:
    fitness = np.round(np.random.default_rng(0).normal(size=60) * 9) + 0.0  # no zero has a sign
    assert best_of(fitness, count)[:count] == np.argsort(fitness, kind="stable")[:count].tolist()
    fitness[:] = np.nan
    assert best_of(fitness, count) == list(range(60))


@pytest.mark.parametrize("count", [MANY, MANY + 1, 3 * MANY + 5])
def test_the_best_of_many_come_first_and_among_equals_the_lower_index(count: int) -> None:
    fitness = np.round(np.random.default_rng(0).normal(size=4 * MANY) * MANY) + 0.0
    assert best_of(fitness, count)[:count] == np.argsort(fitness, kind="stable")[:count].tolist()


def test_who_errs_by_no_number_is_nobody_s_best() -> None:
    shape, config = Shape(1, (1,), 1), EvolutionConfig(population=20)
    learner = PromoterGA(shape, config, 0, "test")
    learner.seed(
        [Network([np.array([[3e38, 0]]), np.array([[1, 0]])]), Network([np.array([[-3e38, 0]]), np.array([[1, 0]])])]
    )
    rows = np.array([[0.0], [1.0]], np.float32)
    assert np.isfinite(learner.learn(rows, rows, version=0, generations=3).error)
    assert not np.isnan(learner.state()["fitness"]).any()


@pytest.mark.parametrize("shape", SHAPES)
def test_same_key_gives_the_same_population_in_one_call_or_in_several(shape: Shape) -> None:
    config = EvolutionConfig(population=50)
    once, again, parts = (evolved(shape, config, count) for count in (5, 5, (2, 3)))
    for left, middle, right in zip(once, again, parts, strict=True):
        assert np.array_equal(left, middle)
        assert np.array_equal(left, right)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("generations", [0, 7, 8])
def test_threads_that_share_a_population_give_the_same_bits(shape: Shape, generations: int) -> None:
    config = EvolutionConfig(population=333, immigrant_share=0.3)
    alone, shared = (evolved(shape, config, generations, helpers=helpers) for helpers in (0, 2))
    for left, right in zip(alone, shared, strict=True):
        assert np.array_equal(left, right)


def test_a_copy_of_a_learner_learns_the_same_and_leaves_the_other_alone() -> None:
    random = np.random.default_rng(0)
    rows = random.normal(size=(30, 3)).astype(np.float32), random.normal(size=(30, 2)).astype(np.float32)
    learner = PromoterGA(Shape(3, (5,), 2), EvolutionConfig(population=30), 0, "test")
    learner.learn(*rows, version=0)
    before, copied = learner.state(), deepcopy(learner)
    errors = [copied.learn(*rows, version=1).error]
    assert all(np.array_equal(array, before[name]) for name, array in learner.state().items())
    errors.append(learner.learn(*rows, version=1).error)
    assert errors[0] == errors[1]


def test_a_population_takes_no_arrays_of_other_sizes_or_that_cannot_be_written() -> None:
    shape, config = SHAPES[0], EvolutionConfig(population=9)
    arrays = [np.zeros((9, shape.weights), np.float32), np.zeros((9, shape.units), np.uint8), np.zeros(9, np.float32)]
    numbers = np.zeros(9)
    for place, wrong in ((0, arrays[0][1:]), (1, arrays[1][:, 1:].copy()), (0, arrays[0].astype(np.float64))):
        given = tuple(wrong if place == number else array for number, array in enumerate(arrays))
        with pytest.raises(ValueError, match=r"sizes|expected"):
            Population(shape, config, given, numbers, numbers.copy())
    arrays[0].setflags(write=False)
    with pytest.raises(ValueError, match="written"):
        Population(shape, config, tuple(arrays), numbers, numbers.copy())


def test_each_part_is_taken_once_until_there_will_be_no_more() -> None:
    board, taken = new_board(), []

    def work() -> None:
        while is_open(board):
            if (number := take(board)) >= 0:
                taken.append(number)
                report(board)

    with ThreadPoolExecutor(3) as threads:
        for _ in range(3):
            threads.submit(work)
        for last in (100, 150):
            put_up(board, last - board[PUT_UP])
            while not is_done(board):
                sleep(0.001)
            assert sorted(taken) == list(range(last))
        board[PUT_UP] = -1


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
