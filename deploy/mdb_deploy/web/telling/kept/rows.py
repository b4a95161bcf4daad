"""What happened in each iteration, in columns: for curves, tables and the time line. Bounded."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from mdb_deploy.web.telling.plan import Plan, number
from mdb_protocol.messages import IterationReport, Pair
from mdb_services.acting.models import prequential
from mdb_services.mechanism.actions.foresight import Known

MOST_ROWS = 100_000
"""The newest so many are kept."""
AT_ONCE = 4000
"""Rows in one frame."""
AMENDED = 2000
"""Changes of rows that are remembered: who has missed more gets all rows again."""
COLUMNS = (
    "iteration", "mode", "explored", "note", "choice", "feedback", "predicted", "event", "success", "obeyed",
    "teacher",
)  # fmt: skip
Get = Callable[[str, int], Known | None]
"""The current model of a name and version, if it is known."""


class Rows:
    """See the module's docstring. A row's place counts from the first there was, also when that is kept no longer."""

    def __init__(self, plan: Plan) -> None:
        self._successes = frozenset(plan.experiment.robot.successes)
        self._models = tuple(plan.books)
        self._columns: dict[str, list[Any]] = {name: [] for name in COLUMNS}
        self._errors: dict[str, list[float | None]] = {name: [] for name in self._models}
        self._first = 0
        self._places: dict[int, int] = {}
        self._amended: deque[tuple[int, int]] = deque(maxlen=AMENDED)
        self.revision = 0
        """How often a row was changed after it was there."""

    @property
    def count(self) -> int:
        """The place of the next row."""
        return self._first + len(self._columns["iteration"])

    @property
    def last(self) -> int:
        """The iteration of the last row; -1: there is none."""
        iterations = self._columns["iteration"]
        return int(iterations[-1]) if iterations else -1

    def add(self, report: IterationReport, obeyed: bool | None) -> bool:
        """Add the row of a report; return False for one that came before."""
        if report.iteration <= self.last:
            return False
        self._places[report.iteration] = self.count
        row = (
            report.iteration, report.mode, int(report.explored), report.note, report.choice, number(report.feedback),
            number(report.predicted, 5), report.event, int(report.event in self._successes), _flag(obeyed),
            report.teacher,
        )  # fmt: skip
        for name, value in zip(COLUMNS, row, strict=True):
            self._columns[name].append(value)
        for name, errors in self._errors.items():
            errors.append(number(report.prequential.get(name), 6))
        if len(self._columns["iteration"]) > MOST_ROWS + AT_ONCE:
            self._forget(AT_ONCE)
        return True

    def _forget(self, count: int) -> None:
        for iteration in self._columns["iteration"][:count]:
            self._places.pop(iteration, None)
        for column in (*self._columns.values(), *self._errors.values()):
            del column[:count]
        self._first += count

    def judge(self, pair: Pair, known: Get) -> bool:
        """Put feedback that came late into its row, with the errors that it shows; return whether that was new."""
        place = self._places.get(pair.iteration)
        if place is None or pair.feedback is None or self._columns["feedback"][place - self._first] is not None:
            return False
        row = place - self._first
        self._columns["feedback"][row] = number(pair.feedback)
        acted_upon = {name: known(name, version) for name, version in pair.versions.items() if name in self._errors}
        errors = prequential({name: model for name, model in acted_upon.items() if model is not None}, pair)
        for name, error in errors.items():
            if self._errors[name][row] is None:
                self._errors[name][row] = number(error, 6)
        self._amend(place)
        return True

    def obey(self, iteration: int, obeyed: bool | None) -> None:
        """Say of a row whether its note was obeyed, when that is known later than the row."""
        place = self._places.get(iteration)
        if place is not None and obeyed is not None and self._columns["obeyed"][place - self._first] is None:
            self._columns["obeyed"][place - self._first] = _flag(obeyed)
            self._amend(place)

    def _amend(self, place: int) -> None:
        self.revision += 1
        self._amended.append((self.revision, place))

    def since(self, place: int, most: int = AT_ONCE) -> dict[str, Any]:
        """Return at most so many rows from a place on; `from` is the place of the first."""
        start = max(place - self._first, 0)
        part = slice(start, start + most)
        told: dict[str, Any] = {"from": self._first + start}
        told |= {name: column[part] for name, column in self._columns.items()}
        told["errors"] = {name: errors[part] for name, errors in self._errors.items()}
        return told

    def changed(self, revision: int) -> int | None:
        """Return the lowest place of those that were changed after a revision; None: none was."""
        if revision >= self.revision:
            return None
        if not self._amended or self._amended[0][0] > revision + 1:
            return 0
        return min(place for at, place in self._amended if at > revision)


def _flag(value: bool | None) -> int | None:
    return None if value is None else int(value)
