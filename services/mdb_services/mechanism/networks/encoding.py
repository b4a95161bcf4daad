"""From what was sensed, heard, done and felt to the rows that models learn, and back (ours).

Variables of an action-perception pair, by name: a sensor's name before the action (`distance`), after it
(`next.distance`), the relative change (`covered.distance`: before minus after), an actuator's name, `action` (which
choice it was, where there are choices), `note` and `feedback`. A variable that was not there is absent from the
facts, and no model that needs it gets a row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.networks.network import Floats

Facts = dict[str, NDArray[np.float64]]
"""Variable name to its values, one a case: (n,), or (n, numbers) of a sensor that gives a vector."""

Scale = float | NDArray[np.float64]

Encoding = Literal["scalar", "one_hot", "rank"]

NOT_SENSED = ("note", "action", "feedback")
DERIVED = ("next.", "covered.")
"""Variables, and the beginnings of variables, that no sensor may be named: such a reading is left out."""


@dataclass(frozen=True, kw_only=True)
class Channel:
    """How one variable becomes numbers in about [-1, 1].

    `scalar` maps `low`..`high` to -1..1, each of the `numbers` of a vector; `rank` maps an index to the place of its
    value among the sorted `values`; `one_hot` gives `size` columns, 1 for the index and 0 elsewhere.
    """

    encoding: Encoding = "scalar"
    low: float = -1.0
    high: float = 1.0
    size: int = 0
    values: tuple[float, ...] = ()
    numbers: int = 1

    def __post_init__(self) -> None:
        if not np.isfinite((self.low, self.high, *self.values)).all():
            raise ValueError(f"low {self.low}, high {self.high}, values {self.values}: expected finite numbers")
        if self.encoding == "scalar" and not self.low < self.high:
            raise ValueError(f"low {self.low} and high {self.high}: expected low < high")
        if self.encoding == "one_hot" and self.size < 1:
            raise ValueError(f"size {self.size}: a one_hot channel needs its number of values")
        if self.encoding == "rank" and len(set(self.values)) < 2:
            raise ValueError(f"values {self.values}: a rank channel needs one of each index, not equal")
        if self.numbers < 1 or (self.numbers > 1 and self.encoding != "scalar"):
            raise ValueError(f"numbers {self.numbers}: expected 1, or more for a scalar channel of a vector")

    @property
    def width(self) -> int:
        """Columns in a row."""
        return self.size if self.encoding == "one_hot" else self.numbers

    @property
    def indices(self) -> int | None:
        """How many values there are to be one of; None for a scalar."""
        return {"scalar": None, "one_hot": self.size}.get(self.encoding, len(self.values))

    def describe(self) -> str:
        """Return in words how a value becomes numbers: equal words, equal numbers."""
        if self.encoding == "one_hot":
            return f"one_hot of {self.size}"
        if self.encoding == "scalar":
            several = f"{self.numbers} times " if self.numbers > 1 else ""
            return f"{several}scalar {self.low:g} to {self.high:g}"
        return f"{self.encoding} of {', '.join(f'{value:g}' for value in self.values)}"

    def has(self, values: NDArray[np.float64]) -> bool:
        """Whether all values can be encoded: an index that the channel lacks cannot, nor a vector of other length."""
        if self.encoding == "scalar":
            return values.ndim == 1 if self.numbers == 1 else values.shape[1:] == (self.numbers,)
        return values.ndim == 1 and self._known.issuperset(values.tolist())  # few: quicker than with arrays

    def encode(self, values: NDArray[np.float64]) -> Floats:
        """Return (n, width) float32 of values (n,) or (n, numbers)."""
        return _scaled(self.columns(values), *self.scale)

    def columns(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the columns (n, width) of values, before they are scaled."""
        if self.encoding == "one_hot":
            return np.equal(values[:, None], np.arange(self.size)).astype(np.float64)
        if self.encoding == "rank":
            values = self._places[values.astype(np.intp)]
        return values[:, None] if values.ndim == 1 else values

    @cached_property
    def _known(self) -> frozenset[int]:
        """The indices that there are."""
        return frozenset(range(self.indices or 0))

    @cached_property
    def _places(self) -> NDArray[np.float64]:
        """The place of each of the `values` among them all."""
        return np.argsort(np.argsort(np.asarray(self.values), kind="stable"), kind="stable").astype(np.float64)

    @property
    def scale(self) -> tuple[float, float, float]:
        """What is taken from a column, by what it is multiplied, and what is taken from that."""
        if self.encoding == "one_hot":
            return 0.0, 1.0, 0.0
        if self.encoding == "rank":
            return 0.0, 2.0 / (len(self.values) - 1), 1.0
        return self.low, 2.0 / (self.high - self.low), 1.0

    def decode(self, columns: Floats) -> NDArray[np.float64]:
        """Return the values (n,) or (n, numbers) of scalar columns (n, numbers)."""
        if self.encoding != "scalar":
            raise ValueError(f"a {self.encoding} channel cannot be a model's output; use scalar")
        values = (columns.astype(np.float64) + 1.0) * (0.5 * (self.high - self.low)) + self.low
        return values[:, 0] if self.numbers == 1 else values


def gather(
    *,
    before: Mapping[str, float | Sequence[float]] | None = None,
    after: Mapping[str, float | Sequence[float]] | None = None,
    note: float | None = None,
    action: Mapping[str, float] | None = None,
    choice: float | None = None,
    feedback: float | None = None,
) -> Facts:
    """Return the facts of one pair, each of shape (1,) or (1, numbers); what is None or missing is absent."""
    facts: Facts = {}
    for prefix, reading in (("", before or {}), ("next.", after or {})):
        for name, value in reading.items():
            if name not in NOT_SENSED and not name.startswith(DERIVED):
                facts[prefix + name] = np.array([value])
    for name, given in (*(action or {}).items(), ("note", note), ("action", choice), ("feedback", feedback)):
        if given is not None:
            facts[name] = np.array([float(given)])
    return with_changes(facts)


def with_changes(facts: Facts) -> Facts:
    """Add `covered.NAME` (before minus after) for every sensor known before and after, or what is after by both."""
    for name in list(facts):
        after, covered = f"next.{name}", f"covered.{name}"
        if after in facts and facts[name].shape == facts[after].shape:
            facts[covered] = facts[name] - facts[after]
        elif covered in facts and facts[name].shape == facts[covered].shape:
            facts[after] = facts[name] - facts[covered]
    return facts


def _scaled(columns: NDArray[np.float64], low: Scale, factor: Scale, middle: Scale) -> Floats:
    """Return columns (n, width) as models read them; low, factor and middle: `Channel.scale`, one or (width,)."""
    scaled = columns - low
    scaled *= factor
    scaled -= middle
    np.maximum(scaled, -1.5, out=scaled)
    np.minimum(scaled, 1.5, out=scaled)
    return scaled.astype(np.float32)


class _Variables:
    """Some variables, and the rows of their columns side by side."""

    def __init__(self, channels: Mapping[str, Channel], names: Sequence[str]) -> None:
        self._channels = [(name, channels[name]) for name in names]
        widths = [channel.width for _, channel in self._channels]
        ends = list(accumulate(widths))
        self.width = sum(widths)
        self.places = {name: slice(end - width, end) for name, end, width in zip(names, ends, widths, strict=True)}
        """The columns of each."""
        scales = np.array([channel.scale for _, channel in self._channels])
        self._scale = np.repeat(scales, widths, axis=0).T

    def rows(self, facts: Facts) -> Floats | None:
        """Return (n, width), or None when a variable is not among the facts or is no value of its channel."""
        columns = []
        for name, channel in self._channels:
            values = facts.get(name)
            if values is None or not channel.has(values):
                return None
            columns.append(channel.columns(values))
        return _scaled(np.concatenate(columns, axis=1), *self._scale)


class Codebook:
    """Inputs and outputs of one model: which variables, how encoded, in which columns."""

    def __init__(self, channels: Mapping[str, Channel], inputs: Sequence[str], outputs: Sequence[str]) -> None:
        """Take the channels by variable name. KeyError, ValueError when a variable has no usable channel."""
        for name in (*inputs, *outputs):
            if name not in channels:
                raise KeyError(f"variable {name!r} has no channel; channels are {', '.join(sorted(channels))}")
        self.inputs, self.outputs = tuple(inputs), tuple(outputs)
        self._channels = {name: channels[name] for name in outputs}
        self._ins, self._outs = _Variables(channels, inputs), _Variables(channels, outputs)
        if any(channels[name].encoding != "scalar" for name in outputs):
            raise ValueError(f"outputs {list(outputs)}: a model's outputs must be scalar channels")

    @property
    def width(self) -> int:
        """Columns of an input row."""
        return self._ins.width

    @property
    def output_width(self) -> int:
        """Columns of a target row."""
        return self._outs.width

    def column(self, output: str) -> int:
        """Return the first column of an output in a target row."""
        return self._outs.places[output].start

    def misfit(self, sizes: Sequence[int]) -> str | None:
        """Return why a network of these layers does not fit these rows; None when it does."""
        if (sizes[0], sizes[-1]) == (self.width, self.output_width):
            return None
        return f"layers {list(sizes)}; expected {self.width} numbers in and {self.output_width} out"

    def input_rows(self, facts: Facts) -> Floats | None:
        """Return (n, width), or None when a variable is not among the facts or is no value of its channel."""
        return self._ins.rows(facts)

    def target_rows(self, facts: Facts) -> Floats | None:
        """Return (n, outputs) cut off at ±1, where models end, or None when a variable is not there."""
        rows = self._outs.rows(facts)
        return None if rows is None else np.minimum(np.maximum(rows, -1.0), 1.0)

    def predicted(self, outputs: Floats) -> Facts:
        """Return predicted outputs (n, output_width) as facts, in the variables' own units."""
        return {name: self._channels[name].decode(outputs[:, place]) for name, place in self._outs.places.items()}
