"""Teachers who come again: what a coming takes, and what returns are judged by."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from mdb_protocol.messages import Scene
from mdb_sim.figures.drawings import draw_comings
from mdb_sim.runs import measures
from mdb_sim.runs.record import ABSENT, RunRecord, Span
from mdb_sim.studies.rows import rows_of
from mdb_sim.verdicts.comings import (
    Coming,
    ComingsRow,
    comings_row,
    comings_table,
    criterion,
    own_firsts,
    ratio_of,
)
from tests.sim.test_measures import ONE, TURNS, place, scene, write_run

INF, NAN = math.inf, math.nan
SEEDS = range(11, 21)


@pytest.fixture(scope="module")
def short_run(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return write_run(tmp_path_factory.mktemp("runs") / "short", 100)


def obeying(record: RunRecord, obeyed: Sequence[int | None]) -> RunRecord:
    """The record with these commands obeyed (1), not (0), or not given (None), from its first iteration on."""
    command, note = 3, ONE.note(3)
    choices = [command if done else 0 for done in obeyed]
    return replace(
        record,
        reported=np.ones(len(obeyed), dtype=np.bool_),
        choice=np.array(choices, dtype=np.int64),
        note=np.array([ABSENT if done is None else note for done in obeyed], dtype=np.int64),
        scenes={i + 1: turned(i + 1, TURNS[choice]) for i, choice in enumerate(choices)},
    )


def turned(count: int, turn_deg: float) -> Scene:
    """After a turn on the spot."""
    before, reached = place(0), place(0, turned_deg=turn_deg)
    action = {"turn": turn_deg}
    return structs.replace(scene(count), action=action, before=before, reached=reached, now=reached)


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
    row = comings_row(rows_of(write_run(tmp_path / "run")))
    assert [coming.teacher for coming in row.comings] == ["one", "two"]
    assert [coming.disobeyed for coming in row.comings] == [20, 20]
    assert [len(coming.recent) for coming in row.comings] == [100, 100]
    # Obeyed from the middle on, but for every fourth: never 18 of 20.
    assert [coming.iterations for coming in row.comings] == [INF, INF]


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
    png, svg = draw_comings({"on": rows, "off": rows}, tmp_path / "comings", ("png", "svg"))
    assert png.read_bytes().startswith(b"\x89PNG")
    assert all(f"coming {place}: teacher" in svg.read_text() for place in range(1, 6))
    assert draw_comings({"on": [row(11, 30)]}, tmp_path / "one")[0].exists()
