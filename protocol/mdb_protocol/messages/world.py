"""Between robot, teacher and brain: what is perceived, done, said, heard."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from mdb_protocol.messages.basics import (
    NOTHING,
    VALUE_BOUND,
    Choice,
    Count,
    Event,
    Iteration,
    Message,
    Name,
    Reading,
    Text,
    Values,
    Versions,
    check_array,
    check_finite,
    check_later,
    check_stamp,
)

MAX_IMAGE = 256
"""Rows or columns of an image, at most."""
MAX_FRAME = 48_000
"""Samples in one frame of sound; a second at the highest rate."""
MAX_ACTION_S = 60
"""Least time of an action that an operator may ask for, at most."""
MAX_ENDED = 256
"""Phases that may be ended early."""


class Intention(Message, frozen=True, kw_only=True):
    """What the optimizer meant by an action: it began at the reading `before`; see `IterationReport` for the rest.

    The robot gives it back with the outcome, unread, so that an optimizer that died meanwhile can form the pair.
    """

    before: Reading
    note: Annotated[int, Meta(ge=0, le=127)] | None
    teacher: Name | None
    holder: Name | None
    mode: Name
    explored: bool
    predicted: float | None
    versions: Versions

    def __post_init__(self) -> None:
        check_finite("before", self.before)
        check_finite("predicted", self.predicted)


class Action(Message, frozen=True, kw_only=True):
    """The action of `iteration` (paper, section 2.1): a value for each of the robot's actuators.

    `choice` is its place among the experiment's choices; None where actions are searched in the actuators' ranges.
    `stamp` is that of the newest perception: the action is void `valid_for_s` after the robot had shown that one.
    """

    iteration: Iteration
    action: Values
    choice: Choice | None = None
    valid_for_s: Annotated[float, Meta(gt=0, le=3600)]
    stamp: float = 0.0
    intention: Intention | None = None

    def __post_init__(self) -> None:
        check_finite("action", self.action)
        check_stamp(self.stamp)


class Perception(Message, frozen=True, kw_only=True):
    """What the robot sensed after its `iteration`-th action (0: none yet), which was `done`.

    `outcome` is the reading that the action led to; `reading` is what the next action starts from. They are the same
    unless an episode ended, after which the robot was put elsewhere. `stamp` says when it was shown, in seconds of
    the robot's own clock: a robot that waits shows it again with a new stamp.
    """

    iteration: Iteration
    event: Event = NOTHING
    outcome: Reading
    reading: Reading
    done: Action | None = None
    stamp: float = 0.0

    def __post_init__(self) -> None:
        check_finite("outcome", self.outcome)
        check_finite("reading", self.reading)
        check_stamp(self.stamp)


class Scene(Message, frozen=True, kw_only=True):
    """What a bystander sees, the teacher among them: named numbers that are true. The brain never reads it.

    The robot did `action` at `before` and came to `reached`; `now` is where the next action starts, the same unless
    `ended`: the episode is over, and the robot was put elsewhere. At iteration 0 nothing was done yet. `success`:
    `event` is one of those that the experiment calls a success; `successes` counts them, `episode` the episodes.
    """

    iteration: Iteration
    episode: Count
    successes: Count
    event: Event
    action: Values | None
    before: Values | None
    reached: Values
    now: Values
    success: bool = False
    ended: bool = False

    def __post_init__(self) -> None:
        for name in ("action", "before", "reached", "now"):
            check_finite(name, getattr(self, name))


class RobotState(Message, frozen=True, kw_only=True):
    """What a robot that is started again goes on from: what it showed last, and what its body gave to go on from.

    `age` counts the actions of the episode. `body` is the body's own; None: it goes on where it stands.
    """

    perception: Perception
    scene: Scene
    age: Count
    body: bytes | None


class Change(Message, frozen=True, kw_only=True):
    """What of the robot is to be another from its next action on, by the names that its body gives."""

    settings: Annotated[dict[Name, bool | int | float | list[int | float] | Text], Meta(min_length=1, max_length=64)]

    def __post_init__(self) -> None:
        numbers = {n: v for n, v in self.settings.items() if isinstance(v, int | float | list)}
        check_finite("settings", numbers)


class Control(Message, frozen=True, kw_only=True):
    """How the run is to go on, as an operator wants it: the whole of it, so the last one counts.

    `iteration`: when it was said. `paused`: the robot takes no action. `action_s`: the least time of an action in
    seconds; None: as the experiment file says. `script`: whether the experiment's own scripted teacher teaches.
    `ended`: the phase that goes on at each of these iterations ends with it; the next phase begins with the next
    iteration, and all later ones begin earlier by as much. An operator who wants one of these changed says the others
    as he read them last.
    """

    iteration: Iteration
    paused: bool = False
    action_s: Annotated[float, Meta(ge=0, le=MAX_ACTION_S)] | None = None
    script: bool = True
    ended: Annotated[list[Iteration], Meta(max_length=MAX_ENDED)] = msgspec.field(default_factory=list)

    def __post_init__(self) -> None:
        check_finite("action_s", self.action_s)

    @property
    def is_usual(self) -> bool:
        """Whether all is as the experiment file says."""
        return not self.paused and self.action_s is None and self.script and not self.ended


class Shape(Message, frozen=True, kw_only=True):
    """A part of a drawing, in the scene's own units: x to the right, y up.

    A "line" joins its points; a "circle" and a "disc" have their centre as their point, and a radius; a "cross" and
    "words" are as large however the drawing is scaled. `what` it stands for gives the colour.
    """

    kind: Literal["line", "circle", "disc", "cross", "words"]
    points: Annotated[list[tuple[float, float]], Meta(min_length=1, max_length=1000)]
    radius: Annotated[float, Meta(ge=0, le=VALUE_BOUND)] = 0.0
    what: Literal["robot", "thing", "trail", "sensed", "wall", "ground"] = "thing"
    words: Annotated[str, Meta(max_length=100)] = ""

    def __post_init__(self) -> None:
        for x, y in self.points:
            check_finite("shape", {"x": x, "y": y})


class Drawing(Message, frozen=True, kw_only=True):
    """A scene as shapes. `box` (x and y of its lower left, of its upper right) is sure to be seen; `front_rad` is
    where the robot's front points, for those who turn the drawing with it.
    """

    shapes: Annotated[list[Shape], Meta(max_length=1000)]
    box: tuple[float, float, float, float]
    front_rad: float | None = None

    def __post_init__(self) -> None:
        left, low, right, high = self.box
        check_finite("box", {"left": left, "low": low, "right": right, "high": high})
        check_finite("front_rad", self.front_rad)
        if not (left < right and low < high):
            raise ValueError(f"box is {self.box}; expected x and y of the lower left, then greater ones")


class Picture(Message, frozen=True, kw_only=True):
    """What a scene looks like, made only while somebody watches: a drawing, or an image (rows, columns, 3)."""

    iteration: Iteration
    drawing: Drawing | None = None
    image: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.image is None:
            return
        check_array("image", self.image, "u", 3)
        if (
            self.image.dtype != np.uint8
            or self.image.shape[2] != 3
            or not 0 < min(self.image.shape) <= max(self.image.shape) <= MAX_IMAGE
        ):
            raise ValueError(
                f"image: got {self.image.shape} of {self.image.dtype}; expected rows and columns of 3 bytes, at most "
                f"{MAX_IMAGE} of each"
            )


class Command(Message, frozen=True, kw_only=True):
    """The teacher's note for the coming action of `iteration`; None: the teacher stays silent.

    `later`: no silence either, but "wait for me": the brain waits for this teacher's note for as long again as it
    mostly does, from now on. Said again and again, it waits as long as he wants, within a bound.
    """

    teacher: Name
    iteration: Iteration
    note: Annotated[int, Meta(ge=0, le=127)] | None
    later: bool = False

    def __post_init__(self) -> None:
        check_later(self.later, "note", self.note)


class Feedback(Message, frozen=True, kw_only=True):
    """Reward or punishment in [-1, 1] for the action taken at `iteration`; None: not now, perhaps later.

    Without an iteration it is for some action of late: the brain finds out how late this teacher is. `later`: "wait
    for me", as in `Command`; it has no value, and without an iteration it means nothing.
    """

    teacher: Name
    iteration: Iteration | None = None
    value: Annotated[float, Meta(ge=-1, le=1)] | None
    later: bool = False

    def __post_init__(self) -> None:
        check_finite("value", self.value)
        check_later(self.later, "value", self.value)


class Lesson(Message, frozen=True, kw_only=True):
    """A teacher who is none of the experiment's own teaches from `iteration` on, or, `over`, no longer.

    For logs and those who watch, never for the brain: `commands` are what he can want, by name, and `notes` the note
    of each.
    """

    teacher: Name
    iteration: Iteration
    commands: Annotated[list[Annotated[str, Meta(max_length=100)]], Meta(max_length=128)]
    notes: Annotated[list[Annotated[int, Meta(ge=0, le=127)]], Meta(max_length=128)]
    over: bool = False

    def __post_init__(self) -> None:
        if len(self.commands) != len(self.notes) or len(set(self.notes)) != len(self.notes):
            raise ValueError(f"notes are {self.notes} of commands {self.commands}; expected another one for each")


class AudioFrame(Message, frozen=True, kw_only=True):
    """A piece of what the teacher's microphone or instrument gives: samples (n,) of 16 bits, mono.

    A note that begins in it is meant for the action of `iteration`. Frames follow one another without a gap.
    `begin` opens an utterance and `end` closes it: if no note was in a whole one, the teacher has stayed silent.
    """

    teacher: Name
    iteration: Iteration
    rate_hz: Annotated[int, Meta(ge=8000, le=48000)]
    samples: np.ndarray
    begin: bool = False
    end: bool = False

    def __post_init__(self) -> None:
        check_array("samples", self.samples, "i", 1)
        if self.samples.dtype != np.int16 or len(self.samples) > MAX_FRAME:
            raise ValueError(
                f"samples: got {len(self.samples)} of {self.samples.dtype}; expected at most {MAX_FRAME} of int16"
            )


class Phase(Message, frozen=True, kw_only=True):
    """The part of the experiment that began at `iteration`, and who teaches in it (None: nobody)."""

    iteration: Iteration
    name: Text
    teacher: Name | None = None
