"""What the teacher is told to do now, and what is told when he leaves: pure functions from a view to words."""

from __future__ import annotations

import math

from rich.text import Text

from mdb_deploy.teach.record import OBEDIENCE_OF
from mdb_deploy.teach.view import Summary, View
from mdb_protocol.words import shown

TURN, QUIET, HURRY = "bold green", "grey50", "bold yellow"
HURRY_S = 3.0
"""With less time than this left, the countdown is in another colour (ours)."""


def turn(view: View, name: str, now_s: float) -> Text:
    """Return what `name` can do now, and how long the brain waits for it; `now_s` by the session's clock."""
    words = _cannot(view, name)
    if words is not None:
        return Text(words, QUIET)
    if view.turn.kind in ("play", "both"):
        return Text(_your_turn(view), TURN).append_text(_left(view, now_s))
    return Text("watch, then judge what it does" if view.turn.kind == "judge" else "watch what it does", QUIET)


def _cannot(view: View, name: str) -> str | None:
    """Return why nobody waits for what this teacher says; None if that is not so."""
    holder = view.report.holder if view.report else None
    if view.turn.kind == "over":
        return "the experiment is over; q leaves"
    if view.paused:
        return "pause: you are silent, and the robot goes on; p ends the pause"
    if view.auto:
        return "watch: your notes are played by themselves"
    if holder not in (None, name):
        return f"watch: {shown(str(holder))} is being obeyed, until silent or gone"
    return None


def _your_turn(view: View) -> str:
    if view.turn.kind == "both":
        return "your turn: judge what it did (0 to 9), then play a note"
    if any(exchange.note is not None for exchange in view.exchanges):
        return "your turn: play a note"
    return "your turn: play a note, see what it does, then judge"


def _left(view: View, now_s: float) -> Text:
    """Return the countdown, or that the brain waits."""
    if view.waits:
        return Text(" · it waits for you", QUIET)
    if view.turn.until_s is None:
        return Text()
    left_s = view.turn.until_s - now_s
    if left_s <= 0.0:
        return Text(" · it goes on without you", HURRY)
    return Text(f" · {math.ceil(left_s)} s left, w: wait", HURRY if left_s < HURRY_S else QUIET)


def closing(summary: Summary, name: str, brain: str) -> str:
    """Return what is told to a teacher who leaves: lines that each end."""
    if not summary.commands:
        return f"{name} has left {brain}. No note was played.\n"
    seen = f"{summary.obeyed} of {summary.judged} were obeyed" if summary.judged else "none could be followed"
    rows = [
        ("notes", f"{summary.commands}; {seen}"),
        ("feedback", f"{_count(summary.rewards, 'reward')}, {_count(summary.punishments, 'punishment')}"),
        ("successes", f"{summary.successes} while you were there"),
    ]
    if summary.first is not None and summary.last is not None:
        rows.insert(1, ("obedience", _rise(summary, summary.first, summary.last)))
    lines = "".join(f"  {title:<11}{said}\n" for title, said in rows)
    return f"{name} has left {brain}.\n{lines}The robot goes on with what it has learnt.\n"


def _rise(summary: Summary, first: float, last: float) -> str:
    if summary.judged <= OBEDIENCE_OF:
        return f"{last:.0%} of {_count(summary.judged, 'note')}"
    return f"{first:.0%} of the first {OBEDIENCE_OF} notes, {last:.0%} of the last {OBEDIENCE_OF}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
