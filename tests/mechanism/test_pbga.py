import numpy as np
import pytest

from mdb_services.mechanism.learners.pbga import PromoterGA
from mdb_services.mechanism.networks.network import Network, Shape
from mdb_services.mechanism.settings import EvolutionConfig

NOTES = 7
COMMUNICATION = Shape(NOTES + 1, (14,), 1)
SMALL = EvolutionConfig(population=40, generations=2)


def communication_table(language: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All 49 cases: note one-hot and action's rank to feedback, +1 for the commanded action down to -1."""
    note, action = np.divmod(np.arange(NOTES * NOTES), NOTES)
    inputs = np.zeros((NOTES * NOTES, NOTES + 1), dtype=np.float32)
    inputs[np.arange(len(note)), note] = 1
    inputs[:, NOTES] = action / 3 - 1
    miss = np.abs(language[note] - action)
    return inputs, (2 * np.maximum(0, 1 - miss / 3) - 1).astype(np.float32)[:, None]


def learn_until(learner: PromoterGA, memory: tuple[np.ndarray, np.ndarray], goal: float, versions: range) -> int:
    for version in versions:
        if learner.learn(*memory, version=version).error < goal:
            return version
    return versions.stop


@pytest.mark.parametrize("seed", [101, 102, 103])
def test_learns_a_language_and_after_it_another(seed: int) -> None:
    random = np.random.default_rng(seed)
    learner = PromoterGA(COMMUNICATION, EvolutionConfig(), seed, "communication")
    assert learn_until(learner, communication_table(random.permutation(NOTES)), 0.05, range(1, 100)) < 100
    assert learn_until(learner, communication_table(random.permutation(NOTES)), 0.05, range(100, 250)) < 250


def test_survivors_are_measured_anew_when_the_memory_changes() -> None:
    """With old fitness values kept, the best of the old language would stay the best for ever."""
    learner = PromoterGA(COMMUNICATION, EvolutionConfig(), 1, "communication")
    inputs, targets = communication_table(np.arange(NOTES))
    for version in range(30):
        before = learner.learn(inputs, targets, version=version).error
    reversed_targets = communication_table(np.arange(NOTES)[::-1])[1]
    changed = learner.learn(inputs, reversed_targets, version=30, generations=0)
    assert changed.error > 0.3 > before
    for version in range(31, 100):
        recovered = learner.learn(inputs, reversed_targets, version=version)
    true_error = np.mean((recovered.network.predict(inputs) - reversed_targets) ** 2)
    assert recovered.error == pytest.approx(true_error, rel=1e-3)
    assert recovered.error < 0.1


def some_memory(shape: Shape, pairs: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    inputs = random.uniform(-1, 1, (pairs, shape.inputs)).astype(np.float32)
    return inputs, np.tanh(inputs @ random.normal(size=(shape.inputs, shape.outputs))).astype(np.float32)


@pytest.mark.parametrize("hidden", [(6,), (5, 4)])
def test_same_seed_gives_the_same_result(hidden: tuple[int, ...]) -> None:
    shape = Shape(3, hidden, 2)
    memory = some_memory(shape, 30)
    runs = [PromoterGA(shape, SMALL, 5, "object") for _ in range(2)]
    for version in range(5):
        bests = [run.learn(*memory, version=version) for run in runs]
    assert bests[0].error == bests[1].error
    for name, array in runs[0].state().items():
        assert np.array_equal(array, runs[1].state()[name], equal_nan=True)
    assert PromoterGA(shape, SMALL, 6, "object").learn(*memory, version=5).error != bests[0].error


def test_restored_population_continues_identically() -> None:
    shape = Shape(3, (6,), 2)
    memory = some_memory(shape, 30)
    whole = PromoterGA(shape, SMALL, 5, "object")
    whole.learn(*memory, version=1, generations=3)
    restarted = PromoterGA(shape, SMALL, 5, "object")
    restarted.restore(whole.state())
    for version in (1, 2, 3):  # the first goes on where generation 3 of version 1 ended
        assert whole.learn(*memory, version=version).error == restarted.learn(*memory, version=version).error
    assert np.array_equal(whole.state()["weights"], restarted.state()["weights"])


def test_generations_in_one_call_or_in_several_give_the_same_population() -> None:
    shape = Shape(3, (6,), 1)
    memory = some_memory(shape, 25)
    once, twice = (PromoterGA(shape, SMALL, 5, "object") for _ in range(2))
    once.learn(*memory, version=1, generations=4)
    twice.learn(*memory, version=1, generations=1)
    twice.learn(*memory, version=1, generations=3)
    assert np.array_equal(once.state()["weights"], twice.state()["weights"])


def test_size_and_bounds_of_the_population_are_kept() -> None:
    config = EvolutionConfig(population=40, weight_limit=2, step_max=1, step_min=0.5, step_first=0.5)
    shape = Shape(3, (6, 3), 2)
    learner = PromoterGA(shape, config, 5, "object")
    for version in range(20):
        best = learner.learn(*some_memory(shape, 10, seed=version), version=version)
    state = learner.state()
    assert state["weights"].shape == (40, shape.weights)
    assert np.abs(state["weights"]).max() <= 2
    assert set(np.unique(state["promoters"])) <= {0, 1}
    assert 0.5 <= state["steps"].min() <= state["steps"].max() <= 1
    assert best.expressed == best.network.expressed <= shape.units


def test_an_elite_never_loses_on_an_unchanged_memory() -> None:
    shape = Shape(3, (6,), 1)
    memory = some_memory(shape, 25)
    learner = PromoterGA(shape, SMALL, 5, "object")
    fitness = []
    for version in range(20):
        learner.learn(*memory, version=version)
        fitness.append(learner.state()["fitness"].min())
    assert fitness == sorted(fitness, reverse=True)


def test_an_empty_memory_changes_nothing_and_one_pair_is_learnt() -> None:
    shape = Shape(2, (3,), 1)
    learner = PromoterGA(shape, SMALL, 5, "object")
    before = learner.state()["weights"]
    best = learner.learn(*some_memory(shape, 0), version=0)
    assert np.isnan(best.error)
    assert best.network.predict(np.zeros((1, 2))).shape == (1, 1)
    assert np.array_equal(learner.state()["weights"], before)
    for version in range(1, 20):
        best = learner.learn(*some_memory(shape, 1), version=version)
    assert best.error < 0.01


def test_a_seeded_network_wins_when_it_is_the_best() -> None:
    random = np.random.default_rng(0)
    expert = Network([random.normal(size=(3, 4)), random.normal(size=(2, 4)) / 4])
    inputs = random.uniform(-1, 1, (50, 3)).astype(np.float32)
    targets = expert.predict(inputs)
    learner = PromoterGA(Shape(3, (8,), 2), SMALL, 5, "object")
    learner.learn(inputs, targets, version=1)
    learner.seed([expert])
    best = learner.learn(inputs, targets, version=2, generations=0)
    assert best.error < 1e-7
    assert best.network.sizes == (3, 3, 2)
    np.testing.assert_allclose(best.network.predict(inputs), targets, atol=1e-6)


def test_seeding_replaces_the_worst() -> None:
    shape = Shape(2, (3,), 1)
    learner = PromoterGA(shape, SMALL, 5, "object")
    learner.learn(*some_memory(shape, 20), version=1)
    state = learner.state()
    worst = int(np.argmax(state["fitness"]))
    learner.seed([Network([np.zeros((1, 3)), np.zeros((1, 2))])])
    changed = (learner.state()["weights"] != state["weights"]).any(axis=1)
    assert np.flatnonzero(changed).tolist() == [worst]


@pytest.mark.parametrize("layers", [[(4, 3), (1, 5)], [(2, 3), (2, 3)], [(2, 3), (2, 3), (1, 3)]])
def test_a_network_that_does_not_fit_is_refused(layers: list[tuple[int, int]]) -> None:
    learner = PromoterGA(Shape(2, (3,), 1), SMALL, 5, "object")
    with pytest.raises(ValueError, match="does not fit"):
        learner.seed([Network([np.zeros(layer) for layer in layers])])


def test_state_of_another_shape_or_damaged_is_refused() -> None:
    learner = PromoterGA(Shape(2, (3,), 1), SMALL, 5, "object")
    with pytest.raises(ValueError, match="start afresh"):
        learner.restore(PromoterGA(Shape(2, (4,), 1), SMALL, 5, "object").state())
    with pytest.raises(ValueError, match="lacks 'steps'"):
        learner.restore({name: array for name, array in learner.state().items() if name != "steps"})
    damaged = learner.state()
    damaged["weights"][0, 0] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        learner.restore(damaged)


def test_a_memory_that_does_not_fit_is_refused() -> None:
    learner = PromoterGA(Shape(2, (3,), 1), SMALL, 5, "object")
    rows, targets = some_memory(Shape(2, (3,), 1), 4)
    for inputs, outputs in ((rows[:, :1], targets), (rows, targets[:3]), (rows * np.nan, targets)):
        with pytest.raises(ValueError, match=r"expected|not finite"):
            learner.learn(inputs, outputs, version=1)


@pytest.mark.parametrize(
    "wrong",
    [{"elite": 0}, {"elite": 200}, {"generations": 0}, {"parent_share": 2}, {"step_min": 0}, {"weight_limit": 0.5}],
)
def test_impossible_configuration_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        EvolutionConfig(**wrong)


def test_a_population_without_any_expressed_unit_grows_again() -> None:
    shape = Shape(1, (8,), 1)
    inputs = np.linspace(-1, 1, 40, dtype=np.float32)[:, None]
    learner = PromoterGA(shape, EvolutionConfig(), 5, "induced")
    state = learner.state()
    state["promoters"][:] = 0
    learner.restore(state)
    for version in range(40):
        best = learner.learn(inputs, np.sin(3 * inputs), version=version)
    assert best.expressed > 0
    assert best.error < 0.05
