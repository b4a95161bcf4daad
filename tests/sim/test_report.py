"""The report is made from results alone, says what is missing, and tells no number that was not measured."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from mdb_sim.report import document
from mdb_sim.report.measured import NOT_YET
from mdb_sim.report.paper import STATEMENTS, statements_table
from mdb_sim.report.sections import SECTIONS
from mdb_sim.studies import tables
from mdb_sim.studies.catalogue import REPORTED, STUDIES
from mdb_sim.studies.results import Result
from mdb_sim.studies.rows import PhaseRow
from mdb_sim.verdicts.aims import aims_table
from tests.sim.phases import label, phase, results, run

ROOT = Path(__file__).parents[2]
VARIANTS = {
    "reproduction": ["graded reward", "binary reward"],
    "paper": ["as shipped", "paper as written", "written + aspiration", "shipped - aspiration"],
    "teachers": ["perfect", "10 % wrong notes"],
    "learners": ["pbga (as shipped)", "Gaussian processes"],
    "memory": ["long-term memory on", "long-term memory off"],
    "life": ["as shipped"],
    "alone": ["as shipped"],
}


def everything() -> list[Result]:
    return [result for study, variants in VARIANTS.items() for result in results(study, variants)]


def written(found: list[Result], folder: Path, variants: document.Variants | None = None) -> str:
    """Write the report into a folder; return its text."""
    document.write(found, folder / "REPORT.md", variants)
    return (folder / "REPORT.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    out = tmp_path_factory.mktemp("report") / "sim" / "REPORT.md"
    files = document.write(everything(), out)
    assert files[0] == out
    assert all(path.stat().st_size > 1000 for path in files)
    return out.read_text(encoding="utf-8"), out.parent


def test_every_study_has_a_section_and_every_figure_is_there(whole: tuple[str, Path]) -> None:
    text, folder = whole
    assert re.findall(r"^## \d+\. (\w+):", text, re.MULTILINE) == [s.name.capitalize() for s in REPORTED]
    figures = re.findall(r"\]\((gallery/[^)]+)\)", text)
    assert len(figures) == 3 + 3 + 1 + 1 + 1
    assert all((folder / figure).exists() for figure in figures)
    assert "missing in these results" not in text
    assert NOT_YET not in text


def test_the_report_begins_with_what_was_found_and_names_what_was_missed(tmp_path: Path) -> None:
    bad = [Result(label("alone", seed=s), run(s, captures={3: 41.0 if s == 12 else 117.0})) for s in (11, 12, 13)]
    mute = Result(label("teachers", "punishes only", 11), run(11, obedience={2: 0.3}))
    document.write([*bad, mute], tmp_path / "REPORT.md")
    short = (tmp_path / "REPORT.md").read_text(encoding="utf-8").partition("## In short")[2].partition("## 1.")[0]
    assert "worst 34.2 % (seed 12). 1 of 6 phases alone below 90 %" in short
    assert "Missed: captures alone, share of ideal, 1500–2000." in short
    assert "below 80 %: punishes only 30.0 %; captures alone below 90 % of the ideal: none." in short
    assert "**life**" not in short


def test_aims_with_teachers_as_they_are_are_told_as_met_missed_or_not_measured() -> None:
    bad = {seed: run(seed, obedience={0: 0.7, 2: 0.5}, captures={1: 116.0, 3: 104.0}) for seed in range(1, 7)}
    late = {seed: run(seed, captures={0: 30.0, 2: 30.0}) for seed in range(1, 7)}
    good = {seed: run(seed) for seed in range(1, 7)}
    fading = "praise that fades (half in 100)"
    table = aims_table(
        {"perfect": good, "20 % wrong notes": bad, fading: bad, "late by 2": good, "late by 2, not named": late}
    )
    assert "| 20 % wrong notes: obedience ≥ 80 % | 60.0 % [60.0 %, 60.0 %] | **no** |" in table
    assert "| 20 % wrong notes: captures alone ≥ 100 | 110 [110, 110] | yes |" in table
    assert "| 20 % wrong feedback: obedience ≥ 80 % | not measured | **no** |" in table
    assert f"| {fading}: mean obedience, both teachers ≥ 97 % of perfect | 60.0 %" in table
    assert "captures ≥ 90 % of named | 71.1 %: 73.2 [73.2, 73.2]; named 103 [103, 103] | **no** |" in table


@pytest.mark.parametrize(
    ("obedience", "seeds", "met"),
    [(0.97, 6, "yes"), (0.95, 6, "**no**"), (float("nan"), 6, "**no**"), (0.97, 2, "yes (few seeds)")],
)
def test_praise_that_fades_may_lose_three_percent_of_the_mean(obedience: float, seeds: int, met: str) -> None:
    perfect = {seed: run(seed) for seed in range(1, seeds + 1)}
    fading = {seed: run(seed, obedience={0: obedience, 2: obedience}) for seed in perfect}
    table = aims_table({"perfect": perfect, "praise that fades (half in 100)": fading})
    row = next(line for line in table.splitlines() if "mean obedience" in line)
    assert row.endswith(f"| {met} |")


def test_of_a_variant_that_captured_nothing_there_is_no_share() -> None:
    nothing = {1: run(1, captures=dict.fromkeys(range(4), 0.0))}
    table = aims_table({"late by 1": nothing, "late by 1, not named": {1: run(1)}})
    assert "| late by 1, not named: captures ≥ 90 % of named | not measured | **no** |" in table


def test_settings_that_differ_between_seeds_and_variants_that_are_gone_are_said(tmp_path: Path) -> None:
    body, short = "robot.body=pybullet", "optimizer.horizon=3"
    settings = {11: (body,), 12: (body,), 13: (body, short)}
    found = [Result(label("alone", seed=s, overrides=of), run(s)) for s, of in settings.items()]
    old = Result(label("alone", "older", seed=11, order=1, overrides=(body,)), run(11))
    text = written([*found, old], tmp_path, {"alone": ["as shipped"]})
    assert f"Set for all: `{body}`." in text
    mixed = f"**Mixed settings** under “as shipped”: seeds 11, 12 with `{body}`; seed 13 with `{body}`, `{short}`"
    assert mixed in text
    assert "**Left out**: 1 run of variants that this study no longer has: “older”." in text
    assert "0 of 6 phases alone" in text, "all three seeds are shown"


def test_the_reproduction_shows_every_variant_with_all_its_own_seeds(tmp_path: Path) -> None:
    found = results("reproduction", ["graded reward"], range(11, 16))
    found += [Result(label("reproduction", "binary reward", s, 1), run(s)) for s in (11, 12)]
    text = written(found, tmp_path)
    assert "median 70 [70, 70] (5 seeds)" in text
    assert "| graded reward (5 seeds) | first teacher, alone |" in text
    assert "| binary reward (2 seeds) | first teacher, alone |" in text
    assert "Side by side, on seeds 11, 12:" in text
    assert "runs of seeds 13 to 15 are missing for some variants" in text


def test_a_study_whose_variants_have_no_seed_in_common_says_so(tmp_path: Path) -> None:
    found = [Result(label("teachers", variant, s, s), run(s)) for s, variant in enumerate(["perfect", "binary"])]
    text, figures = document.one(STUDIES["teachers"], found, tmp_path)
    assert "No seed was run under all variants" in text
    assert figures == []


def test_statements_are_filled_from_what_was_measured(whole: tuple[str, Path]) -> None:
    text, _ = whole
    assert f"{len(STATEMENTS)} statements: " in text
    assert "median 70 [70, 70] (3 seeds)" in text
    assert "obedience mean 99.0 % [99.0 %, 99.0 %] (3 seeds)" in text


def test_a_study_without_results_is_said_to_be_missing_by_its_command(tmp_path: Path) -> None:
    text = written(results("alone", ["as shipped"]), tmp_path)
    for study in REPORTED:
        assert (f"`mdb study {study.name}` is missing" in text) == (study.name != "alone")
    assert text.count(NOT_YET) >= 10
    assert "**Failures**: 0 of 6 phases alone" in text


def test_the_same_results_make_the_same_report(tmp_path: Path) -> None:
    for name in ("one", "two"):
        document.write(results("alone", ["as shipped"]), tmp_path / name / "REPORT.md")
    one, two = (tmp_path / name / "gallery" / "alone.png" for name in ("one", "two"))
    assert one.read_bytes() == two.read_bytes()


def test_bodies_are_told_apart_and_versions_of_the_code_are_named(tmp_path: Path) -> None:
    found = results("alone", ["as shipped"])
    found += [
        Result(label("alone", seed=s, body="pybullet", code="d"), run(s, body=dict.fromkeys(range(4), "pybullet")))
        for s in (11, 12)
    ]
    found.append(Result(label("alone", seed=14, code="other"), run(14)))
    text = written(found, tmp_path)
    assert "### Body: pybullet" in text
    assert "The ideal is that of the kinematic twin" in text
    assert "code c, other" in text
    assert "more than one version of the code" in text
    assert (tmp_path / "gallery" / "alone-pybullet.png").exists()


def test_a_long_life_names_the_seeds_that_failed(tmp_path: Path) -> None:
    rows = (*run(7)[:3], phase(7, 3, captures=50.0))
    text, figures = document.one(STUDIES["life"], [Result(label("life", seed=7), rows)], tmp_path)
    assert "41.7 % (7)" in text
    assert "1 of 2" in text
    assert figures[0].exists()


def test_every_study_has_variants_and_something_to_show() -> None:
    assert set(SECTIONS) == set(STUDIES)
    assert set(tables.VARIANTS) == {*STUDIES, "acceptance"}


def test_files_that_the_statements_name_are_there() -> None:
    table = statements_table({})
    named = re.findall(r"`((?:services|sim)/[\w./]+\.(?:py|md))`", table)
    assert len(named) > 15
    for path in named:
        assert (ROOT / path).exists(), path


def test_a_body_that_changes_is_shown_window_by_window_with_the_worst_seed(tmp_path: Path) -> None:
    names = ("first teacher", "before", "at", "after")

    def rows(seed: int, after: float) -> tuple[PhaseRow, ...]:
        return tuple(replace(row, name=name) for row, name in zip(run(seed, captures={3: after}), names, strict=True))

    variants = "half turns, alone", f"half turns, alone, {tables.STOPPED}"
    found = [
        Result(label("readapt", variant, seed, order), rows(seed, 60.0 if order else 118.0 - seed))
        for order, variant in enumerate(variants)
        for seed in (11, 12, 13)
    ]
    text, figures = document.one(STUDIES["readapt"], found, tmp_path)
    assert "87.5 % (13)" in text
    assert "50.0 % [50.0 %, 50.0 %]" in text
    assert figures[0].stat().st_size > 5000
