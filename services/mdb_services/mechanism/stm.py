"""The short-term memory of one model, its replacement strategy, and a follower's mirror of it.

The memory holds the most relevant action-perception pairs, as rows of one model's inputs and targets (paper,
section 2.2; the strategy is in its reference 12 and ours in detail). Each pair carries a label

    L = Kt * T + Kd * d + Kc * C + Kr * R

and the pair with the lowest leaves when the memory is full: T recency, d distance in input space to the
nearest other pair (so that of pairs contradicting each other the older leaves), C the current model's error
on the pair, R the error when it entered. Each term is scaled to [0, 1] over the stored pairs. Kt = 1 and the
rest 0 is first in, first out. The newcomer itself is never the one that leaves.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.network import Floats

Ids = NDArray[np.int64]


class VersionGapError(ValueError):
    """A change does not follow the mirror's version: changes were missed, ask for the whole memory."""


@dataclass(frozen=True, kw_only=True)
class MemoryConfig:
    """The weights of the label's terms."""

    recency: float = 1.0
    """Kt: keep what came last."""
    distance: float = 0.0
    """Kd: keep what is unlike all others."""
    current_error: float = 0.0
    """Kc: keep what the current model predicts badly."""
    entry_error: float = 0.0
    """Kr: keep what was badly predicted when it came."""

    def __post_init__(self) -> None:
        weights = (self.recency, self.distance, self.current_error, self.entry_error)
        if not all(0 <= weight < np.inf for weight in weights) or sum(weights) == 0:
            raise ValueError(f"label weights are {weights}; expected none negative and one positive at least")


@dataclass(frozen=True)
class Change:
    """What one insert did: the new version, the slot written, the pair's id, the id of the pair that left."""

    version: int
    slot: int
    id: int
    evicted_id: int | None


class MemoryMirror:
    """The rows of a short-term memory, kept by applying its changes in order: all that a follower needs."""

    def __init__(self, capacity: int, inputs: int, outputs: int) -> None:
        if min(capacity, inputs, outputs) < 1:
            given = (capacity, inputs, outputs)
            raise ValueError(f"capacity, inputs, outputs are {given}; expected 1 or more each")
        self.capacity = capacity
        self.version = 0
        self._size = 0
        self._inputs = np.zeros((capacity, inputs), dtype=np.float32)
        self._targets = np.zeros((capacity, outputs), dtype=np.float32)
        self._ids = np.zeros(capacity, dtype=np.int64)

    def __len__(self) -> int:
        return self._size

    def arrays(self) -> tuple[Floats, Floats, Ids]:
        """Return copies of inputs (n, inputs), targets (n, outputs) and ids (n,), in slot order."""
        n = self._size
        return self._inputs[:n].copy(), self._targets[:n].copy(), self._ids[:n].copy()

    def apply(self, change: Change, input_row: NDArray[Any], target_row: NDArray[Any]) -> None:
        """Write one change. Raises VersionGapError when changes were missed, ValueError when it cannot be."""
        if change.version != self.version + 1:
            raise VersionGapError(
                f"change to version {change.version} on a memory of version {self.version}; expected "
                f"{self.version + 1}: ask for the whole memory"
            )
        if not 0 <= change.slot <= min(self._size, self.capacity - 1):
            raise ValueError(
                f"change writes slot {change.slot} of a memory of {self._size} pairs; expected "
                "one in use or the next: the change is damaged, ask for the whole memory"
            )
        self._inputs[change.slot] = _row(input_row, self._inputs.shape[1], "input row")
        self._targets[change.slot] = _row(target_row, self._targets.shape[1], "target row")
        self._ids[change.slot] = change.id
        self._size = max(self._size, change.slot + 1)
        self.version = change.version

    def state(self) -> dict[str, NDArray[Any]]:
        """Return copies of the stored rows, their ids and the version."""
        inputs, targets, ids = self.arrays()
        version = np.array(self.version, dtype=np.int64)
        return {"inputs": inputs, "targets": targets, "ids": ids, "version": version}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over the state of a mirror or of a `ShortTermMemory`; raises ValueError when it does not fit."""
        missing = self.state().keys() - state.keys()
        if missing:
            raise ValueError(f"state lacks {sorted(missing)}: it is not of a memory of this kind")
        count = len(state["ids"])
        shapes = {name: (count, *array.shape[1:]) for name, array in self.state().items() if array.ndim}
        for name, shape in shapes.items():
            given = state[name]
            if given.shape != shape or not np.isfinite(given).all():
                raise ValueError(f"{name} have shape {given.shape}; expected finite numbers of shape {shape}")
        if count > self.capacity:
            raise ValueError(f"state holds {count} pairs, the memory {self.capacity}: make it with that capacity")
        self._size, self.version = count, int(state["version"])
        self._inputs[:count], self._targets[:count] = state["inputs"], state["targets"]
        self._ids[:count] = state["ids"]


class ShortTermMemory(MemoryMirror):
    """The memory's owner: decides which pair leaves when a new one comes."""

    def __init__(self, capacity: int, inputs: int, outputs: int, config: MemoryConfig) -> None:
        super().__init__(capacity, inputs, outputs)
        self.config = config
        self._orders = np.zeros(capacity, dtype=np.int64)
        self._entry_errors = np.zeros(capacity)
        self._distances = np.full((capacity, capacity), np.inf, dtype=np.float32)

    def configure(self, config: MemoryConfig) -> None:
        """Change the label's weights, say to the temporal setting when the context has changed."""
        self.config = config

    def insert(
        self,
        id: int,
        input_row: NDArray[Any],
        target_row: NDArray[Any],
        error_at_entry: float,
        errors_now: NDArray[Any] | None = None,
    ) -> Change | None:
        """Store a pair and return what changed, or None when a pair with this id is stored already.

        errors_now (n,) are the current model's errors on the stored pairs in slot order; None counts as none.
        Raises ValueError when a row or an error is not finite or does not fit.
        """
        if id in self._ids[: self._size]:
            return None
        if not np.isfinite(error_at_entry):
            raise ValueError(f"error at entry is {error_at_entry}; expected a finite number: predict the pair first")
        row = _row(input_row, self._inputs.shape[1], "input row")
        gaps = self._gaps(row)
        full = self._size == self.capacity
        slot = self._lowest(gaps, errors_now) if full else self._size
        change = Change(self.version + 1, slot, id, int(self._ids[slot]) if full else None)
        self.apply(change, row, target_row)
        self._orders[slot], self._entry_errors[slot] = change.version, error_at_entry
        self._distances[slot, : gaps.size], self._distances[: gaps.size, slot] = gaps, gaps
        self._distances[slot, slot] = np.inf
        return change

    def labels(self, errors_now: NDArray[Any] | None = None) -> NDArray[np.float64]:
        """Return the label of each stored pair, in slot order."""
        return self._labels(np.full(self._size, np.inf, dtype=np.float32), errors_now)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return copies of all arrays from which `restore` continues identically."""
        n = self._size
        own = {"orders": self._orders[:n].copy(), "entry_errors": self._entry_errors[:n].copy()}
        return super().state() | own

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from what `state` gave; raises ValueError when it does not fit."""
        super().restore(state)
        n = self._size
        self._orders[:n], self._entry_errors[:n] = state["orders"], state["entry_errors"]
        for slot in range(n):
            self._distances[slot, :n] = self._gaps(self._inputs[slot])
            self._distances[slot, slot] = np.inf

    def _gaps(self, row: Floats) -> Floats:
        """Return the squared distances (n,) of a row to all stored ones, in input space."""
        difference = self._inputs[: self._size] - row
        squared: Floats = np.einsum("ij,ij->i", difference, difference)
        return squared

    def _lowest(self, gaps: Floats, errors_now: NDArray[Any] | None) -> int:
        labels = self._labels(gaps, errors_now)
        lowest = np.flatnonzero(labels == labels.min())
        return int(lowest[np.argmin(self._orders[lowest])])  # of equals the oldest

    def _labels(self, gaps: Floats, errors_now: NDArray[Any] | None) -> NDArray[np.float64]:
        """Return the labels, distances including those to a newcomer."""
        n, config = self._size, self.config
        labels = np.zeros(n)
        if config.recency:
            orders = self._orders[:n]
            labels += config.recency * _scaled((orders - orders.min(initial=self.version)).astype(np.float64))
        if config.distance:
            nearest = np.minimum(self._distances[:n, :n].min(axis=1, initial=np.inf), gaps)
            labels += config.distance * _scaled(np.sqrt(nearest.astype(np.float64)))
        if config.current_error and errors_now is not None:
            labels += config.current_error * _scaled(_row(errors_now, n, "errors now").astype(np.float64))
        if config.entry_error:
            labels += config.entry_error * _scaled(self._entry_errors[:n])
        return labels


def _scaled(term: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a term that is nowhere negative over its largest finite value; infinite counts as one."""
    largest = term[np.isfinite(term)].max(initial=0.0)
    return np.minimum(term / largest, 1.0) if largest > 0 else np.where(term > 0, 1.0, 0.0)


def _row(values: NDArray[Any], length: int, what: str) -> Floats:
    row = np.asarray(values, dtype=np.float32)
    if row.shape != (length,) or not np.isfinite(row).all():
        raise ValueError(f"{what} has shape {row.shape}; expected {length} finite numbers")
    return row
