"""The command line `mdb`: see `mdb --help`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import MutableMapping
from contextlib import suppress
from typing import Any, TextIO, cast

import structlog

from mdb_deploy.cli import (
    change,
    chaos,
    check,
    check_robot,
    init,
    keys,
    ltm,
    past,
    plot,
    run,
    status,
    study,
    teach,
    up,
)
from mdb_protocol.errors import MdbError
from mdb_protocol.words import shown

EPILOG = """\
first steps:
  mdb up                                  the paper's experiment, in processes over Zenoh, with figures
  mdb up --pace lockstep --seed 3         the same, repeatable value by value
  mdb up --inline --iterations 600        in one process, without a router
  mdb up my.toml --set evolution.population=400 --set robot.body=kinematic
  mdb init my-robot --like gymnasium:CartPole-v1, then mdb up my-robot: a robot of your own
  mdb up --no-teacher                     you teach, with 'mdb teach' in another terminal
  mdb status                              who is alive, and how each process does
  mdb plot RUN                            the figures again, from the run's log alone
"""
ORDER = (up, init, teach, change, status, plot, study, ltm, past, keys, check_robot, chaos, check, run)
"""The commands, as `mdb --help` lists them."""


class Unbreakable:
    """A stream that loses what cannot be written: no service is to fail because its log is on a full disk."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write, if that is possible."""
        with suppress(OSError, ValueError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, if that is possible."""
        with suppress(OSError, ValueError):
            self._stream.flush()


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = _parser()
    arguments, words = parser.parse_known_args(argv)
    if words and not getattr(arguments, "takes_words", False):
        parser.error(f"unrecognized arguments: {' '.join(words)}")
    arguments.words = words
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger("info"),
        logger_factory=structlog.PrintLoggerFactory(cast(TextIO, Unbreakable(sys.stderr))),
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="%H:%M:%S.%f", utc=False),
            structlog.processors.format_exc_info,
            _words_shown,
            structlog.dev.ConsoleRenderer(
                colors=sys.stderr.isatty(), exception_formatter=structlog.dev.plain_traceback
            ),
        ],
    )
    try:
        status: int = arguments.command(arguments)
    except MdbError as error:
        sys.stderr.write(f"mdb: {shown(error, lines=True)}\n")
        return 2
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("mdb_"):
            raise
        extra = getattr(arguments, "extra", "brain")
        wanted = f"pip install 'multilevel-darwinist-brain[{extra}]'"
        sys.stderr.write(f"mdb: this needs {error.name}, which is not installed: {wanted}\n")
        return 2
    except OSError as error:
        if error.filename is None:
            raise
        path = shown(error.filename)
        sys.stderr.write(f"mdb: {path}: {error.strerror}; give a path that can be read and written\n")
        return 2
    except KeyboardInterrupt:
        return 130
    return status


def _words_shown(_: object, __: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """Let nothing in the log be more than words: a reason may be quoted from a message or a file."""
    return {name: shown(value, lines=True) if isinstance(value, str) else value for name, value in event.items()}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="mdb",
        description="A robot learns from a teacher: the Multilevel Darwinist Brain over Eclipse Zenoh.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in ORDER:
        command.add(commands)
    return parser
