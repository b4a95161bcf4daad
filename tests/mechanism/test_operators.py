import numpy as np
import pytest

from mdb_services.mechanism import operators
from mdb_services.mechanism.network import Shape, split_layers


def stream(number: int) -> np.ndarray:
    state = np.empty(1, dtype=np.uint64)
    operators.stream(np.uint64(99), 0, number, state)
    return state


def count_after_crossover(first: np.ndarray, second: np.ndarray, trials: int) -> np.ndarray:
    promoters, shares = np.empty_like(first), np.empty(first.size, dtype=np.float32)
    counts = np.empty(trials)
    state = stream(1)
    for trial in range(trials):
        operators.cross_promoters(first, second, state, promoters, shares)
        counts[trial] = promoters.sum()
    return counts


def test_crossover_keeps_the_expected_number_of_expressed_units() -> None:
    random = np.random.default_rng(0)
    for _ in range(5):
        first, second = random.integers(0, 2, (2, 12)).astype(np.uint8)
        counts = count_after_crossover(first, second, 4000)
        spread = counts.std() / np.sqrt(counts.size) + 1e-9
        assert abs(counts.mean() - (first.sum() + second.sum()) / 2) < 4 * spread


@pytest.mark.parametrize("expressed", [0, 1, 3, 7, 8])
def test_structural_mutation_keeps_the_expected_number_of_expressed_units(expressed: int) -> None:
    sizes, state, counts = np.array([2, 8, 1]), stream(2), np.empty(8000)
    for trial in range(counts.size):
        promoters = (np.arange(8) < expressed).astype(np.uint8)
        operators.mutate_structure(promoters, sizes, state)
        counts[trial] = promoters.sum()
    assert counts.min() >= 0
    assert counts.max() <= 8
    assert abs(counts.mean() - expressed) < 4 / np.sqrt(counts.size)
    assert (counts != expressed).any() == (expressed not in (0, 8))


def test_structural_mutation_reaches_every_unit_of_every_layer() -> None:
    sizes, state, flipped = np.array([2, 4, 3, 1]), stream(3), np.zeros(7, dtype=bool)
    start = np.array([1, 0, 1, 0, 1, 0, 0], dtype=np.uint8)
    for _ in range(500):
        promoters = start.copy()
        operators.mutate_structure(promoters, sizes, state)
        assert (promoters != start).sum() == 1
        flipped |= promoters != start
    assert flipped.all()


def crossed(shape: Shape, first: np.ndarray, second: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Cross parents whose weights are all 1 and all 0, so that a child's weight is the first parent's share."""
    sizes, state = np.array(shape.sizes), stream(number)
    promoters, shares = np.empty(shape.units, np.uint8), np.empty(shape.units, np.float32)
    operators.cross_promoters(first, second, state, promoters, shares)
    child = np.empty(shape.weights, dtype=np.float32)
    ones, zeros = np.ones(shape.weights, np.float32), np.zeros(shape.weights, np.float32)
    operators.cross_weights(ones, zeros, sizes, shares, state, child)
    return promoters, child


def test_unit_of_one_expressing_parent_comes_whole_from_it_with_its_outward_weights() -> None:
    shape = Shape(3, (4,), 2)
    first, second = np.array([1, 0, 1, 0], np.uint8), np.array([0, 1, 1, 0], np.uint8)
    for number in range(50):
        promoters, child = crossed(shape, first, second, number)
        hidden, outputs = split_layers(shape.sizes, child)
        assert (hidden[0] == 1).all()
        assert (outputs[:, 0] == 1).all()
        assert (hidden[1] == 0).all()
        assert (outputs[:, 1] == 0).all()
        assert np.unique(hidden[2]).size == 1  # both express it: mixed, with one share for the whole unit
        assert (outputs[:, 2] == hidden[2, 0]).all()
        assert hidden[3, 0] in (0, 1)  # neither: a copy of one parent's
        assert promoters[2:].tolist() == [1, 0]


def test_parametric_mutation_leaves_what_is_not_expressed() -> None:
    shape = Shape(2, (4,), 1)
    promoters = np.array([1, 0, 1, 0], dtype=np.uint8)
    child = np.zeros(shape.weights, dtype=np.float32)
    for number in range(20):
        operators.mutate_weights(
            child, promoters, np.array(shape.sizes), 1.0, np.float32(0.5), np.float32(1), stream(number)
        )
    hidden, outputs = split_layers(shape.sizes, child)
    assert (hidden[[1, 3]] == 0).all()
    assert (hidden[[0, 2]] != 0).all()
    assert (outputs != 0).tolist() == [[True, False, True, False, True]]
    assert np.abs(child).max() <= 1


def test_normal_numbers_have_mean_zero_and_variance_one() -> None:
    state = stream(5)
    numbers = np.array([operators.normal(state) for _ in range(40_000)])
    assert abs(numbers.mean()) < 0.02
    assert abs(numbers.var() - 1) < 0.03
    assert np.abs(numbers).max() < 3.47


def test_offspring_have_streams_of_their_own() -> None:
    firsts = {int(operators.draw(stream(number))) for number in range(1000)}
    assert len(firsts) == 1000
