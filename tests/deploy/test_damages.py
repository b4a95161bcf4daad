"""What is done to a memory file on purpose, a witness of its run notices: each damage is named, none passes."""

import os
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from mdb_deploy.trials.evidence import compare
from mdb_deploy.trials.witness import HEARD, line_of
from mdb_protocol import codec, keys, messages
from mdb_protocol.errors import MdbError
from mdb_services.memory.file import MemoryFile
from tests.services import languages
from tests.services.languages import Student
from tests.services.store_rig import ITERATIONS, Rig, taken

PAIRS = 120
CHECKPOINT = 90


@pytest.fixture(scope="module")
def lived(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the memory of a run in which a teacher came back, and what a witness of it wrote down."""
    folder = tmp_path_factory.mktemp("lived")
    settings = languages.config(experiment={"pace": "concurrent", "iterations": ITERATIONS})
    rig, student = Rig(folder / "memory.sqlite", settings), Student()
    heard = {row: rig.outside.subscriber(row) for row in HEARD}
    model = settings.model[0].name
    with (folder / "witness.jsonl").open("w") as witness:
        for i in range(PAIRS):
            rig.give(languages.pair(i, "ABA"[min(i // 20, 2)]))
            for change in taken(rig.changes):
                rig.show(student.follow(change))
            if i == CHECKPOINT:
                (memory,) = rig.outside.query(keys.MEMORY_SNAPSHOT, 1.0)
                state = {"weights": np.zeros(3, np.float32)}
                kept = messages.Checkpoint(
                    model=model, version=memory.version, generation=1, state=state, memory=memory
                )
                rig.outside.publisher(keys.CHECKPOINT, model=model).put(kept)
                rig.store.step()
            for row, inbox in heard.items():
                witness.writelines(f"{line_of(row, message)}\n" for message in taken(inbox))
    rig.store.close()
    return folder


@pytest.fixture
def folder(lived: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(lived, tmp_path / "lived"))


def sql(*statements: str) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        with sqlite3.connect(folder / "memory.sqlite") as db:
            for statement in statements:
                assert db.execute(statement).rowcount > 0, f"{statement} changes nothing"

    return damage


def _rewritten(folder: Path, at: int, **fields: object) -> None:
    """Another pair of this iteration, as well-formed as any."""
    with sqlite3.connect(folder / "memory.sqlite") as db:
        (payload,) = db.execute("SELECT payload FROM pair WHERE iteration = ?", (at,)).fetchone()
        pair = codec.decode(messages.Pair, payload, codec.encoding_of(messages.Pair))
        changed = codec.encode(msgspec.structs.replace(pair, **fields))
        db.execute("UPDATE pair SET payload = ? WHERE iteration = ?", (changed, at))


def _acknowledged_otherwise(folder: Path) -> None:
    with sqlite3.connect(folder / "memory.sqlite") as db:
        stored = codec.encode(messages.PairStored(iteration=30, versions={}, judged=True))
        db.execute("UPDATE pair SET stored = ? WHERE iteration = 30", (stored,))


def _copied_and_renamed(folder: Path) -> None:
    """The payload of pair 30 as that of pair 40, which it then says it is."""
    with sqlite3.connect(folder / "memory.sqlite") as db:
        db.execute("UPDATE pair SET payload = (SELECT payload FROM pair WHERE iteration = 30) WHERE iteration = 40")
    _rewritten(folder, 40, iteration=40)


def _cut(folder: Path) -> None:
    path = folder / "memory.sqlite"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _drop(folder: Path) -> None:
    with sqlite3.connect(folder / "memory.sqlite") as db:
        db.execute("DROP TABLE long_term")


def _other_model(folder: Path) -> None:
    """Another current model, as well-formed as any."""
    with sqlite3.connect(folder / "memory.sqlite") as db:
        (payload,) = db.execute("SELECT payload FROM model").fetchone()
        model = codec.decode(messages.CurrentModel, payload, codec.encoding_of(messages.CurrentModel))
        changed = msgspec.structs.replace(model, weights=model.weights + 1)
        db.execute("UPDATE model SET payload = ?", (codec.encode(changed),))


def _other_step(folder: Path) -> None:
    """Another pair in what evolvers are told of the last change."""
    with sqlite3.connect(folder / "memory.sqlite") as db:
        version, payload = db.execute("SELECT version, payload FROM step ORDER BY version DESC").fetchone()
        change = codec.decode(messages.MemoryChange, payload, codec.encoding_of(messages.MemoryChange))
        changed = msgspec.structs.replace(change, pairs=change.pairs - 1)
        db.execute("UPDATE step SET payload = ? WHERE version = ?", (codec.encode(changed), version))


def _kept(folder: Path, keep: Callable[[int, str], bool]) -> None:
    """Leave of what the witness wrote these lines."""
    path = folder / "witness.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for i, line in enumerate(lines) if keep(i, line)))


def _piped(folder: Path) -> None:
    (folder / "witness.jsonl").unlink()
    os.mkfifo(folder / "witness.jsonl")


DAMAGES: dict[str, Callable[[Path], object]] = {
    "a pair is deleted": sql("DELETE FROM pair WHERE iteration = 30"),
    "the last pair is deleted": sql(f"DELETE FROM pair WHERE iteration = {PAIRS - 1}"),
    "all pairs are deleted": sql("DELETE FROM pair"),
    "a pair's content is another": lambda folder: _rewritten(folder, 30, after={"x": 0.25}),
    "a pair's feedback is gone": lambda folder: _rewritten(folder, 30, feedback=None),
    "a pair is copied to another iteration": sql(
        "UPDATE pair SET payload = (SELECT payload FROM pair WHERE iteration = 30) WHERE iteration = 40"
    ),
    "a pair is copied after the last": sql(
        "INSERT INTO pair SELECT 500, payload, stored, note, choice FROM pair WHERE iteration = 30"
    ),
    "a pair is copied, and renamed": _copied_and_renamed,
    "a pair is filed under another note": sql("UPDATE pair SET note = 5 WHERE iteration = 30"),
    "a pair's acknowledgement is another": _acknowledged_otherwise,
    "a pair is garbage": sql("UPDATE pair SET payload = x'00' WHERE iteration = 30"),
    "all changes are deleted": sql("DELETE FROM change"),
    "a change is deleted": sql("DELETE FROM change WHERE version = 10"),
    "the last change is deleted": sql("DELETE FROM change WHERE version = (SELECT max(version) FROM change)"),
    "a change has another pair": sql("UPDATE change SET pair = pair - 1 WHERE version = 10"),
    "a change is in another slot": sql("UPDATE change SET slot = slot + 1 WHERE version = 100"),
    "contexts are deleted": sql("DELETE FROM context"),
    "recalled pairs are deleted": sql("DELETE FROM recalled"),
    "seeds are deleted": sql("DELETE FROM seed"),
    "the long-term memory is deleted": sql("DELETE FROM long_term"),
    "a long-term model is another's": sql("UPDATE long_term SET id = id + 50"),
    "the checkpoint is deleted": sql("DELETE FROM checkpoint"),
    "the changes since the checkpoint are deleted": sql("DELETE FROM step"),
    "one of the changes since the checkpoint is deleted": sql(
        "DELETE FROM step WHERE version = (SELECT max(version) - 3 FROM step)"
    ),
    "the current model is deleted": sql("DELETE FROM model"),
    "the current model is another": _other_model,
    "what an evolver is told of a change is another": _other_step,
    "a seed is garbage": sql("UPDATE seed SET payload = x'00'"),
    "seeds are in other places": sql("UPDATE seed SET place = place + 7"),
    "a pair has a word as its note": sql("UPDATE pair SET note = 'x' WHERE iteration = 30"),
    "a table is gone": _drop,
    "half of the file is gone": _cut,
    "the file is gone": lambda folder: (folder / "memory.sqlite").unlink(),
    "the witness has heard nothing": lambda folder: (folder / "witness.jsonl").write_text(""),
    "what the witness wrote is gone": lambda folder: (folder / "witness.jsonl").unlink(),
    "what the witness wrote is something else": lambda folder: (folder / "witness.jsonl").write_text("{}\n"),
    "what the witness wrote is a pipe": _piped,
    "half of what the witness wrote is gone": lambda folder: _kept(folder, lambda i, _: i < PAIRS),
    "the witness has heard no pairs": lambda folder: _kept(folder, lambda _, line: '{"key": "pair"' not in line),
    "the witness has heard of one pair": lambda folder: _kept(folder, lambda i, _: i < 2),
    "an acknowledgement that the witness wrote is cut": lambda folder: (folder / "witness.jsonl").write_text(
        '{"key": "pair/stored", "says": {"iteration": 1}}\n'
    ),
    "another run's memory": lambda folder: MemoryFile(_removed(folder)).close(),
}


def _removed(folder: Path) -> Path:
    (folder / "memory.sqlite").unlink()
    return folder / "memory.sqlite"


def test_a_memory_that_is_as_it_was_holds_and_all_of_it_was_looked_at(folder: Path) -> None:
    told = compare(folder / "witness.jsonl", folder / "memory.sqlite")
    assert told.holds, told
    assert (told.acknowledged, told.stored) == (PAIRS, PAIRS)
    assert all(told.checked.values()), told.checked


@pytest.mark.parametrize(
    "damage",
    [
        pytest.param(name, marks=pytest.mark.edge("damage to what was stored, which the witness notices", name))
        for name in DAMAGES
    ],
)
def test_the_witness_notices(folder: Path, damage: str) -> None:
    DAMAGES[damage](folder)
    try:
        told = compare(folder / "witness.jsonl", folder / "memory.sqlite")
    except MdbError:
        return
    assert not told.holds
