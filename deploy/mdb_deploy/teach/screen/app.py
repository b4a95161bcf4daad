"""The terminal of a teacher: keys to a `TeachingSession`, its view to the screen.

The session runs in a thread of its own, so that the screen never waits for Zenoh; keys are passed on at once, the
screen is drawn four times a second at most.
"""

from __future__ import annotations

import asyncio
import time
from typing import ClassVar

from rich.text import Text
from textual import events
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.widget import Widget
from textual.widgets import Static

from mdb_deploy.teach.keyboard import DIGITS, FULL, NOTE_KEYS, graded
from mdb_deploy.teach.screen import panel, picture, turn
from mdb_deploy.teach.screen.canvas import Window
from mdb_deploy.teach.screen.language import LanguageScreen
from mdb_deploy.teach.session import TeachingSession
from mdb_deploy.teach.thread import SessionThread
from mdb_deploy.teach.view import View

REFRESH_S, POLL_S = 0.25, 0.05
"""The least time from one drawing to the next, and how often the session is asked for something new."""
STALE_S = 1.0
"""Drawn anew after this, although nothing is new: messages fade."""


class ScenePicture(Widget):
    """The scene, as large as there is room for: a drawing, an image, or numbers, as the robot shows it."""

    def __init__(self, session: TeachingSession) -> None:
        super().__init__(id="scene")
        self._view = session.view
        self._window: Window | None = None
        self.front_up = False

    def show(self, view: View) -> None:
        """Draw what is new."""
        self._view = view
        self.border_title = _event(view)
        self.refresh()

    def render(self) -> Text:
        """Draw the scene; words as long as there is none."""
        view, columns, rows = self._view, self.size.width, self.size.height
        if view.scene is None:
            return Text("no scene yet", panel.FAINT)
        if view.picture is not None and view.picture.drawing is not None:
            drawing = view.picture.drawing
            self._window = picture.follow(self._window, drawing)
            return picture.draw(drawing, self._window, columns, rows, front_up=self.front_up)
        if view.picture is not None and view.picture.image is not None:
            return picture.show_image(view.picture.image, columns, rows)
        perceived = view.perception.reading if view.perception else None
        return picture.show_numbers(view.scene.now, perceived, rows)


def _event(view: View) -> str:
    scene = view.scene
    if scene is None:
        return ""
    event = f" [b]{scene.event}![/b]" if scene.event != "none" else ""
    return f"iteration {scene.iteration}, episode {scene.episode}{event}"


class TeachApp(App[int]):
    """See the module's docstring; ends with the exit status."""

    ENABLE_COMMAND_PALETTE = False
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (70, "-wide")]  # noqa: RUF012 - so declared by Textual
    VERTICAL_BREAKPOINTS = [(0, "-low"), (22, "-high")]  # noqa: RUF012
    CSS = """
    Screen { layout: vertical; }
    #top, #turn, #says, #notes, #help { height: auto; width: 100%; }
    #top, #turn, #notes, #help, #panel { text-wrap: nowrap; text-overflow: ellipsis; }
    #turn { height: 1; }
    #says { height: 2; }
    #middle { height: 1fr; layout: horizontal; }
    #scene { width: 1fr; height: 100%; border: round $secondary; }
    #panel { width: 36; height: 100%; padding: 0 0 0 1; }
    .-narrow #middle { layout: vertical; }
    .-narrow #scene { width: 100%; height: 1fr; }
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
        Binding("w", "wait"),
        Binding("l", "language"),
        Binding("h", "hint"),
        Binding("u", "turn_picture"),
        Binding("space", "silence"),
    ]

    def __init__(self, session: TeachingSession, where: str, *, suggest: bool = True) -> None:
        """`where`: the router's endpoint, to be shown; `suggest`: begin with the hint on."""
        super().__init__()
        self.session = session
        self.thread = SessionThread(session)
        self._where, self._suggest = where, suggest
        self._shown, self._shown_s = session.view, -STALE_S

    def compose(self) -> ComposeResult:
        """From top to bottom: who and where, scene and figures, whose turn it is, what goes wrong, notes, keys."""
        yield Static(id="top")
        with Vertical(id="middle"):
            yield ScenePicture(self.session)
            yield Static(id="panel")
        yield Static(id="turn")
        yield Static(id="says")
        yield Static(id="notes")
        yield Static(panel.help_line(), id="help")

    def on_mount(self) -> None:
        """Begin to be present, and to draw."""
        self.thread.start()
        self.set_interval(POLL_S, self._poll)

    def _poll(self) -> None:
        """Draw what is new, in time; leave when the session has failed."""
        if self.thread.failure is not None:
            self.exit(1)
        due_s = REFRESH_S if self.session.view is not self._shown else STALE_S
        if time.monotonic() - self._shown_s >= due_s:
            self._draw_view(self.session.view)

    def _draw_view(self, view: View) -> None:
        self._shown, self._shown_s = view, time.monotonic()
        session, suggest, meant = self.session, self._suggest, self.session.policy.commands
        self._show("#top", panel.top(view, session.instance, session.bus.brain, self._where))
        self._show("#panel", panel.panel(view, session.instance, meant))
        self._show("#turn", turn.turn(view, session.instance, self._shown_s))
        self._show("#says", panel.says(view, meant, self._shown_s, suggest=suggest))
        self._show("#notes", panel.note_keys(view, meant, self.size.width, suggest=suggest))
        self.screen_stack[0].query_one(ScenePicture).show(view)

    def _show(self, where: str, text: Text) -> None:
        """Change a part of the main screen, which may lie below another."""
        self.screen_stack[0].query_one(where, Static).update(text)

    def on_key(self, event: events.Key) -> None:
        """Notes, and feedback for the action that is on the screen."""
        character = event.character or "?"
        if 0 <= (note := NOTE_KEYS.find(character)) < len(self.session.policy.commands):
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

    def action_wait(self) -> None:
        """Ask the brain to wait for what is said here, or no longer."""
        self.session.wait_for_me(not self.session.view.waits)

    def action_hint(self) -> None:
        """Show which command would be right, or hide it."""
        self._suggest = not self._suggest

    def action_turn_picture(self) -> None:
        """Turn the picture with the robot, or with the scene."""
        scene = self.query_one(ScenePicture)
        scene.front_up = not scene.front_up

    def action_language(self) -> None:
        """Look at what the notes mean, and change it."""
        self.push_screen(LanguageScreen(self.session))

    async def action_leave(self) -> None:
        """End presence, then the screen."""
        await asyncio.to_thread(self.thread.stop)
        self.exit(0)
