"""What the brain believes: of each note and action the feedback, and the satisfaction over its inputs as a picture.

Computed from the current models by the same `foresee` that acts. Pure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdb_deploy.web.telling.plan import Plan, number, numbers
from mdb_protocol.messages import Reading
from mdb_services.mechanism.actions.foresight import Known, Mode, Models, foresee
from mdb_services.mechanism.networks.encoding import Channel, Facts, gather
from mdb_services.mechanism.networks.network import Floats

SIDE = 25
"""Values of each of the two inputs in the picture of a model."""
MOST_POINTS = 400
"""Pairs that are drawn into it."""
MOST_NOTES = 32
"""Notes in the table."""


def taught_mode(plan: Plan) -> Mode | None:
    """Return the first mode that acts upon notes."""
    return next((mode for mode in plan.modes.values() if plan.uses_note(mode)), None)


def believers(plan: Plan) -> tuple[tuple[str, ...], bool]:
    """Return the models on which the table depends, and whether it also depends on where the robot is."""
    mode = taught_mode(plan)
    if mode is None or not plan.notes:
        return (), False
    world = plan.books[mode.world]
    valued = mode.valued_by(world.outputs)
    given = {"note", "action", *plan.actuators}
    needed = set(world.inputs) | (set() if valued == mode.world else {*plan.books[valued].inputs} - _after(plan))
    return tuple(dict.fromkeys((mode.world, valued))), not needed <= given


def _after(plan: Plan) -> set[str]:
    return {name for name in plan.variables if name.startswith(("next.", "covered."))}


def beliefs(plan: Plan, models: Models, before: Reading | None) -> dict[str, Any] | None:
    """Return the part `beliefs`: feedback predicted for each note (rows) and action, in [-1, 1], and its support.

    before: where the robot is, which matters where the model reads more than note and action. None: there is no note
    channel, or the models are not there yet.
    """
    mode = taught_mode(plan)
    if mode is None or not plan.notes:
        return None
    actions = plan.choices() if plan.brain.choice else plan.grid()
    count, notes = len(next(iter(actions.values()))), min(plan.notes, MOST_NOTES)
    tried: Facts = {name: np.tile(values, notes) for name, values in actions.items()}
    tried["note"] = np.repeat(np.arange(notes, dtype=np.float64), count)
    foreseen = foresee(mode, models, gather(before=before or {}), tried)
    if foreseen is None:
        return None
    places = actions["action"].astype(int).tolist() if "action" in actions else [None] * count
    values = [{name: float(actions[name][place]) for name in plan.actuators} for place in range(count)]
    return {
        "notes": list(range(notes)),
        "actions": [plan.name(each, place) for each, place in zip(values, places, strict=True)],
        "choices": places,
        "feedback": numbers(np.clip(foreseen.satisfaction, -1, 1).reshape(notes, count)),
        "support": numbers(foreseen.support.reshape(notes, count)),
    }


def valued_alone(plan: Plan) -> tuple[str, str | None] | None:
    """Return the model that tells the satisfaction in the first mode without notes, and its output; None: no such."""
    for mode in plan.modes.values():
        if not plan.uses_note(mode):
            valued = mode.valued_by(plan.books[mode.world].outputs)
            return valued, mode.satisfaction if valued == mode.world else None
    return None


@dataclass(frozen=True)
class Pairs:
    """The pairs of a memory as rows: inputs (n, i), and targets (n, o) or None when these are not known."""

    inputs: Floats
    targets: Floats | None


@dataclass(frozen=True)
class _Column:
    """A column of an input row: what it is called, its ends, and its values in their own units of scaled ones."""

    place: int
    name: str
    low: float
    high: float
    real: Callable[[NDArray[Any]], NDArray[np.float64]]


def induced(plan: Plan, name: str, output: str | None, known: Known, pairs: Pairs) -> dict[str, Any] | None:
    """Return the part `induced`: what a model predicts over two of its inputs, the others held at their median.

    Of more than two inputs these are the two that vary most over the pairs. None: it has no two such inputs.
    """
    book, inputs = plan.books[name], pairs.inputs
    columns, fixed = _columns(plan, book.inputs)
    if len(columns) < 2:
        return None
    width = [float(np.std(inputs[:, column.place])) if len(inputs) else 0.0 for column in columns]
    two = sorted(sorted(range(len(columns)), key=lambda place: -width[place])[:2])
    x, y = columns[two[0]], columns[two[1]]
    middle = np.median(inputs, axis=0) if len(inputs) else np.zeros(book.width)
    for places in fixed.values():  # an index is held at the one that is most frequent
        hot = np.zeros(len(places))
        hot[int(np.argmax(inputs[:, places].sum(axis=0))) if len(inputs) else 0] = 1.0
        middle[places] = hot
    line = np.linspace(-1.0, 1.0, SIDE)
    rows = np.repeat(middle[None, :].astype(np.float32), SIDE * SIDE, axis=0)
    rows[:, x.place], rows[:, y.place] = np.tile(line, SIDE), np.repeat(line, SIDE)
    of = 0 if output is None else book.column(output)
    z = known.network.predict(rows)[:, of].reshape(SIDE, SIDE)
    held = {c.name: number(c.real(middle[[c.place]])[0]) for c in columns if c not in (x, y)}
    held |= {index: number(np.argmax(middle[places])) for index, places in fixed.items()}
    return {
        "model": name,
        "x": _axis(x, line),
        "y": _axis(y, line),
        "z": numbers(z),
        "fixed": held,
        "points": _points(pairs, x, y, of),
    }


def _axis(column: _Column, line: NDArray[Any]) -> dict[str, Any]:
    values = numbers(column.real(line), 4)
    return {"name": column.name, "low": column.low, "high": column.high, "values": values}


def _points(pairs: Pairs, x: _Column, y: _Column, of: int) -> list[list[float | None]]:
    inputs = pairs.inputs[-MOST_POINTS:]
    xs, ys = numbers(x.real(inputs[:, x.place]), 4), numbers(y.real(inputs[:, y.place]), 4)
    targets = [None] * len(inputs) if pairs.targets is None else numbers(pairs.targets[-MOST_POINTS:, of])
    return [list(point) for point in zip(xs, ys, targets, strict=True)]


def _columns(plan: Plan, inputs: Sequence[str]) -> tuple[list[_Column], dict[str, list[int]]]:
    """Return the columns that can be an axis, and the columns of each input that is an index."""
    columns: list[_Column] = []
    fixed: dict[str, list[int]] = {}
    place = 0
    for name in inputs:
        channel = plan.variables[name]
        if channel.encoding == "one_hot":
            fixed[name] = list(range(place, place + channel.width))
        for part in range(channel.width if channel.encoding != "one_hot" else 0):
            label = f"{name}[{part}]" if channel.numbers > 1 else name
            values = sorted(channel.values) if channel.encoding == "rank" else [channel.low, channel.high]
            columns.append(_Column(place + part, label, values[0], values[-1], _real(channel, values)))
        place += channel.width
    return columns, fixed


def _real(channel: Channel, values: Sequence[float]) -> Callable[[NDArray[Any]], NDArray[np.float64]]:
    """Return what brings scaled values of a channel into its own units; between ranks it goes straight."""
    scaled = np.linspace(-1.0, 1.0, len(values))
    if channel.encoding == "rank":
        return lambda columns: np.interp(columns, scaled, values)
    return lambda columns: (
        (np.asarray(columns, np.float64) + 1.0) * (0.5 * (channel.high - channel.low)) + channel.low
    )
