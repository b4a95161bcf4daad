"""The stages of the operation cycle, each with what is known in it, and which may follow which.

Owns what the optimizer knows of the present iteration. Sends and waits for nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from mdb_protocol import messages
from mdb_services.mechanism.actions.choice import Choice
from mdb_services.mechanism.actions.foresight import Known


@dataclass(frozen=True)
class Joining:
    """The memory store has not said yet how far it is."""


@dataclass(frozen=True)
class Meeting:
    """The robot has not been seen yet."""


@dataclass(kw_only=True)
class Deciding:
    """The robot has shown where an iteration begins; its action waits for the command and, in lockstep, models."""

    perception: messages.Perception
    started_s: float
    """When the perception came."""
    begun_s: float
    """When the iteration before was done: from here on a command is awaited."""
    gave_up: set[str] = field(default_factory=set)
    """What was waited for in vain."""


@dataclass(kw_only=True)
class Acting:
    """The action is sent; its outcome is awaited."""

    action: messages.Action
    meant: messages.Intention
    choice: Choice
    models: Mapping[str, Known] | None
    """What was acted upon; None where another optimizer did, who has died."""
    started_s: float
    acted_s: float
    sent_s: float
    """When the action was sent last."""
    gave_up: set[str] = field(default_factory=set)

    @property
    def iteration(self) -> int:
        """Which iteration this is."""
        return self.action.iteration


@dataclass(kw_only=True)
class Judging:
    """The outcome is here; feedback is awaited. Then the pair is formed."""

    acted: Acting
    outcome: messages.Perception
    outcome_s: float
    """When the outcome came."""


@dataclass(kw_only=True)
class Ending:
    """All iterations are done; the last acknowledgements are awaited."""

    since_s: float
    gave_up: set[str] = field(default_factory=set)


@dataclass(frozen=True)
class Ended:
    """The experiment is called finished."""


Stage: TypeAlias = Joining | Meeting | Deciding | Acting | Judging | Ending | Ended

NEXT: dict[type, tuple[type, ...]] = {
    Joining: (Meeting,),
    Meeting: (Deciding, Judging),  # Judging: the robot shows the outcome of what an optimizer before us wanted
    Deciding: (Acting, Ending, Deciding, Judging),  # the last two: the robot is elsewhere
    Acting: (Judging, Deciding),
    Judging: (Deciding, Judging),
    Ending: (Ended,),
    Ended: (),
}
"""Which stages may follow a stage."""
