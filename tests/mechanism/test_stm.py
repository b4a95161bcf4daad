import time
from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_services.mechanism.stm import Change, MemoryConfig, MemoryMirror, ShortTermMemory, VersionGapError


def filled(config: MemoryConfig, rows: list[list[float]], capacity: int, entry_errors: list[float] | None = None):
    memory = ShortTermMemory(capacity, len(rows[0]), 1, config)
    for i, row in enumerate(rows):
        memory.insert(i, np.array(row), np.zeros(1), entry_errors[i] if entry_errors else 0.0)
    return memory


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
        assert change.evicted_id == (queue.popleft() if len(queue) == capacity else None)
        queue.append(pair)
    inputs, targets, stored = memory.arrays()
    assert sorted(stored) == sorted(queue)
    assert np.array_equal(inputs[:, 0], stored)
    assert np.array_equal(targets[:, 0], -stored)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 8), st.integers(0, 40), st.integers(0, 1000))
def test_a_mirror_that_applies_every_change_holds_the_same(capacity: int, inserts: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    memory = ShortTermMemory(capacity, 2, 1, MemoryConfig(recency=0.3, distance=1, entry_error=0.2))
    mirror = MemoryMirror(capacity, 2, 1)
    for pair in range(inserts):
        row, target = random.random(2), random.random(1)
        change = memory.insert(pair, row, target, random.random())
        assert change is not None
        mirror.apply(change, row, target)
    for own, mirrored in zip(memory.arrays(), mirror.arrays(), strict=True):
        assert np.array_equal(own, mirrored)
    assert mirror.version == memory.version == inserts


def test_mirror_refuses_a_gap_and_a_state_mends_it() -> None:
    memory = ShortTermMemory(3, 1, 1, MemoryConfig())
    mirror = MemoryMirror(3, 1, 1)
    memory.insert(1, np.array([1]), np.array([1]), 0)
    second = memory.insert(2, np.array([2]), np.array([2]), 0)
    assert second is not None
    with pytest.raises(VersionGapError, match="ask for the whole memory"):
        mirror.apply(second, np.array([2]), np.array([2]))
    mirror.restore(memory.state())
    third = memory.insert(3, np.array([3]), np.array([3]), 0)
    assert third is not None
    mirror.apply(third, np.array([3]), np.array([3]))
    assert np.array_equal(mirror.arrays()[2], [1, 2, 3])


def test_mirror_refuses_a_slot_beyond_the_next() -> None:
    with pytest.raises(ValueError, match="slot 2"):
        MemoryMirror(3, 1, 1).apply(Change(1, 2, 1, None), np.zeros(1), np.zeros(1))


def test_distance_lets_the_redundant_leave_and_of_a_contradiction_the_older() -> None:
    memory = filled(MemoryConfig(recency=0, distance=1), [[0.0], [1.0], [0.9], [-1.0]], capacity=4)
    change = memory.insert(9, np.array([0.5]), np.zeros(1), 0)
    assert change is not None
    assert change.evicted_id == 1  # as near to 2 as 2 is to it, and older
    change = memory.insert(10, np.array([-1.0]), np.ones(1), 0)
    assert change is not None
    assert change.evicted_id == 3


@pytest.mark.parametrize("which", ["current_error", "entry_error"])
def test_errors_let_the_best_predicted_leave(which: str) -> None:
    errors = [0.5, 0.1, 0.9]
    memory = filled(MemoryConfig(recency=0, **{which: 1.0}), [[0.0], [1.0], [2.0]], 3, errors)
    change = memory.insert(9, np.array([5.0]), np.zeros(1), 0.0, np.array(errors))
    assert change is not None
    assert change.evicted_id == 1


def test_label_is_the_weighted_sum_of_scaled_terms() -> None:
    config = MemoryConfig(recency=2, distance=3, current_error=5, entry_error=7)
    memory = filled(config, [[0.0], [1.0], [3.0]], 3, [0.2, 0.4, 0.8])
    recency, distance = np.array([0, 0.5, 1]), np.array([0.5, 0.5, 1])
    current, entry = np.array([1, 0.5, 0]), np.array([0.25, 0.5, 1])
    expected = 2 * recency + 3 * distance + 5 * current + 7 * entry
    np.testing.assert_allclose(memory.labels(np.array([4.0, 2.0, 0.0])), expected)


def test_temporal_setting_after_a_change_of_context() -> None:
    memory = filled(MemoryConfig(recency=0, distance=1), [[0.0], [5.0], [5.1]], 3)
    memory.configure(MemoryConfig())
    change = memory.insert(9, np.array([5.05]), np.zeros(1), 0)
    assert change is not None
    assert change.evicted_id == 0


def test_restored_memory_continues_identically() -> None:
    config, random = MemoryConfig(recency=0.2, distance=1, entry_error=0.3), np.random.default_rng(3)
    memory, restored = (ShortTermMemory(6, 2, 1, config) for _ in range(2))
    for pair in range(10):
        memory.insert(pair, random.random(2), random.random(1), random.random())
    restored.restore(memory.state())
    for pair in range(10, 40):
        row, target, error = random.random(2), random.random(1), random.random()
        assert memory.insert(pair, row, target, error) == restored.insert(pair, row, target, error)


def test_what_does_not_fit_is_refused() -> None:
    memory = filled(MemoryConfig(), [[0.0, 1.0]], 3)
    with pytest.raises(ValueError, match="expected 2 finite numbers"):
        memory.insert(7, np.zeros(3), np.zeros(1), 0)
    with pytest.raises(ValueError, match="predict the pair first"):
        memory.insert(7, np.zeros(2), np.zeros(1), float("nan"))
    with pytest.raises(ValueError, match="make it with that capacity"):
        ShortTermMemory(1, 2, 1, MemoryConfig()).restore(filled(MemoryConfig(), [[0, 0], [1, 1]], 3).state())
    with pytest.raises(ValueError, match="one positive at least"):
        MemoryConfig(recency=0)


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
