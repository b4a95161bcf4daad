"""Damaged memory files: noticed at the start, said, and what can be read goes into a new one."""

import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from mdb_protocol import codec, keys
from mdb_protocol.errors import DamageError, MdbError
from mdb_services.experiment.brain import BrainConfig
from mdb_services.memory.file import PAGE, MemoryFile
from mdb_services.memory.rescue import rescue, survey
from tests.services import languages
from tests.services.languages import Student
from tests.services.store_rig import ITERATIONS, Rig, taken

PAIRS = 400


def settings() -> BrainConfig:
    return languages.config(experiment={"pace": "concurrent", "iterations": ITERATIONS})


def lived(path: Path) -> Rig:
    """A store whose teacher has changed his language twice: with a long-term memory and recalled pairs."""
    rig, student = Rig(path, settings()), Student()
    for i in range(PAIRS):
        rig.give(languages.pair(i, "ABA"[min(i // 20, 2)]))
        for change in taken(rig.changes):
            rig.show(student.follow(change))
    return rig


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of 400 pairs as a stopped store leaves it."""
    path = tmp_path_factory.mktemp("whole") / "memory.sqlite"
    lived(path).store.close()
    assert path.stat().st_size > 20 * PAGE
    return path


def _garbage(start: float, stop: float) -> Callable[[bytearray], bytes]:
    """Garbage between two parts of the file, from the second page on."""

    def spoil(content: bytearray) -> bytes:
        first, last = (max(int(len(content) * at) // PAGE, 1) * PAGE for at in (start, stop))
        content[first:last] = b"\xa5" * (last - first)
        return bytes(content)

    return spoil


def _bits(content: bytearray) -> bytes:
    for place in range(PAGE, len(content), 997):
        content[place] ^= 0x55
    return bytes(content)


DAMAGES: dict[str, tuple[Callable[[bytearray], bytes], int]] = {
    "nothing": (bytes, PAIRS),
    "half of it is gone": (lambda content: bytes(content[: len(content) // 2]), 50),
    "the last byte is gone": (lambda content: bytes(content[:-1]), PAIRS - 30),
    "garbage in the middle": (_garbage(0.4, 0.6), 150),
    "garbage nearly everywhere": (_garbage(0.1, 1.0), 0),
    "garbage in the header": (lambda content: bytes(b"\xa5" * 100 + content[100:]), PAIRS),
    "garbage in the first page": (lambda content: bytes(b"\xa5" * PAGE + content[PAGE:]), PAIRS),
    "zeros in the first page": (lambda content: bytes(bytes(PAGE) + content[PAGE:]), PAIRS),
    "a byte in each thousand": (_bits, 0),
    "nothing is left": (lambda _: b"", 0),
}
"""What happens to the file, and how many pairs can be read at the least."""


def on_disk(path: Path) -> dict[int, bytes]:
    with sqlite3.connect(path) as db:
        return dict(db.execute("SELECT iteration, payload FROM pair").fetchall())


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_can_be_read_of_a_damaged_file_goes_on_in_a_new_one(whole: Path, tmp_path: Path, damage: str) -> None:
    spoil, least = DAMAGES[damage]
    path, out = tmp_path / "memory.sqlite", tmp_path / "new.sqlite"
    path.write_bytes(spoiled := spoil(bytearray(whole.read_bytes())))
    before = on_disk(whole)
    found = rescue(path, settings(), out)
    assert path.read_bytes() == spoiled, "the damaged file is left as it is"
    after = on_disk(out)
    assert len(found.pairs) == len(after) >= least
    if damage != "a byte in each thousand":
        assert after.items() <= before.items(), "what is there is as it was"
    assert found.missing == (max(after, default=-1) + 1 - len(after))
    rig = Rig(out, settings())
    (progress,) = rig.outside.query(keys.PROGRESS, 1.0)
    assert progress.iteration == max(after, default=-1) + 1
    rig.give(languages.pair(progress.iteration, "A"))
    assert [answer.iteration for answer in taken(rig.stored)] == [progress.iteration]
    assert rig.snapshots()[languages.NAME]["version"] > 0
    rig.store.close()


@pytest.mark.parametrize("damage", ["garbage in the header", "nothing"])
def test_a_memory_that_can_be_read_whole_is_as_it_was(whole: Path, tmp_path: Path, damage: str) -> None:
    path, out = tmp_path / "memory.sqlite", tmp_path / "new.sqlite"
    path.write_bytes(DAMAGES[damage][0](bytearray(whole.read_bytes())))
    found = rescue(path, settings(), out)
    assert found.whole == [languages.NAME]
    assert len(found.long_term) >= 1
    stores = []
    for file in (whole, out):
        rig = Rig(file, settings())
        memory = rig.store._memories[languages.NAME]
        stores.append((rig.snapshots(), rig.store.values(), [codec.to_plain(m) for m in rig.store._file.long_term()]))
        assert memory.stm.version > PAIRS
        rig.store.close()
    assert stores[0] == stores[1]


def test_a_memory_of_which_something_is_lost_is_filled_with_the_newest_pairs(whole: Path, tmp_path: Path) -> None:
    path, out = tmp_path / "memory.sqlite", tmp_path / "new.sqlite"
    path.write_bytes(whole.read_bytes())
    with sqlite3.connect(path) as db:
        db.execute("DELETE FROM change WHERE version = 7")
        db.execute("UPDATE pair SET payload = x'c1' WHERE iteration = 398")
    found = rescue(path, settings(), out)
    assert (found.whole, found.missing) == ([], 1)
    rig = Rig(out, settings())
    snapshot = rig.snapshots()[languages.NAME]
    assert sorted(snapshot["pairs"]) == [391, 392, 393, 394, 395, 396, 397, 399]
    (kept,) = rig.store._file.models().values()
    assert kept.version == snapshot["version"] == 8
    rig.store.close()


def test_what_is_only_in_the_write_ahead_log_is_saved_too(tmp_path: Path) -> None:
    path = tmp_path / "run" / "memory.sqlite"
    path.parent.mkdir()
    rig = lived(path)  # not closed, as after a kill
    log = path.with_name("memory.sqlite-wal")
    assert log.stat().st_size > 0
    content = path.read_bytes()
    path.write_bytes(b"\xa5" * 100 + content[100:])
    assert len(survey(path, settings()).pairs) == PAIRS
    rig.store._file._db = sqlite3.connect(":memory:")


@pytest.mark.parametrize(
    "damage", [d for d in DAMAGES if d not in ("nothing", "nothing is left", "a byte in each thousand")]
)
def test_a_damaged_file_is_noticed_at_the_start(whole: Path, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "memory.sqlite"
    path.write_bytes(DAMAGES[damage][0](bytearray(whole.read_bytes())))
    with pytest.raises(DamageError, match=r"memory\.sqlite cannot be used .*mdb rescue .* --out NEW"):
        MemoryFile(path)


def test_an_empty_file_beside_its_log_is_noticed_and_the_log_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "memory.sqlite"
    rig = lived(path)
    log = path.with_name("memory.sqlite-wal")
    content = log.read_bytes()
    rig.store.close()
    path.write_bytes(b"")
    log.write_bytes(content)
    with pytest.raises(DamageError, match="write-ahead log"):
        MemoryFile(path)
    assert log.read_bytes() == content
    assert survey(path, settings()).long_term


def test_nothing_is_overwritten_and_a_missing_file_is_said(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(MdbError, match="no memory file"):
        rescue(tmp_path / "memory.sqlite", settings(), tmp_path / "new.sqlite")
    with pytest.raises(MdbError, match="there already"):
        rescue(whole, settings(), whole)


def test_where_nothing_can_be_opened_it_is_not_called_damage(tmp_path: Path) -> None:
    with pytest.raises(MdbError, match="Is the disk full") as caught:
        MemoryFile(tmp_path / "no" / "such" / "folder" / "memory.sqlite")
    assert not isinstance(caught.value, DamageError)


def test_a_file_of_the_first_version_of_the_protocol_is_named_as_such(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "memory.sqlite") as old:
        old.execute("CREATE TABLE pair (iteration INTEGER PRIMARY KEY, payload BLOB, stored BLOB, note, action)")
    old.close()
    with pytest.raises(MdbError, match=r"version 1 of the protocol.*Move it away"):
        MemoryFile(tmp_path / "memory.sqlite")
