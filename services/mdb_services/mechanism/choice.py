"""Choice of the current action: every action is tried in the models, the best is taken (paper, section 3).

A mode is a world model and what tells the satisfaction of what it predicts: a satisfaction model, or one
of the world model's own outputs (the trivial satisfaction model of the operation with teacher).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.networks.encoding import Codebook, Facts, with_changes
from mdb_services.mechanism.networks.network import Floats, Network

RANDOM = "random"
"""The mode when no model pair applies, or while exploration is forced."""

GOOD_ERROR = 0.05
"""Mean squared, in scaled units: what a model has that has learnt well from a teacher who never errs (ours)."""
SUPPORTED = 0.5
"""What has as much support as this has been tried, or its like has (ours)."""
ALIKE = 1e-6
"""Hopes that differ by less are equal."""


@dataclass(frozen=True)
class Mode:
    """One pair of models that can act. `satisfaction` is a model's name or an output of the world model.

    Satisfactions are in scaled units: -1 to 1 is the range of their channel. All of what follows is ours.

    A model is believed as far as its memory supports it. With `reach`, a predicted satisfaction counts by its support
    `exp(-(d / reach)^2)`, where d is the distance from the model's inputs to the nearest pair that it was learnt
    from, in scaled units: what nothing is known of promises 0, neither good nor bad. Without that, extrapolation
    decides what a robot does alone, and a new teacher's notes mean what the old one's meant until each was tried.

    While the best promise is below `aspiration`, something else is tried: what may be better by `curiosity` times
    `sqrt(1 - support)`. A graded reward for one wrong action so tells about its neighbours. Where nothing may be
    better, as where nothing at all is known of a command, it is what was tried longest ago under it, with probability
    `exploration`, and what promises most otherwise. What cannot be foreseen is not aspired to: the aspiration is less
    by its `shortfall`, the root of the mean squared error beyond `GOOD_ERROR` that the model has over its memory. So
    a teacher who errs is obeyed, and one who does not loses nothing. With `reach`, once all is supported, the
    shortfall is also the greatest probability with which something is tried again: what is known and certain need
    not be.
    """

    name: str
    world: str
    satisfaction: str
    aspiration: float | None = None
    exploration: float = 0.0
    reach: float | None = None
    curiosity: float = 0.0

    def valued_by(self, outputs: Collection[str]) -> str:
        """Return the model that tells the satisfaction, given the outputs of the world model."""
        return self.world if self.satisfaction in outputs else self.satisfaction


class Known(NamedTuple):
    """A current model ready to use; support: inputs (n, inputs) of the pairs it was learnt from, None if not told."""

    codebook: Codebook
    network: Network
    support: Floats | None = None


@dataclass(frozen=True)
class Choice:
    """The action taken, in which mode, whether to explore, and the satisfaction foreseen for it."""

    action: int
    mode: str
    explored: bool
    predicted: float | None


Models = Mapping[str, Known]


class Foreseen(NamedTuple):
    """For each action (actions,): the satisfaction predicted, in scaled units, and its support, 0 to 1."""

    satisfaction: NDArray[np.float64]
    support: NDArray[np.float64]

    @property
    def promise(self) -> NDArray[np.float64]:
        """What is believed of it (actions,)."""
        return self.satisfaction * self.support


def foresee(mode: Mode, models: Models, facts: Facts, actions: int) -> Foreseen | None:
    """Return what a mode foresees for each action, or None when an input is missing.

    `facts` holds what is known before acting, each of shape (1,). With `reach` the satisfaction is cut off at -1 and
    1, where targets end, and the support tells equals apart. Without, it is not: several actions often promise the
    most there is, and the first of equals, which would be taken, is no better than the others (ours; measured: it is
    what let the robot bump into the object).
    """
    world = models.get(mode.world)
    if world is None:
        return None
    known = {name: np.repeat(values, actions) for name, values in facts.items()}
    known["action"] = np.arange(actions, dtype=np.float64)
    rows = world.codebook.input_rows(known)
    if rows is None:
        return None
    valued, output = world, 0
    if mode.satisfaction in world.codebook.outputs:
        output = world.codebook.outputs.index(mode.satisfaction)
    else:
        known |= world.codebook.predicted(world.network.predict(rows))
        if mode.satisfaction not in models:
            return None
        valued = models[mode.satisfaction]
        rows = valued.codebook.input_rows(with_changes(known))
        if rows is None:
            return None
    sums = valued.network.sums(rows)[:, output].astype(np.float64)
    if mode.reach is None or valued.support is None:
        return Foreseen(sums, np.ones(actions))
    return Foreseen(np.clip(sums, -1, 1), supported(rows, valued.support, mode.reach))


def supported(rows: Floats, support: Floats, reach: float) -> NDArray[np.float64]:
    """Return how far pairs, inputs (n, inputs), support each row (m, inputs): 1 at a pair, less beyond (m,)."""
    nearest = [np.square(support - row).sum(axis=1).min(initial=np.inf) for row in rows]
    return np.exp(-np.array(nearest, dtype=np.float64) / reach**2)


def shortfall(mode: Mode, models: Models, errors: Mapping[str, float]) -> float:
    """Return by how much less is aspired to, for what the model that tells the satisfaction cannot foresee.

    errors: mean squared, each over its model's memory, in scaled units, by the model's name; unknown ones count as 0.
    """
    error = errors.get(mode.valued_by(models[mode.world].codebook.outputs), 0.0)
    return math.sqrt(max(error - GOOD_ERROR, 0.0))


def choose(
    modes: Sequence[Mode],
    models: Models,
    facts: Facts,
    tried: NDArray[np.int64],
    rng: np.random.Generator,
    *,
    errors: Mapping[str, float] | None = None,
    forced_exploration: bool = False,
) -> Choice:
    """Return the choice of the first mode whose inputs are present; a random action when none is.

    `tried` (actions,) tells the iteration in which each action was last taken under this command; `errors` those of
    the models, see `shortfall`. Forced exploration is uniformly random (paper, section 3); how a mode that is not
    content explores is told in `Mode`.
    """
    explores, other = rng.random(), int(rng.integers(tried.size))
    for mode in modes:
        foreseen = foresee(mode, models, facts, tried.size)
        if foreseen is None:
            continue
        action = int(np.argmax(foreseen.promise))
        another = other if forced_exploration else None
        if not forced_exploration and mode.aspiration is not None:
            less = shortfall(mode, models, errors or {})
            if foreseen.promise[action] < mode.aspiration - less:
                known = mode.reach is not None and foreseen.support.min() >= SUPPORTED
                again = min(mode.exploration, less) if known else mode.exploration
                another = _another(mode, foreseen, tried, rng, again=explores < again)
        explored = another is not None
        action = action if another is None else another
        return Choice(action, mode.name, explored, float(foreseen.satisfaction[action]))
    return Choice(other, RANDOM, True, None)


def _another(
    mode: Mode, foreseen: Foreseen, tried: NDArray[np.int64], rng: np.random.Generator, *, again: bool
) -> int | None:
    """Return what a mode that is not content tries in the place of what promises most; None: nothing else."""
    hopes = foreseen.promise + mode.curiosity * np.sqrt(1 - foreseen.support)
    if hopes[np.argmax(foreseen.promise)] < hopes.max() - ALIKE:
        return int(rng.choice(np.flatnonzero(hopes >= hopes.max() - ALIKE)))
    return int(rng.choice(np.flatnonzero(tried == tried.min()))) if again else None
