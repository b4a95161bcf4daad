"""`mdb teach` from its options to its end: joins the brain, keeps the log off the screen, leaves cleanly."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
from collections import deque
from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog

from mdb_deploy.shipped import shipped
from mdb_deploy.teach.keyboard import NOTE_KEYS
from mdb_deploy.teach.microphone import Microphone
from mdb_deploy.teach.screen.app import TeachApp
from mdb_deploy.teach.screen.turn import closing
from mdb_deploy.teach.session import TeachingSession
from mdb_protocol.bundle import Bundle
from mdb_protocol.errors import ConfigError, MdbError
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.experiment.reading import convert, read_file
from mdb_services.experiment.sections import EarSection, OptimizerSection
from mdb_sim.teaching.languages import Language, TeacherError, make_language
from mdb_sim.teaching.policies.pioneer import Reach
from mdb_sim.teaching.policies.plain import Named
from mdb_sim.teaching.policy import Policy, make_policy
from mdb_sim.teaching.service import ROLE
from mdb_sim.teaching.sound import Player, SoundSection

BRAIN, NAME = "pioneer", "teacher"
ENDED_BY_SIGNAL = 130
SCRIPT = shipped("examples/teacher.py")
LOG_KEPT = 20
"""Lines of the log that are written once the screen is given back."""


@dataclass(frozen=True)
class TeachOptions:
    """What the command line says of a teacher."""

    connect: str
    brain: str | None
    name: str | None
    """None for both: as the keys say, or else `BRAIN` and `NAME`."""
    language: str
    keys: Path | None = None
    experiment: Path | None = None
    suggest: bool = True
    """Whether the hint is on at first."""
    auto: bool = False
    sound: str | None = None
    """An instrument that plays the notes."""
    microphone: bool = False


def teach(options: TeachOptions) -> int:
    """Teach until the person leaves; return the exit status. MdbError when that cannot be, or failed."""
    source = options.experiment
    content = read_file(source) if source is not None else {}
    policy = policy_of(content, source)
    player = player_of(options.sound, content, source, len(policy.commands)) if options.sound else None
    language = language_of(options.language, policy)
    brain, name = who(options)
    sys.stderr.write(f"joining {brain} at {options.connect} as {name}\n")
    kept = keep_log()
    with ZenohBus(brain, options.connect, credentials=options.keys) as bus:
        if f"{ROLE}/{name}" in bus.alive():
            raise MdbError(f"somebody teaches {brain} as {name} already; choose another --name")
        session = TeachingSession(
            bus,
            name,
            language,
            policy,
            auto=options.auto,
            player=player,
            listens=options.microphone,
            patience_s=patience_of(content, source),
        )
        if not (sys.stdin.isatty() and sys.stderr.isatty()):
            raise MdbError(
                f"'mdb teach' needs a terminal, to be read from and drawn on; {SCRIPT} teaches without one"
            )
        app = TeachApp(session, options.connect, suggest=options.suggest)
        microphone = Microphone()
        if options.microphone:
            microphone.start(session.microphone)
        try:
            status = asyncio.run(_until_left(app))
        finally:
            microphone.stop()
    with contextlib.suppress(OSError):  # the terminal may be gone
        sys.stdout.write(closing(session.view.summary, name, brain))
        sys.stdout.flush()
    sys.stderr.writelines(f"{line}\n" for line in kept)
    if app.thread.failure is not None:
        raise MdbError(f"teaching ended: {app.thread.failure}") from app.thread.failure
    return status


def who(options: TeachOptions) -> tuple[str, str]:
    """Return the brain and the teacher's name: as the options say, or the keys, or else as they mostly are."""
    user = Bundle.read(options.keys).user if options.keys is not None and options.keys.is_file() else None
    return options.brain or (user.brain if user else BRAIN), options.name or (user.name if user else NAME)


async def _until_left(app: TeachApp) -> int:
    """Run the screen; a signal ends it as `q` does, so that the terminal is restored and presence withdrawn."""
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, app.exit, ENDED_BY_SIGNAL)
    try:
        status = await app.run_async()
    finally:
        app.thread.stop()
    return app.return_code or 0 if status is None else status


def policy_of(content: Mapping[str, Any], source: Path | None) -> Policy:
    """Return what can be wanted of a robot, by its experiment file's content; ConfigError when it cannot be taught.

    By the file's teacher, or else one command a choice. Without a file: what the paper's teacher wants.
    """
    section = content.get("teacher", {})
    choices = [str(choice.get("name")) for choice in content.get("choice", [])]
    if source is None:
        return Reach()
    try:
        if "policy" in section or not choices:
            policy = make_policy(section.get("policy", "reach"), section.get("options", {}), source.resolve().parent)
        else:
            policy = Named(choices)
    except TeacherError as error:
        raise ConfigError(f"{source}: teacher: {error}") from error
    if len(policy.commands) > len(NOTE_KEYS):
        raise ConfigError(f"{source}: {len(policy.commands)} commands; there are keys for {len(NOTE_KEYS)}")
    return policy


def patience_of(content: Mapping[str, Any], source: Path | None) -> tuple[float, float] | None:
    """Return how long the brain waits for a note and for feedback, in seconds, by its file; None without a file."""
    if source is None:
        return None
    section = convert(content.get("optimizer", {}), OptimizerSection, source)
    return section.command_patience_s, section.feedback_patience_s


def player_of(instrument: str, content: Mapping[str, Any], source: Path | None, notes: int) -> Player:
    """Return who plays the notes in the scale of the file's `[ear]`; ConfigError when that cannot be."""
    ear = convert(content.get("ear", {}), EarSection, source)
    if len(ear.notes_hz) != notes:
        raise ConfigError(f"{source}: ear.notes_hz has {len(ear.notes_hz)} notes; expected {notes}, one a command")
    return Player(convert({"instrument": instrument}, SoundSection, "--sound"), ear.notes_hz, seed=0)


def language_of(name: str, policy: Policy) -> Language:
    """Return the language of this name for these commands; ConfigError when there is none."""
    try:
        return make_language(name, policy.order)
    except TeacherError as error:
        raise ConfigError(f"--language: {error}") from error


def keep_log() -> deque[str]:
    """Keep the last warnings in a list that fills from now on: a line on the terminal would spoil the screen."""
    kept: deque[str] = deque(maxlen=LOG_KEPT)

    def keep(_logger: object, method: str, entry: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
        words = " ".join(f"{name}={value}" for name, value in entry.items() if name != "event")
        kept.append(f"mdb teach: {method}: {entry.get('event')} {words}")
        raise structlog.DropEvent

    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger("warning"),
        processors=[structlog.processors.format_exc_info, keep],
    )
    return kept
