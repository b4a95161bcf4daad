"""What the brain tells of itself."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from mdb_protocol.messages.basics import (
    Choice,
    Count,
    Event,
    Iteration,
    Judges,
    Message,
    Name,
    Text,
    Values,
    Versions,
    check_finite,
)


class IterationReport(Message, frozen=True, kw_only=True):
    """What the optimizer did at `iteration`: mode, action, why, and how well each model had foreseen it.

    `predicted` is the satisfaction foreseen for the chosen action (None: no model applied);
    `prequential` each model's mean squared error on this pair before learning it.
    """

    iteration: Iteration
    mode: Name
    action: Values
    choice: Choice | None = None
    explored: bool
    predicted: float | None
    note: Annotated[int, Meta(ge=0, le=127)] | None
    feedback: float | None
    event: Event
    prequential: dict[Name, float]
    versions: Versions
    teacher: Name | None = None
    """Who was obeyed or is to be: whose note it was."""
    judges: Judges = msgspec.field(default_factory=list)
    holder: Name | None = None
    """The teacher who is being obeyed, when only one may be; a teacher who reads another name is not heard."""

    def __post_init__(self) -> None:
        check_finite("action", self.action)
        check_finite("predicted", self.predicted)
        check_finite("feedback", self.feedback)
        check_finite("prequential", self.prequential)


class Timing(Message, frozen=True, kw_only=True):
    """Durations of one iteration on this machine: differs from run to run, unlike all the rest."""

    iteration: Iteration
    perception_to_action_s: float
    cycle_s: float

    def __post_init__(self) -> None:
        check_finite("perception_to_action_s", self.perception_to_action_s)
        check_finite("cycle_s", self.cycle_s)


class Finished(Message, frozen=True, kw_only=True):
    """The optimizer has done all iterations of the experiment."""

    iterations: Iteration


class Status(Message, frozen=True, kw_only=True):
    """A service's answer to "how are you?"; `values` holds its own figures.

    `refused` counts by key what could not be read or used, `dropped` what there was no room for; `rate_hz` are the
    messages that it took a second of late, `queued` those that wait now, `memory_bytes` what it has in memory (0: the
    system does not say), `host` and the `run` folder where it lives. A value `behind`, or `behind.NAME`, is how many
    versions of a memory or model it lags.
    """

    role: Name
    instance: Name
    pid: Count
    uptime_s: float
    values: dict[str, float]
    refused: dict[str, Count]
    dropped: dict[str, Count] = msgspec.field(default_factory=dict)
    rate_hz: float = 0.0
    queued: Count = 0
    memory_bytes: Count = 0
    host: Text = ""
    run: Text = ""
