import numpy as np
import pytest

from mdb_services.mechanism.memories import ltm
from mdb_services.mechanism.memories.ltm import sample_of
from mdb_services.mechanism.networks.gaps import squared_gaps


@pytest.mark.parametrize("columns", [0, 1, 2, 3, 7, 8, 9, 17])
def test_few_columns_are_added_to_the_same_bits_as_many(columns: int) -> None:
    random = np.random.default_rng(columns)
    rows, others = (random.normal(size=(count, columns)).astype(np.float32) for count in (60, 301))
    expected = np.add.reduce(np.square(others - rows[:, None]), axis=2)
    assert np.array_equal(squared_gaps(rows, others), expected)


@pytest.mark.parametrize("columns", [2, 9])
def test_a_sample_of_many_is_that_of_few_at_once(columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = np.random.default_rng(0).normal(size=(300, columns)).astype(np.float32)
    at_once = sample_of(rows, 40)
    monkeypatch.setattr(ltm, "ALL", 1)
    assert np.array_equal(sample_of(rows, 40), at_once)
