from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdb_services.mechanism.networks.network import Network, Shape

sizes = st.tuples(
    st.integers(1, 6), st.lists(st.integers(0, 7), min_size=1, max_size=3).map(tuple), st.integers(1, 4)
)


def random_network(inputs: int, hidden: tuple[int, ...], outputs: int, seed: int = 0) -> Network:
    random, units = np.random.default_rng(seed), (inputs, *hidden, outputs)
    return Network([random.normal(size=(b, a + 1)) for a, b in pairwise(units)])


@given(sizes)
def test_arrays_round_trip(given_sizes: tuple[int, tuple[int, ...], int]) -> None:
    network = random_network(*given_sizes)
    again = Network.from_arrays(*network.to_arrays())
    rows = np.random.default_rng(1).uniform(-1, 1, (5, given_sizes[0]))
    assert again.sizes == network.sizes
    assert np.array_equal(again.predict(rows), network.predict(rows))


@given(sizes)
def test_predictions_are_bounded_float32(given_sizes: tuple[int, tuple[int, ...], int]) -> None:
    outputs = random_network(*given_sizes).predict(np.full((3, given_sizes[0]), 1e6))
    assert outputs.dtype == np.float32
    assert outputs.shape == (3, given_sizes[2])
    assert np.abs(outputs).max() <= 1


def test_predicts_what_the_formula_says() -> None:
    network = Network([[[0.5, -1.0, 0.25]], [[0.75, -0.125]]])
    expected = 0.75 * np.tanh(0.5 * 0.3 - 1.0 * 0.2 + 0.25) - 0.125
    assert network.predict(np.array([[0.3, 0.2]]))[0, 0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("layer_sizes", "weights", "message"),
    [
        ([2, 1], np.zeros(3), "expected inputs, hidden units, outputs"),
        ([2, -1, 1], np.zeros(3), "none negative"),
        ([2, 3, 1], np.zeros(12), r"need \(13,\)"),
        ([2, 3, 1], np.full(13, np.nan), "not finite"),
    ],
)
def test_damaged_arrays_are_refused(layer_sizes: list[int], weights: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Network.from_arrays(layer_sizes, weights)


def test_layers_that_do_not_follow_one_another_are_refused() -> None:
    with pytest.raises(ValueError, match="units before need 4"):
        Network([np.zeros((3, 3)), np.zeros((1, 3))])


def test_inputs_of_another_width_are_refused() -> None:
    with pytest.raises(ValueError, match=r"expected \(n, 2\)"):
        random_network(2, (3,), 1).predict(np.zeros((4, 3)))


@pytest.mark.parametrize("hidden", [(), (0,), (3, 0)])
def test_shape_without_units_is_refused(hidden: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="at least one"):
        Shape(2, hidden, 1)
