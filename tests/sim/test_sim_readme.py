"""What the code cites of sim/README.md is there, and what the page says of settings is so."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mdb_services.mechanism.actions import choice, foresight
from mdb_services.mechanism.memories import context
from mdb_services.mechanism.memories.context import ContextConfig
from mdb_services.mechanism.memories.ltm import LongTermConfig
from mdb_services.mechanism.settings import EvolutionConfig
from mdb_sim.bodies.pioneer import arena, perceive, sonar
from mdb_sim.bodies.pioneer.world import PioneerConfig
from mdb_sim.runs import measures
from mdb_sim.runs.experiment import Experiment
from mdb_sim.teaching.policies import pioneer as reach

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "sim" / "README.md").read_text(encoding="utf-8")
HEADINGS = re.findall(r"^#+ (.+)$", PAGE, re.MULTILINE)
PAPER = ROOT / "deploy" / "experiments" / "paper.toml"
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
        assert heading in (*HEADINGS, "Several teachers"), heading  # the last one is of services/README.md


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
    value = getattr(PioneerConfig(), setting, None) or getattr(Experiment.read(PAPER).robot, setting)
    assert f"{value:g}" in re.sub(r"(\.\d*?)0+\b", r"\1", shown)


def test_the_page_says_the_body_and_the_solver_as_they_are() -> None:
    assert f"radius {arena.BODY_RADIUS_M} m" in PAGE
    assert f"{-sonar.BODY_CENTRE_X_M} m behind" in PAGE
    assert f"height of {sonar.SONAR_HEIGHT_M} m" in PAGE
    assert f"`NOMINAL_RADIUS_M`, `_UNEXPECTED_ECHO`, `_UNCERTAINTY_M` | {perceive.SAME_OBJECT_M}" in PAGE
    pytest.importorskip("pybullet")
    from mdb_sim.bodies.pioneer import physics as pioneer

    assert f"goes {pioneer.SOLVER_ITERATIONS} times over all constraints" in PAGE
    assert f"with {pioneer.BRAKING_M_S2} m/s²" in PAGE
    assert f"when {1e3 * pioneer.ARRIVED_M:g} mm remain" in PAGE


def rows(beginning: str) -> Iterator[list[str]]:
    """The cells of each row of the table that follows these words."""
    table = PAGE.split(beginning)[1].lstrip(":,").split("\n\n")[1]
    for line in table.splitlines()[2:]:
        yield [cell.strip() for cell in line.strip("|").split(" | ")]


def values(cell: str) -> list[float]:
    """The numbers of a cell, without what was before, in brackets; none when it holds other things, too."""
    parts = [part.strip() for part in re.split("[,;]", re.sub(r"\([^)]*\)", "", cell))]
    return [float(part) for part in parts] if all(re.fullmatch(r"-?[\d.]+(e-\d+)?", part) for part in parts) else []


def differences(row: list[str], found: dict[str, Any]) -> list[str]:
    """The settings of a row whose value is not the one of the row; one value may stand for all."""
    names, shown = re.findall(r"`([^`]+)`", row[0]), values(row[1])
    if names and f"`{names[0]}`:" in row[0]:
        names = [f"{names[0]}.{name}" for name in names[1 : 1 + len(shown)]]
    if not shown or not names or not set(names) <= found.keys():
        return []
    shown = shown * len(names) if len(shown) == 1 else shown
    return [f"{n} is {found[n]}, the page says {v}" for n, v in zip(names, shown, strict=True) if found[n] != v]


def test_the_constants_of_the_page_are_those_of_the_code() -> None:
    pioneer = pytest.importorskip("mdb_sim.bodies.pioneer.physics")
    owners = {
        "settings.py": (EvolutionConfig(),),
        "context.py": (ContextConfig(), context),
        "ltm.py": (LongTermConfig(),),
        "choice.py": (choice,),
        "foresight.py": (foresight,),
        "perceive.py": (perceive,),
        "policies/pioneer.py": (reach,),
        "paper.toml": (Experiment.read(PAPER).robot,),
        "measures.py": (measures,),
        "physics.py": (pioneer, PioneerConfig()),
        "PioneerConfig": (PioneerConfig(),),
    }
    compared = 0
    for beginning in ("World, body, teacher, measures", "Defaults of the mechanism"):
        for row in rows(beginning):
            holders = [holder for name, those in owners.items() if name in row[2] for holder in those]
            names = [name for name in re.findall(r"`([^`]+)`", row[0]) if any(hasattr(h, name) for h in holders)]
            found = {name: next(getattr(h, name) for h in holders if hasattr(h, name)) for name in names}
            assert not differences(row, found)
            compared += len(found) if values(row[1]) else 0
    assert compared > 60


def test_the_settings_of_the_page_are_those_of_the_experiment() -> None:
    content = tomllib.loads(PAPER.read_text(encoding="utf-8"))
    models = {model["name"]: model for model in content["model"]}
    modes = {f"mode.{mode['name']}": mode for mode in content["mode"]}
    found = flat(
        {**models, **modes, "channels": content["channels"], **content["experiment"], **content["optimizer"]}
    )
    compared = [row for row in rows("The shipped experiment") if values(row[1])]
    for row in compared:
        names = set(re.findall(r"`([^`]+)`", row[0]))
        assert not differences(row, found)
        assert ":" in row[0] or not names - found.keys(), (
            f"{names - found.keys()}: the experiment has no such setting"
        )
    assert len(compared) > 12


def flat(section: dict[str, Any], above: str = "") -> dict[str, Any]:
    """Each setting by its dotted path; a list of one, as of hidden units, as what it holds."""
    found: dict[str, Any] = {}
    for name, value in section.items():
        if isinstance(value, dict):
            found |= flat(value, f"{above}{name}.")
        else:
            found[above + name] = value[0] if isinstance(value, list) and len(value) == 1 else value
    return found
