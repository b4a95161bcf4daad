"""Praise counts by the best praise of late; punishment stays what it is."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdb_services.mechanism.feedback.praise import FAINT, LATELY, Praise, worth

feedback = st.floats(-1, 1)


def bests(praise: Praise, values: list[float], judges: str = "anna", first: int = 0) -> list[float]:
    """Return the best of late after each judgement, one an iteration."""
    found = []
    for i, value in enumerate(values, first):
        praise.take(i, value, [judges])
        found.append(praise.best(i))
        praise.forget(i - 3)
    return found


@given(st.lists(feedback, min_size=1, max_size=80), st.integers(1, 40))
def test_the_best_is_that_of_the_last_judgements_and_full_praise_until_there_are_enough(
    values: list[float], window: int
) -> None:
    last = [values[max(0, i + 1 - window) : i + 1] for i in range(len(values))]
    assert bests(Praise(window), values) == [max(few) if len(few) == window else 1.0 for few in last]


@given(feedback, feedback)
def test_worth_keeps_the_order_and_the_bounds_and_leaves_punishment(value: float, best: float) -> None:
    counted = worth(value, best)
    assert -1 <= counted <= 1
    assert counted == value if value <= 0 else counted >= value
    assert worth(value, 1.0) == value
    assert value <= 0 or worth(value / 2, best) <= counted


def test_praise_that_fades_is_worth_as_much_as_at_first() -> None:
    values = [0.5 ** (i / 200) for i in range(600)]
    counted = [worth(*both) for both in zip(values, bests(Praise(30), values), strict=True)]
    assert min(counted) > 0.85


def test_praise_too_faint_to_be_meant_does_not_count_as_full() -> None:
    assert worth(FAINT / 10, bests(Praise(5), [FAINT / 10] * 10)[-1]) == pytest.approx(0.1)


def test_a_teacher_who_comes_is_measured_by_full_praise_at_first() -> None:
    praise = Praise(window=3)
    assert bests(praise, [0.1] * 4)[-1] == 0.1
    assert bests(praise, [0.2] * 4, judges="ben", first=4) == [1.0, 1.0, 0.2, 0.2]
    assert bests(praise, [0.1] * 4, first=8) == [1.0, 1.0, 0.1, 0.1]


def test_judges_are_the_same_in_whatever_order_they_judge() -> None:
    praise = Praise(window=3)
    for i in range(6):
        praise.take(i, 0.2, ["anna", "ben"] if i % 2 else ["ben", "anna"])
    assert praise.best(5) == 0.2
    praise.take(6, 0.2, ["anna"])
    assert praise.best(6) == 1.0


def test_who_comes_back_after_a_pause_is_measured_by_full_praise_at_first() -> None:
    praise = Praise(window=3)
    bests(praise, [0.1] * 4)
    assert bests(praise, [0.1] * 3, first=3 + LATELY) == [1.0, 1.0, 0.1]


def test_late_feedback_counts_where_it_belongs() -> None:
    praise = Praise(window=3)
    for i, value in enumerate((0.2, 0.9, 0.1, 0.3, 0.2)):
        praise.take(i, value, ["anna"])
    praise.take(2, 0.4, ["anna"])
    assert (praise.best(2), praise.best(4)) == (0.9, 0.4)


def test_without_a_window_full_praise_is_the_measure() -> None:
    assert set(bests(Praise(window=0), [0.1] * 50)) == {1.0}


def test_what_is_kept_is_bounded() -> None:
    praise = Praise(window=2)
    bests(praise, [0.1] * 3 * LATELY)
    assert len(praise._given) <= LATELY + 4
