"""Words that others chose, on their way to a terminal, a log or a page: shown as what they are, and nothing else.

Names, statuses, messages, paths: whoever wrote them may have written control characters, which a terminal obeys,
marks that turn the direction of writing, or a megabyte. `shown` is for all of them. Markup is no business of this
module: what prints with markup is to be told not to.
"""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable

MOST = 4096
"""Characters that are shown of one text."""
HIDDEN = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
"""Unicode's categories of what is not seen on the screen: control, format, half a pair, private, none, breaks."""
MOST_MARKS = 4
"""Accents on one letter: more would cover the lines above."""


def shown(text: object, most: int = MOST, *, lines: bool = False) -> str:
    """Return a text with everything in it that is not to be seen written out, as \\x1b, and its end cut off.

    `lines`: line breaks stay, as in a message of several lines.
    """
    whole = str(text)
    cut = whole[:most]
    if cut.isascii() and cut.isprintable():
        found = cut
    else:
        found = "".join(_written(letter, lines) for letter in _without_heaps(cut))
    return found if len(whole) <= most else f"{found}... ({len(whole) - most} more characters)"


def close_to(word: str, known: Iterable[str]) -> str | None:
    """Return the word that may have been meant by one that is not known, also in other capitals; None if none is."""
    by_small = {name.lower(): name for name in known}
    close = difflib.get_close_matches(word.lower(), by_small, 1)
    return by_small[close[0]] if close else None


def _written(letter: str, lines: bool) -> str:
    if lines and letter in "\n\t":
        return letter
    if unicodedata.category(letter) not in HIDDEN:
        return letter
    return letter.encode("unicode_escape").decode("ascii")


def _without_heaps(text: str) -> str:
    """Return a text without more accents on one letter than any language has."""
    found, marks = [], 0
    for letter in text:
        marks = marks + 1 if unicodedata.category(letter) in ("Mn", "Me") else 0
        if marks <= MOST_MARKS:
            found.append(letter)
    return "".join(found)
