"""Choice of the current action: every action is tried in the models, the best is taken (paper, section 3).

A mode is a world model and what tells the satisfaction of what it predicts: a satisfaction model, or one
of the world model's own outputs (the trivial satisfaction model of the operation with teacher).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.encoding import Codebook, Facts, with_changes
from mdb_services.mechanism.network import Network

RANDOM = "random"
"""The mode when no model pair applies, or while exploration is forced."""

GOOD_ERROR = 0.05
"""Mean squared, in scaled units: what a model has that has learnt well from a teacher who never errs (ours)."""


@dataclass(frozen=True)
class Mode:
    """One pair of models that can act. `satisfaction` is a model's name or an output of the world model.

    While the best predicted satisfaction is below `aspiration`, the action that was tried longest ago under this
    command is taken with probability `exploration` (ours: without it a robot that obeys wrongly sees only what it
    does wrongly, and a uniformly random action can miss the right one for hundreds of iterations). What cannot be
    foreseen is not aspired to: the aspiration is less by the root of the mean squared error beyond `GOOD_ERROR` that
    the model has over its memory. So a teacher who errs is obeyed, and one who does not loses nothing.
    """

    name: str
    world: str
    satisfaction: str
    aspiration: float | None = None
    exploration: float = 0.0


@dataclass(frozen=True)
class Choice:
    """The action taken, in which mode, whether to explore, and the satisfaction foreseen for it."""

    action: int
    mode: str
    explored: bool
    predicted: float | None


Models = Mapping[str, tuple[Codebook, Network]]


def satisfactions(mode: Mode, models: Models, facts: Facts, actions: int) -> NDArray[np.float64] | None:
    """Return the satisfaction foreseen for each action (actions,), or None when an input is missing.

    `facts` holds what is known before acting, each of shape (1,). The satisfaction is not cut off at the
    models' bound: several actions often promise the most there is, and the first of equals, which would be
    taken, is no better than the others (ours; measured: it is what let the robot bump into the object).
    """
    if mode.world not in models:
        return None
    codebook, world = models[mode.world]
    known = {name: np.repeat(values, actions) for name, values in facts.items()}
    known["action"] = np.arange(actions, dtype=np.float64)
    rows = codebook.input_rows(known)
    if rows is None:
        return None
    if mode.satisfaction in codebook.outputs:
        return codebook.predicted(world.sums(rows))[mode.satisfaction]
    known |= codebook.predicted(world.predict(rows))
    if mode.satisfaction not in models:
        return None
    codebook, satisfaction = models[mode.satisfaction]
    rows = codebook.input_rows(with_changes(known))
    return None if rows is None else satisfaction.sums(rows)[:, 0].astype(np.float64)


def aspired(mode: Mode, models: Models, errors: Mapping[str, float]) -> float:
    """Return what the best action must promise for a mode to be content, with these errors of the models.

    errors: mean squared, each over its model's memory, in scaled units, by the model's name; unknown ones count as 0.
    """
    if mode.aspiration is None:
        return -math.inf
    of_world = mode.satisfaction in models[mode.world][0].outputs
    error = errors.get(mode.world if of_world else mode.satisfaction, 0.0)
    return mode.aspiration - math.sqrt(max(error - GOOD_ERROR, 0.0))


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
    the models, see `aspired`. Forced exploration is uniformly random (paper, section 3); a dissatisfied mode explores
    what was tried longest ago.
    """
    explores, other = rng.random(), int(rng.integers(tried.size))
    for mode in modes:
        foreseen = satisfactions(mode, models, facts, tried.size)
        if foreseen is None:
            continue
        best = int(np.argmax(foreseen))
        dissatisfied = foreseen[best] < aspired(mode, models, errors or {})
        explored = forced_exploration or (dissatisfied and explores < mode.exploration)
        action = best
        if forced_exploration:
            action = other
        elif explored:
            action = int(rng.choice(np.flatnonzero(tried == tried.min())))
        return Choice(action, mode.name, explored, float(foreseen[action]))
    return Choice(other, RANDOM, True, None)
