"""Pairs, memories, and models learnt from them."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from mdb_protocol.messages.basics import (
    MOST_SUPPORT,
    Choice,
    Count,
    Iteration,
    Judges,
    Layers,
    Message,
    Name,
    Reading,
    Text,
    Values,
    Versions,
    check_array,
    check_finite,
    check_rows,
    check_weights,
)

Seeds = Annotated[list["ModelWeights"], Meta(max_length=100)]


class Pair(Message, frozen=True, kw_only=True):
    """Action-perception pair (paper, section 2.1) of `iteration`; `versions`: the models acted upon.

    `teacher` gave the note; `judges` are the authors of the feedback, which is the mean of what they said. A pair
    without feedback may come again with it, when it came late. `best` is the best feedback of late, by which praise
    is measured: 1 is full praise. None: there is no feedback, or it counts as it is.
    """

    iteration: Iteration
    before: Reading
    note: Annotated[int, Meta(ge=0, le=127)] | None
    action: Values
    choice: Choice | None = None
    after: Reading
    feedback: Annotated[float, Meta(ge=-1, le=1)] | None
    versions: Versions
    teacher: Name | None = None
    judges: Judges = msgspec.field(default_factory=list)
    best: Annotated[float, Meta(ge=-1, le=1)] | None = None

    def __post_init__(self) -> None:
        check_finite("before", self.before)
        check_finite("action", self.action)
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
    seeds: Seeds = msgspec.field(default_factory=list)

    def __post_init__(self) -> None:
        check_array("freed", self.freed, "i", 1)
        check_array("evicted", self.evicted, "i", 1)
        _check_slots("change", self)


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
    seeds: Seeds = msgspec.field(default_factory=list)

    def __post_init__(self) -> None:
        _check_slots("snapshot", self)


def _check_slots(what: str, held: MemoryChange | MemorySnapshot) -> None:
    """Raise ValueError unless each slot has its pair, with the rows of its inputs and targets."""
    for name, kind, dimensions in (("slots", "i", 1), ("pairs", "i", 1), ("inputs", "f", 2), ("targets", "f", 2)):
        check_array(name, getattr(held, name), kind, dimensions)
    check_rows(what, held.slots, held.pairs, held.inputs, held.targets)


class Checkpoint(Message, frozen=True, kw_only=True):
    """All from which an evolver goes on: its learner's `state`, and the memory of `version` that it had learnt."""

    model: Name
    version: Count
    generation: Count
    state: dict[Name, np.ndarray]
    memory: MemorySnapshot

    def __post_init__(self) -> None:
        for name, array in self.state.items():
            if array.dtype.kind == "f" and np.isnan(array).any():
                raise ValueError(f"state: {name} holds what is no number")


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
    choices and iterations (n,): when each choice was last taken under each note (-1: without one).
    """

    iteration: Iteration
    versions: Versions
    unjudged: list[Pair]
    judged: list[Pair]
    notes: np.ndarray
    choices: np.ndarray
    iterations: np.ndarray

    def __post_init__(self) -> None:
        for name in ("notes", "choices", "iterations"):
            check_array(name, getattr(self, name), "i", 1)
        check_rows("tried", self.notes, self.choices, self.iterations)


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
