"""The screen on which a teacher sees and changes what the notes mean."""

from __future__ import annotations

import time

from rich.text import Text
from textual import events
from textual.app import ComposeResult
from textual.screen import ModalScreen
from textual.widgets import Static

from mdb_deploy.teach.keyboard import NOTE_KEYS
from mdb_deploy.teach.session import TeachingSession
from mdb_deploy.teach.view import swapped
from mdb_sim.teaching.languages import Language, make_language

TITLE, FAINT = "bold", "not bold grey50"
MOVES = {"up": -1, "down": 1}
LEAVING = ("escape", "enter", "l", "q")
WHOLE = {"o": "ordered", "r": "random"}
"""The keys of a whole language."""


class LanguageScreen(ModalScreen[None]):
    """Which note means what: choose a meaning, press the key of the note that shall say it; the two swap."""

    def __init__(self, session: TeachingSession) -> None:
        super().__init__()
        self._session = session
        self._language = session.view.language
        self._policy = session.policy
        self._order = sorted(range(len(self._policy.commands)), key=lambda command: -self._policy.order[command])
        self._row = 0

    def compose(self) -> ComposeResult:
        """One panel."""
        yield Static(id="language")

    def on_mount(self) -> None:
        """Show the present language."""
        self._draw()

    def _draw(self) -> None:
        text = Text("What your notes mean (the brain is not told)\n\n", style=TITLE)
        for row, command in enumerate(self._order):
            note = self._language.note(command)
            line = f" {self._policy.commands[command]:<10} key {NOTE_KEYS[note]}   note {note:<2} \n"
            text.append(line, "reverse" if row == self._row else "not bold")
        text.append("\n↑ ↓ choose a meaning, a note key gives it that note;\n", FAINT)
        text.append("o ordered   r at random   enter: back", FAINT)
        self.query_one("#language", Static).update(text)

    def on_key(self, event: events.Key) -> None:
        """A note key gives its note to the chosen meaning; no key of letters or digits goes on to the lesson below.

        Every key is dealt with here: an action of a binding would come after the next key of several typed at once.
        """
        character = event.character or "?"
        if event.key in MOVES:
            self._row = (self._row + MOVES[event.key]) % len(self._order)
            self._draw()
        elif event.key in LEAVING:
            self.dismiss()
        elif character in WHOLE:
            name = WHOLE[character]
            self._speak(make_language(f"random:{time.time_ns()}" if name == "random" else name, self._policy.order))
        elif 0 <= (note := NOTE_KEYS.find(character)) < len(self._order):
            self._speak(swapped(self._language, self._order[self._row], note))
        if event.is_printable:
            event.stop()

    def _speak(self, language: Language) -> None:
        self._language = language
        self._session.speak(language)
        self._draw()
