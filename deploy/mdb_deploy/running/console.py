"""The console on which a command writes: words are words in it, and no markup, whoever chose them."""

from __future__ import annotations

from typing import TextIO

from rich.console import Console
from rich.text import Text

from mdb_protocol.words import shown

NARROWEST = 40
"""Columns at the least: with COLUMNS=1 of a shell without a screen each letter would have its line."""


def console_of(stream: TextIO) -> Console:
    """Return a console that takes what it is given as it is: `[red]` and `:smile:` are written so."""
    console = Console(file=stream, markup=False, emoji=False)
    if console.width < NARROWEST:  # noqa: PLR1730 - a width that is set does not follow the window
        console.width = NARROWEST
    return console


def plain(text: object) -> Text:
    """Return words as a part of a table or a display, where a console's own setting does not count."""
    return Text(shown(text, lines=True))
