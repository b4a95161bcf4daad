"""An error that nobody expected: one line, and a file that tells the whole."""

import re
from pathlib import Path

import pytest

from mdb_deploy.cli import main as command_line
from mdb_deploy.cli import plot


@pytest.mark.edge("errors beyond the expected one", "a mistake of ours")
def test_it_is_one_line_and_a_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object) -> list[Path]:
        raise ZeroDivisionError("of nobody's\nmaking")

    monkeypatch.setattr(plot, "draw", fails)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert command_line.main(["plot", "run"]) == 70
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(
        "mdb: an error that nobody expected: ZeroDivisionError: of nobody's making; please report it"
    )
    path = re.search(r"all of it is in (\S+)$", line)
    assert path is not None
    told = Path(path[1]).read_text()
    assert "Python 3" in told
    assert "Traceback" in told


@pytest.mark.edge("errors beyond the expected one", "the system refuses, and names no file")
def test_what_the_system_refuses(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object) -> list[Path]:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(plot, "draw", fails)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    assert command_line.main(["plot", "run"]) == 2
    assert capsys.readouterr().err.startswith(
        "mdb: the system refused: Too many open files; no file could be written"
    )


@pytest.mark.edge("what is no file", "a link to itself as a folder")
@pytest.mark.parametrize("words", [["plot"], ["export"], ["status", "--keys"]])
def test_a_link_to_itself_is_told(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    assert command_line.main([*words, str(loop)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
