"""Results on disk are whole, tell what they are of, and come back as they were."""

import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_sim.studies import results, running
from mdb_sim.studies.results import decode, encode, labels, read, relabelled, write
from mdb_sim.studies.rows import PhaseRow
from tests.sim.phases import label, phase, run

NUMBERS = st.floats(allow_nan=True, allow_infinity=True)


def same(one: PhaseRow, other: PhaseRow) -> bool:
    for field in fields(PhaseRow):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, tuple):
            if len(a) != len(b) or not all(np.array_equal(x, y) for x, y in zip(a, b, strict=True)):
                return False
        elif isinstance(a, np.ndarray):
            if a.dtype != b.dtype or not np.array_equal(a, b, equal_nan=a.dtype.kind == "f"):
                return False
        elif a != b and not (isinstance(a, float) and math.isnan(a) and math.isnan(b)):
            return False
    return True


@settings(deadline=None)  # pyarrow is imported by the first
@given(captures=NUMBERS, seed=st.integers(0, 2**64 - 1), teacher=st.none() | st.text(max_size=5))
def test_a_row_comes_back_as_it_was(captures: float, seed: int, teacher: str | None) -> None:
    empty = np.zeros(0, np.int8)
    rows = [phase(seed, 0), replace(phase(seed, 1), captures=captures, teacher=teacher, captured=empty, paths=())]
    found = decode(encode(label(seed=seed), rows))
    assert found.label == label(seed=seed)
    assert all(same(a, b) for a, b in zip(rows, found.rows, strict=True))


def test_results_lie_by_study_variant_and_seed_and_are_read_in_the_tables_order(tmp_path: Path) -> None:
    for order, variant in ((1, "shipped - aspiration"), (0, "as shipped")):
        for seed in (12, 11):
            of = label("paper", variant, seed, order)
            write(tmp_path, encode(of, run(seed)), of)
    assert (tmp_path / "paper" / "shipped-aspiration" / "seed11-kinematic.parquet").exists()
    found = [(result.label.variant, result.label.seed) for result in read(tmp_path)]
    assert found == [(v, s) for v in ("as shipped", "shipped - aspiration") for s in (11, 12)]
    assert read(tmp_path, "life") == []


def test_what_is_half_written_or_none_of_ours_is_passed_over(tmp_path: Path) -> None:
    path = write(tmp_path, encode(label(), run(11)), label())
    whole = path.read_bytes()
    path.with_name("seed12-kinematic.parquet").write_bytes(whole[: len(whole) // 2])
    path.with_name(".seed13-kinematic.parquet.99").write_bytes(whole)
    assert [found for found, _ in labels(tmp_path)] == [path]


def test_a_run_can_be_another_studys_too() -> None:
    other = label("alone", "as shipped")
    found = decode(relabelled(encode(label(), run(11)), replace(other, seconds=0.0)))
    assert (found.label, found.rows[0].captures) == (other, 69.0)


def test_two_variants_never_have_the_same_path() -> None:
    names = ["written + aspiration", "shipped - aspiration", "late by 1", "late by 1, not named", "10 % wrong notes"]
    assert len({results.word(name) for name in names}) == len(names)


def test_a_result_is_of_one_experiment_one_player_and_one_code(monkeypatch: pytest.MonkeyPatch) -> None:
    content = {"experiment": {"seed": 1}}
    first = running.fingerprint(content, "brain")
    assert first == running.fingerprint({"experiment": {"seed": 1}}, "brain")
    assert first != running.fingerprint({"experiment": {"seed": 2}}, "brain")
    assert first != running.fingerprint(content, "random")
    monkeypatch.setattr(running, "code_checksum", lambda: "another")
    assert first != running.fingerprint(content, "brain")


def test_comments_and_docstrings_are_no_other_code() -> None:
    old = 'def f() -> int:\n    """Say."""\n    return 1  # why\n'
    words = running._without_words
    assert words(old) == words(old.replace("Say", "Tell").replace("why", "because"))
    assert words(old) != words(old.replace("1", "2"))
