"""A run folder that is lost is said within seconds, and so is that it is back; what is lost is not acknowledged."""

import shutil
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from mdb_deploy.running.folder import LOOK_S, RunFolder
from mdb_services.shell.place import Place


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        self.now_s += LOOK_S
        return self.now_s


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    run = tmp_path / "run"
    run.mkdir()
    return run


@pytest.mark.edge("the run folder taken away", "moved away and back")
def test_a_folder_that_is_moved_away_is_said_once_and_that_it_is_back(folder: Path) -> None:
    watched = RunFolder(folder, "stop", Clock())
    with capture_logs() as said:
        watched.look()
        folder.rename(folder.with_name("elsewhere"))
        for _ in range(3):
            watched.look()
        assert watched.trouble == "gone: deleted or moved away"
        folder.with_name("elsewhere").rename(folder)
        watched.look()
    assert [line["event"] for line in said] == ["the run folder is lost", "the run folder is back"]
    assert "the robot stops after 100 pairs" in said[0]["then"]
    assert watched.trouble == ""


@pytest.mark.edge("the run folder taken away", "another folder in its place")
def test_another_folder_in_its_place_is_not_it(folder: Path) -> None:
    watched = RunFolder(folder, "act", Clock())
    keeps_the_inode = folder.with_name("old")
    folder.rename(keeps_the_inode)
    folder.mkdir()
    with capture_logs() as said:
        watched.look()
    assert watched.trouble == "gone; something else is in its place"
    assert "nothing is stored" in said[0]["then"]


@pytest.mark.edge("the run folder taken away", "one of its files deleted")
def test_a_file_that_was_deleted_is_not_written_to_any_more(folder: Path) -> None:
    file = folder / "memory.sqlite"
    file.touch()
    place, patient = Place(file), Place(file, 60.0)
    place.check()
    patient.check()
    shutil.rmtree(folder)
    patient.check()  # it has looked a moment ago
    with pytest.raises(FileNotFoundError, match="deleted or moved away"):
        place.check()
