"""The short-term memory: who leaves, what a change of context does, and that a mirror holds the same."""

import time
from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_services.mechanism.memories.stm import Change, MemoryConfig, MemoryMirror, ShortTermMemory, VersionGapError

fixed = settings(derandomize=True, deadline=None, max_examples=60)
MIXED = MemoryConfig(recency=0.3, distance=1, entry_error=0.2)


def filled(
    config: MemoryConfig, rows: list[list[float]], capacity: int, entry_errors: list[float] | None = None
) -> ShortTermMemory:
    memory = ShortTermMemory(capacity, len(rows[0]), 1, config)
    for i, row in enumerate(rows):
        memory.insert(i, np.array(row), np.zeros(1), entry_errors[i] if entry_errors else 0.0)
    return memory


def put(memory: ShortTermMemory, pair: int, row: list[float] | None = None) -> Change:
    change = memory.insert(pair, np.array([float(pair)] if row is None else row), np.array([-float(pair)]), 0.0)
    assert change is not None
    return change


def recalled(count: int, width: int = 1) -> tuple[tuple[int, ...], np.ndarray, np.ndarray]:
    """Ids, inputs and targets of pairs from the long-term memory."""
    ids = tuple(range(-1, -1 - count, -1))
    return ids, np.repeat(np.array(ids, float)[:, None], width, axis=1), -np.array(ids, float)[:, None]


def by_id(memory: MemoryMirror) -> dict[int, tuple[list[float], list[float]]]:
    return {int(id): (i.tolist(), t.tolist()) for i, t, id in zip(*memory.arrays(), strict=True)}


def judged(outcome: float, pairs: list[tuple[float, float]], capacity: int = 4) -> ShortTermMemory:
    """A memory by distance alone of these inputs and targets, in this order; ids from 0 on."""
    memory = ShortTermMemory(capacity, 1, 1, MemoryConfig(recency=0, distance=1, outcome=outcome))
    for id, (row, target) in enumerate(pairs):
        memory.insert(id, np.array([row]), np.array([target]), 0.0)
    return memory


class Story:
    """An owner that lives through random inserts and changes of context; what each changed, with its rows."""

    def __init__(self, capacity: int, seed: int, config: MemoryConfig = MIXED) -> None:
        self.memory = ShortTermMemory(capacity, 2, 1, config)
        self.random = np.random.default_rng(seed)
        self.pairs, self.recalled = 0, 0

    def insert(self) -> tuple[Change, np.ndarray, np.ndarray]:
        row, target = self.random.integers(0, 4, 2) / 2, self.random.random(1)
        change = self.memory.insert(self.pairs, row, target, self.random.random())
        assert change is not None
        self.pairs += 1
        return change, row[None], target[None]

    def begin_context(self, back: int, count: int) -> tuple[Change, np.ndarray, np.ndarray]:
        """The context began `back` versions ago; as many pairs come back as `count`, or as there is room for."""
        ids = tuple(range(-self.recalled - 1, -self.recalled - 1 - count, -1))
        self.recalled += count
        inputs, targets = self.random.random((count, 2)), self.random.random((count, 1))
        first = max(0, self.memory.version - back)
        change = self.memory.begin_context(first, ids, inputs, targets)
        return change, inputs[: len(change.ids)], targets[: len(change.ids)]

    def step(self, kind: tuple[int, int] | None) -> tuple[Change, np.ndarray, np.ndarray]:
        return self.insert() if kind is None else self.begin_context(*kind)


steps = st.lists(st.none() | st.tuples(st.integers(-1, 9), st.integers(0, 6)), max_size=40)
"""None: an insert; otherwise a change of context that began so many versions ago, with so many pairs recalled."""


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 8), st.lists(st.integers(0, 30), max_size=60))
def test_recency_alone_is_first_in_first_out(capacity: int, ids: list[int]) -> None:
    memory = ShortTermMemory(capacity, 1, 1, MemoryConfig())
    queue: deque[int] = deque()
    for pair in ids:
        change = memory.insert(pair, np.array([pair]), np.array([-pair]), 0.5)
        if pair in queue:
            assert change is None
            continue
        assert change is not None
        assert change.evicted == ((queue.popleft(),) if len(queue) == capacity else ())
        queue.append(pair)
    inputs, targets, stored = memory.arrays()
    assert sorted(stored) == sorted(queue)
    assert np.array_equal(inputs[:, 0], stored)
    assert np.array_equal(targets[:, 0], -stored)


@fixed
@given(st.integers(1, 8), steps, st.integers(0, 1000))
def test_a_mirror_that_applies_every_change_holds_the_same(
    capacity: int, kinds: list[tuple[int, int] | None], seed: int
) -> None:
    story, mirror = Story(capacity, seed), MemoryMirror(capacity, 2, 1)
    for kind in kinds:
        held = set(by_id(mirror))
        change, inputs, targets = story.step(kind)
        mirror.apply(change, inputs, targets)
        assert set(by_id(mirror)) == held - set(change.evicted) | set(change.ids)
        assert set(change.evicted) <= held
        assert by_id(mirror) == by_id(story.memory)
        assert np.array_equal(mirror.slots, story.memory.slots)
        assert len(mirror) == len(mirror.slots) <= capacity
    assert mirror.version == story.memory.version == len(kinds)


@fixed
@given(st.integers(1, 8), steps, st.integers(0, 1000), st.integers(0, 40))
def test_a_mirror_that_joins_late_holds_the_same(
    capacity: int, kinds: list[tuple[int, int] | None], seed: int, joins: int
) -> None:
    story, mirror = Story(capacity, seed), MemoryMirror(capacity, 2, 1)
    for place, kind in enumerate(kinds):
        if place == joins:
            mirror.restore(story.memory.state())
        change, inputs, targets = story.step(kind)
        if place >= joins:
            mirror.apply(change, inputs, targets)
            assert by_id(mirror) == by_id(story.memory)


def test_mirror_refuses_a_gap_and_a_state_mends_it() -> None:
    memory = ShortTermMemory(3, 1, 1, MemoryConfig())
    mirror = MemoryMirror(3, 1, 1)
    put(memory, 1)
    second = put(memory, 2)
    with pytest.raises(VersionGapError, match="ask for the whole memory"):
        mirror.apply(second, np.array([[2]]), np.array([[-2]]))
    assert len(mirror) == mirror.version == 0
    mirror.restore(memory.state())
    third = put(memory, 3)
    mirror.apply(third, np.array([[3]]), np.array([[-3]]))
    assert np.array_equal(mirror.arrays()[2], [1, 2, 3])


ONE = np.zeros((1, 1))


@pytest.mark.parametrize(
    ("change", "inputs", "targets", "said"),
    [
        (Change(3, (3,), (9,), ()), ONE, ONE, "touches slots"),
        (Change(3, (-1,), (9,), ()), ONE, ONE, "touches slots"),
        (Change(3, (), (), (), (3,)), ONE[:0], ONE[:0], "touches slots"),
        (Change(3, (0, 0), (8, 9), ()), np.zeros((2, 1)), np.zeros((2, 1)), "each once"),
        (Change(3, (0,), (9,), (), (0,)), ONE, ONE, "each once"),
        (Change(3, (), (), (), (1, 1)), ONE[:0], ONE[:0], "each once"),
        (Change(3, (0,), (9,), ()), np.zeros((2, 1)), ONE, "input rows"),
        (Change(3, (0,), (9,), ()), np.zeros((1, 2)), ONE, "input rows"),
        (Change(3, (0,), (9,), ()), ONE, np.zeros((1, 2)), "target rows"),
        (Change(3, (0,), (9,), ()), ONE, np.full((1, 1), np.nan), "target rows"),
        (Change(3, (0,), (9,), ()), np.full((1, 1), np.inf), ONE, "input rows"),
        (Change(3, (0,), (8, 9), ()), ONE, ONE, "ids"),
        (Change(3, (0, 2), (9,), ()), np.zeros((2, 1)), np.zeros((2, 1)), "ids"),
        (Change(3, (0,), (), ()), ONE, ONE, "ids"),
        (Change(2, (0,), (9,), ()), ONE, ONE, "version"),
        (Change(5, (0,), (9,), ()), ONE, ONE, "version"),
    ],
)
def test_a_damaged_change_changes_nothing(change: Change, inputs: np.ndarray, targets: np.ndarray, said: str) -> None:
    mirror = MemoryMirror(3, 1, 1)
    for version in (1, 2):
        mirror.apply(Change(version, (version - 1,), (version,), ()), np.full((1, 1), version), np.ones((1, 1)))
    before = mirror.state()
    with pytest.raises(ValueError, match=said):
        mirror.apply(change, inputs, targets)
    for name, array in mirror.state().items():
        np.testing.assert_array_equal(array, before[name])


def test_distance_lets_the_redundant_leave_and_of_a_contradiction_the_older() -> None:
    memory = filled(MemoryConfig(recency=0, distance=1), [[0.0], [1.0], [0.9], [-1.0]], capacity=4)
    assert put(memory, 9, [0.5]).evicted == (1,)  # as near to 2 as 2 is to it, and older
    assert put(memory, 10, [-1.0]).evicted == (3,)


@pytest.mark.parametrize("which", ["current_error", "entry_error"])
def test_errors_let_the_best_predicted_leave(which: str) -> None:
    errors = [0.5, 0.1, 0.9]
    memory = filled(MemoryConfig(recency=0, **{which: 1.0}), [[0.0], [1.0], [2.0]], 3, errors)
    change = memory.insert(9, np.array([5.0]), np.zeros(1), 0.0, np.array(errors))
    assert change is not None
    assert change.evicted == (1,)


def test_label_is_the_weighted_sum_of_scaled_terms() -> None:
    config = MemoryConfig(recency=2, distance=3, current_error=5, entry_error=7)
    memory = filled(config, [[0.0], [1.0], [3.0]], 3, [0.2, 0.4, 0.8])
    recency, distance = np.array([0, 0.5, 1]), np.array([0.5, 0.5, 1])
    current, entry = np.array([1, 0.5, 0]), np.array([0.25, 0.5, 1])
    expected = 2 * recency + 3 * distance + 5 * current + 7 * entry
    np.testing.assert_allclose(memory.labels(np.array([4.0, 2.0, 0.0])), expected)


CONTRADICTION = [(0.0, 1.0), (0.0, -1.0), (0.5, 0.0), (1.0, 0.0)]
"""The first two are alike in what was there and differ in what came of it."""


def test_pairs_alike_in_inputs_and_unlike_in_outcome_both_stay_where_the_outcome_counts() -> None:
    newcomer = np.array([0.9]), np.array([0.0])
    change = judged(0.3, CONTRADICTION).insert(9, *newcomer, 0.0)
    assert change is not None
    assert change.evicted == (3,), "it is nearest to the newcomer, the contradicting ones are 1.1 apart"
    change = judged(0.0, CONTRADICTION).insert(9, *newcomer, 0.0)
    assert change is not None
    assert change.evicted == (0,), "without, of a contradiction the older leaves"


def test_the_outcome_counts_in_the_squared_distance() -> None:
    memory = judged(0.3, [(0.0, 1.0), (0.0, -1.0), (3.0, 0.0)])
    nearest = np.sqrt([0.3 * 4, 0.3 * 4, 9 + 0.3])
    np.testing.assert_allclose(memory.labels(), nearest / nearest.max(), rtol=1e-6)


def test_of_pairs_alike_in_both_the_older_leaves_also_where_the_outcome_counts() -> None:
    change = judged(0.3, [(0.0, 1.0), (0.0, -1.0), (5.0, 0.0)], 3).insert(9, np.zeros(1), np.array([-1.0]), 0.0)
    assert change is not None
    assert change.evicted == (1,)


def nearest_of(memory: ShortTermMemory) -> np.ndarray:
    """The squared distance of each pair to the nearest other, by looking at all of them."""
    inputs, targets, _ = memory.arrays()
    gaps = np.square(inputs[:, None] - inputs[None]).sum(axis=2)
    gaps += memory.config.outcome * np.square(targets[:, None] - targets[None]).sum(axis=2)
    np.fill_diagonal(gaps, np.inf)
    return gaps.min(axis=1, initial=np.inf)


@pytest.mark.parametrize("outcome", [0.0, 0.3])
@fixed
@given(st.integers(1, 8), steps, st.integers(0, 1000))
def test_the_nearest_other_pair_is_known_whatever_comes_and_leaves(
    outcome: float, capacity: int, kinds: list[tuple[int, int] | None], seed: int
) -> None:
    story = Story(capacity, seed, replace(MIXED, outcome=outcome))
    for kind in kinds:
        story.step(kind)
        np.testing.assert_allclose(story.memory._gaps[story.memory.slots], nearest_of(story.memory), rtol=1e-5)


def test_a_restored_memory_measures_the_same_distances() -> None:
    memory, other = judged(0.3, CONTRADICTION), judged(0.3, [(7.0, 7.0)])
    other.restore(memory.state())
    np.testing.assert_array_equal(other._gaps, memory._gaps)
    np.testing.assert_array_equal(other.labels(), memory.labels())


def test_another_setting_for_a_while_does_not_change_what_the_outcome_counts() -> None:
    memory, straight = (judged(0.3, CONTRADICTION[:3]) for _ in range(2))
    memory.configure(MemoryConfig())
    for one in (memory, straight):
        one.insert(3, np.array([0.0]), np.array([0.0]), 0.0)
    memory.configure(straight.config)
    np.testing.assert_array_equal(memory._gaps, straight._gaps)
    assert put(memory, 9).evicted == put(straight, 9).evicted


def test_temporal_setting_after_a_change_of_context() -> None:
    memory = filled(MemoryConfig(recency=0, distance=1), [[0.0], [5.0], [5.1]], 3)
    memory.configure(MemoryConfig())
    assert put(memory, 9, [5.05]).evicted == (0,)


@fixed
@given(st.integers(1, 8), st.integers(0, 12), st.integers(0, 14), st.integers(0, 12), st.integers(0, 1000))
def test_a_new_context_drops_exactly_what_entered_before_it(
    capacity: int, inserts: int, first: int, count: int, seed: int
) -> None:
    story = Story(capacity, seed)
    entered = {}
    for _ in range(inserts):
        change, _, _ = story.insert()
        entered[change.ids[0]] = change.version
    held = by_id(story.memory)
    stays = {id for id in held if entered[id] >= first}
    ids, inputs, targets = recalled(count, width=2)
    change = story.memory.begin_context(first, ids, inputs, targets)
    assert set(change.evicted) == held.keys() - stays
    assert change.ids == ids[: capacity - len(stays)]
    after = by_id(story.memory)
    assert after.keys() == stays | set(change.ids)
    assert {id: after[id] for id in stays} == {id: held[id] for id in stays}
    assert len(story.memory) == len(after) == len(stays) + len(change.ids)
    assert change.version == story.memory.version == inserts + 1


def test_nothing_leaves_and_nothing_comes_when_nothing_is_dropped_or_recalled() -> None:
    memory = filled(MemoryConfig(), [[0.0], [1.0]], 3)
    held = by_id(memory)
    change = memory.begin_context(0)
    assert (change.slots, change.ids, change.evicted, change.freed) == ((), (), (), ())
    assert (by_id(memory), memory.version) == (held, 3)


def test_of_more_recalled_pairs_than_room_the_last_are_left_out() -> None:
    memory = filled(MemoryConfig(), [[0.0], [1.0], [2.0], [3.0]], 4)
    change = memory.begin_context(3, *recalled(5))
    assert (change.ids, change.evicted, change.freed) == ((-1, -2), (0, 1), ())
    assert sorted(by_id(memory)) == [-2, -1, 2, 3]
    assert by_id(memory)[-2] == ([-2.0], [2.0])
    change = memory.begin_context(3, *recalled(5))  # what was recalled before gives way
    assert (change.ids, change.evicted) == ((-1, -2), (-1, -2))


def test_freed_slots_are_used_again_before_anyone_has_to_leave() -> None:
    memory = filled(MemoryConfig(), [[0.0], [1.0], [2.0], [3.0]], 4)
    change = memory.begin_context(4, *recalled(1))
    assert (change.slots, change.freed) == ((0,), (1, 2))
    assert [put(memory, pair).slots for pair in (10, 11)] == [(1,), (2,)]
    assert sorted(by_id(memory)) == [-1, 3, 10, 11]
    assert put(memory, 12).evicted == (3,), "now it is full, and the oldest leaves"


def test_what_has_left_counts_no_more_as_near() -> None:
    memory = filled(MemoryConfig(recency=0, distance=1), [[0.0], [0.1], [5.0], [9.0]], 4)
    memory.begin_context(2)  # 0.0, next to 0.1, has left
    np.testing.assert_allclose(memory.labels(), np.array([4.9, 4.0, 4.0]) / 4.9, rtol=1e-6)
    memory.begin_context(4, *recalled(2))  # of those there were, 9.0 stays, next to -1.0 and -2.0
    assert memory.arrays()[0][:, 0].tolist() == [-1.0, -2.0, 9.0]
    np.testing.assert_allclose(memory.labels(), np.array([1.0, 1.0, 10.0]) / 10, rtol=1e-6)


def test_recalled_pairs_are_as_old_as_their_context() -> None:
    memory = filled(MemoryConfig(), [[0.0], [1.0]], 3)
    memory.begin_context(2, *recalled(2))
    assert put(memory, 5).evicted == (1,), "the one that came before the change was noticed"
    assert [put(memory, pair).evicted for pair in (6, 7, 8)] == [(-1,), (-2,), (5,)]


def test_the_pairs_of_a_context_are_given_oldest_first() -> None:
    errors_at_entry = [0.1 * i for i in range(6)]
    memory = filled(MemoryConfig(), [[float(i)] for i in range(6)], 4, errors_at_entry)  # slots hold 4, 5, 2, 3
    for first, expected in ((0, [2, 3, 4, 5]), (5, [4, 5]), (6, [5]), (7, [])):
        inputs, targets, errors = memory.since(first)
        assert inputs[:, 0].tolist() == expected
        assert targets.shape == (len(expected), 1)
        assert errors.tolist() == [errors_at_entry[pair] for pair in expected]


@pytest.mark.parametrize("config", [MIXED, replace(MIXED, outcome=0.3)], ids=["inputs", "outcome"])
@fixed
@given(st.integers(1, 8), steps, steps, st.integers(0, 1000))
def test_restored_memory_continues_identically(
    config: MemoryConfig,
    capacity: int,
    before: list[tuple[int, int] | None],
    after: list[tuple[int, int] | None],
    seed: int,
) -> None:
    story, other = Story(capacity, seed, config), Story(capacity, seed + 1, config)
    for kind in before:
        story.step(kind)
    for kind in (None, None, (0, 3), None):  # a memory that held something else
        other.step(kind)
    other.memory.restore(story.memory.state())
    other.random, other.pairs, other.recalled = np.random.default_rng(5), story.pairs, story.recalled
    story.random = np.random.default_rng(5)
    for kind in after:
        assert story.step(kind)[0] == other.step(kind)[0]
        np.testing.assert_array_equal(story.memory.labels(), other.memory.labels())
    for name, array in story.memory.state().items():
        np.testing.assert_array_equal(array, other.memory.state()[name])


def test_what_does_not_fit_is_refused() -> None:
    memory = filled(MemoryConfig(), [[0.0, 1.0]], 3)
    with pytest.raises(ValueError, match=r"input row have shape .*expected finite numbers of shape \(1, 2\)"):
        memory.insert(7, np.zeros(3), np.zeros(1), 0)
    with pytest.raises(ValueError, match="target row have shape"):
        memory.insert(7, np.zeros(2), np.zeros(2), 0)
    with pytest.raises(ValueError, match="predict the pair first"):
        memory.insert(7, np.zeros(2), np.zeros(1), float("nan"))
    with pytest.raises(ValueError, match="make it with that capacity"):
        ShortTermMemory(1, 2, 1, MemoryConfig()).restore(filled(MemoryConfig(), [[0, 0], [1, 1]], 3).state())
    with pytest.raises(ValueError, match="one positive at least"):
        MemoryConfig(recency=0)
    with pytest.raises(ValueError, match="expected 1 or more each"):
        MemoryMirror(0, 1, 1)
    assert (memory.version, len(memory)) == (1, 1)


@pytest.mark.parametrize(
    "damage",
    [
        {"slots": np.array([0, 0])},
        {"slots": np.array([0, 3])},
        {"slots": np.array([-1, 0])},
        {"slots": np.array([0])},
        {"ids": np.array([1, 2, 3])},
        {"inputs": np.zeros((2, 2))},
        {"targets": np.full((2, 1), np.nan)},
        {"orders": np.array([1])},
        {"entry_errors": np.array([0.0, np.inf])},
    ],
    ids=lambda damage: next(iter(damage)),
)
def test_a_damaged_state_is_refused_and_changes_nothing(damage: dict[str, np.ndarray]) -> None:
    memory, other = filled(MemoryConfig(), [[5.0]], 3), filled(MemoryConfig(), [[0.0], [1.0]], 3)
    before = memory.state()
    with pytest.raises(ValueError, match=r"expected finite numbers|make it with that capacity"):
        memory.restore(other.state() | damage)
    for name, array in memory.state().items():
        np.testing.assert_array_equal(array, before[name])
    with pytest.raises(ValueError, match=r"lacks \['orders'\]"):
        memory.restore({name: array for name, array in other.state().items() if name != "orders"})


def test_the_setting_can_be_changed_and_says_what_is_wrong() -> None:
    with pytest.raises(ValueError, match="expected none negative"):
        replace(MIXED, distance=-1.0)
    with pytest.raises(ValueError, match="expected none negative"):
        replace(MIXED, entry_error=float("inf"))
    for bad in (-0.1, float("inf"), float("nan")):
        with pytest.raises(ValueError, match=f"outcome is {bad}; expected 0, or a positive number"):
            replace(MIXED, outcome=bad)


def test_an_insert_takes_less_than_a_millisecond() -> None:
    random = np.random.default_rng(0)
    memory = ShortTermMemory(800, 4, 3, MemoryConfig(recency=0.5, distance=1))
    rows = random.random((900, 4))
    for pair in range(850):
        memory.insert(pair, rows[pair], np.zeros(3), 0)
    times = []
    for pair in range(850, 900):
        start = time.perf_counter()
        memory.insert(pair, rows[pair], np.zeros(3), 0)
        times.append(time.perf_counter() - start)
    assert min(times) < 1e-3
