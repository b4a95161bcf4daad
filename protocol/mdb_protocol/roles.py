"""Who may write and read what, by the key table: the brain all, a teacher writes what is his, a viewer only reads, an
operator may change the robot and how the run goes on.

Owns the rules, not their enforcement: that is the router's, by the certificate a client shows. A client asks here
first, because the router drops what it denies without a word.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from mdb_protocol.errors import BusError
from mdb_protocol.keys import ALIVE, KEYS, ROOT, STATUS, Key

PRESENCE = (STATUS, ALIVE)
"""Rows on which everyone has a key of its own, by role and instance."""
TEACHER_WRITES = tuple(row for row in KEYS if row.writer == "that teacher")
OPERATOR_WRITES = tuple(row for row in KEYS if row.writer == "that operator")
TEACHER_READS = tuple(row for row in KEYS if row.teachers_read)


class Role(Enum):
    """What a user of a brain may do; the value is its name in certificates, files and liveliness tokens."""

    BRAIN = "brain"
    TEACHER = "teacher"
    VIEWER = "viewer"
    OPERATOR = "operator"


@dataclass(frozen=True)
class User:
    """Somebody who shows a certificate: one role, on one brain, under one name."""

    brain: str
    role: Role
    name: str

    def __str__(self) -> str:
        of = "" if self.role is Role.BRAIN else f" of brain {self.brain}"
        return f"{self.role.value} {self.name}{of}"

    def writes(self) -> list[str]:
        """Return the key expressions it may write; concrete keys but for the brain's own."""
        return [self.everything()] if self.role is Role.BRAIN else list(self.writes_on().values())

    def writes_on(self) -> dict[Key, str]:
        """Return a guest's own concrete key of each row that he may write."""
        rows = {Role.TEACHER: TEACHER_WRITES, Role.OPERATOR: OPERATOR_WRITES}.get(self.role, ())
        own = {"teacher": self.name, "role": self.role.value, "instance": self.name}
        return {row: row.at(self.brain, **{name: own[name] for name in row.parameters}) for row in (*rows, *PRESENCE)}

    def reads(self) -> list[str]:
        """Return the key expressions it may read."""
        if self.role is not Role.TEACHER:
            return [self.everything()]
        rows = dict.fromkeys((*TEACHER_READS, *TEACHER_WRITES))
        return [row.at(self.brain, **({"teacher": self.name} if "teacher" in row.parameters else {})) for row in rows]

    def everything(self) -> str:
        """Return the key expression of all keys of its brain."""
        return f"{ROOT}/{self.brain}/**"

    def check_writes(self, row: Key, key: str) -> None:
        """Raise BusError when the router would drop what this user writes on a key of `row`."""
        if self.role is not Role.BRAIN and key not in self.writes():
            raise BusError(
                f"{self} may not write {key} (only writer: {row.writer}); allowed: {', '.join(self.writes())}"
            )

    def check_brain(self, brain: str) -> None:
        """Raise BusError when these are keys of another brain."""
        if brain != self.brain:
            raise BusError(f"these are the keys of {self}; for brain {brain} others are needed ('mdb keys list')")


def table() -> str:
    """Return who may do what as Markdown, as it stands in deploy/README.md."""
    writes, presence = _paths(TEACHER_WRITES), _paths(PRESENCE)
    read = _paths(row for row in TEACHER_READS if "teacher" not in row.parameters)
    read_own = _paths(row for row in (*TEACHER_READS, *TEACHER_WRITES) if "teacher" in row.parameters)
    return "\n".join(
        [
            "| role | writes | reads |",
            "|---|---|---|",
            "| brain | all keys of its brain | all keys of its brain |",
            f"| teacher | with its own name: {writes}, {presence} | {read}; with its own name: {read_own} |",
            f"| viewer | with its own name: {presence} | all keys of its brain |",
            f"| operator | {_paths(OPERATOR_WRITES)}; with its own name: {presence} | all keys of its brain |",
        ]
    )


def _paths(rows: Iterable[Key]) -> str:
    return ", ".join(f"`{row.path}`" for row in rows)
