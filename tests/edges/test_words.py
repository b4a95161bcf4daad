"""`words.toml`: each case as a user meets it, in a process of its own; never a traceback."""

import os
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from mdb_deploy.experiments import experiment_path

CASES = tomllib.loads((Path(__file__).parent / "words.toml").read_text(encoding="utf-8"))["kind"]
SHIPPED = "paper.toml"
"""Stands in the text of a file for that experiment's text; a line's end before it, for all of its lines."""
LONG = "@long@"
BOUND_S = 100.0
QUICK = 3
"""So many of each kind are tried in every run of the tests; the others with `-m long`."""


def cases() -> list[Any]:
    return [
        pytest.param(
            case, id=f"{kind['name']}: {case['input']}",
            marks=[pytest.mark.edge(kind["name"], case["input"]), *([pytest.mark.long] if at >= QUICK else [])],
        )
        for kind in CASES for at, case in enumerate(kind["case"])
    ]  # fmt: skip


def lay(folder: Path, case: Mapping[str, Any]) -> None:
    """Write the files of a case."""
    for name, text in case.get("files", {}).items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        content = text.replace(SHIPPED, experiment_path("paper").read_text(encoding="utf-8"))
        content = content.lstrip("\r\n").replace("\n", "\r\n") if text.startswith("\r\n") else content
        path.write_bytes(content.encode())
    for name, digits in case.get("bytes", {}).items():
        (folder / name).write_bytes(bytes.fromhex(digits))


def environment(case: Mapping[str, Any]) -> dict[str, str]:
    path = os.pathsep.join(word for word in sys.path if word)  # as a wheel's: whatever this process finds
    given = {name: value.replace("+", path) for name, value in case.get("env", {}).items()}
    return os.environ | {"PYTHONPATH": path} | given


@pytest.mark.parametrize("case", cases())
def test_it_holds(case: Mapping[str, Any], tmp_path: Path) -> None:
    folder = tmp_path / "here"
    folder.mkdir()
    lay(folder, case)
    words = [word.replace(LONG, "x" * 300) for word in case["words"]]
    words += ["--set", case["set"]] if "set" in case else []
    done = subprocess.run(
        [sys.executable, "-m", "mdb_deploy.cli", *words], cwd=folder, env=environment(case), stdin=subprocess.DEVNULL,
        capture_output=True, text=True, timeout=BOUND_S, check=False,
    )  # fmt: skip
    said = done.stdout + done.stderr
    assert done.returncode == case["status"], said
    for words_there in case["says"]:
        assert words_there in said
    for words_absent in ["Traceback", *case.get("no", [])]:
        assert words_absent not in said
    if done.returncode == 2:
        assert len(done.stderr.strip().splitlines()) == 1, "one line"
