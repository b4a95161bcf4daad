"""The run log: everything that was said is read again, whatever the end of the recorder was."""

import errno
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from structlog.testing import capture_logs

from mdb_protocol import codec, keys, messages
from mdb_protocol.bus import TAPPED
from mdb_protocol.errors import MdbError
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_protocol.waiting import Raw
from mdb_services import recorder as recorder_module
from mdb_services.recorder import RETRY_S, EmptyLogError, Recorded, Recorder, read_log, segments_of
from tests.services.small import BRAIN, model, pair, perception


class Rig:
    def __init__(self, run: Path) -> None:
        self.run, self.fabric = run, Fabric()
        self.world = MemoryBus(self.fabric, BRAIN)
        self.recorder = self.start()

    def start(self) -> Recorder:
        self.recorder = Recorder(MemoryBus(self.fabric, BRAIN), self.run)
        return self.recorder

    def stop(self) -> None:
        self.recorder.close()
        self.recorder.bus.close()

    def say(self, row: keys.Key, message: Any, **parameters: str) -> None:
        self.world.publisher(row, **parameters).put(message)

    def junk(self, key: str, payload: bytes, encoding: str) -> None:
        self.fabric.put(self.world, keys.PAIR, Raw(key, payload, encoding))

    def read(self) -> list[tuple[str, int]]:
        return [(r.row.path, getattr(r.message, "iteration", -1)) for r in readable(self.run)]


def readable(run: Path) -> list[Recorded]:
    """What can be read of a log; nothing of one that has nothing."""
    try:
        return list(read_log(run))
    except EmptyLogError:
        return []


def test_the_last_word_is_waited_for_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "LAST_WORD_S", 10.0)
    rig = Rig(tmp_path)
    rig.say(keys.PAIR, pair(1))
    rig.recorder.step()
    wait, later = rig.recorder.bus.wait, [(keys.PAIR, pair(2)), (keys.FINISHED, messages.Finished(iterations=3))]

    def told_later(timeout_s: float) -> bool:
        """Others speak when it has nothing to do any more."""
        if later:
            rig.say(*later.pop(0))
        return wait(timeout_s)

    monkeypatch.setattr(rig.recorder.bus, "wait", told_later)
    rig.stop()
    assert [path for path, _ in rig.read()] == ["pair", "pair", "finished"]


def test_what_was_said_is_read_again_in_order(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.say(keys.PERCEPTION, perception(0))
    rig.say(keys.PAIR, pair(1))
    rig.say(keys.CURRENT_MODEL, model("object", 7), model="object")
    rig.say(keys.PERCEPTION, perception(2))
    rig.recorder.step()
    assert rig.recorder.values()["messages"] == 4
    rig.stop()
    recorded = list(read_log(tmp_path))
    assert [r.row for r in recorded] == [keys.PERCEPTION, keys.PAIR, keys.CURRENT_MODEL, keys.PERCEPTION]
    assert recorded[1].message == pair(1)
    assert recorded[2].key == "mdb/test/model/object"
    assert codec.encode(recorded[2].message) == codec.encode(model("object", 7))
    assert [r.time_s for r in recorded] == sorted(r.time_s for r in recorded)


def test_vectors_are_read_again_and_what_does_not_belong_in_the_log_is_not_in_it(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    seen = perception(1, reading={"sonar": [0.5, 1.5], "distance": 1.0})
    rig.say(keys.PERCEPTION, seen)
    rig.say(keys.PICTURE, messages.Picture(iteration=1, image=np.zeros((4, 4, 3), np.uint8)))
    rig.stop()
    assert [r.message for r in read_log(tmp_path)] == [seen]
    assert rig.recorder.bus.refusals.counts == {}, "a picture is no junk"


def test_what_came_just_before_the_end_is_written(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.say(keys.PAIR, pair(1))
    rig.stop()
    assert rig.read() == [("pair", 1)]


def test_a_killed_recorder_leaves_what_it_has_taken(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    for i in range(20):
        rig.say(keys.PAIR, pair(i))
    rig.recorder.step()
    assert rig.read() == [("pair", i) for i in range(20)], "the file was never closed"
    rig.stop()


def test_a_restarted_recorder_writes_the_next_segment(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    for i in range(12):
        rig.say(keys.PAIR, pair(i))
        rig.stop()
        rig.start()
    rig.stop()
    assert len(list(tmp_path.glob("run*.mcap"))) == 13
    assert rig.read() == [("pair", i) for i in range(12)]


def test_what_comes_in_a_burst_is_written_together_with_the_times_at_which_it_came(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fabric, now_ns = Fabric(), iter(range(10**9, 10**12, 10**9))
    monkeypatch.setattr("mdb_protocol.bus.time.time_ns", lambda: next(now_ns))
    world, recorder = MemoryBus(fabric, BRAIN), Recorder(MemoryBus(fabric, BRAIN), tmp_path, gather_s=0.003)
    pairs = world.publisher(keys.PAIR)
    pairs.put(pair(1))
    monkeypatch.setattr("mdb_services.recorder.time.sleep", lambda _: pairs.put(pair(2)))  # while it gathers
    assert recorder.step()
    monkeypatch.undo()
    recorder.close()
    found = [(r.message.iteration, r.time_s) for r in read_log(tmp_path)]
    assert found == [(1, 1.0), (2, 2.0)]


def test_a_segment_that_someone_deleted_is_no_obstacle(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    for i in range(3):
        rig.say(keys.PAIR, pair(i))
        rig.stop()
        rig.start()
    rig.stop()
    (tmp_path / "run-1.mcap").unlink()
    rig.start()
    rig.say(keys.PAIR, pair(9))
    rig.stop()
    assert rig.read() == [("pair", 0), ("pair", 2), ("pair", 9)]


def test_junk_is_counted_and_not_recorded(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    key, right = keys.PAIR.at(BRAIN), codec.encoding_of(messages.Pair)
    rig.say(keys.PAIR, pair(0))
    for payload, encoding in ((b"", right), (b"\xc1", right), (b"x" * 99, "text/plain"), (codec.encode(pair(5)), "")):
        rig.junk(key, payload, encoding)
    rig.junk("mdb/test/no/such/key", b"junk", right)
    rig.junk("nonsense", b"junk", ";;;")
    rig.say(keys.PAIR, pair(1))
    rig.stop()
    assert rig.recorder.values()["messages"] == 2
    assert rig.recorder.bus.refusals.counts == {keys.PAIR.path: 4, TAPPED: 2}
    assert rig.read() == [("pair", 0), ("pair", 1)]


def test_junk_in_a_field_that_nobody_knows_does_not_break_the_log(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    payload = b"\x82\xaaiterations\x05\xa3why\xd4\x05\x00"  # an extension type that there is not
    rig.junk(keys.FINISHED.at(BRAIN), payload, codec.encoding_of(messages.Finished))
    rig.say(keys.PAIR, pair(1))
    rig.stop()
    assert [r.message for r in read_log(tmp_path)] == [messages.Finished(iterations=5), pair(1)]


def test_more_keys_and_encodings_than_a_log_file_has_room_for_begin_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "MAX_CHANNELS", 50)
    rig = Rig(tmp_path)
    rig.say(keys.PAIR, pair(0))
    for i in range(70):
        command = messages.Command(teacher=f"anna{i}", iteration=i, note=1)
        rig.say(keys.COMMAND, command, teacher=command.teacher)
    rig.say(keys.PAIR, pair(1))
    rig.recorder.step()
    rig.stop()
    assert len(rig.read()) == 72
    assert len(list(tmp_path.glob("run*.mcap"))) == 2


class Disk:
    """A file on a disk that takes so many bytes."""

    def __init__(self, file: IO[bytes], room: list[int]) -> None:
        self._file, self._room = file, room
        self._buffer = b""

    def write(self, data: bytes) -> int:
        self._buffer += data
        return len(data)

    def tell(self) -> int:
        return self._file.tell() + len(self._buffer)

    def flush(self) -> None:
        taken = self._buffer[: self._room[0]]
        self._file.write(taken)
        self._file.flush()
        self._room[0] -= len(taken)
        self._buffer = self._buffer[len(taken) :]
        if self._buffer:
            raise OSError(errno.ENOSPC, "No space left on device")

    def close(self) -> None:
        try:
            self.flush()
        finally:
            self._file.close()


def test_a_full_disk_costs_what_comes_meanwhile_and_one_segment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    room, now = [3000], [100.0]
    opened = Path.open
    monkeypatch.setattr(
        recorder_module.Path,
        "open",
        lambda path, mode="r", **given: (
            Disk(opened(path, mode), room) if mode == "xb" else opened(path, mode, **given)
        ),
    )
    fabric = Fabric()
    world, recorder = MemoryBus(fabric, BRAIN), Recorder(MemoryBus(fabric, BRAIN), tmp_path, clock=lambda: now[0])
    pairs = world.publisher(keys.PAIR)
    with capture_logs() as lines:
        for i in range(200):
            pairs.put(pair(i))
            recorder.step()
            now[0] += 0.1
        values = recorder.values()
        kept = int(values["messages"])
        assert (values["disk_refuses"], kept + values["lost"], 0 < kept < 20) == (1.0, 200, True)
        assert len(list(tmp_path.glob("run*.mcap"))) == 1
        room[0] = 10**6
        now[0] += RETRY_S
        pairs.put(pair(200))
        recorder.step()
        assert recorder.values()["disk_refuses"] == 0.0
    recorder.close()
    assert [line["event"] for line in lines] == [
        "cannot write the run log; until it can, what is said is not recorded", "recording again",
    ]  # fmt: skip
    assert len(list(tmp_path.glob("run*.mcap"))) == 2
    read = [r.message.iteration for r in read_log(tmp_path)]  # type: ignore[attr-defined]
    assert read == [*range(len(read) - 1), 200]
    assert len(read) == kept + 1


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    rig = Rig(tmp_path_factory.mktemp("whole"))
    for i in range(5):
        rig.say(keys.PAIR, pair(i))
        rig.say(keys.CURRENT_MODEL, model("object", i), model="object")
    rig.stop()
    return (rig.run / "run.mcap").read_bytes()


def test_a_log_cut_short_anywhere_gives_what_was_whole(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    counts = []
    for end in range(0, len(whole), 7):
        path.write_bytes(whole[:end])
        counts.append(len(readable(tmp_path)))
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (0, 10)


@settings(derandomize=True, deadline=None, max_examples=150)
@given(data=st.data())
def test_a_damaged_log_ends_early_and_raises_nothing_else(
    whole: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    damaged = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    run = tmp_path_factory.mktemp("damaged")
    (run / "run.mcap").write_bytes(damaged)
    assert len(readable(run)) <= 10


def test_a_folder_without_log_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(MdbError, match="no run log"):
        list(read_log(tmp_path))


def test_a_log_says_what_made_it(tmp_path: Path) -> None:
    (tmp_path / "experiment.toml").write_text("[experiment]\nseed = 7\n")
    bus = MemoryBus(Fabric(), "test")
    Recorder(bus, tmp_path).close()
    with (tmp_path / "run.mcap").open("rb") as file:
        metadata = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    assert "seed = 7" in metadata["experiment"]["experiment.toml"]
    assert {"python", "protocol", "numpy", "eclipse-zenoh"} <= set(metadata["versions"])


def test_of_a_log_that_is_bounded_the_newest_is_kept_and_each_part_has_its_index(tmp_path: Path) -> None:
    keep = 400_000
    fabric = Fabric()
    world = MemoryBus(fabric, BRAIN)
    recorder = Recorder(MemoryBus(fabric, BRAIN), tmp_path, keep_bytes=keep)
    publisher = world.publisher(keys.PAIR)
    for i in range(3000):
        publisher.put(pair(i))
        recorder.step()
    recorder.close()
    segments = segments_of(tmp_path)
    assert len(segments) > 2
    assert sum(path.stat().st_size for path in segments) < keep
    for path in segments:
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count > 0
    kept = [getattr(r.message, "iteration", -1) for r in read_log(tmp_path)]
    assert kept == list(range(kept[0], 3000))
    assert len(kept) > 500


def test_a_log_of_nothing_is_an_error_and_so_is_another_brains(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.stop()
    with pytest.raises(EmptyLogError, match="no message can be read"):
        list(read_log(tmp_path))
    rig = Rig(tmp_path)
    rig.say(keys.PAIR, pair(1))
    rig.stop()
    assert len(list(read_log(tmp_path, BRAIN))) == 1
    with pytest.raises(EmptyLogError, match="no message of brain other"):
        list(read_log(tmp_path, "other"))
