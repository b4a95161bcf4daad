"""The robot's state on disk, whatever happens while it is written."""

import resource
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from mdb_protocol import messages
from mdb_sim.robot import state_file
from mdb_sim.robot.state_file import StateFile


def state(number: int) -> messages.RobotState:
    perception = messages.Perception(iteration=number, outcome={"gap": 0.5}, reading={"gap": 0.25})
    of = {"action": None, "before": None, "reached": {"x": 1.0}, "now": {"x": 2.0}}
    scene = messages.Scene(iteration=number, episode=0, successes=0, event="none", **of)
    return messages.RobotState(perception=perception, scene=scene, age=number, body=b"x" * number)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "run").mkdir()
    return tmp_path / "run" / "robot.state"


@pytest.mark.parametrize("power_safe", [False, True])
def test_the_last_state_counts(path: Path, power_safe: bool) -> None:
    file = StateFile(path, power_safe=power_safe)
    assert file.read() is None
    for number in range(5):
        file.write(state(number))
        assert file.read() == StateFile(path).read() == state(number)
    file.close()
    file.write(state(5))
    assert file.read() == state(5)


def test_of_a_state_that_was_not_written_whole_the_one_before_counts(path: Path) -> None:
    file, ends = StateFile(path), []
    for number in range(4):
        file.write(state(number))
        ends.append(path.stat().st_size)
    content = path.read_bytes()
    for length in range(ends[0], ends[-1]):
        path.write_bytes(content[:length])
        with capture_logs() as lines:
            assert StateFile(path).read() == state(sum(end <= length for end in ends) - 1)
        assert [line["log_level"] for line in lines] == ["warning"] * (length not in ends)
    StateFile(path).write(state(9))
    assert StateFile(path).read() == state(9), "what was left of another is not in the middle of the file"


def test_a_file_within_its_first_state_is_set_aside(path: Path) -> None:
    StateFile(path).write(state(3))
    for damaged in (b"", path.read_bytes()[:-1], b"\xc1" + path.read_bytes(), b"\xc0" + path.read_bytes()[:-1]):
        path.write_bytes(damaged)
        assert StateFile(path).read() is None
        assert path.with_suffix(".damaged").read_bytes() == damaged
        assert not path.exists()


def test_the_file_stays_small(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(state_file, "ADDED_BYTES", 1000)
    file = StateFile(path)
    for number in (*range(50), 2000, 3000, 3):
        file.write(state(number))
        assert file.read() == state(number)
        assert path.stat().st_size <= max(1000, number + 300)


def test_a_disk_that_takes_a_part_only_is_told_of_and_costs_nothing_that_it_took(path: Path) -> None:
    file = StateFile(path)
    for number in range(3):
        file.write(state(number))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 10, before[1]))
    try:
        with pytest.raises(OSError, match="a part of the robot's state only"):
            file.write(state(3))
        assert StateFile(path).read() == state(2)
        file.write(state(4))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert StateFile(path).read() == state(4)


def test_a_folder_that_is_away_is_told_of_until_it_is_back(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(state_file, "LOOKED_S", 0.0)
    file, away = StateFile(path), path.parent.with_name("away")
    file.write(state(0))
    path.parent.rename(away)
    for number in (1, 2):
        with pytest.raises(OSError, match=r"robot\.state"):
            file.write(state(number))
    away.rename(path.parent)
    assert file.read() == state(0)
    file.write(state(3))
    assert file.read() == state(3)
