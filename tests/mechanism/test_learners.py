"""What is particular to single learners; what all must do is in tests/conformance."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdb_services.mechanism.learners import make_learner
from mdb_services.mechanism.learners.adam import gradient
from mdb_services.mechanism.learners.committee import Committee, mean, parts
from mdb_services.mechanism.networks.network import Network, Shape
from mdb_services.mechanism.settings import LEARNER_CONFIGS, AdamConfig, CmaConfig, EvolutionConfig, RidgeConfig

SHAPE = Shape(2, (3,), 1)


def rows(pairs: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    inputs = random.uniform(-1, 1, (pairs, 2)).astype(np.float32)
    return inputs, np.sin(inputs.sum(axis=1, keepdims=True))


@pytest.mark.parametrize("shape", [Shape(2, (4,), 3), Shape(2, (4, 3), 2)])
def test_the_gradient_is_that_of_the_mean_squared_error(shape: Shape) -> None:
    random = np.random.default_rng(1)
    genome, inputs, targets = (random.normal(size=size) for size in (shape.weights, (5, 2), (5, shape.outputs)))

    def error(moved: np.ndarray) -> float:
        layers, signals = [], inputs
        start = 0
        for before, after in zip(shape.sizes[:-1], shape.sizes[1:], strict=True):
            layers.append(moved[start : start + after * (before + 1)].reshape(after, before + 1))
            start += after * (before + 1)
        for layer in layers[:-1]:
            signals = np.tanh(signals @ layer[:, :-1].T + layer[:, -1])
        return float(np.mean((signals @ layers[-1][:, :-1].T + layers[-1][:, -1] - targets) ** 2))

    step = 1e-6 * np.eye(shape.weights)
    differences = [(error(genome + h) - error(genome - h)) / 2e-6 for h in step]
    np.testing.assert_allclose(gradient(shape, genome, inputs, targets), differences, atol=1e-7)


def test_the_plain_population_keeps_all_its_units() -> None:
    learner = make_learner("ga", SHAPE, EvolutionConfig(population=30, immigrant_share=0.2), 5, "object")
    for version in range(10):
        assert learner.learn(*rows(20), version=version).expressed == SHAPE.units
    assert learner.state()["promoters"].all()


def test_ridge_has_as_many_features_as_it_is_told_but_no_fewer_than_the_shape() -> None:
    for features, units in ((20, 20), (2, 3)):
        learner = make_learner("ridge", SHAPE, RidgeConfig(features=features), 5, "object")
        assert learner.learn(*rows(20), version=1).network.sizes == (2, units, 1)


def test_ridge_without_penalty_to_speak_of_passes_through_few_pairs() -> None:
    learner = make_learner("ridge", SHAPE, RidgeConfig(penalty=1e-9), 5, "object")
    assert learner.learn(*rows(10), version=1).error < 1e-5


def test_the_step_of_cma_stays_within_its_bounds() -> None:
    pytest.importorskip("cmaes")
    learner = make_learner("cma", SHAPE, CmaConfig(step_min=0.1, step_max=0.4), 5, "object")
    for version in range(60):
        learner.learn(*rows(20), version=version)
        state = learner.state()
        assert 0.0999 < state["sigma"][0] * np.sqrt(state["C"].mean()) < 0.4001


@pytest.mark.parametrize("name", ["adam", "cma", "ridge"])
def test_seeds_wait_for_one_memory_only(name: str) -> None:
    if name == "cma":
        pytest.importorskip("cmaes")
    learner = make_learner(name, SHAPE, LEARNER_CONFIGS[name](), 5, "object")
    learner.seed([learner.learn(*rows(0), version=0).network] * 2)
    assert len(learner.state()["waiting"]) == 2
    learner.learn(*rows(5), version=1, generations=0)
    assert len(learner.state()["waiting"]) == 0


def some_networks(room: Shape, hidden: list[tuple[int, ...]], seed: int) -> list[Network]:
    random = np.random.default_rng(seed)
    sizes = [(room.inputs, *units, room.outputs) for units in hidden]
    return [Network([random.normal(size=(b, a + 1)) for a, b in pairwise(layers)]) for layers in sizes]


@pytest.mark.parametrize(
    ("room", "hidden"),
    [
        (Shape(2, (3,), 1), [(3,), (1,), (0,)]),
        (Shape(3, (4, 2), 2), [(4, 2), (3, 1), (1, 2), (4, 2)]),
        (Shape(1, (2, 3, 2), 2), [(2, 3, 1), (1, 2, 2)]),
    ],
)
@given(seed=st.integers(0, 1000))
def test_the_mean_of_networks_is_a_network_and_can_be_taken_apart(
    room: Shape, hidden: list[tuple[int, ...]], seed: int
) -> None:
    networks = some_networks(room, hidden, seed)
    inputs = np.random.default_rng(seed).uniform(-1, 1, (20, room.inputs)).astype(np.float32)
    whole = Network(mean([network.layers for network in networks], room))
    assert (
        whole.sizes == Committee([make_learner("adam", room, AdamConfig(), 0, "")] * len(networks), 0, "").shape.sizes
    )
    expected = np.mean([network.sums(inputs) for network in networks], axis=0)
    np.testing.assert_allclose(whole.sums(inputs), expected, atol=1e-5)
    for part, network in zip(parts(whole, len(networks)), networks, strict=True):
        np.testing.assert_allclose(part.sums(inputs), network.sums(inputs), atol=1e-4)
        assert part.expressed <= network.expressed


def test_a_committee_that_was_reported_comes_back_as_a_seed_and_stays_until_the_mean_is_better() -> None:
    known, other = rows(40), (rows(40)[0], -rows(40)[1])
    first, second = (make_learner("pbga", SHAPE, EvolutionConfig(), seed, "object", members=3) for seed in (5, 6))
    for version in range(60):
        best = first.learn(*known, version=version)
        second.learn(*other, version=version)
    for _ in range(3):
        second.seed([best.network])
    assert len(second.state()["waiting"]) == 1, "what waits already does not wait twice"
    assert second.learn(*known, version=60, generations=0).error == pytest.approx(best.error, rel=1e-4)
    errors = [second.learn(*known, version=version).error for version in range(61, 130)]
    assert max(errors) <= best.error * 1.02  # a member that seems a little better may make the mean a little worse
    assert len(second.state()["waiting"]) == 0
    assert min(errors) < best.error


def test_a_committee_errs_less_than_its_members_where_nothing_was_learnt() -> None:
    elsewhere = np.random.default_rng(1).uniform(-1, 1, (500, 2)).astype(np.float32)
    truth = np.sin(elsewhere.sum(axis=1, keepdims=True))
    ratios = []
    for seed in range(8):
        few = rows(12, seed)
        learners = [make_learner("pbga", SHAPE, EvolutionConfig(), seed, "object", members=n) for n in (1, 7)]
        for version in range(40):
            networks = [learner.learn(*few, version=version).network for learner in learners]
        alone, together = (np.mean((network.predict(elsewhere) - truth) ** 2) for network in networks)
        ratios.append(together / alone)
    assert np.median(ratios) < 0.9


@pytest.mark.parametrize("name", ["pbga", "ga", "de"])
def test_more_seeds_than_the_population_has_places_are_refused(name: str) -> None:
    learner = make_learner(name, SHAPE, LEARNER_CONFIGS[name](population=4), 5, "object")
    network = learner.learn(*rows(5), version=1).network
    learner.seed([network] * 4)
    with pytest.raises(ValueError, match="5 networks for a population of 4"):
        learner.seed([network] * 5)


@pytest.mark.parametrize(
    ("name", "array", "value"),
    [
        ("pbga", "promoters", 2),
        ("ga", "promoters", 0),
        ("adam", "squares", -1),
        ("adam", "steps", -1),
        ("cma", "sigma", 0),
        ("cma", "C", -1),
        ("cma", "mean", 11),
        ("de", "factors", np.inf),
    ],
)
def test_a_state_that_cannot_be_is_refused(name: str, array: str, value: float) -> None:
    if name == "cma":
        pytest.importorskip("cmaes")
    learner = make_learner(name, SHAPE, LEARNER_CONFIGS[name](), 5, "object")
    state = learner.state()
    state[array].flat[0] = value
    with pytest.raises(ValueError, match="start afresh"):
        learner.restore(state)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("de", {"population": 3}),
        ("de", {"generations": 0}),
        ("de", {"best_share": 1.5}),
        ("de", {"weight_limit": 0.5}),
        ("cma", {"population": 1}),
        ("cma", {"step_min": 0.0}),
        ("cma", {"weight_penalty": -1.0}),
        ("adam", {"steps": 0}),
        ("adam", {"rate": 0.0}),
        ("adam", {"decay": float("inf")}),
        ("ridge", {"features": 0}),
        ("ridge", {"features": 5000}),
        ("ridge", {"penalty": 0.0}),
    ],
)
def test_impossible_settings_are_refused(name: str, wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        LEARNER_CONFIGS[name](**wrong)
