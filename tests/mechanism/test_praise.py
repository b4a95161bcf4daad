"""Praise counts by the best praise of late; punishment stays what it is."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdb_services.mechanism.praise import FAINT, LONG_AGO, Praise, worth

feedback = st.floats(-1, 1)


@given(st.lists(feedback, min_size=1, max_size=80), st.integers(1, 40))
def test_the_best_is_that_of_the_last_judgements_and_full_praise_until_there_are_enough(
    values: list[float], window: int
) -> None:
    praise = Praise(window)
    for i, value in enumerate(values):
        last = values[max(0, i + 1 - window) : i + 1]
        expected = max(last) if len(last) == window else 1.0
        assert praise.best(i, value) == expected
        praise.forget(i - 3)


@given(feedback, feedback)
def test_worth_keeps_the_order_and_the_bounds_and_leaves_punishment(value: float, best: float) -> None:
    counted = worth(value, best)
    assert -1 <= counted <= 1
    assert counted == value if value <= 0 else counted >= value
    assert worth(value, 1.0) == value
    assert value <= 0 or worth(value / 2, best) <= counted


def test_praise_that_fades_is_worth_as_much_as_at_first() -> None:
    praise = Praise(window=30)
    for i in range(600):
        value = 0.5 ** (i / 200)
        counted = worth(value, praise.best(i, value))
        assert counted == pytest.approx(1.0, abs=0.1)


def test_praise_too_faint_to_be_meant_does_not_count_as_full() -> None:
    praise = Praise(window=5)
    for i in range(10):
        best = praise.best(i, FAINT / 10)
    assert worth(FAINT / 10, best) == pytest.approx(0.1)


def test_late_feedback_counts_where_it_belongs() -> None:
    praise = Praise(window=3)
    for i, value in enumerate((0.2, 0.9, 0.1, 0.3, 0.2)):
        praise.best(i, value)
    assert praise.best(2, 0.4) == 0.9
    assert praise.best(4, 0.2) == 0.4


def test_without_a_window_full_praise_is_the_best() -> None:
    praise = Praise(window=0)
    assert {praise.best(i, 0.1) for i in range(50)} == {1.0}
    praise.forget(40)
    assert praise.best(50, 0.1) == 1.0


def test_what_is_long_ago_is_forgotten_and_what_is_kept_is_bounded() -> None:
    praise = Praise(window=2)
    for i in range(500):
        praise.best(i, 0.1)
        praise.forget(i - 20)
    assert len(praise._given) <= 22 + 1
    assert praise.best(500, 0.1) == 0.1
    assert praise.best(500 + LONG_AGO, 0.1) == 1.0


def test_restored_it_goes_on_the_same() -> None:
    values = [math.sin(i) for i in range(40)]
    whole, again = Praise(window=7), Praise(window=7)
    for i, value in enumerate(values):
        whole.best(i, value)
    again.restore(dict(enumerate(values)))
    assert [whole.best(i, 0.1) for i in range(40, 60)] == [again.best(i, 0.1) for i in range(40, 60)]
