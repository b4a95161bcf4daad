"""The command line `mdb`: see `mdb --help`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import MutableMapping
from functools import cache
from typing import Any

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
    web,
)
from mdb_deploy.cli.failing import let_go, told, unbreakable
from mdb_deploy.cli.parsing import Parser, Version
from mdb_protocol.words import shown

DESCRIPTION = """\
A robot learns from a teacher, and goes on alone when the teacher has left: the Multilevel Darwinist Brain.

first steps:
  mdb up                    the demonstration, two minutes: two teachers, and the robot alone after each
  mdb up --web              the same in your browser, where you can teach it, too
  mdb up --no-teacher       you teach it; in another terminal: mdb teach
  mdb up paper              the experiment of the paper
  mdb init my-robot         an experiment of your own, to begin with; then: mdb up my-robot
  mdb plot RUN              the figures of a run again
"""
EPILOG = """\
more of 'mdb up':
  mdb up --inline                         in one process, without a router
  mdb up paper --pace lockstep --seed 3   repeatable: one seed, one run, value by value
  mdb up my.toml --set evolution.population=400 --set robot.body=kinematic

'mdb COMMAND --help' tells the options of a command; deploy/README.md tells more.
"""
ORDER = (up, web, teach, init, plot, status, change, past, ltm, study, keys, check_robot, chaos, check, run)
"""The commands, as `mdb --help` lists them."""


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    arguments, stdout = argparse.Namespace(), sys.stdout
    try:
        arguments = _arguments(argv)
        _begin_log()
        if getattr(arguments, "goes_on", False):
            sys.stdout = unbreakable(stdout)
        status: int = arguments.command(arguments)
        sys.stdout.flush()
    except (Exception, KeyboardInterrupt) as error:
        return told(error, getattr(arguments, "extra", "brain"))
    finally:
        sys.stdout = stdout
        let_go(stdout)
    return status


def _begin_log() -> None:
    import structlog

    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger("info"),
        logger_factory=structlog.PrintLoggerFactory(unbreakable(sys.stderr)),
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


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = _parser()
    parser.check_first(sys.argv[1:] if argv is None else argv)
    arguments, words = parser.parse_known_args(argv)
    if words and not getattr(arguments, "takes_words", False):
        arguments.parser.refuse(words)
    arguments.words = words
    return arguments


def _words_shown(_: object, __: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """Let nothing in the log be more than words: a reason may be quoted from a message or a file."""
    return {name: shown(value, lines=True) if isinstance(value, str) else value for name, value in event.items()}


@cache
def _parser() -> Parser:
    """Return what knows all commands: made once, for who is a fork of `mdb up` has it in memory already."""
    parser = Parser(
        prog="mdb",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=Version)
    commands = parser.add_subparsers(required=True, metavar="COMMAND", title="commands")
    for command in ORDER:
        command.add(commands)
    return parser
