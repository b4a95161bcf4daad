"""The short-term memory of one model, its replacement strategy, and a follower's mirror of it.

The memory holds the most relevant action-perception pairs, as rows of one model's inputs and targets (paper,
section 2.2; the strategy is in its reference 12 and ours in detail). Each pair carries a label

    L = Kt * T + Kd * d + Kc * C + Kr * R

and the pair with the lowest leaves when the memory is full: T recency, d distance to the nearest other pair, C the
current model's error on the pair, R the error when it entered. The distance is over the inputs, so that of pairs
contradicting each other the older leaves, or over inputs and targets: then both stay, as they must where the inputs
do not tell everything (ours: a robot that obeys feels few punishments, and a model that forgets them promises too
much for what it no longer knows). Each term is scaled to [0, 1] over the stored pairs. Kt = 1 and the
rest 0 is first in, first out. The newcomer itself is never the one that leaves.

When the context has changed (`context.py`), the weights are those of the temporal setting until the new context
is known, and what is older than the change can be dropped at once.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.networks.network import Floats

Ids = NDArray[np.int64]
NOBODY = -1
"""In the place of the nearest other pair's slot, where there is none."""
TOGETHER = 2**16
"""Numbers of the differences between pairs that are taken at once: as many as stay in the processor's cache."""


class VersionGapError(ValueError):
    """A change does not follow the mirror's version: changes were missed, ask for the whole memory."""


@dataclass(frozen=True, kw_only=True)
class MemoryConfig:
    """The weights of the label's terms."""

    recency: float = 1.0
    """Kt: keep what came last."""
    distance: float = 0.0
    """Kd: keep what is unlike all others."""
    outcome: float = 0.0
    """How much the targets count in that distance, where the inputs count 1: above 0, two pairs that began alike and
    ended differently are unlike, and both stay."""
    current_error: float = 0.0
    """Kc: keep what the current model predicts badly."""
    entry_error: float = 0.0
    """Kr: keep what was badly predicted when it came."""

    def __post_init__(self) -> None:
        weights = (self.recency, self.distance, self.current_error, self.entry_error)
        if not all(0 <= weight < np.inf for weight in weights) or sum(weights) == 0:
            raise ValueError(f"label weights are {weights}; expected none negative and one positive at least")
        if not 0 <= self.outcome < np.inf:
            raise ValueError(f"outcome is {self.outcome}; expected 0, or a positive number")


@dataclass(frozen=True)
class Change:
    """One step from a version to the next: which slots were written with which pairs, which were emptied."""

    version: int
    slots: tuple[int, ...]
    """Slots written, in the order of `ids` and of the rows that come with the change."""
    ids: tuple[int, ...]
    evicted: tuple[int, ...]
    """Ids of the pairs that left."""
    freed: tuple[int, ...] = ()
    """Slots that are empty from now on."""


class MemoryMirror:
    """The rows of a short-term memory, kept by applying its changes in order: all that a follower needs."""

    def __init__(self, capacity: int, inputs: int, outputs: int) -> None:
        if min(capacity, inputs, outputs) < 1:
            given = (capacity, inputs, outputs)
            raise ValueError(f"capacity, inputs, outputs are {given}; expected 1 or more each")
        self.capacity = capacity
        self.version = 0
        self._used = np.zeros(capacity, dtype=bool)
        self._inputs = np.zeros((capacity, inputs), dtype=np.float32)
        self._targets = np.zeros((capacity, outputs), dtype=np.float32)
        self._ids = np.zeros(capacity, dtype=np.int64)

    def __len__(self) -> int:
        return int(np.count_nonzero(self._used))

    @property
    def slots(self) -> Ids:
        """Return the slots in use (n,), in order; all arrays of pairs are in this order."""
        return np.flatnonzero(self._used)

    def arrays(self) -> tuple[Floats, Floats, Ids]:
        """Return copies of inputs (n, inputs), targets (n, outputs) and ids (n,), in slot order."""
        slots = self.slots
        return self._inputs.take(slots, axis=0), self._targets.take(slots, axis=0), self._ids[slots]

    def apply(self, change: Change, inputs: NDArray[Any], targets: NDArray[Any]) -> None:
        """Take over one change with its rows, inputs (k, inputs) and targets (k, outputs).

        Raises VersionGapError when changes were missed, ValueError when it cannot be; then nothing is changed.
        """
        if change.version != self.version + 1:
            raise VersionGapError(
                f"change to version {change.version} on a memory of version {self.version}; expected "
                f"{self.version + 1}: ask for the whole memory"
            )
        touched = (*change.slots, *change.freed)
        if len(set(touched)) < len(touched) or not all(0 <= slot < self.capacity for slot in touched):
            raise ValueError(
                f"change touches slots {touched} of {self.capacity}; expected each once and within: "
                "the change is damaged, ask for the whole memory"
            )
        count = len(change.slots)
        if len(change.ids) != count:
            raise ValueError(f"change has ids {change.ids} for slots {change.slots}; expected as many of each")
        input_rows = _rows(inputs, (count, self._inputs.shape[1]), "input rows")
        target_rows = _rows(targets, (count, self._targets.shape[1]), "target rows")
        written = list(change.slots)
        self._inputs[written], self._targets[written] = input_rows, target_rows
        self._ids[written] = change.ids
        self._used[written] = True
        self._used[list(change.freed)] = False
        self.version = change.version

    def state(self) -> dict[str, NDArray[Any]]:
        """Return copies of the stored rows, their slots and ids, and the version."""
        inputs, targets, ids = self.arrays()
        version = np.array(self.version, dtype=np.int64)
        return {"inputs": inputs, "targets": targets, "ids": ids, "slots": self.slots, "version": version}

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
        slots = state["slots"]
        if not ((slots >= 0) & (slots < self.capacity)).all() or len(np.unique(slots)) < count:
            raise ValueError(
                f"state holds {count} pairs in slots up to {slots.max(initial=0)}, the memory has {self.capacity}: "
                "make it with that capacity"
            )
        self.version = int(state["version"])
        self._used[:] = False
        self._used[slots] = True
        self._inputs[slots], self._targets[slots] = state["inputs"], state["targets"]
        self._ids[slots] = state["ids"]


class ShortTermMemory(MemoryMirror):
    """The memory's owner: decides which pair leaves when a new one comes."""

    def __init__(self, capacity: int, inputs: int, outputs: int, config: MemoryConfig) -> None:
        super().__init__(capacity, inputs, outputs)
        self.config = config
        self._orders = np.zeros(capacity, dtype=np.int64)
        self._entry_errors = np.zeros(capacity)
        self._gaps = np.full(capacity, np.inf, dtype=np.float32)
        """Squared distance of each slot's pair to the nearest other; infinite where there is none."""
        self._neighbours = np.full(capacity, NOBODY)
        """The slot of that nearest other."""

    def configure(self, config: MemoryConfig) -> None:
        """Change the label's weights, say to the temporal setting when the context has changed."""
        measured_anew = config.outcome != self.config.outcome
        self.config = config
        if measured_anew:
            self._look_around_all()

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
        if (self._used & (self._ids == id)).any():
            return None
        if not np.isfinite(error_at_entry):
            raise ValueError(f"error at entry is {error_at_entry}; expected a finite number: predict the pair first")
        row = _rows(np.asarray(input_row)[None], (1, self._inputs.shape[1]), "input row")
        targets = _rows(np.asarray(target_row)[None], (1, self._targets.shape[1]), "target row")
        (apart,) = self._distances(row, targets)
        full = len(self) == self.capacity
        slot = self._lowest(apart, errors_now) if full else int(self._used.argmin())
        evicted = (int(self._ids[slot]),) if full else ()
        change = Change(self.version + 1, (slot,), (id,), evicted)
        self._inputs[slot], self._targets[slot], self._ids[slot], self._used[slot] = row[0], targets[0], id, True
        self._orders[slot], self._entry_errors[slot] = change.version, error_at_entry
        self.version = change.version
        left = np.flatnonzero(self._neighbours == slot)
        self._come_near(slot, apart)
        self._look_around(left)
        return change

    def since(self, version: int) -> tuple[Floats, Floats, NDArray[np.float64]]:
        """Return inputs (n, inputs), targets (n, outputs) and errors at entry (n,) of what entered since `version`.

        That version's pair included, recalled pairs (negative ids) not, the oldest first.
        """
        slots = np.flatnonzero(self._used & (self._orders >= version) & (self._ids >= 0))
        slots = slots[np.argsort(self._orders[slots], kind="stable")]
        return self._inputs[slots], self._targets[slots], self._entry_errors[slots]

    def begin_context(
        self, first: int, ids: tuple[int, ...] = (), inputs: NDArray[Any] | None = None, targets: Any = None
    ) -> Change:
        """Drop what entered before version `first`, and what was recalled; store recalled pairs; return what changed.

        ids (k,), inputs (k, inputs) and targets (k, outputs) are pairs of the context that came back, from the
        long-term memory; of more than there is room for the last are left out. With `first` 0 nothing is dropped.
        """
        stays = self._used & (self._orders >= first) & (self._ids >= 0) if first else self._used
        free = np.flatnonzero(~stays)
        ids = ids[: len(free)]
        slots = tuple(int(slot) for slot in free[: len(ids)])
        leaving = self._used & ~stays
        freed = tuple(int(slot) for slot in np.flatnonzero(leaving) if slot not in slots)
        evicted = tuple(int(id) for id in self._ids[leaving])
        change = Change(self.version + 1, slots, ids, evicted, freed)
        rows = self._inputs[:0], self._targets[:0]
        if inputs is not None:
            rows = inputs[: len(ids)], targets[: len(ids)]
        self.apply(change, *rows)
        for slot in change.slots:
            self._orders[slot], self._entry_errors[slot] = change.version, 0.0
        self._look_around_all()
        return change

    def _come_near(self, slot: int, apart: Floats) -> None:
        """Tell all pairs of a new one in a slot, and it of the nearest; it is `apart` (capacity,) from them."""
        apart[~self._used] = apart[slot] = np.inf
        nearer = apart < self._gaps
        self._gaps[nearer], self._neighbours[nearer] = apart[nearer], slot
        nearest = int(apart.argmin())
        self._gaps[slot] = apart[nearest]
        self._neighbours[slot] = nearest if math.isfinite(apart[nearest]) else NOBODY

    def _look_around_all(self) -> None:
        """Find the nearest other pair of each."""
        self._gaps[:], self._neighbours[:] = np.inf, NOBODY
        self._look_around(self.slots)

    def _look_around(self, slots: Ids) -> None:
        """Find the nearest other pair of each of these slots: of few after an insert, so that it takes O(n)."""
        most = max(1, TOGETHER // self._inputs.size)
        for first in range(0, len(slots), most):
            some = slots[first : first + most]
            gaps = self._apart(some)
            nearest = gaps.argmin(axis=1)
            self._gaps[some] = smallest = gaps[np.arange(len(some)), nearest]
            self._neighbours[some] = np.where(np.isfinite(smallest), nearest, NOBODY)

    def _apart(self, slots: NDArray[Any]) -> Floats:
        """Return the squared distances (k, capacity) of the pairs in k slots to all others; infinite without one."""
        apart = self._distances(self._inputs[slots], self._targets[slots])
        apart[:, ~self._used] = np.inf
        apart[np.arange(len(slots)), slots] = np.inf
        return apart

    def _distances(self, rows: Floats, targets: Floats) -> Floats:
        """Return the squared distances (k, capacity) of k rows and targets to what all slots hold."""
        apart = _squared(rows, self._inputs)
        if self.config.outcome:
            apart += np.float32(self.config.outcome) * _squared(targets, self._targets)
        return apart

    def labels(self, errors_now: NDArray[Any] | None = None) -> NDArray[np.float64]:
        """Return the label of each stored pair, in slot order."""
        return self._labels(self._gaps, errors_now)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return copies of all arrays from which `restore` continues identically."""
        own = {"orders": self._orders[self._used], "entry_errors": self._entry_errors[self._used]}
        return super().state() | own

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from what `state` gave; raises ValueError when it does not fit."""
        super().restore(state)
        slots = state["slots"]
        self._orders[slots], self._entry_errors[slots] = state["orders"], state["entry_errors"]
        self._look_around_all()

    def _lowest(self, apart: Floats, errors_now: NDArray[Any] | None) -> int:
        """Return the slot of the pair that leaves for one `apart` (capacity,) from all; of equals the oldest."""
        labels = self._labels(np.minimum(self._gaps, apart), errors_now)
        lowest = np.flatnonzero(labels == labels.min())
        slots = self.slots[lowest]
        return int(slots[self._orders[slots].argmin()])

    def _labels(self, gaps: Floats, errors_now: NDArray[Any] | None) -> NDArray[np.float64]:
        """Return the labels of pairs with these squared distances (capacity,) to their nearest others."""
        config = self.config
        labels = np.zeros(len(self))
        if config.recency:
            orders = self._orders[self._used]
            labels += config.recency * _scaled((orders - orders.min(initial=self.version)).astype(np.float64))
        if config.distance:
            labels += config.distance * _scaled(np.sqrt(gaps[self._used].astype(np.float64)))
        if config.current_error and errors_now is not None:
            errors = _rows(errors_now, (len(self),), "errors now")
            labels += config.current_error * _scaled(errors.astype(np.float64))
        if config.entry_error:
            labels += config.entry_error * _scaled(self._entry_errors[self._used])
        return labels


def _squared(ones: Floats, others: Floats) -> Floats:
    """Return the squared distances (k, n) of k rows to n others."""
    difference = others - ones[:, None]
    squared: Floats = np.einsum("kij,kij->ki", difference, difference)
    return squared


def _scaled(term: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a term that is nowhere negative over its largest finite value; infinite counts as one."""
    largest = term.max(initial=0.0)
    if 0 < largest < np.inf:
        shares: NDArray[np.float64] = term / largest
        return shares
    largest = term[np.isfinite(term)].max(initial=0.0)
    return np.minimum(term / largest, 1.0) if largest > 0 else np.where(term > 0, 1.0, 0.0)


def _rows(values: NDArray[Any], shape: tuple[int, ...], what: str) -> Floats:
    rows = np.asarray(values, dtype=np.float32)
    if rows.shape != shape or not np.isfinite(rows).all():
        raise ValueError(f"{what} have shape {rows.shape}; expected finite numbers of shape {shape}")
    return rows
