"""From what was sensed, heard, done and felt to the rows that models learn, and back (ours).

Variables of an action-perception pair, by name: a sensor's name before the action (`distance`), after it
(`next.distance`), the relative change (`covered.distance`: before minus after), and `note`, `action`,
`feedback`. A variable that was not there is absent from the facts, and no model that needs it gets a row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Facts = dict[str, NDArray[np.float64]]
"""Variable name to its values, shape (n,): one a case."""

Encoding = Literal["scalar", "one_hot", "rank"]


@dataclass(frozen=True, kw_only=True)
class Channel:
    """How one variable becomes numbers in about [-1, 1].

    `scalar` maps `low`..`high` to -1..1; `rank` maps an index to the place of its value among the sorted
    `values`; `one_hot` gives `size` columns, 1 for the index and 0 elsewhere.
    """

    encoding: Encoding = "scalar"
    low: float = -1.0
    high: float = 1.0
    size: int = 0
    values: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.encoding == "scalar" and not self.low < self.high:
            raise ValueError(f"low {self.low} and high {self.high}: expected low < high")
        if self.encoding == "one_hot" and self.size < 1:
            raise ValueError(f"size {self.size}: a one_hot channel needs its number of values")
        if self.encoding == "rank" and len(self.values) < 2:
            raise ValueError(f"{len(self.values)} values: a rank channel needs the value of each index")

    @property
    def width(self) -> int:
        """Columns in a row."""
        return self.size if self.encoding == "one_hot" else 1

    def encode(self, values: NDArray[np.float64]) -> Floats:
        """Return (n, width) float32 of values (n,)."""
        if self.encoding == "one_hot":
            columns = np.arange(self.size)
            return (values[:, None] == columns).astype(np.float32)
        if self.encoding == "rank":
            places = np.argsort(np.argsort(np.asarray(self.values), kind="stable"), kind="stable")
            scaled = places[values.astype(np.intp)] * (2.0 / (len(self.values) - 1)) - 1.0
        else:
            scaled = (values - self.low) * (2.0 / (self.high - self.low)) - 1.0
        return np.clip(scaled, -1.5, 1.5).astype(np.float32)[:, None]

    def decode(self, column: Floats) -> NDArray[np.float64]:
        """Return the values (n,) of a scalar column (n,)."""
        if self.encoding != "scalar":
            raise ValueError(f"a {self.encoding} channel cannot be a model's output; use scalar")
        return (column.astype(np.float64) + 1.0) * (0.5 * (self.high - self.low)) + self.low


def gather(
    *,
    before: Mapping[str, float] | None = None,
    after: Mapping[str, float] | None = None,
    note: float | None = None,
    action: float | None = None,
    feedback: float | None = None,
) -> Facts:
    """Return the facts of one pair, each of shape (1,); what is None or missing is absent."""
    facts: Facts = {}
    for name, value in (before or {}).items():
        facts[name] = np.array([value])
    for name, value in (after or {}).items():
        facts[f"next.{name}"] = np.array([value])
    for name, given in (("note", note), ("action", action), ("feedback", feedback)):
        if given is not None:
            facts[name] = np.array([float(given)])
    return with_changes(facts)


def with_changes(facts: Facts) -> Facts:
    """Add `covered.NAME` (before minus after) for every sensor that is known before and after."""
    for name in [name for name in facts if f"next.{name}" in facts]:
        facts[f"covered.{name}"] = facts[name] - facts[f"next.{name}"]
    return facts


class Codebook:
    """Inputs and outputs of one model: which variables, how encoded, in which columns."""

    def __init__(
        self, channels: Mapping[str, Channel], inputs: Sequence[str], outputs: Sequence[str]
    ) -> None:
        """Take the channels by variable name. KeyError, ValueError when a variable has no usable channel."""
        for name in (*inputs, *outputs):
            if name not in channels:
                raise KeyError(f"variable {name!r} has no channel; channels are {', '.join(sorted(channels))}")
        self.inputs, self.outputs = tuple(inputs), tuple(outputs)
        self._channels = {name: channels[name] for name in (*inputs, *outputs)}
        if any(channels[name].encoding != "scalar" for name in outputs):
            raise ValueError(f"outputs {list(outputs)}: a model's outputs must be scalar channels")

    @property
    def width(self) -> int:
        """Columns of an input row."""
        return sum(self._channels[name].width for name in self.inputs)

    def input_rows(self, facts: Facts) -> Floats | None:
        """Return (n, width), or None when a variable is not among the facts."""
        return self._rows(self.inputs, facts)

    def target_rows(self, facts: Facts) -> Floats | None:
        """Return (n, outputs) cut off at ±1, where models end, or None when a variable is not there."""
        rows = self._rows(self.outputs, facts)
        return None if rows is None else np.clip(rows, -1.0, 1.0)

    def _rows(self, names: tuple[str, ...], facts: Facts) -> Floats | None:
        if any(name not in facts for name in names):
            return None
        return np.concatenate([self._channels[name].encode(facts[name]) for name in names], axis=1)

    def predicted(self, outputs: Floats) -> Facts:
        """Return predicted outputs (n, outputs) as facts, in the variables' own units."""
        return {name: self._channels[name].decode(outputs[:, i]) for i, name in enumerate(self.outputs)}
