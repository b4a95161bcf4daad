"""Readers that leave: what only prints ends quietly, what works goes on to its end."""

import subprocess
import sys
from pathlib import Path

import pytest

MDB = [sys.executable, "-m", "mdb_deploy.cli"]
BOUND_S = 100.0
SHORT = ("--without-pybullet", "--iterations", "5", "--no-plot", "--set", "evolution.population=40")


def unread(words: list[str], folder: Path, lines: int) -> tuple[int, str]:
    """Run `mdb` for a reader who leaves after so many lines; return its status, and what it complains of."""
    with subprocess.Popen(
        [*MDB, *words], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        assert running.stdout is not None
        assert running.stderr is not None
        for _ in range(lines):
            running.stdout.readline()
        running.stdout.close()
        said = running.stderr.read()
        return running.wait(BOUND_S), said


@pytest.mark.edge("pipes and terminals", "mdb up --inline | head -1")
@pytest.mark.parametrize("lines", [0, 1])
def test_a_run_goes_on_when_its_reader_has_left(lines: int, tmp_path: Path) -> None:
    assert unread(["up", "--inline", *SHORT], tmp_path, lines) == (0, "")
    (log,) = tmp_path.glob("runs/*/run.mcap")
    assert log.stat().st_size > 0


@pytest.mark.edge("pipes and terminals", "mdb keys schema | true")
def test_what_only_prints_ends_quietly(tmp_path: Path) -> None:
    status, said = unread(["keys", "schema"], tmp_path, 0)
    assert (status, said) == (141, "")


@pytest.mark.edge("pipes and terminals", "mdb up --inline >&- 2>&- <&-: closed streams")
def test_closed_streams_lead_nowhere(tmp_path: Path) -> None:
    command = f'exec "{sys.executable}" -m mdb_deploy.cli up --inline {" ".join(SHORT)} <&- >&- 2>&-'
    assert subprocess.run(["sh", "-c", command], cwd=tmp_path, timeout=BOUND_S, check=False).returncode == 0
    (log,) = tmp_path.glob("runs/*/run.mcap")
    assert log.stat().st_size > 0


@pytest.mark.edge("errors beyond the expected one", "the working directory was deleted")
def test_a_deleted_working_directory_is_said(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    command = f'rmdir ../gone; exec "{sys.executable}" -m mdb_deploy.cli prepare --without-pybullet --run run'
    done = subprocess.run(
        ["sh", "-c", command], cwd=gone, capture_output=True, text=True, timeout=BOUND_S, check=False
    )
    assert done.returncode == 2
    assert done.stderr == "mdb: the folder that you are in is not there any more; change into another (cd)\n"


@pytest.mark.edge("pipes and terminals", "its output on a full disk")
@pytest.mark.parametrize("words", [["keys"], ["up", "--help"], ["--version"]], ids=" ".join)
def test_a_full_disk_is_said(words: list[str], tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*MDB, *words], cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, timeout=BOUND_S, check=False
        )
    assert done.returncode == 2
    assert "No space left on device" in done.stderr
    assert "Traceback" not in done.stderr
