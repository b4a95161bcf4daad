"""The words and figures around the picture: pure functions from a view to text. `meant`: what each command
means, in words.
"""

from __future__ import annotations

from collections.abc import Sequence

from rich.text import Text

from mdb_deploy.teach.keyboard import HELP, NOTE_KEYS
from mdb_deploy.teach.record import OBEDIENCE_OF, SUCCESSES_IN
from mdb_deploy.teach.view import Exchange, Latency, View
from mdb_protocol.messages import IterationReport
from mdb_protocol.words import shown

CELL = 11
"""Columns of a key in the rows of notes."""
NOTICE_S = 4.0
"""A notice is shown so long."""
GOOD, BAD, WARN, FAINT, TITLE = "green", "red", "yellow", "grey50", "bold"
BY = {"taught": "as its teacher says", "induced": "alone, as it has learnt"}
"""The paper's two modes in words; another experiment's mode is shown by its name."""


def top(view: View, name: str, brain: str, where: str) -> Text:
    """Return who teaches whom, and whether he is heard."""
    heard = ("connected", GOOD) if view.trouble is None else ("not heard", BAD)
    state = " · the experiment is over" if view.finished else " · pause: silent" if view.paused else ""
    return Text.assemble((name, TITLE), " teaches ", (brain, TITLE), f" at {where} · ", heard, (state, WARN))


def says(view: View, meant: Sequence[str], now_s: float, *, suggest: bool) -> Text:
    """Return what is most urgent to say: trouble, a notice, which command would be right."""
    if view.trouble is not None:
        return Text(shown(view.trouble), f"bold {BAD}")
    if view.notice is not None and now_s - view.noticed_s < NOTICE_S:
        return Text(shown(view.notice), WARN)
    if suggest and view.wanted is not None:
        key = NOTE_KEYS[view.language.note(view.wanted)]
        return Text(f"hint: {meant[view.wanted]} would be right; your key is {key} (h: no hint)", GOOD)
    return Text()


def note_keys(view: View, meant: Sequence[str], columns: int, *, suggest: bool) -> Text:
    """Return each note's key and what it means, in as many rows as are needed; the last note said is reversed."""
    last = next((exchange.note for exchange in view.exchanges if exchange.spoke), None)
    wanted = view.language.note(view.wanted) if suggest and view.wanted is not None else None
    in_a_row = max(1, columns // CELL)
    text = Text()
    for note in range(len(meant)):
        command = meant[view.language.command(note)]
        style = "reverse" if note == last else GOOD if note == wanted else ""
        text.append("\n" if note and note % in_a_row == 0 else "")
        text.append(NOTE_KEYS[note], f"{TITLE} {style}").append(f" {command}".ljust(CELL - 1)[: CELL - 1], style)
    return text


def help_line() -> Text:
    """Return the other keys."""
    text = Text()
    for key, what in HELP:
        text.append("  " if text else "").append(key, TITLE).append(f" {what}", FAINT)
    return text


def panel(view: View, name: str, meant: Sequence[str]) -> Text:
    """Return the figures, the most important first, then the last iterations, the newest first."""
    judged = f"{view.obedience:.0%} of {view.judged} (last {OBEDIENCE_OF})" if view.obedience is not None else "-"
    rate = f", {view.successes_per_100:.1f} in {SUCCESSES_IN}" if view.successes_per_100 is not None else ""
    rows = [
        ("acts", _acting(view.report)),
        ("teacher", _teacher(view, name)),
        ("successes", f"{view.successes}{rate}"),
        ("obedience", judged),
        *_errors(view.errors),
        *_latency(view.latency),
    ]
    text = Text()
    for title, said in rows:
        text.append(f"{title:<10}", TITLE).append(f"{said}\n")
    text.append(f"\n{'iter.':>6} {'meant':<9}{'did':<9}reward\n", FAINT)
    for exchange in view.exchanges:
        text.append_text(_exchange(exchange, meant))
    return text


def _acting(report: IterationReport | None) -> str:
    if report is None:
        return "-"
    return "exploring" if report.explored else BY.get(report.mode, report.mode)


def _teacher(view: View, name: str) -> str:
    """Who is being obeyed, and who else is there."""
    holder = view.report.holder if view.report else None
    others = f" (also here: {', '.join(view.others)})" if view.others else ""
    return ("-" if holder is None else "you" if holder == name else holder) + others


def _errors(errors: dict[str, float]) -> list[tuple[str, str]]:
    lines = [f"{model} {error:.3f}" for model, error in sorted(errors.items())]
    return list(zip(["error", *[""] * len(lines)], lines, strict=False))


def _latency(latency: Latency) -> list[tuple[str, str]]:
    """From a command to the sight of its action and to its report; the brain's part of it."""
    seen, back, own = map(_ms, (latency.to_action_s, latency.to_report_s, latency.perception_to_action_s))
    return [("delay, ms", f"action {seen}, report {back}"), ("", f"the brain's {own}")]


def _ms(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1000 * seconds:.0f}"


def _exchange(exchange: Exchange, meant: Sequence[str]) -> Text:
    """Return one line: iteration, key, what was meant, what the robot did, feedback."""
    key = "·" if exchange.note is None else NOTE_KEYS[exchange.note]
    said = "-" if exchange.command is None else meant[exchange.command]
    did = "…" if exchange.did is None else meant[exchange.did]
    style = "" if exchange.obeyed is None else GOOD if exchange.obeyed else BAD
    text = Text(f"{exchange.iteration:>4} {key} {said:<9.9}").append(f"{did:<9.9}", style)
    if exchange.heard is False:
        return text.append("not heard\n", BAD)
    return text.append("\n" if exchange.feedback is None else f"{exchange.feedback:+.2f}\n")
