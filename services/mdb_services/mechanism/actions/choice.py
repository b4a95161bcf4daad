"""Choice of the current action: actions are tried in the models, the best is taken (paper, section 3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from mdb_services.mechanism.actions.foresight import Foreseen, Mode, Models, foresee, shortfall
from mdb_services.mechanism.actions.spaces import Space, Values
from mdb_services.mechanism.networks.encoding import Facts

RANDOM_MODE = "random"
"""The mode when no model pair applies."""
SUPPORTED = 0.5
"""What has as much support as this has been tried, or its like has (ours)."""
DOUBT = 0.1
"""Of times that a mode is not content although all is known and certain, something is tried again in so many (ours):
a command may have been misjudged once, and a robot that believes it would never find out."""
ALIKE = 1e-6
"""Hopes that differ by less are equal."""


@dataclass(frozen=True)
class Choice:
    """The action taken, which choice it is (None: a point in a range), in which mode, whether to explore, and the
    satisfaction foreseen for it."""

    action: Values
    choice: int | None
    mode: str
    explored: bool
    predicted: float | None


def choose(
    modes: Sequence[Mode],
    models: Models,
    facts: Facts,
    space: Space,
    *,
    note: int | None,
    rng: np.random.Generator,
    errors: Mapping[str, float] | None = None,
    forced_exploration: bool = False,
) -> Choice:
    """Return the choice of the first mode whose inputs are present; a random action when none is.

    `facts` holds what is known before acting, `note` among it; `errors` those of the models, see `shortfall`. Forced
    exploration is uniformly random (paper, section 3), and so is babbling; how a mode that is not content explores is
    told in `Mode`.
    """
    explores, other = rng.random(), space.random(rng)
    for mode in modes:
        foresees = partial(foresee, mode, models, facts)
        babbles = mode.babbling > 0 and rng.random() < mode.babbling
        if forced_exploration or babbles:
            if (predicted := foresees(other)) is not None:
                return _chosen(space, other, 0, mode.name, explored=True, foreseen=predicted)
            continue
        looked = space.look(foresees, rng)
        if looked is None:
            continue
        actions, foreseen = looked
        place, another = foreseen.best(mode.margin), None
        if mode.aspiration is not None:
            less = shortfall(mode, models, errors or {})
            if foreseen.promise.max() < mode.aspiration - less:
                known = mode.reach is not None and foreseen.support.min() >= SUPPORTED
                again = min(mode.exploration, max(less, DOUBT)) if known else mode.exploration
                longest_ago = space.longest_ago(note, actions) if explores < again else None
                another = _another(mode, foreseen, longest_ago, rng)
        explored = another is not None
        place = place if another is None else another
        return _chosen(space, actions, place, mode.name, explored=explored, foreseen=foreseen)
    return _chosen(space, other, 0, RANDOM_MODE, explored=True, foreseen=None)


def _chosen(
    space: Space, actions: Facts, place: int, mode: str, *, explored: bool, foreseen: Foreseen | None
) -> Choice:
    predicted = None if foreseen is None else float(foreseen.satisfaction[place])
    return Choice(space.values(actions, place), space.choice(actions, place), mode, explored, predicted)


def _another(mode: Mode, foreseen: Foreseen, longest_ago: np.ndarray | None, rng: np.random.Generator) -> int | None:
    """Return what a mode that is not content tries in the place of what promises most; None: nothing else."""
    hopes = foreseen.promise + mode.curiosity * np.sqrt(1 - foreseen.support)
    if hopes[np.argmax(foreseen.promise)] < hopes.max() - ALIKE:
        return int(rng.choice(np.flatnonzero(hopes >= hopes.max() - ALIKE)))
    return None if longest_ago is None else int(rng.choice(longest_ago))
