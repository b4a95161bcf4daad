"""The README stays true: its key table is the code's, its commands exist, its pictures are there."""

import re
from pathlib import Path

import pytest

from mdb_deploy.cli.main import main
from mdb_protocol.keys import table

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def test_key_table_is_the_one_of_the_code() -> None:
    assert table() in README, "print it with `mdb keys` between the marks"


def test_every_command_it_names_exists(capsys: pytest.CaptureFixture[str]) -> None:
    named = set(re.findall(r"^mdb ([a-z-]+)", README, re.MULTILINE)) | {"test"}
    for command in named - {"test"}:
        with pytest.raises(SystemExit) as stop:
            main([command, "--help"])
        assert stop.value.code == 0, command
    capsys.readouterr()


def test_pictures_and_linked_files_are_there() -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target
