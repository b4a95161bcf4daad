"""An evolver between a hand-driven memory store and whoever wants its models."""

from typing import Any

import numpy as np
import pytest

from mdb_protocol import codec, keys, messages
from mdb_protocol.bus import Raw
from mdb_protocol.errors import ConfigError
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.config import BrainConfig
from mdb_services.evolver import Evolver
from tests.services.small import BRAIN, LOCKSTEP, config, model

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
        self.evolver = self.start()
        if store:
            self.open_store()

    def start(self) -> Evolver:
        self.evolver = Evolver(MemoryBus(self.fabric, BRAIN), self.settings, NAME)
        return self.evolver

    def open_store(self) -> None:
        self.store.queryable(keys.MEMORY_SNAPSHOT, self._snapshot, model=NAME)
        self.store.queryable(keys.KEPT_MODEL, lambda: self.kept, model=NAME)

    def _snapshot(self) -> messages.MemorySnapshot:
        self.asked += 1
        order = sorted(self.rows)
        fields = {
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
        evicted = self.rows.get(slot, (None,))[0]
        self.rows[slot] = (self.version, value)
        self.version += 1
        if not lost:
            self.change(slot=slot, evicted=evicted, inputs=self._inputs(value), targets=[value])

    def change(self, *, inputs: list[float], targets: list[float], **fields: Any) -> None:
        plain = {"version": self.version, "pair": self.version, "evicted": None, "slot": 0} | fields
        rows = {"inputs": np.array(inputs, np.float32), "targets": np.array(targets, np.float32)}
        self.publisher.put(messages.MemoryChange(model=NAME, **plain, **rows))

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

    def fail() -> messages.MemorySnapshot:
        raise OSError("disk is gone")

    rig.store.queryable(keys.MEMORY_SNAPSHOT, fail, model=NAME)
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
    rig.change(version=1, inputs=[9, 9], targets=[9])
    assert rig.settle() == []


@pytest.mark.parametrize(
    "fields",
    [
        {"inputs": [0.0, 0.0, 0.0], "targets": [0.0]},
        {"inputs": [0.0], "targets": [0.0]},
        {"inputs": [0.0, 0.0], "targets": []},
        {"inputs": [0.0, 0.0], "targets": [0.0, 0.0]},
        {"inputs": [0.0, 0.0], "targets": [0.0], "slot": 3},
        {"inputs": [0.0, 0.0], "targets": [0.0], "slot": 2**31},
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
        dict.fromkeys(("pairs",), np.zeros(9, np.int64))
        | {"inputs": np.zeros((9, 2), np.float32), "targets": np.zeros((9, 1), np.float32)},
    ],
    ids=["inputs", "targets", "capacity"],
)
def test_a_snapshot_of_another_experiment_is_refused_and_asked_for_again(fields: dict[str, Any]) -> None:
    rig = Rig()
    rig.insert()
    rig.snapshot_fields = fields
    assert [rig.evolver.step() for _ in range(5)] == [False] * 5
    assert rig.evolver.bus.refusals.counts[keys.MEMORY_SNAPSHOT.path] == 5
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


def test_a_model_that_the_file_lacks_is_a_config_error() -> None:
    with pytest.raises(ConfigError, match="no model 'subject'"):
        Evolver(MemoryBus(Fabric(), BRAIN), config(), "subject")
