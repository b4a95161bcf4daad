"""The studies' statistics are honest: never stays never, one seed has no interval, the worst seed is shown."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mdb_sim import measures
from mdb_sim.record import ABSENT, RunRecord, Span
from mdb_sim.study import (
    Coming,
    ComingsRow,
    Quantity,
    ablation_quantities,
    ablation_table,
    comings_row,
    comings_table,
    criterion,
    differences,
    estimate,
    number,
    own_firsts,
    ratio_of,
)
from mdb_sim.study_figures import draw_ablation, draw_comings
from tests.sim.test_acceptance import good_row
from tests.sim.test_measures import ONE, write_run

INF, NAN = math.inf, math.nan
SEEDS = range(11, 21)


@pytest.fixture(scope="module")
def short_run(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return write_run(tmp_path_factory.mktemp("runs") / "short", 100)


def obeying(record: RunRecord, obeyed: Sequence[int | None]) -> RunRecord:
    """The record with these commands obeyed (1), not (0), or not given (None), from its first iteration on."""
    command, note = 3, ONE.note(3)
    return replace(
        record,
        reported=np.ones(len(obeyed), dtype=np.bool_),
        action=np.array([command if done else 0 for done in obeyed], dtype=np.int64),
        note=np.array([ABSENT if done is None else note for done in obeyed], dtype=np.int64),
    )


def span(stop: int) -> Span:
    return Span("taught", 0, stop, "one", ONE)


# ---- the measures of a coming ----


def test_obedience_begins_with_the_first_whole_window_of_eighteen_in_twenty(short_run: RunRecord) -> None:
    # Disobeyed at 0 to 9, obeyed from 10 on: the window that ends at 27 holds 8 and 9 and 18 obeyed.
    record = replace(obeying(short_run, [0] * 10 + [1] * 40), spans=(span(50),))
    assert measures.iterations_to_obedience(record, span(50)) == 28
    assert measures.disobeyed_at_first(record, span(50)) == 10


def test_a_window_is_whole_also_where_all_is_obeyed_at_once(short_run: RunRecord) -> None:
    record = replace(obeying(short_run, [1] * 50), spans=(span(50),))
    assert measures.iterations_to_obedience(record, span(50)) == measures.RECENT
    assert measures.disobeyed_at_first(record, span(50)) == 0
    assert measures.recent_obedience(record, span(50))[0] == 1.0


def test_silence_is_neither_obeyed_nor_not(short_run: RunRecord) -> None:
    record = replace(obeying(short_run, [None, 1] * 25), spans=(span(50),))
    assert measures.iterations_to_obedience(record, span(50)) == 40


def test_obedience_that_never_came_is_not_one_that_is_not_in_the_log(short_run: RunRecord) -> None:
    record = replace(obeying(short_run, [0] * 50), spans=(span(50),))
    assert measures.iterations_to_obedience(record, span(50)) == INF
    assert math.isnan(measures.iterations_to_obedience(record, span(60)))
    assert math.isnan(measures.disobeyed_at_first(obeying(short_run, [0] * 19), span(50)))


def test_each_taught_phase_is_a_coming_and_begins_anew(tmp_path: Path) -> None:
    row = comings_row(write_run(tmp_path / "run"))
    assert [coming.teacher for coming in row.comings] == ["one", "two"]
    assert [coming.disobeyed for coming in row.comings] == [20, 20]
    assert [len(coming.recent) for coming in row.comings] == [100, 100]
    # Obeyed from the middle on, but for every fourth: never 18 of 20.
    assert [coming.iterations for coming in row.comings] == [INF, INF]


# ---- statistics ----


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


def quantity(values: dict[str, Sequence[float]]) -> Quantity:
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
    found = quantity({"as shipped": shipped, "slower": [value + 5 for value in shipped], "same": shipped})
    assert found.difference("slower").value == 5.0
    assert [found.verdict(variant) for variant in found.values] == ["", "worse", ""]
    faster = quantity({"as shipped": shipped, "faster": [value - 5 for value in shipped]})
    assert faster.verdict("faster") == "better"


def test_few_seeds_make_nothing_clear() -> None:
    found = quantity({"as shipped": [10.0] * 5, "slower": [99.0] * 5})
    assert found.difference("slower").clear
    assert found.verdict("slower") == ""


def test_the_worst_seed_is_the_one_that_never_came_to_it_or_has_no_value() -> None:
    found = quantity({"a": [10.0, INF, 30.0], "b": [NAN, INF, 30.0]})
    assert found.worst("a") == (INF, 2)
    assert found.worst("b")[1] == 1
    assert [found.never("a"), found.never("b")] == [1, 1]
    assert replace(found, low_is_good=False, values={"a": (3.0, 1.0, 2.0)}).worst("a") == (1.0, 2)


# ---- ablation ----

RESULTS = {
    "as shipped": [good_row(seed) for seed in SEEDS],
    "worse": [replace(good_row(seed), captures=(69.0, 50.0 + seed, 106.0, 111.0)) for seed in SEEDS],
    "slow": [replace(good_row(seed), below=(45.0, INF if seed < 14 else 200.0)) for seed in SEEDS],
}


def test_the_table_says_what_matters_counts_never_and_shows_the_worst_seed() -> None:
    table = ablation_table(ablation_quantities(RESULTS))
    assert "| worse | 45 | 80 | 4.0 % | 3.0 % | 99.0 % | 97.0 % | 69 | 65.5 **worse** | 106 | 111 |" in table
    assert "| worse | 65.5 [63.7, 67.3] | 65.5 [63, 68] | 61 (11) | -46.5 [-48.3, -44.7] **worse** |" in table
    assert "| slow | – | 200 [200, never] | never (11) | 3 of 10 | +120 [+120, +∞] **worse** |" in table
    assert "Of 20 comparisons, about 1 would be so by chance alone" in table
    assert "| as shipped | 112 [112, 112] | 112 [112, 112] | 112 (11) |  |" in table


def test_runs_of_other_seeds_are_not_compared() -> None:
    with pytest.raises(ValueError, match="expected runs of the seeds"):
        ablation_quantities({"as shipped": [good_row(1)], "other": [good_row(2)]})


def test_the_figure_of_the_ablation_is_made_also_of_nothing_and_of_one_seed(tmp_path: Path) -> None:
    nothing = replace(good_row(1), below=(INF, NAN), obedience=(NAN, NAN))
    for name, results in {"all": RESULTS, "one": {"as shipped": [nothing], "other": [nothing]}}.items():
        png, svg = draw_ablation(ablation_quantities(results), tmp_path / name)
        assert png.read_bytes().startswith(b"\x89PNG")
        assert "never" in svg.read_text()
    assert "no data in these logs" in (tmp_path / "one.svg").read_text()
    assert "3 of 10" in (tmp_path / "all.svg").read_text()


# ---- teachers who come again ----


def row(seed: int, *iterations: float, random: int = 200) -> ComingsRow:
    recent = np.linspace(0.0, 1.0, 50)
    comings = [Coming(t, i, 5.0, recent) for t, i in zip("ABABA", iterations, strict=False)]
    return ComingsRow(seed, random, tuple(comings))


def test_a_return_is_compared_with_the_first_coming_and_with_the_teachers_own() -> None:
    assert own_firsts(["A", "B", "A", "C", "B"]) == {2: 0, 4: 1}
    rows = [row(11, 240, 80, 21, 24, 20), row(12, 240, 80, 21, 25, 20), row(13, 300, 250, 21, 25, 20)]
    first, own = criterion(rows, own=False), criterion(rows, own=True)
    assert first.met == {11: True, 12: False, 13: True}
    assert own.met == {11: False, 12: False, 13: True}
    assert first.worst == (25 / 240, 12)
    assert own.worst == (25 / 80, 12)


def test_without_the_window_only_what_comes_before_it_counts() -> None:
    rows = [row(11, 240, 80, 21, 26, 20), row(12, 240, 80, 43, 20, 20), row(13, 20, 20, 20, 20, 20)]
    assert criterion(rows, own=True, window=False).met == {11: True, 12: False, 13: False}
    assert criterion(rows[:2], own=False, window=False).worst == (23 / 220, 12)


def test_a_first_coming_that_never_obeyed_makes_no_return_quick() -> None:
    assert math.isnan(ratio_of(20.0, INF))
    assert ratio_of(INF, 200.0) == INF
    judged = criterion([row(11, INF, 80, 20, 20, 20), row(12, 300, 80, 20, INF, 20)], own=False)
    assert judged.met == {11: False, 12: False}
    assert judged.worst[1] == 11
    assert criterion([row(11, 200)], own=False).met == {11: False}


def test_the_table_of_comings_shows_each_seed_and_what_a_whole_window_allows() -> None:
    on = [row(seed, 240, 80, 21, 24, 20) for seed in SEEDS]
    off = [row(seed, 240, 80, 90, INF, 70) for seed in SEEDS]
    table = comings_table({"on": on, "off": off})
    assert "only where the first took 200 or more" in table
    assert "200 iterations of forced exploration" in table
    assert "| on | 10 of 10 | 0.100 (11) | 0 of 10 | 0.300 (11) |" in table
    assert (
        "| 14 | on | 240 | 80 | 21 | 24 | 20 | 0.087 | 0.100 | 0.083 | 0.300 | yes | **no** | 5, 5, 5, 5, 5 |"
        in table
    )
    assert "| 14 | off | 240 | 80 | 90 | never | 70 |" in table
    assert "| 4 (B), off | – | never | never (11) | 10 of 10 | +∞ [+∞, +∞] **worse** |" in table


def test_the_figure_of_comings_has_a_panel_a_coming(tmp_path: Path) -> None:
    rows = [row(seed, 240, 80, 21, 24, 20) for seed in SEEDS]
    png, svg = draw_comings({"on": rows, "off": rows}, tmp_path / "comings")
    assert png.read_bytes().startswith(b"\x89PNG")
    assert all(f"coming {place}: teacher" in svg.read_text() for place in range(1, 6))
    assert draw_comings({"on": [row(11, 30)]}, tmp_path / "one")[0].exists()
