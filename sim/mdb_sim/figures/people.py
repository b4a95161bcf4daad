"""Who taught a run beside its scripted phases: people, and clients that announce a lesson as people do."""

from __future__ import annotations

from dataclasses import dataclass

from mdb_sim.runs.record import RunRecord

MOST_ROWS = 5
"""Rows of people, at the most: whoever is too many shares the last one."""


@dataclass(frozen=True)
class Stay:
    """From its first lesson to its end somebody taught: iterations `start` to `stop`, `stop` not included."""

    name: str
    start: int
    stop: int


def stays(record: RunRecord) -> tuple[Stay, ...]:
    """Return who came to teach and was heard, in order; left out is whoever the phases show already.

    Who was never obeyed did not teach. Who left without a word has left after the last iteration that names him.
    """
    begun: dict[str, int] = {}
    found: list[Stay] = []
    for lesson in record.lessons:
        if not lesson.over:
            begun.setdefault(lesson.teacher, lesson.iteration)
        elif (start := begun.pop(lesson.teacher, None)) is not None:
            found.append(Stay(lesson.teacher, start, max(lesson.iteration, start + 1)))
    found += [Stay(name, start, _heard_until(record, name, start)) for name, start in begun.items()]
    taught = [stay for stay in found if _was_heard(record, stay) and not _is_shown(record, stay)]
    return tuple(sorted(taught, key=lambda stay: (stay.start, stay.name)))


def lanes(found: tuple[Stay, ...]) -> list[list[Stay]]:
    """Return stays in rows; in each nobody overlaps another, as long as `MOST_ROWS` are enough."""
    rows: list[list[Stay]] = []
    for stay in found:
        row = next((row for row in rows if row[-1].stop <= stay.start), None)
        if row is None and len(rows) < MOST_ROWS:
            row = []
            rows.append(row)
        (rows[-1] if row is None else row).append(stay)
    return rows


def _names(record: RunRecord, iteration: int, name: str) -> bool:
    """Whether the brain obeyed this teacher in an iteration, or was judged by him."""
    report = record.reports.get(iteration)
    return report is not None and (report.teacher == name or name in report.judges)


def _heard_until(record: RunRecord, name: str, start: int) -> int:
    heard = (i for i in range(record.iterations - 1, start - 1, -1) if _names(record, i, name))
    return next(heard, start) + 1


def _was_heard(record: RunRecord, stay: Stay) -> bool:
    return any(_names(record, i, stay.name) for i in range(stay.start, min(stay.stop, record.iterations)))


def _is_shown(record: RunRecord, stay: Stay) -> bool:
    """Whether all of a stay lies in phases of this teacher: in a run without a script lessons are the phases."""
    phases = [span for span in record.spans if span.teacher == stay.name]
    return all(any(span.start <= i < span.stop for span in phases) for i in range(stay.start, stay.stop))
