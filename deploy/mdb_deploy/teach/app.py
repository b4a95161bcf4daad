"""The terminal of a teacher: keys to a `TeachingSession`, its view to the screen.

The session runs in a thread of its own, so that the screen never waits for Zenoh; keys are passed on at once, the
screen is drawn four times a second at most.
"""

from __future__ import annotations

import asyncio
import threading
import time
from typing import ClassVar

from rich.text import Text
from textual import events
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.screen import ModalScreen
from textual.widget import Widget
from textual.widgets import Static

from mdb_deploy.teach import arena
from mdb_deploy.teach.session import CAPTURES_IN, OBEDIENCE_OF, Latency, TeachingSession, View, meaning, swapped
from mdb_protocol.messages import IterationReport
from mdb_services.service import run
from mdb_sim.teacher import Language, make_language
from mdb_sim.teacher_service import placement_of

NOTE_KEYS = "zxcvbnmasdfg"
"""The key of each note: the lower row as on a piano, then the middle row."""
DIGITS = "0123456789"
FULL = {"+": 1.0, "=": 1.0, "-": -1.0}
"""Full reward and punishment; = is + without shift."""
REFRESH_S, POLL_S = 0.25, 0.05
"""The least time from one drawing to the next, and how often the session is asked for something new."""
STALE_S = 1.0
"""Drawn anew after this, although nothing is new: messages fade."""
NOTICE_S = 4.0
STOP_S = 3.0
"""Bound on the session's own end."""
CELL = 11
"""Columns of a key in the row of notes."""
GOOD, BAD, FAINT, TITLE = "green", "red", "grey50", "bold"
HELP = (
    ("0-9", "-1…+1"), ("+-", "full"), ("space", "silent"), ("p", "pause"), ("l", "language"), ("h", "hint"),
    ("u", "turn"), ("q", "leave"),
)  # fmt: skip
BY = {"taught": "taught, by its teacher", "induced": "induced, by itself"}
"""The paper's two modes in words; another experiment's mode is shown by its name."""


def graded(digit: int) -> float:
    """Return the feedback that a digit stands for: 0 is -1, 9 is +1, each step 2/9."""
    return 2 * digit / 9 - 1


class SessionThread:
    """Runs a session until told to stop; the thread owns the session's bus and closes it."""

    def __init__(self, session: TeachingSession) -> None:
        self.session = session
        self.failure: Exception | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="teaching", daemon=True)

    def start(self) -> None:
        """Begin to be present."""
        self._thread.start()

    def _run(self) -> None:
        try:
            run(self.session, self._stop.is_set)
        except Exception as error:
            self.failure = error

    @property
    def running(self) -> bool:
        """Whether the session goes on."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Leave; returns when presence has ended, or after `STOP_S`."""
        self._stop.set()
        self.session.bus.poke()
        if self._thread.is_alive():
            self._thread.join(STOP_S)


class ArenaPicture(Widget):
    """The arena, as large as there is room for."""

    def __init__(self, session: TeachingSession) -> None:
        super().__init__(id="arena")
        self._session = session
        self._view = session.view
        self._window: arena.Window | None = None
        self.heading_up = False

    def show(self, view: View) -> None:
        """Draw what is new."""
        self._view = view
        self.border_title = _event(view)
        self.refresh()

    def render(self) -> Text:
        """Draw the scene; words as long as there is none."""
        view = self._view
        if view.scene is None:
            return Text("no scene yet", style=FAINT)
        placement = placement_of(view.scene.now)
        self._window = arena.follow(self._window, placement)
        sensed = view.perception if view.perception and view.perception.iteration == view.scene.iteration else None
        reading = sensed.reading if sensed else None
        picture = arena.Picture(placement, view.trail, reading, self.heading_up)
        return arena.draw(picture, self._window, self._session.world, self.size.width, self.size.height)


def _event(view: View) -> str:
    scene = view.scene
    if scene is None:
        return ""
    event = f" [b]{scene.event}![/b] placed anew" if scene.event != "none" else ""
    return f"iteration {scene.iteration}, episode {scene.episode}{event}"


class LanguageScreen(ModalScreen[None]):
    """Which note means what: choose a meaning, press the key of the note that shall say it; the two swap."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "move(-1)"),
        Binding("down", "move(1)"),
        Binding("escape,enter,l,q", "dismiss"),
        Binding("o", "choose('ordered')"),
        Binding("r", "choose('random')"),
    ]

    def __init__(self, session: TeachingSession) -> None:
        super().__init__()
        self._session = session
        self._language = session.view.language
        self._turns = session.world.turns_deg
        self._order = sorted(range(len(self._turns)), key=lambda action: -self._turns[action])
        self._row = 0

    def compose(self) -> ComposeResult:
        """One panel."""
        yield Static(id="language")

    def on_mount(self) -> None:
        """Show the present language."""
        self._draw()

    def _draw(self) -> None:
        text = Text("What your notes mean (the brain never knows)\n\n", style=TITLE)
        for row, command in enumerate(self._order):
            note = self._language.note(command)
            line = f" {meaning(self._turns[command]):<10} key {NOTE_KEYS[note]}   note {note:<2} \n"
            text.append(line, "reverse" if row == self._row else "not bold")
        text.append("\n↑ ↓ choose a meaning, a note key gives it that note;\n", "not bold " + FAINT)
        text.append("o ordered   r at random   enter: back", "not bold " + FAINT)
        self.query_one("#language", Static).update(text)

    def action_move(self, by: int) -> None:
        """Choose another meaning."""
        self._row = (self._row + by) % len(self._order)
        self._draw()

    def action_choose(self, name: str) -> None:
        """Take a whole language."""
        self._speak(make_language(f"random:{time.time_ns()}" if name == "random" else name, self._turns))

    def on_key(self, event: events.Key) -> None:
        """A note key gives its note to the chosen meaning."""
        note = NOTE_KEYS.find(event.character or "?")
        if 0 <= note < len(self._turns):
            event.stop()
            self._speak(swapped(self._language, self._order[self._row], note))

    def _speak(self, language: Language) -> None:
        self._language = language
        self._session.speak(language)
        self._draw()


class TeachApp(App[int]):
    """See the module's docstring; ends with the exit status."""

    ENABLE_COMMAND_PALETTE = False
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (70, "-wide")]  # noqa: RUF012 - so declared by Textual
    VERTICAL_BREAKPOINTS = [(0, "-low"), (22, "-high")]  # noqa: RUF012
    CSS = """
    Screen { layout: vertical; }
    #top, #says, #notes, #help { height: auto; width: 100%; }
    #top, #notes, #help, #panel { text-wrap: nowrap; text-overflow: ellipsis; }
    #says { height: 2; }
    #middle { height: 1fr; layout: horizontal; }
    #arena { width: 1fr; height: 100%; border: round $secondary; }
    #panel { width: 36; height: 100%; padding: 0 0 0 1; }
    .-narrow #middle { layout: vertical; }
    .-narrow #arena { width: 100%; height: 1fr; }
    .-narrow #panel { width: 100%; height: 8; }
    .-narrow.-low #panel { height: 4; }
    .-low #help { display: none; }
    .-low #says { height: 1; }
    LanguageScreen { align: center middle; }
    #language { max-width: 100%; max-height: 100%; }
    #language { width: 58; height: auto; border: round $primary; padding: 0 1; background: $surface; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q,ctrl+c,ctrl+q", "leave", priority=False),
        Binding("p", "pause"),
        Binding("l", "language"),
        Binding("h", "hint"),
        Binding("u", "turn_picture"),
        Binding("space", "silence"),
    ]

    def __init__(self, session: TeachingSession, where: str, *, suggest: bool = False) -> None:
        super().__init__()
        self.session = session
        self.thread = SessionThread(session)
        self._where, self._suggest = where, suggest
        self._shown, self._shown_s = session.view, -STALE_S
        self._notes = len(session.world.turns_deg)

    def compose(self) -> ComposeResult:
        """From top to bottom: who and where, arena and figures, what goes wrong, notes, keys."""
        yield Static(id="top")
        with Vertical(id="middle"):
            yield ArenaPicture(self.session)
            yield Static(id="panel")
        yield Static(id="says")
        yield Static(id="notes")
        yield Static(_help(), id="help")

    def on_mount(self) -> None:
        """Begin to be present, and to draw."""
        self.thread.start()
        self.set_interval(POLL_S, self._poll)

    def _poll(self) -> None:
        """Draw what is new, in time; leave when the session has failed."""
        if not self.thread.running:
            self.exit(1)
        due_s = REFRESH_S if self.session.view is not self._shown else STALE_S
        if time.monotonic() - self._shown_s >= due_s:
            self._draw_view(self.session.view)

    def _draw_view(self, view: View) -> None:
        self._shown, self._shown_s = view, time.monotonic()
        self._show("#top", self._top(view))
        self._show("#panel", panel(view, self.session))
        self._show("#says", self._says(view))
        self._show("#notes", self._note_keys(view))
        for picture in self.screen_stack[0].query(ArenaPicture):
            picture.show(view)

    def _show(self, where: str, text: Text) -> None:
        self.screen_stack[0].query_one(where, Static).update(text)

    def _top(self, view: View) -> Text:
        connected = Text("connected", GOOD) if view.trouble is None else Text("not heard", BAD)
        state = " · the experiment is over" if view.finished else " · pause: silent" * view.paused
        return Text.assemble(
            (self.session.instance, TITLE), " teaches ", (self.session.bus.brain, TITLE), f" at {self._where} · ",
            connected, (state, "yellow"), no_wrap=True, overflow="ellipsis",
        )  # fmt: skip

    def _says(self, view: View) -> Text:
        if view.trouble is not None:
            return Text(view.trouble, f"bold {BAD}")
        if view.notice is not None and time.monotonic() - view.noticed_s < NOTICE_S:
            return Text(view.notice, "yellow")
        if self._suggest and view.wanted is not None:
            note = view.language.note(view.wanted)
            turn = meaning(self.session.world.turns_deg[view.wanted])
            return Text(f"to face the object: {turn}, your key {NOTE_KEYS[note]}", GOOD)
        return Text()

    def _note_keys(self, view: View) -> Text:
        text = Text(no_wrap=True)
        last = next((e.note for e in view.exchanges if e.spoke), None)
        wanted = view.language.note(view.wanted) if self._suggest and view.wanted is not None else None
        a_row = max(1, self.size.width // CELL)
        for note in range(self._notes):
            turn = meaning(self.session.world.turns_deg[view.language.command(note)])
            style = "reverse" if note == last else GOOD if note == wanted else ""
            text.append(NOTE_KEYS[note], f"bold {style}").append(f" {turn}".ljust(CELL - 1)[: CELL - 1], style)
            if (note + 1) % a_row == 0 and note + 1 < self._notes:
                text.append("\n")
        return text

    def on_key(self, event: events.Key) -> None:
        """Notes, and feedback for the action that is on the screen."""
        character = event.character or "?"
        if 0 <= (note := NOTE_KEYS.find(character)) < self._notes:
            self.session.command(note)
        elif character in DIGITS:
            self._judge(graded(int(character)))
        elif character in FULL:
            self._judge(FULL[character])

    def _judge(self, value: float) -> None:
        scene = self._shown.scene
        self.session.feedback(value, scene.iteration - 1 if scene else -1)

    def action_silence(self) -> None:
        """Say nothing, and say so."""
        self.session.command(None)

    def action_pause(self) -> None:
        """Stay, but silent; or go on."""
        self.session.pause()

    def action_hint(self) -> None:
        """Show which command would be right, or hide it."""
        self._suggest = not self._suggest

    def action_turn_picture(self) -> None:
        """Turn the picture with the robot, or with the arena."""
        picture = self.query_one(ArenaPicture)
        picture.heading_up = not picture.heading_up

    def action_language(self) -> None:
        """Look at what the notes mean, and change it."""
        self.push_screen(LanguageScreen(self.session))

    async def action_leave(self) -> None:
        """End presence, then the screen."""
        await asyncio.to_thread(self.thread.stop)
        self.exit(0)


def _help() -> Text:
    text = Text(no_wrap=True, overflow="ellipsis")
    for key, what in HELP:
        text.append(key, TITLE).append(f" {what}  ", FAINT)
    return text


def panel(view: View, session: TeachingSession) -> Text:
    """Return the figures, the most important first, then the last iterations."""
    report, scene = view.report, view.scene
    rows = [
        ("acts", _acting(report)),
        ("word", _word(view, session.instance)),
        ("captures", f"{view.captures}" + _per(view.captures_per_100)),
        ("obeys", "-" if view.obedience is None else f"{view.obedience:.0%} of {view.judged} (last {OBEDIENCE_OF})"),
    ]
    rows += [
        ("error" if i == 0 else "", f"{name} {mean:.3f}")
        for i, (name, mean) in enumerate(sorted(view.errors.items()))
    ]
    rows += _latency(view.latency)
    text = Text(no_wrap=True, overflow="ellipsis")
    for name, said in rows:
        text.append(f"{name:<9}", TITLE).append(f"{said}\n")
    text.append(f"\n{'iter.':>6} {'meant':<9}{'did':<9}reward\n", FAINT)
    return text.append_text(_history(view, session)) if scene else text


def _per(rate: float | None) -> str:
    return "" if rate is None else f", {rate:.1f} in {CAPTURES_IN}"


def _word(view: View, name: str) -> str:
    holder = view.report.holder if view.report else None
    others = f" (also here: {', '.join(view.others)})" if view.others else ""
    return ("-" if holder is None else "you" if holder == name else holder) + others


def _acting(report: IterationReport | None) -> str:
    if report is None:
        return "-"
    return f"{report.mode}, exploring" if report.explored else BY.get(report.mode, report.mode)


def _latency(latency: Latency) -> list[tuple[str, str]]:
    """From a command to the sight of its action and to its report; the brain's part of it."""
    seen, back = _ms(latency.to_action_s), _ms(latency.to_report_s)
    own = _ms(latency.perception_to_action_s)
    return [("ms until", f"action {seen}, report {back}"), ("", f"brain's own {own}")]


def _ms(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1000 * seconds:.0f}"


def _history(view: View, session: TeachingSession) -> Text:
    turns = session.world.turns_deg
    text = Text()
    for exchange in view.exchanges:
        known = [index is not None and index < len(turns) for index in (exchange.command, exchange.action)]
        key = "·" if exchange.note is None else NOTE_KEYS[exchange.note]
        meant = meaning(turns[exchange.command or 0]) if known[0] else "-"
        did = meaning(turns[exchange.action or 0]) if known[1] else "…"
        style = "" if not (known[0] and known[1]) else GOOD if exchange.command == exchange.action else BAD
        text.append(f"{exchange.iteration:>4} {key} {meant:<9}").append(f"{did:<9}", style)
        if exchange.heard is False:
            text.append("not heard\n", BAD)
        else:
            text.append("\n" if exchange.feedback is None else f"{exchange.feedback:+.2f}\n")
    return text
