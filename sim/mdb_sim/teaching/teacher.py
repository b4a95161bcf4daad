"""The scripted teacher: what it commands, in which notes it says so, and how it rewards. Pure, without I/O.

Owns: languages (which note stands for which command), the wanted action, the feedback. The teacher sees the
true scene, never the brain's inside; a command is the index of the action it asks for (paper, section 3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mdb_sim.bodies.pioneer.arena import bearing_rad, wrap_rad
from mdb_sim.body import Placement

FeedbackKind = Literal["graded", "binary"]

MISS_WITHOUT_PLEASURE = 3
"""Missing by so many steps of turn, or more, earns the full punishment (sim/README.md, "Teacher")."""


class TeacherError(ValueError):
    """A language, command or action that does not exist; the message tells how to mend it."""


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
                f" {len(self.notes) - 1} exactly once, one a command; mend the list"
            )

    def note(self, command: int) -> int:
        """The note that says this command."""
        return self.notes[_checked_index("command", command, len(self.notes))]

    def command(self, note: int) -> int:
        """The command that this note says."""
        return self.notes.index(_checked_index("note", note, len(self.notes)))


def make_language(name: str, turns_deg: Sequence[float]) -> Language:
    """The language of this name for these actions.

    "ordered": notes rise from the largest right turn to the largest left turn; "reversed": they fall;
    "paper": in the order in which the paper lists the actions (section 3, and our `turns_deg`);
    "random:SEED": a permutation drawn from the seed; "notes:3,0,1,...": the given note for each action.
    TeacherError for anything else.
    """
    count = len(turns_deg)
    kind, _, detail = name.partition(":")
    if name == "ordered":
        return Language(name, turn_ranks(turns_deg))
    if name == "reversed":
        return Language(name, tuple(count - 1 - rank for rank in turn_ranks(turns_deg)))
    if name == "paper":
        return Language(name, tuple(range(count)))
    if kind == "random" and detail.isdecimal() and int(detail) < 2**64:
        rng = np.random.Generator(np.random.Philox(key=int(detail)))
        return Language(name, tuple(rng.permutation(count).tolist()))
    if kind == "notes" and len(parts := detail.split(",")) == count and all(p.strip().isdecimal() for p in parts):
        return Language(name, tuple(int(part) for part in parts))
    listing = ",".join(map(str, range(count)))
    raise TeacherError(
        f"no language {name!r} for {count} actions; expected 'ordered', 'reversed', 'paper', 'random:SEED'"
        f" (as in 'random:7'), or 'notes:' and {count} notes (as in 'notes:{listing}')"
    )


def turn_ranks(turns_deg: Sequence[float]) -> tuple[int, ...]:
    """For each action its rank among the turns, 0 for the one farthest right."""
    by_turn = sorted(range(len(turns_deg)), key=lambda action: turns_deg[action])
    return tuple(by_turn.index(action) for action in range(len(turns_deg)))


def wanted_action(placement: Placement, turns_rad: Sequence[float]) -> int:
    """The action after whose turn the robot best faces the object; the first of equals."""
    bearing = bearing_rad(placement)
    return min(range(len(turns_rad)), key=lambda action: abs(wrap_rad(bearing - turns_rad[action])))


def graded_feedback(command: int, action: int, turns: Sequence[float]) -> float:
    """Pleasure or pain in [-1, 1] for this action after this command (paper, section 3).

    turns: one an action, in any unit, since only their order counts. +1 for obedience, less for each step of
    turn missed, -1 from three steps on.
    """
    ranks = turn_ranks(turns)
    wanted = ranks[_checked_index("command", command, len(ranks))]
    miss = abs(wanted - ranks[_checked_index("action", action, len(ranks))])
    return 2.0 * max(0.0, 1.0 - miss / MISS_WITHOUT_PLEASURE) - 1.0


def binary_feedback(command: int, action: int, turns: Sequence[float]) -> float:
    """+1 for obedience, -1 for anything else: much harder to learn from (sim/README.md, "Teacher")."""
    obeyed = _checked_index("command", command, len(turns)) == _checked_index("action", action, len(turns))
    return 1.0 if obeyed else -1.0


FEEDBACKS: dict[FeedbackKind, Callable[[int, int, Sequence[float]], float]] = {
    "graded": graded_feedback,
    "binary": binary_feedback,
}
"""How a teacher may reward, by the name that a configuration gives it."""


def _checked_index(noun: str, value: int, count: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
        raise TeacherError(f"{noun}={value!r} does not exist; expected an int from 0 to {count - 1}")
    return value
