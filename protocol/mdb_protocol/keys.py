"""The one table of keys: what each carries, its only writer, its delivery, what a late joiner gets.

No key is spelled anywhere else. The table in protocol/README.md is printed from it (`mdb keys`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

from mdb_protocol import messages as m
from mdb_protocol.codec import MAX_BYTES
from mdb_protocol.errors import MdbError
from mdb_protocol.messages import Message

ROOT = "mdb"
PARAMETER = re.compile(r"{(\w+)}")
NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
LETTERS = 512
"""No key of a brain is longer; what is longer is not remembered."""
SMALL = 2**16
"""Bytes of a message of a few numbers and names, at most."""
TINY = 2**12
"""Bytes of what a guest says each iteration, at most."""
MODEL_BYTES = 2**22


class Delivery(Enum):
    """How a key's values travel."""

    LATEST = "latest value: may drop, a reader keeps only the newest; a late joiner gets the last"
    RELIABLE = (
        "reliable: in order, none lost while connected; a late joiner gets what comes, perhaps older ones first"
    )
    LATCHED = "latched: reliable, and a late joiner gets the last"
    QUERY = "query: answered when asked"
    TOKEN = "liveliness token: there while its owner lives"


@dataclass(frozen=True)
class Key:
    """One row of the key table; `path` lies below `mdb/<brain>/` and may hold {parameters}."""

    path: str
    message: type[Message] | None
    writer: str
    delivery: Delivery
    meaning: str
    late_joiner: str = ""
    repeatable: bool = True
    """Whether a lockstep run of one seed has the same values on it every time."""
    history: int = 1
    """Of a key with history: how many of its last samples a late joiner gets."""
    recorded: bool = True
    """Whether it belongs in a run's log."""
    most_bytes: int = SMALL
    """Largest sample; the router lets no larger one through, and none is read."""
    most_hz: float = 0.0
    """How often the router lets a guest write; 0: no guest does. What it drops is asked for again, within bounds."""
    teachers_read: bool = False
    """Whether a teacher may read it; where the key names a teacher, only under that name (see `roles`)."""

    @property
    def guests_write(self) -> bool:
        """Whether its writer is somebody who is not of the brain."""
        return self.most_hz > 0

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the path's parameters, in order."""
        return tuple(PARAMETER.findall(self.path))

    def at(self, brain: str, **parameters: str) -> str:
        """Return the full key; a parameter left out becomes `*`, which is for readers only."""
        filled = {name: parameters.pop(name, "*") for name in self.parameters}
        if parameters:
            raise MdbError(f"key {self.path} has no parameter {', '.join(parameters)}")
        for name, value in {"brain": brain, **filled}.items():
            left_out = value == "*" and name != "brain"
            if not left_out and not NAME.fullmatch(value):
                raise MdbError(
                    f"{name} is {value!r}; expected 1 to 64 letters, digits, '_', '.' or '-' (no '/', no '*')"
                )
        return f"{ROOT}/{brain}/{self.path.format(**filled)}"

    def match(self, brain: str, key: str) -> dict[str, str] | None:
        """Return the parameters in a full key of this row, or None when it is not one."""
        return _parameters(self.path, brain, key) if len(key) <= LETTERS else None


@lru_cache(maxsize=1024)
def _parameters(path: str, brain: str, key: str) -> dict[str, str] | None:
    """Do as `Key.match`; the same few keys come again and again."""
    found = _pattern(path, brain).fullmatch(key)
    return found.groupdict() if found else None


@lru_cache(maxsize=1024)
def _pattern(path: str, brain: str) -> re.Pattern[str]:
    pattern = PARAMETER.sub(r"(?P<\1>[A-Za-z0-9_.-]{1,64})", path)
    return re.compile(f"{ROOT}/{re.escape(brain)}/{pattern}")


PERCEPTION = Key("perception", m.Perception, "robot", Delivery.LATEST, "what the robot senses", teachers_read=True)
SCENE = Key(
    "scene", m.Scene, "robot", Delivery.LATEST, "what a bystander sees: for teachers and viewers", teachers_read=True
)
PICTURE = Key(
    "picture",
    m.Picture,
    "robot",
    Delivery.LATEST,
    "what the scene looks like, while somebody watches",
    repeatable=False,
    teachers_read=True,
    recorded=False,
    most_bytes=MODEL_BYTES,
)
ACTION = Key("action", m.Action, "action optimizer", Delivery.LATEST, "the current action")
CHANGE = Key(
    "change",
    m.Change,
    "that operator",
    Delivery.RELIABLE,
    "something of the robot is to be another",
    repeatable=False,
    most_hz=20,
)
CONTROL = Key(
    "control",
    m.Control,
    "that operator",
    Delivery.LATCHED,
    "how the run is to go on: paused, at which pace, with the scripted teacher or without, phases ended early",
    repeatable=False,
    most_hz=20,
    teachers_read=True,
)
COMMAND = Key(
    "teacher/{teacher}/command",
    m.Command,
    "that teacher",
    Delivery.LATCHED,
    'a note, or silence, or "wait for me"',
    late_joiner="the last 32",
    history=32,
    most_bytes=TINY,
    most_hz=500,
)
FEEDBACK = Key(
    "teacher/{teacher}/feedback",
    m.Feedback,
    "that teacher",
    Delivery.LATCHED,
    'reward or punishment, or "wait for me"',
    late_joiner="the last 32",
    history=32,
    most_bytes=TINY,
    most_hz=500,
)
LESSON = Key(
    "teacher/{teacher}/lesson",
    m.Lesson,
    "that teacher",
    Delivery.LATCHED,
    "who teaches from now on, and what his notes mean: for the log, never for the brain",
    repeatable=False,
    most_hz=20,
)
AUDIO = Key(
    "teacher/{teacher}/audio",
    m.AudioFrame,
    "that teacher",
    Delivery.RELIABLE,
    "sound, in which notes are to be heard",
    most_bytes=2 * SMALL,
    most_hz=50,
)
HEARD = Key(
    "heard/{teacher}",
    m.Command,
    "ear",
    Delivery.LATCHED,
    "the note heard in a teacher's sound, or silence",
    teachers_read=True,
    late_joiner="the last 32",
    history=32,
)
PHASE = Key("phase", m.Phase, "scripted teacher", Delivery.LATCHED, "the phase of the experiment", teachers_read=True)
PAIR = Key(
    "pair",
    m.Pair,
    "action optimizer",
    Delivery.RELIABLE,
    "an action-perception pair, sent again until it is stored",
)
PAIR_STORED = Key(
    "pair/stored", m.PairStored, "memory store", Delivery.RELIABLE, "acknowledges a pair that is on disk"
)
MEMORY_CHANGE = Key(
    "memory/{model}/change",
    m.MemoryChange,
    "memory store",
    Delivery.RELIABLE,
    "one step of a model's short-term memory: an insert, or the beginning of a context",
    late_joiner="an evolver asks memory/{model}/resume, others memory/{model}/snapshot",
    most_bytes=MAX_BYTES,
)
MEMORY_SNAPSHOT = Key(
    "memory/{model}/snapshot",
    m.MemorySnapshot,
    "memory store",
    Delivery.QUERY,
    "a model's whole short-term memory",
    most_bytes=MAX_BYTES,
    repeatable=False,
)
CONTEXT = Key(
    "memory/{model}/context",
    m.ContextEvent,
    "memory store",
    Delivery.RELIABLE,
    "a change of context, a model stored in the long-term memory or recalled from it",
    teachers_read=True,
)
CURRENT_MODEL = Key(
    "model/{model}",
    m.CurrentModel,
    "that evolver",
    Delivery.LATCHED,
    "the current model",
    late_joiner="the last; when the evolver is dead, from memory/{model}/model",
    most_bytes=MODEL_BYTES,
)
KEPT_MODEL = Key(
    "memory/{model}/model",
    m.CurrentModel,
    "memory store",
    Delivery.QUERY,
    "the last current model, kept on disk",
    most_bytes=MODEL_BYTES,
    repeatable=False,
)
CHECKPOINT = Key(
    "checkpoint/{model}",
    m.Checkpoint,
    "that evolver",
    Delivery.LATEST,
    "the whole state of an evolver, now and then",
    most_bytes=MAX_BYTES,
    repeatable=False,
    recorded=False,
)
RESUME = Key(
    "memory/{model}/resume",
    m.Resume,
    "memory store",
    Delivery.QUERY,
    "an evolver's last checkpoint and the changes since",
    most_bytes=MAX_BYTES,
    repeatable=False,
)
PROGRESS = Key(
    "memory/progress",
    m.Progress,
    "memory store",
    Delivery.QUERY,
    "how far the pairs go, for an optimizer that begins",
    most_bytes=MAX_BYTES,
    repeatable=False,
)
ITERATION = Key(
    "iteration",
    m.IterationReport,
    "action optimizer",
    Delivery.RELIABLE,
    "what was done and foreseen",
    teachers_read=True,
)
TIMING = Key(
    "timing",
    m.Timing,
    "action optimizer",
    Delivery.RELIABLE,
    "durations of the iteration",
    repeatable=False,
    teachers_read=True,
)
FINISHED = Key(
    "finished", m.Finished, "action optimizer", Delivery.LATCHED, "the experiment is over", teachers_read=True
)
STATUS = Key(
    "status/{role}/{instance}",
    m.Status,
    "each service",
    Delivery.QUERY,
    "rates, versions, refused messages",
    repeatable=False,
    teachers_read=True,
)
ALIVE = Key(
    "alive/{role}/{instance}",
    None,
    "each service",
    Delivery.TOKEN,
    "declared last, so it means ready",
    repeatable=False,
    teachers_read=True,
)
ALIVE_ANYWHERE = ALIVE.at("BRAIN").replace("BRAIN", "*")
"""The tokens of all brains."""
CLAIM = Key(
    "claim/{role}/{instance}/{holder}",
    None,
    "each service",
    Delivery.TOKEN,
    "declared first: who is, or wants to be, this service of the brain",
    repeatable=False,
)

KEYS = (
    PERCEPTION, SCENE, PICTURE, CHANGE, CONTROL, ACTION, COMMAND, FEEDBACK, LESSON, AUDIO, HEARD, PHASE, PAIR,
    PAIR_STORED, MEMORY_CHANGE, MEMORY_SNAPSHOT, CONTEXT, CURRENT_MODEL, KEPT_MODEL, CHECKPOINT, RESUME, PROGRESS,
    ITERATION, TIMING, FINISHED, STATUS, ALIVE, CLAIM,
)  # fmt: skip


def brains_of(found: Iterable[str]) -> list[str]:
    """Return the names of the brains that full keys belong to, in order; what can be none's name is left out."""
    return sorted({name for key in found if NAME.fullmatch(name := key.split("/")[1])})


@lru_cache(maxsize=1024)
def find(brain: str, key: str) -> Key | None:
    """Return the row that a full key belongs to, or None."""
    return next((row for row in KEYS if row.match(brain, key) is not None), None)


def table() -> str:
    """Return the key table as Markdown, as it stands in protocol/README.md."""
    lines = [
        "| key below `mdb/<brain>/` | payload | at most | only writer | delivery | late joiner | meaning |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in KEYS:
        delivery, _, _ = row.delivery.value.partition(":")
        late = (
            row.late_joiner
            or {
                Delivery.LATEST: "the last",
                Delivery.LATCHED: "the last",
                Delivery.RELIABLE: "what comes, perhaps older ones first",
                Delivery.QUERY: "asks",
                Delivery.TOKEN: "all that live",
            }[row.delivery]
        )
        payload = row.message.__name__ if row.message else "none"
        lines.append(
            f"| `{row.path}` | {payload} | {_at_most(row)} | {row.writer} | {delivery} | {late} | {row.meaning} |"
        )
    return "\n".join(lines)


def _at_most(row: Key) -> str:
    """Return a row's limits in words."""
    if row.message is None:
        return "none"
    size = f"{row.most_bytes // 2**20} MB" if row.most_bytes >= 2**20 else f"{row.most_bytes // 2**10} kB"
    return f"{size}, {row.most_hz:g} a second" if row.guests_write else size
