"""The statistics are honest: never stays never, one seed has no interval, the worst seed is shown."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mdb_sim.figures.drawings import draw_quantities
from mdb_sim.studies.results import Result
from mdb_sim.verdicts.quantities import Quantity, all_quantities, quantity_table, runs_of, summary
from mdb_sim.verdicts.statistics import differences, estimate, number, wilson
from tests.sim.phases import label, run

INF, NAN = math.inf, math.nan
SEEDS = range(11, 21)


def test_an_interval_is_as_wide_as_the_standard_error_asks_and_always_the_same() -> None:
    values = np.random.default_rng(3).normal(5.0, 1.0, size=100)
    found = estimate(values, "mean")
    assert found.value == pytest.approx(values.mean())
    assert found.high - found.low == pytest.approx(2 * 1.96 * np.std(values) / 10, rel=0.05)
    assert found.low < found.value < found.high
    assert estimate(values, "mean") == found


def test_equal_seeds_have_no_width_and_one_seed_has_no_interval() -> None:
    assert estimate([4.0] * 10, "median") == estimate([4.0] * 3, "median")
    assert (estimate([4.0] * 10, "mean").low, estimate([4.0] * 10, "mean").high) == (4.0, 4.0)
    found = estimate([4.0], "mean")
    assert found.value == 4.0
    assert math.isnan(found.low)


def test_never_is_more_than_any_number_and_a_missing_value_is_not_left_out() -> None:
    assert estimate([50.0, 60.0, INF], "median").value == 60.0
    assert estimate([50.0, 60.0, INF], "median").high == INF
    assert estimate([50.0, INF], "median").value == INF
    assert estimate([50.0, 60.0, INF], "mean").value == INF
    assert math.isnan(estimate([50.0, NAN], "median").value)
    assert math.isnan(estimate([], "median").value)


def test_a_seed_that_never_came_to_it_either_way_makes_no_difference() -> None:
    assert differences([INF, INF, 50.0, 70.0], [INF, 60.0, INF, 60.0]) == [0.0, INF, -INF, 10.0]
    assert math.isnan(differences([NAN], [60.0])[0])
    assert estimate([INF, -INF], "median").value == 0.0


def test_a_rate_has_an_interval_also_where_nothing_failed() -> None:
    found = wilson(0, 48)
    assert (found.value, found.low) == (0.0, pytest.approx(0.0, abs=1e-12))
    assert found.high == pytest.approx(0.0741, abs=1e-4)
    assert wilson(4, 48).low == pytest.approx(0.0329, abs=1e-4)
    assert (wilson(48, 48).value, wilson(48, 48).high) == (1.0, 1.0)
    assert math.isnan(wilson(0, 0).value)


def made(values: dict[str, Sequence[float]]) -> Quantity:
    return Quantity(
        name="iterations",
        seeds=tuple(range(1, len(next(iter(values.values()))) + 1)),
        values={variant: tuple(of) for variant, of in values.items()},
        statistic="median",
        low_is_good=True,
        shape=number,
    )


def test_a_difference_is_paired_so_seeds_that_differ_among_themselves_do_not_hide_it() -> None:
    shipped = [10.0, 500.0, 90.0, 210.0, 370.0, 440.0]
    found = made({"as shipped": shipped, "slower": [value + 5 for value in shipped], "same": shipped})
    assert found.difference("slower").value == 5.0
    assert [found.verdict(variant) for variant in found.values] == ["", "worse", ""]
    faster = made({"as shipped": shipped, "faster": [value - 5 for value in shipped]})
    assert faster.verdict("faster") == "better"


def test_few_seeds_make_nothing_clear() -> None:
    found = made({"as shipped": [10.0] * 5, "slower": [99.0] * 5})
    assert found.difference("slower").clear
    assert found.verdict("slower") == ""


def test_the_worst_seed_is_the_one_that_never_came_to_it_or_has_no_value() -> None:
    found = made({"a": [10.0, INF, 30.0], "b": [NAN, INF, 30.0]})
    assert found.worst("a") == (INF, 2)
    assert found.worst("b")[1] == 1
    assert [found.never("a"), found.never("b")] == [1, 1]
    assert replace(found, low_is_good=False, values={"a": (3.0, 1.0, 2.0)}).worst("a") == (1.0, 2)


# ---- variants ----

WORSE = {seed: run(seed, captures={1: 50.0 + seed}) for seed in SEEDS}
SLOW = {seed: run(seed, iterations_to_obedience={2: INF if seed < 14 else 200.0}) for seed in SEEDS}
RUNS = {"as shipped": {seed: run(seed) for seed in SEEDS}, "worse": WORSE, "slow": SLOW}


def test_the_table_says_what_matters_counts_never_and_shows_the_worst_seed() -> None:
    quantities = {q.name: q for q in all_quantities(RUNS)}
    table = summary(list(quantities.values()))
    assert "55.5 % [54.0 %, 57.0 %] **worse**<br>worst 51.7 % (11)" in table
    assert "Of 24 comparisons, about 1.2 would be so by chance" in table
    slow = quantity_table([quantities["iterations to 90 % obedience, second teacher (1000–1500)"]], "variant")
    assert "| slow | – | 200 [200, never] | never (11) | 3 of 10 | +156 [+156, +∞] **worse** |" in slow


def test_seeds_that_a_variant_lacks_are_left_out_of_all() -> None:
    found = [Result(label("paper", "a", seed), run(seed)) for seed in (1, 2, 3)]
    found += [Result(label("paper", "b", seed, 1), run(seed)) for seed in (3, 1)]
    assert {variant: list(seeds) for variant, seeds in runs_of(found).items()} == {"a": [1, 3], "b": [1, 3]}


def test_the_figure_of_variants_is_made_also_of_nothing_and_of_one_seed(tmp_path: Path) -> None:
    nothing = run(1, iterations_to_obedience={0: NAN, 2: INF}, obedience={0: NAN, 2: NAN})
    for name, runs in {"all": RUNS, "one": {"as shipped": {1: nothing}, "other": {1: nothing}}}.items():
        png, svg = draw_quantities(all_quantities(runs), tmp_path / name, "Variants", ("png", "svg"))
        assert png.read_bytes().startswith(b"\x89PNG")
        assert "never" in svg.read_text()
    assert "no data in these logs" in (tmp_path / "one.svg").read_text()
    assert "3 of 10" in (tmp_path / "all.svg").read_text()
