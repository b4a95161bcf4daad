"""A teacher's memory of one run, and the measures that follow from it. Pure: no bus, no clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import replace
from typing import Any

from mdb_deploy.teach.view import Exchange, Latency, Summary
from mdb_protocol import messages

ERROR_MEAN = 40
"""Reports in the running mean of a model's error (sim/README.md, "Errors, told apart")."""
OBEDIENCE_OF = 20
"""Commands that obedience is the share of."""
SUCCESSES_IN = 100
"""Iterations over which the rate of successes is taken."""
FEW = 10
"""Iterations that must have been seen before a rate of successes says anything (ours)."""
KEPT, SHOWN = 256, 40
"""Iterations remembered, and those of them that are shown."""


class Record:
    """See the module's docstring. Times are seconds of one clock, the caller's."""

    def __init__(self, teacher: str) -> None:
        self._teacher = teacher
        self.without_effect = 0
        """Commands in a row that the brain's reports do not name this teacher for."""
        self._reported = -1
        self._exchanges: dict[int, Exchange] = {}
        self._sent_s: dict[int, float] = {}
        self._errors: dict[str, deque[float]] = {}
        self._successes: deque[tuple[int, int]] = deque()
        self._latency = Latency()
        self._summary = Summary()
        self._first: list[bool] = []
        self._last: deque[bool] = deque(maxlen=OBEDIENCE_OF)
        """Whether the first and last commands were obeyed."""

    def exchange(self, iteration: int) -> Exchange:
        """Return what is known of an iteration."""
        return self._exchanges.get(iteration, Exchange(iteration))

    def note_down(self, iteration: int, **changes: Any) -> None:
        """Add to what is known of an iteration; the oldest is forgotten."""
        self._exchanges[iteration] = replace(self.exchange(iteration), **changes)
        while len(self._exchanges) > KEPT:
            oldest = min(self._exchanges)
            del self._exchanges[oldest]
            self._sent_s.pop(oldest, None)

    def said(self, iteration: int, note: int | None, command: int | None, now_s: float) -> None:
        """Remember a note, or silence, and when it was said; a note after the iteration's report was too late."""
        self.note_down(iteration, spoke=True, note=note, command=command)
        self._sent_s[iteration] = now_s
        self._summary = replace(self._summary, commands=self._summary.commands + (note is not None))
        if iteration <= self._reported:
            self._take_effect(iteration, heard=False)

    def judged(self, iteration: int, value: float) -> None:
        """Remember feedback in [-1, 1]."""
        self.note_down(iteration, feedback=value)
        rewards, punishments = self._summary.rewards + (value > 0.0), self._summary.punishments + (value < 0.0)
        self._summary = replace(self._summary, rewards=rewards, punishments=punishments)

    def _take_effect(self, iteration: int, *, heard: bool) -> None:
        """Count whether a note had an effect; silence has none to have."""
        if self.exchange(iteration).note is not None:
            self.without_effect = 0 if heard else self.without_effect + 1
            self.note_down(iteration, heard=heard)

    def see(self, scene: messages.Scene, now_s: float, *, did: int | None, obeyed: bool | None) -> None:
        """Take in a scene, and what is thought of the action that led to it."""
        if scene.action is not None:
            self.note_down(scene.iteration - 1, did=did, obeyed=obeyed)
            self._sum_up(scene, obeyed)
            if (sent_s := self._sent_s.get(scene.iteration - 1)) is not None:
                self._latency = replace(self._latency, to_action_s=now_s - sent_s)
        self._successes.append((scene.iteration, scene.successes))
        while self._successes[0][0] < scene.iteration - SUCCESSES_IN:
            self._successes.popleft()

    def _sum_up(self, scene: messages.Scene, obeyed: bool | None) -> None:
        """Count an action; `successes` by their difference, for before this teacher came they are not his."""
        total = self._summary
        if self._successes:
            total = replace(total, successes=total.successes + max(0, scene.successes - self._successes[-1][1]))
        if obeyed is not None:
            total = replace(total, judged=total.judged + 1, obeyed=total.obeyed + obeyed)
            self._last.append(obeyed)
            if len(self._first) < OBEDIENCE_OF:
                self._first.append(obeyed)
        self._summary = total

    def summary(self) -> Summary:
        """Return all that this teacher has done so far."""
        return replace(self._summary, first=_share(self._first), last=_share(self._last))

    def read(self, report: messages.IterationReport, now_s: float) -> None:
        """Take in the brain's own word on an iteration: whom it obeyed, how well it had foreseen what came."""
        for model, error in report.prequential.items():
            self._errors.setdefault(model, deque(maxlen=ERROR_MEAN)).append(error)
        self._reported = report.iteration
        self._take_effect(report.iteration, heard=report.teacher == self._teacher)
        if (sent_s := self._sent_s.pop(report.iteration, None)) is not None:
            self._latency = replace(self._latency, to_report_s=now_s - sent_s)

    def time(self, timing: messages.Timing) -> None:
        """Take in how long the brain took."""
        self._latency = replace(self._latency, perception_to_action_s=timing.perception_to_action_s)

    def measures(self) -> dict[str, Any]:
        """Return what follows, by the names in `View`."""
        newest = [self._exchanges[i] for i in sorted(self._exchanges, reverse=True)]
        commands = [e for e in newest if e.command is not None and e.obeyed is not None][:OBEDIENCE_OF]
        obeyed = sum(e.obeyed is True for e in commands)
        return {
            "exchanges": tuple(newest[:SHOWN]),
            "errors": {model: sum(recent) / len(recent) for model, recent in self._errors.items()},
            "obedience": obeyed / len(commands) if commands else None,
            "judged": len(commands),
            "successes": self._successes[-1][1] if self._successes else 0,
            "successes_per_100": self._success_rate(),
            "latency": self._latency,
            "summary": self.summary(),
        }

    def _success_rate(self) -> float | None:
        if not self._successes:
            return None
        (first, had), (last, has) = self._successes[0], self._successes[-1]
        return SUCCESSES_IN * (has - had) / (last - first) if last - first >= FEW else None


def _share(obeyed: Collection[bool]) -> float | None:
    return sum(obeyed) / len(obeyed) if obeyed else None
