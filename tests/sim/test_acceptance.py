"""The acceptance table is honest: every seed visible, a missing value meets nothing."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from mdb_sim.acceptance import (
    PAPER_CAPTURES,
    PAPER_OBEDIENCE,
    AcceptanceRow,
    acceptance_row,
    acceptance_table,
    judge,
)
from tests.sim.test_measures import write_run


def good_row(seed: int) -> AcceptanceRow:
    return AcceptanceRow(
        run=f"run-{seed}",
        seed=seed,
        iterations=2000,
        below=(45.0, 80.0),
        pair_errors=(0.04, 0.03),
        obedience=(0.99, 0.97),
        captures=(69.0, 112.0, 106.0, 111.0),
        obedience_windows=PAPER_OBEDIENCE,
        capture_windows=PAPER_CAPTURES,
    )


def test_the_table_lists_the_criteria_of_the_notes_and_what_is_met() -> None:
    criteria = judge([good_row(seed) for seed in range(1, 6)])
    assert [c.must for c in criteria] == [
        "100 / 200", "< 20 %", "≥ 90 %; ≥ 80 %", "≥ 60", "≥ 85; ≥ 60", "≥ 85", "≥ 85; ≥ 60",
    ]  # fmt: skip
    assert all(c.must_met for c in criteria)
    assert [c.stretch_met for c in criteria] == [True, True, False, True, True, True, True]


def test_one_bad_seed_fails_the_worst_but_not_the_mean_and_stays_visible() -> None:
    rows = [good_row(seed) for seed in range(1, 5)]
    rows.append(replace(good_row(5), captures=(69.0, 41.0, 106.0, 111.0), below=(math.inf, 80.0)))
    criteria = judge(rows)
    assert [c.must_met for c in criteria] == [True, True, True, True, False, True, True]
    assert criteria[4].statistic("mean") == pytest.approx((97.8,))
    assert criteria[4].statistic("worst") == (41.0,)
    table = acceptance_table(rows)
    assert "| run-5 | 5 | 2000 | never | 80 | 4.0 % | 3.0 % | 99.0 % | 97.0 % | 69 | 41 | 106 | 111 |" in table
    assert table.count("**no**") == 3
    assert "paper's schedule" not in table


def test_a_missing_value_meets_nothing_and_a_limit_of_the_error_is_not_below_it() -> None:
    criteria = judge([replace(good_row(1), captures=(69.0,), pair_errors=(0.2, 0.03))])
    assert [c.must_met for c in criteria] == [True, False, True, True, False, False, False]
    assert not any(c.must_met for c in judge([]))


def test_another_schedule_is_pointed_out(tmp_path: Path) -> None:
    assert "paper's schedule" in acceptance_table([acceptance_row(write_run(tmp_path / "run", 10))])
