import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_services.mechanism.kernel import (
    BLOCK,
    TANH_ERROR,
    compiled,
    in_blocks,
    population_errors,
    reference_errors,
    tanh32,
)
from mdb_services.mechanism.network import Shape

shapes = st.builds(
    Shape, st.integers(1, 9), st.lists(st.integers(1, 9), min_size=1, max_size=3).map(tuple), st.integers(1, 4)
)


def measured(weights, promoters, shape, inputs, targets):
    errors, squares = np.empty(len(weights)), np.empty(len(weights))
    sizes = np.array(shape.sizes, dtype=np.int64)
    population_errors(weights, promoters, sizes, in_blocks(inputs), in_blocks(targets), len(inputs), errors, squares)
    return errors, squares


def case(shape, pairs, seed, population=7):
    random = np.random.default_rng(seed)
    weights = random.normal(0, 1.5, (population, shape.weights)).astype(np.float32)
    promoters = random.integers(0, 2, (population, shape.units)).astype(np.uint8)
    inputs = random.uniform(-1.5, 1.5, (pairs, shape.inputs)).astype(np.float32)
    targets = random.uniform(-1, 1, (pairs, shape.outputs)).astype(np.float32)
    return weights, promoters, inputs, targets


@settings(max_examples=80, deadline=None)
@given(shapes, st.integers(1, 3 * BLOCK + 1), st.integers(0, 10**6))
def test_agrees_with_the_reference(shape: Shape, pairs: int, seed: int) -> None:
    weights, promoters, inputs, targets = case(shape, pairs, seed)
    errors, _ = measured(weights, promoters, shape, inputs, targets)
    expected = reference_errors(weights, promoters, shape.sizes, inputs, targets)
    np.testing.assert_allclose(errors, expected, rtol=2e-5, atol=1e-6)


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


@compiled
def _tanh_all(values, results):
    for i in range(values.size):
        results[i] = tanh32(values[i])


def test_tanh_keeps_its_error_bound() -> None:
    small = np.logspace(-30, 1, 50_000)
    values = np.concatenate([np.linspace(-12, 12, 200_001), small, -small, [0.0, 3e38, -3e38, math.inf, -math.inf]])
    values = values.astype(np.float32)
    results = np.empty_like(values)
    _tanh_all(values, results)
    assert np.abs(results - np.tanh(values.astype(np.float64))).max() <= TANH_ERROR
    assert np.abs(results).max() <= 1 + TANH_ERROR


@pytest.mark.parametrize(("pairs", "blocks"), [(1, 1), (BLOCK, 1), (BLOCK + 1, 2)])
def test_blocks_are_filled_up_with_zeros(pairs: int, blocks: int) -> None:
    rows = np.ones((pairs, 3))
    packed = in_blocks(rows)
    assert packed.shape == (blocks, 4, BLOCK)
    assert packed.sum() == rows.sum()
