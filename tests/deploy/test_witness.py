"""The witness writes down what it hears, and says what of it the memory does not have."""

import sqlite3
from pathlib import Path
from typing import Any

import pytest

from mdb_deploy.trials.evidence import compare
from mdb_deploy.trials.witness import write_down
from mdb_protocol import keys, messages
from mdb_protocol.errors import MdbError
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.memory.file import MemoryFile

BRAIN = "test"


def pair(iteration: int, feedback: float | None = 1.0, **fields: Any) -> messages.Pair:
    plain: dict[str, Any] = {"before": {"distance": float(iteration)}, "after": {"distance": iteration + 0.9}}
    plain |= {"action": {"turn": 20.0}, "choice": 2}
    return messages.Pair(iteration=iteration, note=1, feedback=feedback, versions={"object": 1}, **(plain | fields))


def stored(iteration: int, *, judged: bool = True) -> messages.PairStored:
    return messages.PairStored(iteration=iteration, versions={}, judged=judged)


def heard(folder: Path, *said: messages.Pair | messages.PairStored) -> Path:
    """A witness's file after it heard this."""
    fabric, out = Fabric(), folder / "witness.jsonl"
    speaker = MemoryBus(fabric, BRAIN)
    told = False

    class Listener(MemoryBus):
        """Hears all of it when it waits for the first time."""

        def wait(self, timeout_s: float) -> bool:
            nonlocal told
            for message in said:
                row = keys.PAIR if isinstance(message, messages.Pair) else keys.PAIR_STORED
                speaker.publisher(row).put(message)
            told = True
            return super().wait(timeout_s)

    write_down(Listener(fabric, BRAIN), out, lambda: told)
    return out


def memory(folder: Path, *pairs: messages.Pair) -> Path:
    """A memory store's file with these pairs."""
    path = folder / "memory.sqlite"
    with MemoryFile(path) as file:
        for one in pairs:
            file.add(one, stored(one.iteration, judged=one.feedback is not None), [])
    return path


def test_what_was_acknowledged_and_is_there_holds(tmp_path: Path) -> None:
    witness = heard(tmp_path, pair(0), stored(0), pair(1), pair(1), stored(1), stored(1), pair(2))
    told = compare(witness, memory(tmp_path, pair(0), pair(1)))
    assert told.holds
    assert (told.acknowledged, told.stored, told.missing) == (2, 2, [])


def test_what_was_acknowledged_and_is_not_there_is_lost(tmp_path: Path) -> None:
    told = compare(heard(tmp_path, pair(0), stored(0), pair(1), stored(1)), memory(tmp_path, pair(0)))
    assert (told.holds, told.lost) == (False, [1])


@pytest.mark.parametrize(
    "kept", [pair(0, after={"distance": 0.5}), pair(0, action={"turn": 45.0}), pair(0, None), pair(0, -1.0)]
)
def test_what_is_there_otherwise_is_altered(tmp_path: Path, kept: messages.Pair) -> None:
    told = compare(heard(tmp_path, pair(0), stored(0)), memory(tmp_path, kept))
    assert (told.holds, told.altered, told.lost) == (False, [0], [])


def test_late_feedback_alters_nothing_but_must_not_be_lost_again(tmp_path: Path) -> None:
    witness = heard(tmp_path, pair(0, None), stored(0, judged=False), pair(0), stored(0))
    assert compare(witness, memory(tmp_path, pair(0))).holds
    (tmp_path / "memory.sqlite").unlink()
    assert compare(witness, memory(tmp_path, pair(0, None))).altered == [0]


def test_one_act_counted_twice_is_doubled_and_a_gap_is_missing(tmp_path: Path) -> None:
    twice = pair(3, before={"distance": 2.0}, after={"distance": 2.9})
    told = compare(heard(tmp_path, stored(0)), memory(tmp_path, pair(0), pair(2), twice))
    assert (told.holds, told.doubled, told.missing) == (False, [3], [1])


def test_a_pair_that_entered_a_memory_twice_is_doubled(tmp_path: Path) -> None:
    path = memory(tmp_path, pair(0))
    with sqlite3.connect(path) as db:
        db.executemany("INSERT INTO change VALUES (?, ?, ?, ?, ?)", [("object", v, v, 0, 0.0) for v in (1, 2)])
    assert compare(heard(tmp_path, pair(0), stored(0)), path).doubled == [0]


def test_half_a_line_of_a_killed_witness_is_left_out(tmp_path: Path) -> None:
    witness = heard(tmp_path, pair(0), stored(0))
    witness.write_text(witness.read_text() + '{"key": "pair/sto')
    assert compare(witness, memory(tmp_path, pair(0))).holds


def test_no_findings_and_no_memory_are_clear_errors(tmp_path: Path) -> None:
    with pytest.raises(MdbError, match="the witness has left nothing"):
        compare(tmp_path / "none", tmp_path / "none")
    with pytest.raises(MdbError, match="cannot compare"):
        compare(heard(tmp_path, pair(0)), tmp_path / "none")
