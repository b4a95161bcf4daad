import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_services.mechanism.evolution.genomes import Measure, in_blocks
from mdb_services.mechanism.evolution.layout import BLOCK, GROUP, LANES, TANH_ERROR
from mdb_services.mechanism.networks.network import Shape
from tests.mechanism.reference import reference_errors

shapes = st.builds(
    Shape, st.integers(1, 9), st.lists(st.integers(1, 9), min_size=1, max_size=3).map(tuple), st.integers(1, 4)
)
PAIRS = LANES // GROUP
around_blocks = [
    PAIRS - 1,
    PAIRS,
    PAIRS + 1,
    2 * PAIRS,
    2 * PAIRS + 1,
    BLOCK - 1,
    BLOCK,
    BLOCK + 1,
    3 * BLOCK,
    3 * BLOCK + PAIRS + 1,
]
ROUGH = 100 * TANH_ERROR
"""What the errors of tanh may come to in an output, after up to three layers: weights are added up."""
pair_counts = st.one_of(st.integers(1, 200), st.sampled_from(around_blocks))


def measured(weights, promoters, shape, inputs, targets):
    errors, squares = np.empty(len(weights)), np.empty(len(weights))
    Measure(shape, inputs, targets).write(weights, promoters, errors, squares)
    return errors, squares


def case(shape, pairs, seed, population=7):
    random = np.random.default_rng(seed)
    weights = random.normal(0, 1.5, (population, shape.weights)).astype(np.float32)
    promoters = random.integers(0, 2, (population, shape.units)).astype(np.uint8)
    inputs = random.uniform(-1.5, 1.5, (pairs, shape.inputs)).astype(np.float32)
    targets = random.uniform(-1, 1, (pairs, shape.outputs)).astype(np.float32)
    return weights, promoters, inputs, targets


@settings(max_examples=150, deadline=None)
@given(shapes, pair_counts, st.integers(0, 10**6))
def test_agrees_with_the_reference(shape: Shape, pairs: int, seed: int) -> None:
    weights, promoters, inputs, targets = case(shape, pairs, seed)
    errors, _ = measured(weights, promoters, shape, inputs, targets)
    expected = reference_errors(weights, promoters, shape.sizes, inputs, targets)
    np.testing.assert_allclose(np.sqrt(errors), np.sqrt(expected), atol=ROUGH)


@settings(max_examples=60, deadline=None)
@given(shapes, pair_counts, st.integers(0, 10**6), st.data())
def test_agrees_with_the_reference_when_whole_layers_are_silent_or_expressed(
    shape: Shape, pairs: int, seed: int, data: st.DataObject
) -> None:
    weights, promoters, inputs, targets = case(shape, pairs, seed)
    layer = data.draw(st.integers(0, len(shape.hidden) - 1))
    start = sum(shape.hidden[:layer])
    promoters[:3, start : start + shape.hidden[layer]] = 0
    promoters[3], promoters[4] = 0, 1
    errors, squares = measured(weights, promoters, shape, inputs, targets)
    expected = reference_errors(weights, promoters, shape.sizes, inputs, targets)
    np.testing.assert_allclose(np.sqrt(errors), np.sqrt(expected), atol=ROUGH)
    assert squares[4] == pytest.approx(np.sum(weights[4].astype(float) ** 2), rel=1e-5)


@settings(max_examples=30, deadline=None)
@given(shapes, st.integers(0, 10**6))
def test_genes_that_are_not_expressed_do_not_matter(shape: Shape, seed: int) -> None:
    weights, promoters, inputs, targets = case(shape, 20, seed)
    changed, start, gene = weights.copy(), 0, 0
    for before, units in zip(shape.sizes, shape.hidden, strict=False):
        for unit in range(units):
            silent = promoters[:, gene + unit] == 0
            rows = slice(start + unit * (before + 1), start + (unit + 1) * (before + 1))
            changed[silent, rows] = 77
        start, gene = start + units * (before + 1), gene + units
    for left, right in zip(
        measured(weights, promoters, shape, inputs, targets),
        measured(changed, promoters, shape, inputs, targets),
        strict=True,
    ):
        assert np.array_equal(left, right)


def test_large_weights_and_inputs_stay_finite_and_right() -> None:
    shape = Shape(3, (5, 4), 2)
    weights, promoters, inputs, targets = case(shape, 40, 3)
    weights *= 1000
    errors, _ = measured(weights, promoters, shape, inputs * 1000, targets)
    expected = reference_errors(weights, promoters, shape.sizes, inputs * 1000, targets)
    np.testing.assert_allclose(errors, expected, rtol=1e-4)


def test_a_weight_that_is_not_a_number_shows_in_the_error() -> None:
    shape = Shape(2, (3,), 1)
    weights, promoters, inputs, targets = case(shape, 20, 3)
    weights[2, 0], promoters[:] = math.nan, 1
    errors, _ = measured(weights, promoters, shape, inputs, targets)
    assert np.isnan(errors).tolist() == [False, False, True, False, False, False, False]


def test_sum_of_squares_counts_expressed_weights_only() -> None:
    shape = Shape(1, (2,), 1)  # unit a: 1, 2; unit b: 3, 4; output: 5 (a), 6 (b), 7 (bias)
    weights = np.array([[1, 2, 3, 4, 5, 6, 7]], dtype=np.float32)
    rows = np.zeros((1, 1), dtype=np.float32)
    _, squares = measured(weights, np.array([[0, 1]], dtype=np.uint8), shape, rows, rows)
    assert squares[0] == 3**2 + 4**2 + 6**2 + 7**2


def test_same_input_gives_the_same_bits() -> None:
    shape = Shape(4, (14,), 3)
    arguments = case(shape, 400, 1, population=20)
    first, _ = measured(*arguments[:2], shape, *arguments[2:])
    again, _ = measured(*arguments[:2], shape, *arguments[2:])
    assert np.array_equal(first, again)


def test_threads_that_share_a_population_by_rows_give_the_same_bits() -> None:
    shape = Shape(4, (14,), 3)
    weights, promoters, inputs, targets = case(shape, 200, 1, population=501)
    whole, squares = measured(weights, promoters, shape, inputs, targets)
    with ThreadPoolExecutor(2) as threads:
        rows = (slice(0, 100), slice(100, 501))
        parts = list(threads.map(lambda part: measured(weights[part], promoters[part], shape, inputs, targets), rows))
    assert np.array_equal(np.concatenate([errors for errors, _ in parts]), whole)
    assert np.array_equal(np.concatenate([squares for _, squares in parts]), squares)


def test_a_genome_s_error_depends_on_no_other_genome() -> None:
    shape = Shape(8, (32, 16, 9), 1)
    weights, promoters, inputs, targets = case(shape, 37, 1, population=200)
    whole, squares = measured(weights, promoters, shape, inputs, targets)
    for place in range(len(weights)):
        one = slice(place, place + 1)
        error, square = measured(weights[one], promoters[one], shape, inputs, targets)
        assert (error[0], square[0]) == (whole[place], squares[place])


def test_without_room_for_squares_the_errors_are_the_same() -> None:
    shape = Shape(3, (6,), 2)
    weights, promoters, inputs, targets = case(shape, 33, 1)
    errors = np.empty(len(weights))
    Measure(shape, inputs, targets).write(weights, promoters, errors, np.empty(0))
    assert np.array_equal(errors, measured(weights, promoters, shape, inputs, targets)[0])


def test_other_numbers_than_contiguous_float32_are_refused() -> None:
    shape = Shape(2, (3,), 1)
    weights, promoters, inputs, targets = case(shape, 4, 1)
    for wrong in (weights.astype(np.float64), weights[:, ::-1]):
        with pytest.raises(ValueError, match="contiguous"):
            measured(wrong, promoters, shape, inputs, targets)


def test_arrays_of_other_sizes_are_refused() -> None:
    shape = Shape(2, (3,), 1)
    weights, promoters, inputs, targets = case(shape, 4, 1)
    measure, errors = Measure(shape, inputs, targets), np.empty(len(weights))
    for wrong in (weights[:, 1:].copy(), weights[1:]):
        with pytest.raises(ValueError, match="expected"):
            measure.write(wrong, promoters, errors, errors)
    with pytest.raises(ValueError, match="expected"):
        measure.write(weights, promoters, errors, errors[1:])
    with pytest.raises(ValueError, match="inputs"):
        Measure(Shape(3, (3,), 1), inputs, targets)


def measured_tanh(values: np.ndarray) -> np.ndarray:
    """Return tanh of each value as hidden units have it, from the errors of networks that give it as their output."""
    shape, one = Shape(1, (1,), 1), np.ones((1, 1), np.float32)
    weights = values[:, None] * [[1, 0, 0, 0]] + [[0, 0, 1, 0]]
    promoters = np.ones((len(values), 1), np.uint8)
    errors, _ = measured(weights.astype(np.float32), promoters, shape, one, -2 * one)
    return np.sqrt(errors) - 2


def test_tanh_keeps_its_error_bound() -> None:
    values = np.concatenate([np.linspace(0, 9, 1_000_001), np.logspace(-44, 38, 100_000), [3e38]]).astype(np.float32)
    right, rounding = np.tanh(values.astype(np.float64)), 5e-7
    for sign in (1, -1):
        results = sign * measured_tanh(sign * values)
        assert np.abs(results - right).max() <= TANH_ERROR + rounding
        assert results.max() <= 1 + rounding


@pytest.mark.parametrize(("pairs", "blocks"), [(1, 1), (BLOCK, 1), (BLOCK + 1, 2), (3 * BLOCK, 3)])
def test_blocks_hold_columns_and_are_filled_up_with_zeros(pairs: int, blocks: int) -> None:
    rows = np.random.default_rng(0).random((pairs, 3), dtype=np.float32)
    packed = in_blocks(rows)
    assert packed.shape == (blocks, 3, BLOCK, GROUP)
    assert (packed == packed[..., :1]).all()
    columns = packed[..., 0].transpose(0, 2, 1).reshape(-1, 3)
    assert np.array_equal(columns[:pairs], rows)
    assert not columns[pairs:].any()
    assert packed.ctypes.data % 64 == 0
