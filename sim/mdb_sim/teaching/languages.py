"""Languages: which note stands for which command. Pure, without I/O.

A command is a place in the list of what a teacher's policy can want; no order is supposed among notes (paper,
section 3: any correspondence will do).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


class TeacherError(ValueError):
    """A language, command or policy that does not exist; the message tells how to mend it."""


@dataclass(frozen=True, slots=True)
class Language:
    """Which note stands for which command: `notes[command]`, a permutation of 0 to n - 1."""

    name: str
    notes: tuple[int, ...]

    def __post_init__(self) -> None:
        """Check that each note stands for one command, or the teacher would be ambiguous."""
        if sorted(self.notes) != list(range(len(self.notes))):
            raise TeacherError(
                f"language {self.name!r} has the notes {self.notes}; expected each of 0 to"
                f" {len(self.notes) - 1} exactly once, one a command; correct the list"
            )

    def note(self, command: int) -> int:
        """The note that says this command."""
        return self.notes[_checked_index("command", command, len(self.notes))]

    def command(self, note: int) -> int:
        """The command that this note says."""
        return self.notes.index(_checked_index("note", note, len(self.notes)))


def make_language(name: str, order: Sequence[int]) -> Language:
    """The language of this name for commands of these ranks (`Policy.order`).

    "ordered": notes rise with the commands' order, as from the largest right turn to the largest left turn;
    "reversed": they fall; "paper": as the commands are listed (paper, section 3); "random:SEED": a permutation drawn
    from the seed; "notes:3,0,1,...": the given note for each command. TeacherError for anything else.
    """
    count = len(order)
    kind, _, detail = name.partition(":")
    if name == "ordered":
        return Language(name, tuple(order))
    if name == "reversed":
        return Language(name, tuple(count - 1 - rank for rank in order))
    if name == "paper":
        return Language(name, tuple(range(count)))
    if kind == "random" and detail.isdecimal() and int(detail) < 2**64:
        rng = np.random.Generator(np.random.Philox(key=int(detail)))
        return Language(name, tuple(rng.permutation(count).tolist()))
    if kind == "notes" and len(parts := detail.split(",")) == count and all(p.strip().isdecimal() for p in parts):
        return Language(name, tuple(int(part) for part in parts))
    listing = ",".join(map(str, range(count)))
    raise TeacherError(
        f"no language {name!r} for {count} commands; expected 'ordered', 'reversed', 'paper', 'random:SEED'"
        f" (as in 'random:7'), or 'notes:' and {count} notes (as in 'notes:{listing}')"
    )


def _checked_index(noun: str, value: int, count: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
        raise TeacherError(f"{noun}={value!r} does not exist; expected an int from 0 to {count - 1}")
    return value
