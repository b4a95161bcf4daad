"""An evolver between a hand-driven memory store and whoever wants its models."""

import sys
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
import pytest

from mdb_protocol import codec, keys, messages
from mdb_protocol.errors import ConfigError
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_protocol.waiting import Raw
from mdb_services.evolver import Evolver
from mdb_services.experiment.brain import BrainConfig, brain_config
from mdb_services.mechanism.networks.network import Network
from tests.services.small import BRAIN, CONTENT, LOCKSTEP, config, config_of_vectors, content, model

NAME, CAPACITY, GENERATIONS = "object", 4, 2


class Rig:
    """An evolver, and a memory store of a few lines that answers for it."""

    def __init__(self, settings: BrainConfig | None = None, *, store: bool = True) -> None:
        self.settings, self.fabric = settings or config(), Fabric()
        self.store = MemoryBus(self.fabric, BRAIN)
        self.models = self.store.subscriber(keys.CURRENT_MODEL)
        self.publisher = self.store.publisher(keys.MEMORY_CHANGE, model=NAME)
        self.version = 0
        self.rows: dict[int, tuple[int, float]] = {}
        self.asked = 0
        self.snapshot_fields: dict[str, Any] = {}
        self.kept: messages.CurrentModel | None = None
        self.checkpoint: messages.Checkpoint | None = None
        self.steps: list[messages.MemoryChange] = []
        self.checkpoints = self.store.subscriber(keys.CHECKPOINT, model=NAME)
        self.evolver = self.start()
        if store:
            self.open_store()

    def start(self) -> Evolver:
        self.evolver = Evolver(MemoryBus(self.fabric, BRAIN), self.settings, NAME)
        return self.evolver

    def open_store(self) -> None:
        self.store.queryable(keys.RESUME, self._resume, model=NAME)
        self.store.queryable(keys.KEPT_MODEL, lambda: self.kept, model=NAME)

    def _resume(self) -> messages.Resume:
        memory = self._snapshot()
        return messages.Resume(model=NAME, checkpoint=self.checkpoint, changes=self.steps, memory=memory)

    def _snapshot(self) -> messages.MemorySnapshot:
        self.asked += 1
        order = sorted(self.rows)
        fields = {
            "slots": np.array(order, np.int64),
            "pairs": np.array([self.rows[slot][0] for slot in order], np.int64),
            "inputs": np.array([self._inputs(self.rows[slot][1]) for slot in order], np.float32).reshape(-1, 2),
            "targets": np.array([[self.rows[slot][1]] for slot in order], np.float32).reshape(-1, 1),
        }
        return messages.MemorySnapshot(model=NAME, version=self.version, **(fields | self.snapshot_fields))

    @staticmethod
    def _inputs(value: float) -> list[float]:
        return [value, -value]

    def insert(self, *, lost: bool = False) -> None:
        slot, value = self.version % CAPACITY, np.sin(self.version)
        evicted = [self.rows[slot][0]] if slot in self.rows else []
        self.rows[slot] = (self.version, value)
        self.version += 1
        if not lost:
            self.change(slots=[slot], evicted=evicted, inputs=[self._inputs(value)], targets=[[value]])

    def change(
        self, *, inputs: Any, targets: Any, seeds: Sequence[messages.ModelWeights] = (), **fields: Any
    ) -> None:
        """Say that the memory has changed; without fields, that a pair was written to slot 0."""
        plain = {"slots": [0], "pairs": [self.version], "freed": [], "evicted": []}
        arrays = {name: np.array(fields.pop(name, value), np.int64) for name, value in plain.items()}
        rows = {"inputs": np.array(inputs, np.float32), "targets": np.array(targets, np.float32)}
        version = fields.pop("version", self.version)
        change = messages.MemoryChange(model=NAME, version=version, seeds=list(seeds), **arrays, **rows, **fields)
        self.last = change
        self.publisher.put(change)

    def settle(self) -> list[messages.CurrentModel]:
        """Step, bounded, until the evolver has nothing to do; return the models it published."""
        for _ in range(50):
            if not self.evolver.step():
                break
        else:
            pytest.fail("the evolver never came to rest")
        return list(iter(self.models.take, None))


def weights(models: list[messages.CurrentModel]) -> list[list[float]]:
    return [m.weights.tolist() for m in models]


def test_each_version_gets_its_generations_and_a_model() -> None:
    rig = Rig()
    assert rig.settle() == [], "nothing is learnt from an empty memory"
    for version in range(1, 7):
        rig.insert()
        (learnt,) = rig.settle()
        assert (learnt.version, learnt.generation) == (version, GENERATIONS * version)
        assert (learnt.layers[0], learnt.layers[-1]) == (2, 1)
    assert rig.evolver.values()["behind"] == 0
    assert rig.asked == 1


def test_a_model_of_vectors_has_all_their_numbers_in_its_layers() -> None:
    rig = Rig(config_of_vectors())
    random, rig.version = np.random.default_rng(0), 3
    rig.snapshot_fields = {
        "slots": np.arange(3), "pairs": np.arange(3),
        "inputs": random.uniform(-1, 1, (3, 4)).astype(np.float32),
        "targets": random.uniform(-1, 1, (3, 3)).astype(np.float32),
    }  # fmt: skip
    (learnt,) = rig.settle()
    assert (learnt.layers[0], learnt.layers[-1]) == (4, 3)
    assert learnt.version == 3


@pytest.mark.parametrize(("learner", "generations"), [({"name": "adam", "steps": 3}, 3), ({"name": "ridge"}, 1)])
def test_another_learner_is_the_files_choice(learner: dict[str, Any], generations: int) -> None:
    rig = Rig(config(learner=learner))
    rig.insert()
    first = rig.settle()[-1]
    rig.insert()
    second = rig.settle()[-1]
    assert (first.generation, second.generation) == (generations, 2 * generations)
    rig.kept = second
    rig.evolver.bus.close()
    rig.start()
    assert rig.settle()[-1].generation == 3 * generations, "it takes up its own model"


def test_a_learner_whose_package_is_missing_is_a_config_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cmaes", None)
    with pytest.raises(ConfigError, match=r"pip install .*\[learners\]"):
        Evolver(MemoryBus(Fabric(), BRAIN), config(learner={"name": "cma"}), NAME)


def reaching(**sections: Any) -> BrainConfig:
    """The brain whose model of these tests is weighed by its support: the mode that it tells the satisfaction of."""
    alone = {"name": "alone", "world": NAME, "satisfaction": "next.distance", "reach": 0.3}
    return brain_config(content(**sections) | {"mode": [CONTENT["mode"][0], alone]}, "small.toml")


def check_support(rig: Rig, learnt: messages.CurrentModel) -> None:
    assert learnt.support is not None
    assert learnt.version == rig.version
    values = [rig.rows[slot][1] for slot in sorted(rig.rows)]
    np.testing.assert_array_equal(learnt.support, np.array([rig._inputs(value) for value in values], np.float32))


def test_the_inputs_of_a_version_go_with_its_model_where_a_mode_has_reach() -> None:
    rig = Rig(reaching())
    for _ in range(CAPACITY + 2):
        rig.insert()
        (learnt,) = rig.settle()
        check_support(rig, learnt)


def test_without_reach_no_inputs_are_sent_nor_those_of_a_model_that_tells_no_satisfaction() -> None:
    first = CONTENT["mode"][0] | {"reach": 0.3}
    other = brain_config(content() | {"mode": [first, CONTENT["mode"][1]]}, "small.toml")
    for settings in (config(), other):
        rig = Rig(settings)
        rig.insert()
        (learnt,) = rig.settle()
        assert learnt.support is None


@pytest.mark.parametrize("pace", ["concurrent", "lockstep"])
@pytest.mark.parametrize("kept", [True, False])
def test_a_restarted_evolver_tells_the_inputs_too(pace: str, *, kept: bool) -> None:
    rig = Rig(reaching(experiment={"pace": pace}, evolver={"checkpoint_every": 5 if kept else 1000}))
    taught(rig, 7)
    assert (rig.checkpoint is not None) is kept
    rig.evolver.bus.close()
    rig.start()
    check_support(rig, rig.settle()[-1])
    rig.insert()
    rig.steps.append(rig.last)
    check_support(rig, rig.settle()[-1])


def test_the_concurrent_pace_learns_the_newest_of_what_came_together() -> None:
    rig = Rig()
    rig.settle()
    for _ in range(3):
        rig.insert()
    assert [(m.version, m.generation) for m in rig.settle()] == [(3, GENERATIONS)]


def test_lockstep_learns_one_version_after_the_other() -> None:
    together, apart = Rig(config(experiment=LOCKSTEP)), Rig(config(experiment=LOCKSTEP))
    for rig in (together, apart):
        rig.settle()
    one: list[messages.CurrentModel] = []
    for _ in range(4):
        together.insert()
        apart.insert()
        one += apart.settle()
    other = together.settle()
    assert [m.version for m in other] == [m.version for m in one] == [1, 2, 3, 4]
    assert weights(other) == weights(one), "how the changes arrive makes no difference"


def test_lockstep_does_one_version_a_step() -> None:
    rig = Rig(config(experiment=LOCKSTEP))
    rig.settle()
    rig.insert()
    rig.insert()
    rig.evolver.step()
    assert [m.version for m in iter(rig.models.take, None)] == [1]


def test_an_evolver_without_memory_store_asks_again_and_does_nothing_else() -> None:
    rig = Rig(store=False)
    rig.insert()
    assert [rig.evolver.step() for _ in range(5)] == [False] * 5
    assert rig.models.take() is None
    rig.open_store()
    assert [m.version for m in rig.settle()] == [1]
    assert rig.asked == 1


def test_a_store_that_fails_is_asked_again() -> None:
    rig = Rig(store=False)

    def fail() -> messages.Resume:
        raise OSError("disk is gone")

    rig.store.queryable(keys.RESUME, fail, model=NAME)
    assert [rig.evolver.step() for _ in range(5)] == [False] * 5
    rig.open_store()
    rig.insert()
    assert [m.version for m in rig.settle()] == [1]


def test_after_a_lost_change_the_whole_memory_is_asked_for() -> None:
    rig = Rig()
    rig.settle()
    rig.insert()
    rig.settle()
    rig.insert(lost=True)
    rig.insert()
    (learnt,) = rig.settle()
    assert (learnt.version, learnt.generation) == (3, 2 * GENERATIONS)
    assert rig.asked == 2
    rig.insert()
    assert [m.version for m in rig.settle()] == [4]
    assert rig.asked == 2


def test_a_change_from_far_ahead_is_counted_and_nothing_of_it_is_taken() -> None:
    rig = Rig()
    rig.insert()
    rig.settle()
    population = rig.evolver._learner.state()
    seed = messages.ModelWeights(layers=[2, 1, 1], weights=np.full(5, 1e6, np.float32))
    for version in (rig.version + 2, 2**53):
        rig.change(inputs=[[9.0, 9.0]], targets=[[9.0]], version=version, seeds=[seed])
        assert rig.settle() == []
    assert rig.evolver.bus.refusals.counts[keys.MEMORY_CHANGE.path] == 2
    after = rig.evolver._learner.state()
    assert all(np.array_equal(after[name], array) for name, array in population.items())
    rig.insert()
    (model,) = rig.settle()
    assert model.version == 2


def test_the_model_after_a_gap_is_that_of_the_population_not_an_older_kept_one() -> None:
    rig = Rig()
    rig.settle()
    rig.kept = model(NAME, 1, last=0.0)
    rig.insert()
    rig.settle()
    rig.insert()
    rig.settle()
    rig.insert(lost=True)
    rig.insert()
    assert [m.generation for m in rig.settle()] == [3 * GENERATIONS], "generations never go back"


def test_changes_known_already_are_passed_over() -> None:
    rig = Rig()
    rig.insert()
    rig.insert()
    assert [m.version for m in rig.settle()] == [2], "both came with the snapshot, and as changes"
    rig.change(version=1, inputs=[[9, 9]], targets=[[9]])
    assert rig.settle() == []


@pytest.mark.parametrize(
    "fields",
    [
        {"inputs": [[0.0, 0.0, 0.0]], "targets": [[0.0]]},
        {"inputs": [[0.0]], "targets": [[0.0]]},
        {"inputs": [[0.0, 0.0]], "targets": np.zeros((1, 0))},
        {"inputs": [[0.0, 0.0]], "targets": [[0.0, 0.0]]},
        {"inputs": [[0.0, 0.0]], "targets": [[0.0]], "slots": [CAPACITY]},
        {"inputs": [[0.0, 0.0]], "targets": [[0.0]], "slots": [2**31]},
        {"inputs": [[0.0, 0.0]], "targets": [[0.0]], "slots": [-1]},
        {"inputs": [[0.0, 0.0]], "targets": [[0.0]], "freed": [0]},
        {"inputs": [[0.0, 0.0]], "targets": [[0.0]], "freed": [CAPACITY]},
        {"inputs": [[0.0, 0.0]] * 2, "targets": [[0.0]] * 2, "slots": [1, 1], "pairs": [7, 8]},
    ],
)
def test_a_damaged_change_is_counted_and_heals(fields: dict[str, Any]) -> None:
    straight, rig = Rig(), Rig()
    for one in (straight, rig):
        one.settle()
        one.insert()
        one.settle()
    rig.change(version=rig.version + 1, **fields)
    assert rig.settle() == []
    assert rig.evolver.bus.refusals.counts[keys.MEMORY_CHANGE.path] == 1
    for one in (straight, rig):
        one.insert()
    assert weights(rig.settle()) == weights(straight.settle()), "no half of it was kept"


def test_junk_on_the_change_key_is_counted() -> None:
    rig = Rig()
    rig.settle()
    key, encoding = keys.MEMORY_CHANGE.at(BRAIN, model=NAME), codec.encoding_of(messages.MemoryChange)
    for payload in (b"", b"\xc1", b"junk"):
        rig.fabric.put(rig.store, keys.MEMORY_CHANGE, Raw(key, payload, encoding))
    rig.insert()
    assert [m.version for m in rig.settle()] == [1]
    assert rig.evolver.bus.refusals.counts[keys.MEMORY_CHANGE.path] == 3


@pytest.mark.parametrize(
    "fields",
    [
        {"inputs": np.zeros((1, 3), np.float32)},
        {"targets": np.zeros((1, 2), np.float32)},
        {"slots": np.arange(9), "pairs": np.arange(9)}
        | {"inputs": np.zeros((9, 2), np.float32), "targets": np.zeros((9, 1), np.float32)},
        {"slots": np.array([CAPACITY])},
        {"slots": np.array([-1])},
    ],
    ids=["inputs", "targets", "capacity", "slot", "no slot"],
)
def test_a_snapshot_of_another_experiment_is_refused_and_asked_for_again(fields: dict[str, Any]) -> None:
    rig = Rig()
    rig.insert()
    rig.snapshot_fields = fields
    assert [rig.evolver.step() for _ in range(5)] == [False] * 5
    assert rig.evolver.bus.refusals.counts[keys.RESUME.path] == 5
    rig.snapshot_fields = {}
    assert [m.version for m in rig.settle()] == [1]


def test_a_restarted_evolver_goes_on_from_the_kept_model() -> None:
    rig = Rig()
    for _ in range(4):
        rig.insert()
        rig.settle()
    rig.kept = rig.settle()[-1] if rig.models.take() else model(NAME, 40, last=0.3)
    rig.evolver.bus.close()
    rig.start()
    (learnt,) = rig.settle()
    assert (learnt.version, learnt.generation) == (4, 40 + GENERATIONS)


@pytest.mark.parametrize("layers", [[2, 9, 1], [3, 0, 1], [2, 1], [2, 1, 1, 1]], ids=str)
def test_a_kept_model_that_does_not_fit_is_refused_and_evolution_begins_anew(layers: list[int]) -> None:
    rig = Rig()
    rig.kept = model(NAME, 40, layers=layers)
    rig.insert()
    assert [(m.version, m.generation) for m in rig.settle()] == [(1, GENERATIONS)]
    assert rig.evolver.bus.refusals.counts[keys.KEPT_MODEL.path] == 1


def network(value: float, hidden: int = 1) -> messages.ModelWeights:
    """What explains the rig's memory exactly when `value` is 1: the target is the first input; nearly linear."""
    layers = [2, hidden, 1]
    first, last = np.zeros((hidden, 3)), np.zeros((1, hidden + 1))
    first[0, 0], last[0, 0] = 1e-3, 1e3 * value
    return messages.ModelWeights(layers=layers, weights=np.concatenate([first.ravel(), last.ravel()]))


EXACT, WRONG, OPPOSITE = network(1.0), network(-1.0), network(-0.5)


def settled(*, seeds: Sequence[messages.ModelWeights] = ()) -> tuple[Rig, messages.CurrentModel]:
    """A rig that has learnt a full memory, then a change that brings seeds and nothing else."""
    rig = Rig()
    for _ in range(CAPACITY):
        rig.insert()
        rig.settle()
    rig.version += 1
    rig.change(slots=[], pairs=[], inputs=np.zeros((0, 2)), targets=np.zeros((0, 1)), seeds=seeds)
    (learnt,) = rig.settle()
    assert learnt.version == rig.version == CAPACITY + 1
    return rig, learnt


@pytest.mark.parametrize("seeds", [[EXACT], [EXACT, WRONG], [WRONG, OPPOSITE, EXACT]], ids=len)
def test_recalled_networks_enter_the_population(seeds: list[messages.ModelWeights]) -> None:
    _, without = settled()
    rig, learnt = settled(seeds=seeds)
    assert learnt.error < 1e-5 < without.error, "the best is as good as the best seed"
    assert rig.evolver.bus.refusals.counts == {}
    rig.insert()
    assert rig.settle()[-1].error < 1e-5, "and stays"


def test_wrong_seeds_do_no_harm() -> None:
    _, without = settled()
    _, learnt = settled(seeds=[WRONG, OPPOSITE])
    assert learnt.error <= without.error * 1.5


@pytest.mark.parametrize(
    "bad",
    [
        network(1.0, hidden=9),
        messages.ModelWeights(layers=[3, 0, 1], weights=np.zeros(1)),
        messages.ModelWeights(layers=[2, 1], weights=np.zeros(3)),
        messages.ModelWeights(layers=[2, 1, 1, 1], weights=np.zeros(7)),
    ],
    ids=lambda bad: str(bad.layers),
)
def test_a_recalled_network_that_does_not_fit_is_counted_and_the_others_are_taken(bad: messages.ModelWeights) -> None:
    for seeds in ([bad, EXACT], [EXACT, bad]):
        rig, learnt = settled(seeds=seeds)
        assert rig.evolver.bus.refusals.counts == {keys.MEMORY_CHANGE.path: 1}
        assert learnt.error < 1e-5


def test_a_change_of_context_frees_slots_and_writes_others() -> None:
    rig = Rig()
    for _ in range(CAPACITY):
        rig.insert()
    rig.settle()
    rig.version += 1
    values = [0.3, -0.8]
    rig.change(
        slots=[3, 0], pairs=[-1, -2], freed=[1], evicted=[0, 1, 3],
        inputs=[rig._inputs(value) for value in values], targets=[[value] for value in values],
    )  # fmt: skip
    (learnt,) = rig.settle()
    inputs = np.array([rig._inputs(value) for value in (-0.8, np.sin(2), 0.3)], np.float32)
    misses = Network.from_arrays(learnt.layers, learnt.weights).predict(inputs) - inputs[:, :1]
    assert learnt.error == pytest.approx(np.mean(misses**2), rel=1e-5)
    rig.rows = {0: (-2, -0.8), 2: (2, np.sin(2)), 3: (-1, 0.3)}
    asked, other = rig.asked, rig.start()
    other.step()
    assert rig.asked == asked + 1
    for one, same in zip(other._mirror.arrays(), rig.evolver._mirror.arrays(), strict=True):
        assert np.array_equal(one, same)


def test_a_memory_that_was_emptied_is_followed_and_nothing_is_learnt_from_it() -> None:
    rig = Rig()
    rig.insert()
    rig.settle()
    rig.version += 1
    nothing = {"slots": [], "pairs": [], "inputs": np.zeros((0, 2)), "targets": np.zeros((0, 1))}
    rig.change(**nothing, freed=[0], evicted=[0])
    rig.settle()
    rig.rows.clear()
    rig.insert()
    assert [m.version for m in rig.settle()] == [3]


def test_an_evolver_that_joins_takes_the_networks_of_the_present_context() -> None:
    rig = Rig(store=False)
    for _ in range(CAPACITY):
        rig.insert()
    rig.snapshot_fields = {"seeds": [EXACT]}
    rig.open_store()
    assert rig.settle()[-1].error < 1e-5


def test_an_evolver_that_joins_takes_all_of_them_and_the_kept_model() -> None:
    rig = Rig(store=False)
    for _ in range(CAPACITY):
        rig.insert()
    rig.snapshot_fields = {"seeds": [EXACT, WRONG]}
    rig.kept = model(NAME, 1)
    rig.open_store()
    assert rig.settle()[-1].error < 1e-5


def test_after_a_gap_the_networks_come_with_the_snapshot() -> None:
    rig, _ = settled()
    rig.version += 2
    rig.snapshot_fields = {"seeds": [EXACT]}
    rig.change(slots=[], pairs=[], inputs=np.zeros((0, 2)), targets=np.zeros((0, 1)))
    (learnt,) = rig.settle()
    assert (learnt.version, learnt.error < 1e-5) == (rig.version, True)


def test_a_model_that_the_file_lacks_is_a_config_error() -> None:
    with pytest.raises(ConfigError, match="no model 'subject'"):
        Evolver(MemoryBus(Fabric(), BRAIN), config(), "subject")


def taught(rig: Rig, versions: int) -> list[messages.CurrentModel]:
    """Let the memory change so often, one change after the other, as a store that keeps them; return the models."""
    models = []
    for _ in range(versions):
        rig.insert()
        rig.steps.append(rig.last)
        models += rig.settle()
        if (checkpoint := rig.checkpoints.take()) is not None:
            rig.checkpoint = checkpoint
            rig.steps = [change for change in rig.steps if change.version > checkpoint.version]
    return models


LEARNERS = ["pbga", "ga", "de", "cma", "adam", "ridge"]


@pytest.mark.parametrize("learner", LEARNERS)
@pytest.mark.parametrize("died_at", [1, 4, 5, 7, 10])
def test_in_lockstep_a_killed_evolver_goes_on_as_if_it_had_lived(learner: str, died_at: int) -> None:
    settings = config(experiment=LOCKSTEP, learner={"name": learner}, evolver={"checkpoint_every": 5})
    straight, rig = Rig(settings), Rig(settings)
    expected = taught(straight, 12)
    taught(rig, died_at)
    rig.evolver.bus.close()
    rig.start()
    again = rig.settle()
    assert [m.version for m in again] == [died_at], "the last once more: nobody may have heard it"
    got = [*again, *taught(rig, 12 - died_at)]
    assert [codec.encode(m) for m in got] == [codec.encode(m) for m in expected[died_at - 1 :]]


def test_in_the_concurrent_pace_a_killed_evolver_goes_on_with_its_population() -> None:
    rig = Rig(config(evolver={"checkpoint_every": 5}))
    taught(rig, 7)
    population = rig.evolver._learner.state()["weights"]
    rig.evolver.bus.close()
    rig.start()
    (learnt,) = rig.settle()
    assert (learnt.version, learnt.generation) == (7, GENERATIONS * 6), "5 as they were, the newest once more"
    assert (rig.evolver._learner.state()["weights"] == population).mean() > 0.05, "the elite at least"


def test_a_checkpoint_of_another_experiment_is_refused_and_all_begins_anew() -> None:
    rig = Rig(config(experiment=LOCKSTEP, evolver={"checkpoint_every": 5}))
    taught(rig, 6)
    assert rig.checkpoint is not None
    wrong = {name: array[:1] for name, array in rig.checkpoint.state.items()}
    rig.checkpoint = msgspec.structs.replace(rig.checkpoint, state=wrong)
    rig.evolver.bus.close()
    rig.start()
    assert [m.version for m in rig.settle()] == [6]
    assert rig.evolver.bus.refusals.counts == {keys.RESUME.path: 1}


def test_a_change_missed_in_lockstep_is_made_good_step_by_step() -> None:
    settings = config(experiment=LOCKSTEP)
    straight, rig = Rig(settings), Rig(settings)
    expected = taught(straight, 6)
    taught(rig, 3)
    rig.publisher = rig.store.publisher(keys.MEMORY_CHANGE, model="induced")  # lost on the way
    rig.insert()
    rig.steps.append(rig.last)
    rig.publisher = rig.store.publisher(keys.MEMORY_CHANGE, model=NAME)
    assert weights(taught(rig, 2)[-1:]) == weights(expected[-1:])
