"""The messages of the brain, one frozen class each: what is on the wire, with its units and bounds.

Owns the payload types; says nothing of keys (`keys`) or bytes (`codec`). Unknown fields are accepted, so
a newer sender can talk to an older reader; wrong types and non-finite numbers are refused with their path.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

Iteration = Annotated[int, Meta(ge=0, le=2**53)]
Count = Annotated[int, Meta(ge=0, le=2**53)]
Index = Annotated[int, Meta(ge=0, le=2**31)]
Name = Annotated[str, Meta(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_.-]+\Z")]
Text = Annotated[str, Meta(max_length=4096)]
Event = Literal["none", "capture", "bump", "lost", "timeout"]
Reading = Annotated[dict[Name, float], Meta(max_length=256)]
Versions = Annotated[dict[Name, Count], Meta(max_length=256)]
Judges = Annotated[list[Name], Meta(max_length=256)]
Layers = Annotated[list[Annotated[int, Meta(ge=0, le=4096)]], Meta(min_length=2, max_length=8)]
Seeds = Annotated[list["ModelWeights"], Meta(max_length=100)]

MOST_SUPPORT = 100_000
"""Pairs in the largest memory that an experiment may ask for."""
VALUE_BOUND = 1e6
"""Sensor and model values beyond this are refused: no sensor of a robot means them."""

MAX_FRAME = 48_000
"""Samples in one frame of sound; a second at the highest rate."""


def check_finite(what: str, values: Mapping[str, float] | float | None) -> None:
    """Raise ValueError when a number is not finite or is beyond `VALUE_BOUND`."""
    if values is None:
        return
    items = values.items() if isinstance(values, Mapping) else ((what, values),)
    for name, value in items:
        if not math.isfinite(value) or abs(value) > VALUE_BOUND:
            raise ValueError(f"{what}: {name} is {value!r}; expected a finite number within ±{VALUE_BOUND:g}")


def check_stamp(stamp: float) -> None:
    """Raise ValueError when a time in seconds is not finite: nothing would ever be too late for it."""
    if not math.isfinite(stamp):
        raise ValueError(f"stamp is {stamp!r}; expected a finite number of seconds")


def check_array(what: str, array: np.ndarray, kind: str, ndim: int) -> None:
    """Raise ValueError unless `array` has the dtype kind ("f", "i", "u"), dimensions and finite values."""
    if array.dtype.kind != kind or array.ndim != ndim:
        raise ValueError(f"{what}: got {array.ndim} dimensions of {array.dtype}; expected {ndim} of kind {kind!r}")
    if kind == "f" and not (np.isfinite(array).all() and (np.abs(array) <= VALUE_BOUND).all()):
        raise ValueError(f"{what}: holds values that are not finite or beyond ±{VALUE_BOUND:g}")


def check_rows(what: str, *arrays: np.ndarray) -> None:
    """Raise ValueError unless all arrays have as many rows."""
    if len({len(array) for array in arrays}) > 1:
        raise ValueError(f"{what}: arrays of {[len(array) for array in arrays]} rows; expected as many of each")


def check_weights(layers: list[int], weights: np.ndarray) -> None:
    """Raise ValueError unless weights (n,) are those of a network of these layers."""
    check_array("weights", weights, "f", 1)
    expected = sum((i + 1) * o for i, o in pairwise(layers))
    if len(weights) != expected:
        raise ValueError(f"weights: got {len(weights)}, but layers {layers} need {expected}")


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """Base of all messages."""


class Placement(Message, frozen=True, kw_only=True):
    """Where robot and object truly are: metres and radians in the arena's frame."""

    x_m: float
    y_m: float
    heading_rad: float
    object_x_m: float
    object_y_m: float

    def __post_init__(self) -> None:
        check_finite("placement", {name: getattr(self, name) for name in self.__struct_fields__})


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
    """The action of `iteration`: an index into the robot's actions.

    `stamp` is that of the newest perception: the action is void `valid_for_s` after the robot had shown that one.
    """

    iteration: Iteration
    action: Annotated[int, Meta(ge=0, le=1023)]
    valid_for_s: Annotated[float, Meta(gt=0, le=3600)]
    stamp: float = 0.0
    intention: Intention | None = None

    def __post_init__(self) -> None:
        check_stamp(self.stamp)


class Perception(Message, frozen=True, kw_only=True):
    """What the robot sensed after its `iteration`-th action (0: none yet), which was `done`.

    `outcome` is the reading that the action led to; `reading` is what the next action starts from. They
    are the same unless `event` brought a new placement. A sensor that sees nothing is left out. `stamp` says when
    it was shown, in seconds of the robot's own clock: a robot that waits shows it again with a new stamp.
    """

    iteration: Iteration
    event: Event
    outcome: Reading
    reading: Reading
    done: Action | None = None
    stamp: float = 0.0

    def __post_init__(self) -> None:
        check_finite("outcome", self.outcome)
        check_finite("reading", self.reading)
        check_stamp(self.stamp)


class Scene(Message, frozen=True, kw_only=True):
    """What a bystander sees, the teacher among them; the brain never reads it.

    The robot did `action` at `before` and came to `reached`; `now` is where the next action starts, the
    same unless `event` brought a new placement. At iteration 0 nothing was done yet.
    """

    iteration: Iteration
    episode: Count
    captures: Count
    event: Event
    action: Annotated[int, Meta(ge=0, le=1023)] | None
    before: Placement | None
    reached: Placement
    now: Placement


class Command(Message, frozen=True, kw_only=True):
    """The teacher's note for the coming action of `iteration`; None: the teacher stays silent."""

    teacher: Name
    iteration: Iteration
    note: Annotated[int, Meta(ge=0, le=127)] | None


class Feedback(Message, frozen=True, kw_only=True):
    """Reward or punishment in [-1, 1] for the action taken at `iteration`; None: not now, perhaps later.

    Without an iteration it is for some action of late: the brain finds out how late this teacher is.
    """

    teacher: Name
    iteration: Iteration | None = None
    value: Annotated[float, Meta(ge=-1, le=1)] | None

    def __post_init__(self) -> None:
        check_finite("value", self.value)


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


class Pair(Message, frozen=True, kw_only=True):
    """Action-perception pair (paper, section 2.1) of `iteration`; `versions`: the models acted upon.

    `teacher` gave the note; `judges` are the authors of the feedback, which is the mean of what they said. A pair
    without feedback may come again with it, when it came late. `best` is the best feedback of late, by which praise
    is measured: 1 is full praise. None: there is no feedback, or it counts as it is.
    """

    iteration: Iteration
    before: Reading
    note: Annotated[int, Meta(ge=0, le=127)] | None
    action: Annotated[int, Meta(ge=0, le=1023)]
    after: Reading
    feedback: Annotated[float, Meta(ge=-1, le=1)] | None
    versions: Versions
    teacher: Name | None = None
    judges: Judges = []
    best: Annotated[float, Meta(ge=-1, le=1)] | None = None

    def __post_init__(self) -> None:
        check_finite("before", self.before)
        check_finite("after", self.after)
        check_finite("feedback", self.feedback)
        check_finite("best", self.best)


class PairStored(Message, frozen=True, kw_only=True):
    """The pair of `iteration` is on disk, with its feedback if `judged`.

    `versions`: each model's short-term memory after it.
    """

    iteration: Iteration
    versions: Versions
    judged: bool = False


class ModelWeights(Message, frozen=True, kw_only=True):
    """A network: `layers` and `weights` as in `CurrentModel`."""

    layers: Layers
    weights: np.ndarray

    def __post_init__(self) -> None:
        check_weights(self.layers, self.weights)


class MemoryChange(Message, frozen=True, kw_only=True):
    """One step of the short-term memory of `model` to `version`: an insert, or the beginning of a context.

    slots (k,) now hold pairs (k,) with rows inputs (k, i) and targets (k, o); slots `freed` (m,) are empty and the
    pairs `evicted` (n,) have left. A negative pair was recalled from the long-term memory, and `seeds` are networks
    recalled from there, the best first.
    """

    model: Name
    version: Count
    slots: np.ndarray
    pairs: np.ndarray
    inputs: np.ndarray
    targets: np.ndarray
    freed: np.ndarray
    evicted: np.ndarray
    seeds: Seeds = []

    def __post_init__(self) -> None:
        for name in ("slots", "pairs", "freed", "evicted"):
            check_array(name, getattr(self, name), "i", 1)
        check_array("inputs", self.inputs, "f", 2)
        check_array("targets", self.targets, "f", 2)
        check_rows("change", self.slots, self.pairs, self.inputs, self.targets)


class MemorySnapshot(Message, frozen=True, kw_only=True):
    """The whole short-term memory of `model`: slots (n,), pairs (n,), inputs (n, i), targets (n, o).

    `seeds` are the networks that were recalled when the present context began.
    """

    model: Name
    version: Count
    slots: np.ndarray
    pairs: np.ndarray
    inputs: np.ndarray
    targets: np.ndarray
    seeds: Seeds = []

    def __post_init__(self) -> None:
        check_array("slots", self.slots, "i", 1)
        check_array("pairs", self.pairs, "i", 1)
        check_array("inputs", self.inputs, "f", 2)
        check_array("targets", self.targets, "f", 2)
        check_rows("snapshot", self.slots, self.pairs, self.inputs, self.targets)


class Checkpoint(Message, frozen=True, kw_only=True):
    """All from which an evolver goes on: its learner's `state`, and the memory of `version` that it had learnt."""

    model: Name
    version: Count
    generation: Count
    state: dict[Name, np.ndarray]
    memory: MemorySnapshot


class Resume(Message, frozen=True, kw_only=True):
    """What the memory store has for an evolver that begins or has missed something.

    `checkpoint` is its last one; `changes` are those after it, or after the beginning when there is none, in order,
    as far back as they are kept; `memory` is the whole memory as it is now.
    """

    model: Name
    checkpoint: Checkpoint | None
    changes: list[MemoryChange]
    memory: MemorySnapshot


class Progress(Message, frozen=True, kw_only=True):
    """How far the memory store is, for an optimizer that begins: the pair of `iteration` is the next one.

    versions: each model's short-term memory; unjudged, judged: the newest pairs without feedback and with it; notes,
    actions and iterations (n,): when each action was last taken under each note (-1: without one).
    """

    iteration: Iteration
    versions: Versions
    unjudged: list[Pair]
    judged: list[Pair]
    notes: np.ndarray
    actions: np.ndarray
    iterations: np.ndarray

    def __post_init__(self) -> None:
        for name in ("notes", "actions", "iterations"):
            check_array(name, getattr(self, name), "i", 1)
        check_rows("tried", self.notes, self.actions, self.iterations)


class RobotState(Message, frozen=True, kw_only=True):
    """What a robot that is started again goes on from: what it showed last, and what its body counts."""

    perception: Perception
    scene: Scene
    episode_age: Count
    unseen: Count


class ContextEvent(Message, frozen=True, kw_only=True):
    """What the memory store made of the errors of `model` when the pair of `iteration` came.

    changed: it predicts badly what it predicted well, so the context is another one; known: the new context is
    learnt; stored: the model entered the long-term memory as `stored`; recalled: `stored` fits the new context
    and acts. `error` is that model's on the pairs that told.
    """

    model: Name
    iteration: Iteration
    kind: Literal["changed", "known", "stored", "recalled"]
    stored: Count | None = None
    error: float = 0.0

    def __post_init__(self) -> None:
        check_finite("error", self.error)


class CurrentModel(Message, frozen=True, kw_only=True):
    """The best network of `model` after its generations on memory `version`.

    `layers` are the numbers of inputs, expressed hidden units and outputs; `weights` the matrices
    (units, inputs + 1), bias last, flattened one after the other; `error` the mean squared error over
    the short-term memory in the outputs' scaled units. `support` holds the inputs (n, inputs) of the pairs in that
    memory, where a mode believes the model no farther than they reach.
    """

    model: Name
    version: Count
    generation: Count
    layers: Layers
    weights: np.ndarray
    error: float
    support: np.ndarray | None = None

    def __post_init__(self) -> None:
        check_weights(self.layers, self.weights)
        check_finite("error", self.error)
        if self.support is not None:
            check_array("support", self.support, "f", 2)
            if len(self.support) > MOST_SUPPORT:
                raise ValueError(
                    f"support has {len(self.support)} rows; no memory holds more than {MOST_SUPPORT} pairs"
                )
            columns, inputs = self.support.shape[1], self.layers[0]
            if columns != inputs:
                raise ValueError(f"support has {columns} columns; the network has {inputs} inputs")


class LongTermModel(Message, frozen=True, kw_only=True):
    """A model in the long-term memory, on disk or carried to another run, with its context and where it comes from.

    `reads` says for each of its inputs and outputs what numbers the network gets; a brain can use the model when
    its own variables are the same. `pairs` are a sample of the pairs that it was learnt from, `error` its mean
    squared error on the pairs that made it worth storing; `uses` counts the changes of context after which it
    fitted; `origin` names where it was imported from.
    """

    id: Count
    model: Name
    reads: dict[Text, Text]
    layers: Layers
    weights: np.ndarray
    error: float
    pairs: list[Pair]
    uses: Count = 0
    touched: Count = 0
    iteration: Iteration = 0
    experiment: Text = ""
    brain: Text = ""
    seed: Annotated[int, Meta(ge=0)] = 0
    origin: Text = ""

    def __post_init__(self) -> None:
        check_weights(self.layers, self.weights)
        check_finite("error", self.error)


class LongTermFile(Message, frozen=True, kw_only=True):
    """Models on their way from one run to another: `mdb ltm export`, `mdb ltm import`."""

    models: list[LongTermModel]


class IterationReport(Message, frozen=True, kw_only=True):
    """What the optimizer did at `iteration`: mode, action, why, and how well each model had foreseen it.

    `predicted` is the satisfaction foreseen for the chosen action (None: no model applied);
    `prequential` each model's mean squared error on this pair before learning it.
    """

    iteration: Iteration
    mode: Name
    action: Annotated[int, Meta(ge=0, le=1023)]
    explored: bool
    predicted: float | None
    note: Annotated[int, Meta(ge=0, le=127)] | None
    feedback: float | None
    event: Event
    prequential: dict[Name, float]
    versions: Versions
    teacher: Name | None = None
    """Who was obeyed or is to be: whose note it was."""
    judges: Judges = []
    holder: Name | None = None
    """Who holds the word, when only one teacher may; a teacher who reads another name is not heard."""

    def __post_init__(self) -> None:
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
    system does not say). A value `behind`, or `behind.NAME`, is how many versions of a memory or model it lags.
    """

    role: Name
    instance: Name
    pid: Count
    uptime_s: float
    values: dict[str, float]
    refused: dict[str, Count]
    dropped: dict[str, Count] = {}
    rate_hz: float = 0.0
    queued: Count = 0
    memory_bytes: Count = 0
