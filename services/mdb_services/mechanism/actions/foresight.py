"""What modes foresee of actions: the satisfaction that each promises, and how far the memory supports it.

A mode is a world model and what tells the satisfaction of what it predicts: a satisfaction model, or one of the
world model's own outputs (the trivial satisfaction model of the operation with teacher; paper, section 3).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.networks.encoding import Codebook, Facts, with_changes
from mdb_services.mechanism.networks.gaps import squared_gaps
from mdb_services.mechanism.networks.network import Floats, Network

GOOD_ERROR = 0.05
"""Mean squared, in scaled units: what a model has that has learnt well from a teacher who never errs (ours)."""


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
    `exploration`, and what promises most otherwise. What cannot be foreseen is not hoped for: the aspiration is less
    by its `shortfall`, the root of the mean squared error beyond `GOOD_ERROR` that the model has over its memory. So
    a teacher who errs is obeyed, and one who does not loses nothing. With `reach`, once all is supported, the
    shortfall, or a little doubt (`choice.DOUBT`), is also the greatest probability with which something is tried
    again: what is known and certain need not be.

    Of actions that promise about as much, at most `margin` less than the best, the most familiar one is taken: that
    whose foreseen effect has most pairs of the memory near it. A robot that obeys is praised for nearly all that it
    does. What is usual is told from what is seldom right by how often it was, and hardly by its feedback.

    `babbling` is the probability of any action at all, however content the mode is (as infants babble). A robot that
    always obeys sees good actions only, and a model from state and action to feedback cannot learn from these alone
    what is bad.
    """

    name: str
    world: str
    satisfaction: str
    aspiration: float | None = None
    exploration: float = 0.0
    reach: float | None = None
    curiosity: float = 0.0
    margin: float = 0.0
    babbling: float = 0.0

    def valued_by(self, outputs: Collection[str]) -> str:
        """Return the model that tells the satisfaction, given the outputs of the world model."""
        return self.world if self.satisfaction in outputs else self.satisfaction


class Known(NamedTuple):
    """A current model ready to use; support: inputs (n, inputs) of the pairs it was learnt from, None if not told."""

    codebook: Codebook
    network: Network
    support: Floats | None = None


Models = Mapping[str, Known]


class Foreseen(NamedTuple):
    """For each action (actions,): the satisfaction predicted, in scaled units, its support, 0 to 1, and how familiar
    it is: the number of the memory's pairs, of which those further away count less."""

    satisfaction: NDArray[np.float64]
    support: NDArray[np.float64]
    familiarity: NDArray[np.float64]

    @property
    def promise(self) -> NDArray[np.float64]:
        """What is believed of it (actions,)."""
        return self.satisfaction * self.support

    def best(self, margin: float) -> int:
        """Return the action that promises most, or with a margin the most familiar one of those about as good."""
        promise = self.promise
        if not margin:
            return int(np.argmax(promise))
        good = np.flatnonzero(promise >= promise.max() - margin)
        return int(max(good, key=lambda action: (self.familiarity[action], promise[action])))


def foresee(mode: Mode, models: Models, facts: Facts, tried: Facts) -> Foreseen | None:
    """Return what a mode foresees for each action, or None when an input is missing.

    `facts` holds what is known before acting, each of shape (1, ...); `tried` what is different for each action, each
    of shape (actions,). With `reach` the satisfaction is cut off at -1 and
    1, where targets end, and the support tells equals apart. Without, it is not: several actions often promise the
    most there is, and the first of equals, which would be taken, is no better than the others (ours; measured: it is
    what let the robot bump into the object).
    """
    world = models.get(mode.world)
    if world is None:
        return None
    actions = len(next(iter(tried.values())))
    known = {name: values.repeat(actions, axis=0) for name, values in facts.items()} | tried
    rows = world.codebook.input_rows(known)
    if rows is None:
        return None
    valued, output = world, 0
    if mode.satisfaction in world.codebook.outputs:
        output = world.codebook.column(mode.satisfaction)
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
        return Foreseen(sums, np.ones(actions), np.zeros(actions))
    near = nearness(rows, valued.support, mode.reach)
    return Foreseen(np.minimum(np.maximum(sums, -1), 1), near.max(axis=1, initial=0.0), near.sum(axis=1))


def nearness(rows: Floats, support: Floats, reach: float) -> NDArray[np.float64]:
    """Return how near each row (m, inputs) is to each pair, inputs (n, inputs): 1 at the pair, less beyond (m, n)."""
    return np.exp(-squared_gaps(rows, support).astype(np.float64) / reach**2)


def shortfall(mode: Mode, models: Models, errors: Mapping[str, float]) -> float:
    """Return by how much less is aspired to, for what the model that tells the satisfaction cannot foresee.

    errors: mean squared, each over its model's memory, in scaled units, by the model's name; unknown ones count as 0.
    """
    error = errors.get(mode.valued_by(models[mode.world].codebook.outputs), 0.0)
    return math.sqrt(max(error - GOOD_ERROR, 0.0))
