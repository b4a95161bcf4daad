"""The README pages stay true: what they print is the code's, their commands exist, what they link to is there."""

import re
from pathlib import Path

import pytest

from mdb_deploy.cli.main import main
from mdb_protocol.keys import table

ROOT = Path(__file__).parents[2]
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted(ROOT.glob("*/README.md")))
}
FRONT_LINES = 100
"""The front page is read in two minutes; what is more belongs into a folder's page."""


def headings(page: str) -> set[str]:
    """The anchors of a page, as GitHub makes them."""
    found = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", page, flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in found}


def test_every_folder_has_its_page_and_the_front_page_is_short() -> None:
    rooms = ("deploy", "protocol", "services", "sim", "tests")
    assert {"README.md", *(f"{room}/README.md" for room in rooms)} <= PAGES.keys()
    assert len(PAGES["README.md"].splitlines()) <= FRONT_LINES
    for room in rooms:
        assert f"]({room}/README.md)" in PAGES["README.md"], room


def test_key_table_is_the_one_of_the_code() -> None:
    assert table() in PAGES["protocol/README.md"], "print it with `mdb keys` between the marks"


@pytest.mark.parametrize("page", PAGES)
def test_every_command_it_names_exists(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    for command in sorted(set(re.findall(r"^mdb ([a-z-]+)", PAGES[page], re.MULTILINE)) - {"test"}):
        with pytest.raises(SystemExit) as stop:
            main([command, "--help"])
        assert stop.value.code == 0, command
    capsys.readouterr()


@pytest.mark.parametrize("page", PAGES)
def test_pictures_linked_files_and_headings_are_there(page: str) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", PAGES[page]):
        if re.match(r"\w+:", target):
            continue
        name, _, anchor = target.partition("#")
        path = (ROOT / page).parent / name if name else ROOT / page
        assert path.exists(), target
        if anchor and path.suffix == ".md":
            assert anchor in headings(path.read_text(encoding="utf-8")), target
