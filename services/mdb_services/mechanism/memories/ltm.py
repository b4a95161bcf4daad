"""The long-term memory of one model: networks that were good and stable, each with a sample of its context.

Paper, section 2.2: the long-term memory stores the models that gave successful and stable results, to be used
again directly or as seeds. When to store, when two models are the same and which is forgotten are ours.
Owns the decisions; where models are kept, and what a sample's pairs were, is its owner's business.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.networks.gaps import squared_gaps
from mdb_services.mechanism.networks.network import Floats, Network
from mdb_services.mechanism.settings import at_least, positive

ALL = 1000
"""Of no more rows than this all distances are computed at once."""


@dataclass(frozen=True, kw_only=True)
class LongTermConfig:
    """What is worth storing and what is recalled. Errors are mean squared, in the models' scaled units."""

    capacity: int = 20
    """Models stored; beyond it the least useful is forgotten. 0: no long-term memory."""
    good_error: float = 0.05
    """A model is good while the mean error on its last `stable_pairs` pairs, foreseen, is below this."""
    stable_pairs: int = 40
    """It is stored after having been good for so many pairs in succession, and stored anew as often."""
    sample: int = 40
    """Pairs of its context that are stored with it."""
    same_error: float = 0.05
    """A model knows what another knows when its error on the other's sample is larger by less than this than the
    other's own."""
    fit_error: float = 0.1
    """A stored model fits when its error on the newest pairs is below this: it then acts at once."""
    fit_pairs: int = 2
    """Pairs of a new context, at least, on which a stored model is tried."""
    missed_error: float = 0.2
    """A pair with a larger error is missed. After `fit_pairs` missed ones a stored model that fits acts, before the
    change is certain: a context that is known needs less evidence than a new one."""
    newest: int = 100
    """Pairs of a new context, at most, on which a stored model is tried."""
    seeds: int = 3
    """Stored models that enter the population when the context has changed, the best first."""

    def __post_init__(self) -> None:
        if self.capacity < 0 or self.seeds < 0:
            raise ValueError(f"capacity {self.capacity}, seeds {self.seeds}: expected none negative")
        at_least(self, stable_pairs=1, sample=1, fit_pairs=1)
        if self.newest < self.fit_pairs:
            raise ValueError(f"newest is {self.newest}; expected fit_pairs = {self.fit_pairs} or more")
        positive(self, "good_error", "same_error", "fit_error", "missed_error")


@dataclass(frozen=True)
class Stored:
    """A model in the long-term memory, with its sample: inputs (n, inputs), targets (n, outputs)."""

    id: int
    network: Network
    inputs: Floats
    targets: Floats
    uses: int = 0
    """How often it fitted after a change of context."""
    touched: int = 0
    """When it was last stored or used, in the owner's count, say of pairs."""


class Stability:
    """Whether a model has been good for a while: follows the errors on pairs that it has not learnt yet."""

    def __init__(self, config: LongTermConfig) -> None:
        self._config = config
        self._errors: deque[float] = deque(maxlen=config.stable_pairs)
        self._since = 0

    def begin(self) -> None:
        """Begin anew, as after a change of context."""
        self._errors.clear()
        self._since = 0

    def step(self, error: float) -> bool:
        """Take one error; return whether the model should be stored now."""
        self._errors.append(error)
        self._since += 1
        due = self._since >= self._config.stable_pairs and self.error < self._config.good_error
        if due:
            self._since = 0
        return due

    @property
    def error(self) -> float:
        """Return the mean of the last errors."""
        return sum(self._errors) / len(self._errors) if self._errors else 0.0


def sample_of(inputs: Floats, count: int) -> NDArray[np.intp]:
    """Return which `count` of the rows (n, inputs) are the most unlike one another, in order.

    One after the other, always the one farthest from those chosen, beginning with the first row. So the sample
    covers what is rare as well, wrong actions above all: a robot that obeys sees few of them.
    """
    if len(inputs) <= count:
        return np.arange(len(inputs))
    gaps, chosen = np.full(len(inputs), np.inf), [0]
    apart = squared_gaps(inputs, inputs) if len(inputs) <= ALL else None
    while len(chosen) < count:
        last = inputs[chosen[-1] : chosen[-1] + 1]
        np.minimum(gaps, squared_gaps(last, inputs)[0] if apart is None else apart[chosen[-1]], out=gaps)
        gaps[chosen[-1]] = -1.0
        chosen.append(int(gaps.argmax()))
    return np.sort(np.array(chosen, dtype=np.intp))


@dataclass(frozen=True)
class Trial:
    """How a stored model does on the newest pairs."""

    stored: Stored
    error: float
    fits: bool


class LongTermMemory:
    """Stored models by id; see the module's docstring."""

    def __init__(self, config: LongTermConfig) -> None:
        self.config = config
        self._stored: dict[int, Stored] = {}

    def __len__(self) -> int:
        return len(self._stored)

    def __iter__(self) -> Iterator[Stored]:
        return iter(self._stored.values())

    def restore(self, stored: Stored) -> None:
        """Take over a model that was stored before."""
        self._stored[stored.id] = stored

    def store(self, network: Network, inputs: Floats, targets: Floats, now: int) -> tuple[Stored, list[int]]:
        """Store a good and stable model with its sample; return how it is stored, and the ids that were forgotten.

        It replaces all that knew no more than it, and has their uses. If one knows all that it knows and more, that
        one stays as it is: it was learnt of the same context, and longer.
        """
        new = Stored(max(self._stored, default=0) + 1, network, inputs, targets)
        known = {old.id: old for old in self if self._knows(new, old)}
        others = [old for old in self if old.id not in known]
        better = next((old for old in others if self._knows(old, new)), None)
        if better is not None:
            self._stored[better.id] = replace(better, touched=now)
            return self._stored[better.id], []
        id, *doubles = known or [new.id]
        new = replace(new, id=id, uses=sum(old.uses for old in known.values()), touched=now)
        self._stored[id] = new
        others.sort(key=lambda old: (old.uses, old.touched))
        too_many = max(0, len(others) + 1 - self.config.capacity)
        forgotten = doubles + [old.id for old in others[:too_many]]
        for id in forgotten:
            del self._stored[id]
        return new, forgotten

    def _knows(self, one: Stored, other: Stored) -> bool:
        """Whether one model predicts the sample of another as well as that one does."""
        own = _error(other.network, other.inputs, other.targets)
        return _error(one.network, other.inputs, other.targets) - own < self.config.same_error

    def most_useful(self) -> Stored | None:
        """Return the model that fitted most often, of equals the newest; None when there is none."""
        return max(self, key=lambda stored: (stored.uses, stored.touched, stored.id), default=None)

    def trials(self, inputs: Floats, targets: Floats, before: int) -> list[Trial]:
        """Try the stored models on the newest pairs of a context, oldest first; the best model comes first.

        Only those last touched before a time, the context's beginning: what was stored since is of this very one.
        """
        if len(inputs) < self.config.fit_pairs:
            return []
        newest_inputs, newest_targets = inputs[-self.config.newest :], targets[-self.config.newest :]
        found = []
        for stored in (stored for stored in self if stored.touched < before):
            error = _error(stored.network, newest_inputs, newest_targets)
            found.append(Trial(stored, error, error < self.config.fit_error))
        return sorted(found, key=lambda trial: (trial.error, trial.stored.id))

    def use(self, id: int, now: int) -> Stored:
        """Count that a model fitted after a change; return it."""
        old = self._stored[id]
        self._stored[id] = replace(old, uses=old.uses + 1, touched=now)
        return self._stored[id]


def _error(network: Network, inputs: Floats, targets: Floats) -> float:
    """Return the mean squared error over the rows."""
    return float(np.mean(np.square(network.predict(inputs) - targets), dtype=np.float64))
