"""A teacher's memory of one run, and the measures that follow from it. Pure: no bus, no clock."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

from mdb_deploy.teach.view import Exchange, Latency
from mdb_protocol import messages

ERROR_MEAN = 40
"""Reports in the running mean of a model's error (sim/README.md, "Errors, told apart")."""
OBEDIENCE_OF = 20
"""Commands that obedience is the share of."""
CAPTURES_IN = 100
"""Iterations over which the rate of captures is taken."""
FEW = 10
"""Iterations that must have been seen before a rate of captures says anything (ours)."""
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
        self._captures: deque[tuple[int, int]] = deque()
        self._trail: deque[tuple[float, float]] = deque(maxlen=KEPT)
        self._scene: messages.Scene | None = None
        self._latency = Latency()

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
        if iteration <= self._reported:
            self._take_effect(iteration, heard=False)

    def _take_effect(self, iteration: int, *, heard: bool) -> None:
        """Count whether a note had an effect; silence has none to have."""
        if self.exchange(iteration).note is not None:
            self.without_effect = 0 if heard else self.without_effect + 1
            self.note_down(iteration, heard=heard)

    def see(self, scene: messages.Scene, now_s: float) -> None:
        """Take in a scene."""
        last, self._scene = self._scene, scene
        if scene.action is not None:
            self.note_down(scene.iteration - 1, action=scene.action)
            if (sent_s := self._sent_s.get(scene.iteration - 1)) is not None:
                self._latency = replace(self._latency, to_action_s=now_s - sent_s)
        if last is None or scene.event != "none" or scene.episode != last.episode:
            self._trail.clear()
        self._trail.append((scene.now.x_m, scene.now.y_m))
        self._captures.append((scene.iteration, scene.captures))
        while self._captures[0][0] < scene.iteration - CAPTURES_IN:
            self._captures.popleft()

    def read(self, report: messages.IterationReport, now_s: float) -> None:
        """Take in the brain's own word on an iteration: whom it obeyed, how well it had foreseen what came."""
        for model, error in report.prequential.items():
            self._errors.setdefault(model, deque(maxlen=ERROR_MEAN)).append(error)
        self._reported = report.iteration
        self.note_down(report.iteration, action=report.action)
        self._take_effect(report.iteration, heard=report.teacher == self._teacher)
        if (sent_s := self._sent_s.pop(report.iteration, None)) is not None:
            self._latency = replace(self._latency, to_report_s=now_s - sent_s)

    def time(self, timing: messages.Timing) -> None:
        """Take in how long the brain took."""
        self._latency = replace(self._latency, perception_to_action_s=timing.perception_to_action_s)

    def measures(self) -> dict[str, Any]:
        """Return what follows, by the names in `View`."""
        newest = [self._exchanges[i] for i in sorted(self._exchanges, reverse=True)]
        commands = [e for e in newest if e.command is not None and e.action is not None][:OBEDIENCE_OF]
        obeyed = sum(e.action == e.command for e in commands)
        return {
            "trail": tuple(self._trail),
            "exchanges": tuple(newest[:SHOWN]),
            "errors": {model: sum(recent) / len(recent) for model, recent in self._errors.items()},
            "obedience": obeyed / len(commands) if commands else None,
            "judged": len(commands),
            "captures": self._captures[-1][1] if self._captures else 0,
            "captures_per_100": self._capture_rate(),
            "latency": self._latency,
        }

    def _capture_rate(self) -> float | None:
        if not self._captures:
            return None
        (first, had), (last, has) = self._captures[0], self._captures[-1]
        return CAPTURES_IN * (has - had) / (last - first) if last - first >= FEW else None
