"""What the code cites of sim/README.md is there, and what the page says of settings is so."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from mdb_sim import arena, perceive, sonar
from mdb_sim.robot import RobotConfig

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "sim" / "README.md").read_text(encoding="utf-8")
HEADINGS = re.findall(r"^#+ (.+)$", PAGE, re.MULTILINE)
NAMED, CITED = "sim/README" + ".md", re.compile("sim/README" + r'\.md,\s+"([^"]+)"')


def sources() -> Iterator[Path]:
    for folder in ("protocol", "services", "sim", "deploy", "tests"):
        yield from (ROOT / folder).rglob("*.py")


def test_every_citation_of_the_page_names_one_of_its_headings() -> None:
    cited = 0
    for path in sources():
        text = path.read_text(encoding="utf-8")
        headings = CITED.findall(text)
        if path != Path(__file__):
            assert len(headings) == text.count(NAMED), f'{path}: cite it as {NAMED}, "HEADING"'
        for heading in headings:
            assert heading in HEADINGS, f"{path} cites {heading!r}; the page has {HEADINGS}"
        cited += len(headings)
    assert cited > 10


def test_sections_that_the_page_itself_names_exist() -> None:
    for heading in re.findall(r'"([A-Z][^"]+)"', re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL)):
        if heading not in ("Several teachers",):  # of the project's README
            assert heading in HEADINGS, heading


@pytest.mark.parametrize(
    ("setting", "shown"),
    [
        ("advance_m", "0.20 m ahead"),
        ("object_radius_m", "radius 0.15 m"),
        ("place_min_m", "0.7 to 1.5 m"),
        ("capture_distance_m", "at most 0.40 m"),
        ("capture_angle_deg", "at most 20° from the front"),
        ("episode_iterations", "after 40 iterations"),
        ("arena_m", "a square of 10 m"),
        ("sonar_rays", "cast as 7 rays"),
        ("sonar_half_cone_deg", "cone of ±15°"),
        ("sonar_specular_deg", "more than 40° from"),
        ("attention_m", "within 2 m"),
        ("physics_hz", "90 steps a second"),
    ],
)
def test_the_page_says_the_settings_as_they_are(setting: str, shown: str) -> None:
    assert shown in PAGE
    assert f"{getattr(RobotConfig(), setting):g}" in re.sub(r"(\.\d*?)0+\b", r"\1", shown)


def test_the_page_says_the_body_and_the_solver_as_they_are() -> None:
    assert f"radius {arena.BODY_RADIUS_M} m" in PAGE
    assert f"{-sonar.BODY_CENTRE_X_M} m behind" in PAGE
    assert f"height of {sonar.SONAR_HEIGHT_M} m" in PAGE
    assert f"`NOMINAL_RADIUS_M`, `_UNEXPECTED_ECHO`, `_UNCERTAINTY_M` | {perceive.SAME_OBJECT_M}" in PAGE
    pytest.importorskip("pybullet")
    from mdb_sim import pioneer

    assert f"goes {pioneer.SOLVER_ITERATIONS} times over all constraints" in PAGE
    assert f"with {pioneer.BRAKING_M_S2} m/s²" in PAGE
    assert f"when {1e3 * pioneer.ARRIVED_M:g} mm remain" in PAGE
