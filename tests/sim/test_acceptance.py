"""The acceptance table is honest: each seed against its own ideal, all visible, a missing value meets nothing."""

import math

import pytest

from mdb_sim.verdicts.acceptance import (
    acceptance_table,
    error_without_obedience,
    failure_rate,
    failures,
    judge,
)
from tests.sim.phases import run

GOOD = {seed: run(seed) for seed in range(1, 11)}


def missed(seeds: dict[int, tuple]) -> list[str]:  # type: ignore[type-arg]
    return [criterion.name for criterion in judge(seeds) if not criterion.met]


def test_a_good_brain_meets_every_criterion() -> None:
    criteria = judge(GOOD)
    assert [c.must for c in criteria] == [
        *["mean ≥ 97 %; worst ≥ 90 %"] * 2,
        "mean ≥ 97 %",
        "mean ≥ 90 %",
        "median ≤ 45",
        *["mean ≥ 98 %; worst ≥ 96 %"] * 2,
        *["shown only"] * 4,
    ]
    assert missed(GOOD) == []


def test_one_bad_seed_fails_the_worst_and_is_named() -> None:
    seeds = GOOD | {4: run(4, captures={3: 41.0})}
    assert missed(seeds) == ["captures alone, share of ideal, 1500–2000"]
    assert failures(seeds) == (1, 20)
    assert "1 of 20 phases alone below 90 % of the ideal, 5.0 % [0.9 %, 23.6 %]" in failure_rate(seeds)
    assert "4 (1500–2000: 34.2 %)" in failure_rate(seeds)
    table = acceptance_table(seeds)
    assert "| 4 | 69 (70) | 116 (118) | 110 (116) | 41 (120) |" in table
    assert table.count("**no**") == 1


def test_each_seed_is_judged_by_its_own_ideal_and_not_by_a_number() -> None:
    hard = run(4, captures={3: 88.0}, ideal_captures={3: 90.0})
    assert missed(GOOD | {4: hard}) == []


def test_obedience_that_comes_late_in_the_median_is_missed_and_a_low_error_does_not_make_up_for_it() -> None:
    late = {seed: run(seed, iterations_to_obedience={2: 60.0}, iterations_to_error={2: 41.0}) for seed in GOOD}
    assert missed(late) == ["iterations to 90 % obedience, 1000–1500"]


def test_a_brain_that_foresees_well_and_does_not_obey_is_counted() -> None:
    wrong = {seed: run(seed, obedience={2: 0.1}) for seed in (1, 2)} | {3: run(3)}
    told = error_without_obedience(wrong)
    assert "does not imply obedience" in told
    assert "fell below 10 % in 6 of 6 taught phases; in 2 of these" in told


@pytest.mark.parametrize("field", ["captures", "ideal_captures"])
def test_a_missing_value_meets_nothing_and_is_a_failure(field: str) -> None:
    seeds = {1: run(1), 2: run(2, **{field: {1: math.nan}})}
    assert "captures alone, share of ideal, 500–1000" in missed(seeds)
    assert failures(seeds) == (1, 4)


def test_no_runs_meet_nothing() -> None:
    assert judge({}) == []
    assert acceptance_table({}) == "No runs.\n"
