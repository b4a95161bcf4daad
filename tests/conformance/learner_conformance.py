"""What every learner must do: derive a test class from `LearnerConformance` and supply `make`.

Owns the meaning of the `Learner` contract as tests. Uses the contract's members only, on rows as the
communication model has them: a note one-hot and the action's rank to a graded feedback.
"""

from itertools import pairwise

import numpy as np
import pytest

from mdb_services.mechanism.learners import Learner
from mdb_services.mechanism.networks.network import Network, Shape

NOTES = 7
COMMUNICATION = Shape(NOTES + 1, (16,), 1)
SMALL, DEEP = Shape(3, (6,), 2), Shape(3, (6, 4), 2)


def language(permutation):
    """All 49 cases of a language (7,), the action that each note commands: inputs (49, 8) and targets (49, 1)."""
    note, action = np.divmod(np.arange(NOTES * NOTES), NOTES)
    inputs = np.column_stack([np.eye(NOTES)[note], action / 3 - 1]).astype(np.float32)
    miss = np.abs(np.asarray(permutation)[note] - action)
    return inputs, (2 * np.maximum(0, 1 - miss / 3) - 1).astype(np.float32)[:, None]


def some_memory(shape, pairs=30, seed=0):
    random = np.random.default_rng(seed)
    inputs = random.uniform(-1, 1, (pairs, shape.inputs)).astype(np.float32)
    return inputs, np.tanh(inputs @ random.normal(size=(shape.inputs, shape.outputs))).astype(np.float32)


def some_network(sizes, seed=0):
    """A network of these layers, its outputs well within their bounds."""
    random = np.random.default_rng(seed)
    return Network([random.normal(size=(rows, columns + 1)) / 4 for columns, rows in pairwise(sizes)])


def true_error(network, memory):
    inputs, targets = memory
    return np.mean((network.predict(inputs) - targets) ** 2)


def assert_same(first, second):
    assert_same_state(first.state(), second.state())


def assert_same_state(one, other):
    assert one.keys() == other.keys()
    for name, array in one.items():
        assert np.array_equal(array, other[name]), name


class LearnerConformance:
    """The suite; a subclass supplies `make`."""

    def make(self, shape: Shape, seed: int = 5, name: str = "evolver/communication") -> Learner:
        raise NotImplementedError

    @pytest.mark.parametrize("seed", [101, 102])
    def test_after_a_change_of_language_the_error_is_the_true_one_and_recovers(self, seed):
        """With errors kept from the old memory, the best of the old language would be reported for ever."""
        random = np.random.default_rng(seed)
        first, second = language(random.permutation(NOTES)), language(random.permutation(NOTES))
        learner = self.make(COMMUNICATION, seed)
        for version in range(60):
            before = learner.learn(*first, version=version)
        assert before.error < 0.1 * np.var(first[1])
        changed = learner.learn(*second, version=60, generations=0)
        assert changed.error == pytest.approx(true_error(changed.network, second), rel=1e-5)
        assert changed.error > 0.3
        errors = []
        for version in range(60, 130):
            recovered = learner.learn(*second, version=version)
            assert recovered.error == pytest.approx(true_error(recovered.network, second), rel=1e-5)
            errors.append(recovered.error)
        assert errors[4] < 0.7 * changed.error, "no version reports what was best on the old memory"
        assert errors[-1] < 0.1 * np.var(second[1])

    @pytest.mark.parametrize("shape", [SMALL, DEEP])
    def test_reports_the_true_error_of_a_network_of_its_shape(self, shape):
        learner, memory = self.make(shape), some_memory(shape)
        for version in range(80):
            best = learner.learn(*memory, version=version)
            assert best.error == pytest.approx(true_error(best.network, memory), rel=1e-5)
        assert best.error < 0.2 * np.var(memory[1])
        assert (best.network.sizes[0], best.network.sizes[-1]) == (shape.inputs, shape.outputs)
        assert len(best.network.sizes) == len(shape.sizes)
        assert best.expressed == best.network.expressed

    @pytest.mark.parametrize("shape", [SMALL, DEEP])
    def test_same_seed_gives_the_same_and_another_seed_or_name_another(self, shape):
        learners = [self.make(shape), self.make(shape), self.make(shape, seed=6), self.make(shape, name="other")]
        for version in range(3):
            errors = [learner.learn(*some_memory(shape, seed=version), version=version).error for learner in learners]
        assert_same(*learners[:2])
        assert len(set(errors)) == 3

    def test_generations_in_one_call_or_in_several_are_the_same(self):
        once, twice = self.make(SMALL), self.make(SMALL)
        for version in (1, 2):
            memory = some_memory(SMALL, seed=version)
            once.learn(*memory, version=version, generations=3)
            twice.learn(*memory, version=version, generations=1)
            twice.learn(*memory, version=version, generations=0)
            twice.learn(*memory, version=version, generations=2)
        assert_same(once, twice)

    def test_says_how_many_generations_a_call_does(self):
        told, default = self.make(SMALL), self.make(SMALL)
        assert told.generations >= 1
        told.learn(*some_memory(SMALL), version=1, generations=told.generations)
        default.learn(*some_memory(SMALL), version=1)
        assert_same(told, default)

    def test_an_empty_memory_changes_nothing(self):
        learner, other = self.make(SMALL), self.make(SMALL)
        for version in (0, 1):
            best = learner.learn(*some_memory(SMALL, 0), version=version)
            assert np.isnan(best.error)
            assert np.isfinite(best.network.predict(np.zeros((1, SMALL.inputs)))).all()
            assert_same(learner, other)
            learner.learn(*some_memory(SMALL), version=version)
            other.learn(*some_memory(SMALL), version=version)

    def test_one_pair_is_learnt(self):
        learner = self.make(SMALL)
        for version in range(1, 30):
            best = learner.learn(*some_memory(SMALL, 1), version=version)
        assert best.error < 0.01

    def test_many_versions_without_a_change_leave_it_able_to_change(self):
        first, second = language(np.arange(NOTES)), language(np.arange(NOTES)[::-1])
        learner = self.make(COMMUNICATION)
        for version in range(300):
            learner.learn(*first, version=version)
        for version in range(300, 400):
            best = learner.learn(*second, version=version)
        assert best.error < 0.1 * np.var(second[1])

    @pytest.mark.parametrize(("shape", "sizes"), [(SMALL, (3, 6, 2)), (SMALL, (3, 2, 2)), (DEEP, (3, 4, 4, 2))])
    def test_with_a_perfect_seed_it_is_perfect_at_once_and_stays_good(self, shape, sizes):
        seed = some_network(sizes)
        inputs, _ = some_memory(shape)
        memory = inputs, seed.predict(inputs)
        for versions_before in (0, 3):
            learner = self.make(shape)
            for version in range(versions_before):
                learner.learn(*some_memory(shape), version=version)
            learner.seed([some_network(sizes, 1), seed])
            learner.seed([some_network(sizes, 2)])
            assert learner.learn(*memory, version=10, generations=0).error < 1e-10
            assert learner.learn(*memory, version=11).error < 1e-3

    def test_a_bad_seed_does_no_harm(self):
        learner, memory = self.make(SMALL), some_memory(SMALL)
        for version in range(20):
            before = learner.learn(*memory, version=version)
        learner.seed([some_network((3, 1, 2), seed) for seed in range(3)])
        assert learner.learn(*memory, version=20, generations=0).error <= before.error + 1e-6

    @pytest.mark.parametrize("sizes", [(2, 6, 2), (3, 6, 1), (3, 999, 2), (3, 3, 3, 2)])
    def test_a_seed_that_does_not_fit_is_refused_and_changes_nothing(self, sizes):
        learner = self.make(SMALL)
        with pytest.raises(ValueError, match="does not fit"):
            learner.seed([some_network(SMALL.sizes), some_network(sizes)])
        assert_same(learner, self.make(SMALL))

    def test_restored_it_continues_identically(self):
        whole, restarted = self.make(SMALL), self.make(SMALL)
        for version in range(4):
            whole.learn(*some_memory(SMALL, seed=version), version=version)
        whole.learn(*some_memory(SMALL, seed=4), version=4, generations=1)
        whole.seed([some_network((3, 2, 2)), some_network(SMALL.sizes)])
        restarted.restore(whole.state())
        assert_same(whole, restarted)
        for version in (4, 5, 6):  # the first goes on where generation 1 of version 4 ended
            memory = some_memory(SMALL, seed=version)
            assert whole.learn(*memory, version=version).error == restarted.learn(*memory, version=version).error
        assert_same(whole, restarted)

    def test_a_state_is_a_copy(self):
        learner, other = self.make(SMALL), self.make(SMALL)
        state = learner.state()
        other.restore(state)
        for either in (learner, other):
            either.learn(*some_memory(SMALL), version=1)
        assert_same_state(state, self.make(SMALL).state())

    def test_a_damaged_or_foreign_state_is_refused_and_changes_nothing(self):
        learner = self.make(SMALL)
        learner.learn(*some_memory(SMALL), version=1)
        kept = self.make(SMALL)
        kept.restore(learner.state())
        state = learner.state()
        damaged = [{name: array for name, array in state.items() if name != lacking} for lacking in state]
        damaged += [state | {name: array[..., None]} for name, array in state.items()]
        damaged += [state | {name: array.astype(np.complex64)} for name, array in state.items()]
        weights = next(name for name in state if name.endswith("weights"))
        damaged += [state | {weights: state[weights] * np.float32("nan")}, self.make(DEEP).state(), {}]
        damaged += [state | {"clock": np.array([1, -1])}]
        for wrong in damaged:
            with pytest.raises(ValueError, match="start afresh"):
                learner.restore(wrong)
            assert_same(learner, kept)

    def test_a_memory_that_does_not_fit_is_refused_and_changes_nothing(self):
        learner = self.make(SMALL)
        inputs, targets = some_memory(SMALL)
        wrong = [(inputs[:, :2], targets), (inputs, targets[:, :1]), (inputs, targets[:3]), (inputs[0], targets[0])]
        wrong += [(inputs * np.nan, targets), (inputs, targets * np.inf)]
        for memory in wrong:
            with pytest.raises(ValueError, match=r"expected|not finite"):
                learner.learn(*memory, version=1)
            assert_same(learner, self.make(SMALL))
