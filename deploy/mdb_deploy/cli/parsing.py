"""How `mdb` reads its words: a parser that says a mistake in one line, with the nearest word that there is."""

from __future__ import annotations

import argparse
import platform
import re
import sys
from typing import TYPE_CHECKING, Any, NoReturn

from mdb_protocol.words import close_to

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

DISTRIBUTION = "multilevel-darwinist-brain"
MISTYPED = re.compile(r"invalid choice: '([^']*)'")
LISTED = re.compile(r" \(choose from .*\)$", re.DOTALL)


class Parser(argparse.ArgumentParser):
    """An argparse parser with suggestions, which argparse itself has from Python 3.14 on."""

    def __init__(self, *words: Any, **settings: Any) -> None:
        super().__init__(*words, **settings | {"allow_abbrev": False})
        self.set_defaults(parser=self)

    def error(self, message: str) -> NoReturn:
        """Say what is wrong in one line, and end."""
        found = MISTYPED.search(message)
        if found is not None:
            choices = [str(choice) for action in self._actions for choice in action.choices or ()]
            close = nearest(found[1], choices)
            message = LISTED.sub("", message) + (close or f"; there are {', '.join(choices)}")
        self.exit(2, f"{self.prog}: {message}; see '{self.prog} --help'\n")

    def _print_message(self, message: str, file: SupportsWrite[str] | None = None) -> None:
        """Print; argparse itself says nothing when help or version cannot be written."""
        if file is sys.stdout:
            print(message, end="", file=file, flush=True)
        else:
            super()._print_message(message, file)

    def check_first(self, words: list[str]) -> None:
        """Refuse an option before the command that is none; argparse would say that the command is missing."""
        known = [option for action in self._actions for option in action.option_strings]
        if words and words[0].startswith("-") and words[0] not in known:
            self.refuse(words[:1])

    def refuse(self, words: list[str]) -> NoReturn:
        """Say that there are no such options, or that the words are too many."""
        options = [option for action in self._actions for option in action.option_strings]
        told = [f"{word}{nearest(word.partition('=')[0], options)}" for word in words]
        self.error(f"no such option or too many words: {', '.join(told)}")


class Version(argparse.Action):
    """Say the version, and end; argparse's own wants to know it each time, which takes 2 MB of each process."""

    def __init__(self, option_strings: list[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="show program's version number and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        """See `argparse.Action`."""
        python = f"Python {platform.python_version()}, {sys.executable}"
        parser._print_message(f"mdb {own_version()} ({python})\n", sys.stdout)
        parser.exit()


def nearest(word: str, known: list[str]) -> str:
    """Return what to add to an error about a word: the nearest that is known, if one is near."""
    close = close_to(word, known)
    return f"; did you mean {close}?" if close else ""


def own_version() -> str:
    """Return the version of this project that is installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(DISTRIBUTION)
    except PackageNotFoundError:
        return "(not installed)"
