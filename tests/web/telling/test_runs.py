"""Past runs as the server asks them: each is read once, and one that goes on not again at each question."""

import asyncio
import shutil
from pathlib import Path
from typing import Any

import pytest

from mdb_deploy.web import runs as module
from mdb_deploy.web.runs import PastRuns
from mdb_deploy.web.telling import past


def test_a_run_that_goes_on_is_not_read_again_at_each_question(
    pioneer: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = shutil.copytree(pioneer, tmp_path / "run") / "run.mcap"
    whole, opened = log.read_bytes(), []
    honest = past.PastRun

    def counted(folder: Path) -> Any:
        opened.append(folder)
        return honest(folder)

    monkeypatch.setattr(past, "PastRun", counted)
    runs = PastRuns(tmp_path)

    def ask() -> int:
        with log.open("ab") as file:
            file.write(b"\0")
        return asyncio.run(runs.ask("run", lambda run: int(run.iterations)))

    log.write_bytes(whole[: len(whole) // 2])
    first = [ask() for _ in range(5)]
    assert len(set(first)) == 1
    assert len(opened) == 1
    monkeypatch.setattr(module, "OPENED_AGAIN_S", 0.0)
    monkeypatch.setattr(module, "OPENED_SHARE", 0.0)
    runs = PastRuns(tmp_path)
    ask()
    log.write_bytes(whole)
    assert ask() == 80
    assert len(opened) == 3
    runs.close()


def test_a_folder_that_is_removed_meanwhile_is_left_out(pioneer: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        shutil.copytree(pioneer, tmp_path / name)
    runs = PastRuns(tmp_path)
    gone = tmp_path / "gone"
    shutil.copytree(pioneer, gone)
    (gone / "run.mcap").unlink()
    (gone / "run.mcap").symlink_to(tmp_path / "nothing")
    assert {run["name"] for run in asyncio.run(runs.runs())} == {"one", "two"}
    runs.close()
