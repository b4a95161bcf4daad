"""What a teacher's screen shows at one moment: plain values, never changed, only replaced."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from mdb_protocol import messages
from mdb_sim.teaching.languages import Language


@dataclass(frozen=True)
class Exchange:
    """One iteration as this teacher lived it: what it said, what it saw the robot do, how it judged.

    `command` is what `note` meant when it was said; `did`: the command that what happened is most like; `obeyed`:
    whether what was meant happened; `heard`: whether the brain's report names this teacher.
    """

    iteration: int
    spoke: bool = False
    note: int | None = None
    command: int | None = None
    did: int | None = None
    obeyed: bool | None = None
    feedback: float | None = None
    heard: bool | None = None


@dataclass(frozen=True)
class Latency:
    """Seconds from a command to the sight of its action, to the report of its iteration; the brain's own share.

    The report waits for the feedback, so a person's own hesitation is in it; the brain's share, from its
    perception to its action, has the wait for the command in it.
    """

    to_action_s: float | None = None
    to_report_s: float | None = None
    perception_to_action_s: float | None = None


@dataclass(frozen=True)
class Turn:
    """What the teacher can do now.

    "play" the note for the next action, of this `iteration`; "judge" the last one, of the iteration before; "both";
    "watch", for there is nothing to say now; or all is "over". `until_s`: when the brain goes on without him, by the
    session's clock; None: it waits, or that is not known.
    """

    kind: Literal["play", "judge", "both", "watch", "over"] = "watch"
    iteration: int = 0
    until_s: float | None = None


@dataclass(frozen=True)
class Summary:
    """All that a teacher has done in a run.

    `commands`: notes that he said; `obeyed` of the `judged` ones, after which it could be seen what the robot did.
    `successes`: the robot's while he was there. `first`, `last`: the share of his first and last
    `record.OBEDIENCE_OF` judged commands that were obeyed; None: there are none.
    """

    commands: int = 0
    judged: int = 0
    obeyed: int = 0
    rewards: int = 0
    punishments: int = 0
    successes: int = 0
    first: float | None = None
    last: float | None = None


@dataclass(frozen=True)
class View:
    """All there is to show."""

    language: Language
    scene: messages.Scene | None = None
    perception: messages.Perception | None = None
    picture: messages.Picture | None = None
    report: messages.IterationReport | None = None
    exchanges: tuple[Exchange, ...] = ()
    """The last iterations seen, the newest first."""
    errors: dict[str, float] = field(default_factory=dict)
    """Each model's error on pairs before it learnt them, mean of the last `record.ERROR_MEAN`."""
    obedience: float | None = None
    """Share of the last `judged` commands after which the robot did what was meant."""
    judged: int = 0
    successes: int = 0
    successes_per_100: float | None = None
    latency: Latency = Latency()
    wanted: int | None = None
    """The command that would be right now."""
    others: tuple[str, ...] = ()
    """The other teachers who are there."""
    paused: bool = False
    """Whether this teacher is silent; of the robot, see `control`."""
    auto: bool = False
    """Whether the session teaches by itself."""
    heard: messages.Command | None = None
    """What the ear heard last in this teacher's sound."""
    waits: bool = False
    """Whether this teacher has asked the brain to wait for him."""
    turn: Turn = Turn()
    summary: Summary = Summary()
    control: messages.Control | None = None
    """What an operator said last."""
    finished: bool = False
    trouble: str | None = None
    """Why the teacher is not heard."""
    notice: str | None = None
    """What became of the last key, where it is not what was asked for."""
    noticed_s: float = -math.inf


def swapped(language: Language, command: int, note: int) -> Language:
    """Return the language in which `note` says `command`; the command that it said takes the other note."""
    notes = list(language.notes)
    other = language.command(note)
    notes[command], notes[other] = notes[other], notes[command]
    return Language(f"notes:{','.join(map(str, notes))}", tuple(notes))
