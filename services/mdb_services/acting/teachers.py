"""What the teachers said, and who is obeyed: one service's view of all who teach.

Owns the policy of several teachers. Pure: the optimizer hands in what came and who is alive, and asks.
"""

from __future__ import annotations

import math
from collections.abc import Container
from typing import Any, NamedTuple

from mdb_protocol import messages
from mdb_services.experiment.sections import Word

ROLE = "teacher"
KEPT_AHEAD = 256
"""Iterations to come for which something is kept; beyond it the farthest ahead is dropped."""
KEPT_TEACHERS = 64
"""Teachers heard for one iteration; who comes later is not."""


class Verdict(NamedTuple):
    """Feedback in [-1, 1], the mean of what its authors said, or None."""

    value: float | None
    judges: list[str]


class Teachers:
    """See the module's docstring."""

    def __init__(self, word: Word, window: int = 0) -> None:
        """Feedback is kept for so many iterations behind, and for `KEPT_AHEAD`."""
        self._kept_feedback = KEPT_AHEAD + window
        self.holder: str | None = None
        """The teacher who is being obeyed; always None where all are heard."""
        self._first_only = word == "first"
        self._commands: dict[int, dict[str, messages.Command]] = {}
        self._feedback: dict[int, dict[str, float | None]] = {}
        self._asked: dict[int, dict[str, float]] = {}
        self._asked_feedback: dict[int, dict[str, float]] = {}
        """When each teacher last asked to be waited for: with his command, and with his feedback."""
        self._seen: set[str] = set()
        self._nameless: dict[str, None] = {}
        """Whose feedback names no iteration; who spoke last is last."""

    def hear(self, command: messages.Command) -> None:
        """Keep a teacher's first command for an iteration."""
        said = self._commands.setdefault(command.iteration, {})
        if len(said) < KEPT_TEACHERS:
            said.setdefault(command.teacher, command)
        _bound(self._commands, KEPT_AHEAD)

    def ask(self, message: messages.Command | messages.Feedback, now_s: float) -> None:
        """Keep that a teacher asks to be waited for, with a command or feedback that is to come `later`."""
        if message.iteration is None:
            return
        kept = self._asked if isinstance(message, messages.Command) else self._asked_feedback
        asked = kept.setdefault(message.iteration, {})
        if message.teacher in asked or len(asked) < KEPT_TEACHERS:
            asked[message.teacher] = now_s
        _bound(kept, KEPT_AHEAD if kept is self._asked else self._kept_feedback)

    def judge(self, feedback: messages.Feedback) -> None:
        """Keep a teacher's first feedback for an iteration; what he said instead of "not now" counts.

        Of one who names no iteration only that is kept: he is not waited for, until he names one again.
        """
        if feedback.iteration is None:
            self._nameless.pop(feedback.teacher, None)
            self._nameless[feedback.teacher] = None
            if len(self._nameless) > KEPT_TEACHERS:
                del self._nameless[next(iter(self._nameless))]
            return
        self._nameless.pop(feedback.teacher, None)
        self.credit(feedback.iteration, feedback)

    def credit(self, iteration: int, feedback: messages.Feedback) -> None:
        """Keep a teacher's first feedback for an iteration that he has named, or is thought to mean."""
        said = self._feedback.setdefault(iteration, {})
        if said.get(feedback.teacher) is None and (feedback.teacher in said or len(said) < KEPT_TEACHERS):
            said[feedback.teacher] = feedback.value
        _bound(self._feedback, self._kept_feedback)

    def settled(self, iteration: int, alive: frozenset[str]) -> bool:
        """Whether nothing would be gained by waiting longer for a command; `alive` as of `Bus.alive`."""
        present = {name for name in alive if name.startswith(f"{ROLE}/")}
        self._seen |= present
        said = self._commands.get(iteration, {})
        if self.holder is not None and self._is_gone(self.holder, present):
            self.holder = None
        if self.holder is not None and self.holder not in said:
            return False
        if any(command.note is not None for command in said.values()):
            return True
        return (self.holder is not None or len(said) >= len(present)) and not self._pending(iteration, present)

    def asked_s(self, iteration: int, alive: frozenset[str]) -> float:
        """Return when one whose command is awaited last asked to be waited for; -inf: nobody did."""
        pending = self._pending(iteration, {name for name in alive if name.startswith(f"{ROLE}/")})
        if self.holder is not None and self.holder not in self._commands.get(iteration, {}):
            return pending.get(self.holder, -math.inf)
        return max(pending.values(), default=-math.inf)

    def asked_feedback_s(self, iteration: int, teacher: str | None) -> float:
        """Return when a teacher last asked to be waited for with his feedback; -inf: he did not."""
        asked = self._asked_feedback.get(iteration, {})
        return -math.inf if teacher is None else asked.get(teacher, -math.inf)

    def _pending(self, iteration: int, present: set[str]) -> dict[str, float]:
        """Return who asked to be waited for and has not said his command yet, and when; who has no token is gone."""
        said, asked = self._commands.get(iteration, {}), self._asked.get(iteration, {})
        return {who: s for who, s in asked.items() if who not in said and f"{ROLE}/{who}" in present}

    def _is_gone(self, teacher: str, present: set[str]) -> bool:
        """A scripted teacher has no token of its own, only its process has: it goes when nobody is left."""
        token = f"{ROLE}/{teacher}"
        return not present or (token in self._seen and token not in present)

    def is_there(self, teacher: str | None, alive: frozenset[str]) -> bool:
        """Whether it makes sense to wait for what this teacher thinks."""
        present = {name for name in alive if name.startswith(f"{ROLE}/")}
        return teacher is not None and not self._is_gone(teacher, present)

    def word(self, iteration: int) -> messages.Command | None:
        """Return the command that counts, None for silence; who is obeyed is decided here.

        When he who was obeyed is silent, or his time is up, the first other one with a note is obeyed from now on.
        """
        said = self._commands.get(iteration, {})
        if self.holder is not None:
            his = said.get(self.holder)
            if his is not None and his.note is not None:
                return his
            self.holder = None
        taken = next((command for command in said.values() if command.note is not None), None)
        if taken is not None and self._first_only:
            self.holder = taken.teacher
        return taken

    def answered(self, iteration: int, teacher: str | None) -> bool:
        """Whether the teacher who commanded has said what he thinks of it, or that he will later."""
        return teacher is None or teacher in self._nameless or teacher in self._feedback.get(iteration, {})

    @property
    def spoken_of(self) -> Container[int]:
        """The iterations for which there is feedback, if only that it comes later."""
        return self._feedback

    def verdict(self, iteration: int, teacher: str | None) -> Verdict:
        """Return the feedback for an iteration in which `teacher` commanded (None: nobody).

        Where only one is obeyed, only he who commanded judges. What the robot did by itself is judged by the
        first who says anything.
        """
        said = {who: v for who, v in self._feedback.get(iteration, {}).items() if v is not None}
        if self._first_only:
            judge = teacher if teacher is not None else self.holder or next(iter(said), None)
            said = {who: v for who, v in said.items() if who == judge}
        return Verdict(sum(said.values()) / len(said), list(said)) if said else Verdict(None, [])

    def forget(self, before: int, feedback_before: int) -> None:
        """Drop commands for iterations below `before` and feedback for those below `feedback_before`."""
        _forget(self._commands, before)
        _forget(self._feedback, feedback_before)
        _forget(self._asked, before)
        _forget(self._asked_feedback, feedback_before)


def _forget(kept: dict[int, Any], before: int) -> None:
    for iteration in [iteration for iteration in kept if iteration < before]:
        del kept[iteration]


def _bound(kept: dict[int, Any], most: int) -> None:
    if len(kept) > most:
        del kept[max(kept)]
