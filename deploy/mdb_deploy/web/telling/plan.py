"""What telling needs of an experiment, made once: modes, codebooks, actions by name, what the notes mean.

Pure. An experiment whose policy cannot be had here (its package is not installed) is told without it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdb_protocol.errors import MdbError
from mdb_services.mechanism.actions.foresight import Mode
from mdb_services.mechanism.networks.encoding import Codebook, Facts
from mdb_sim.runs.experiment import Experiment
from mdb_sim.teaching.languages import Language
from mdb_sim.teaching.policy import Policy
from mdb_sim.teaching.schedule import Schedule

MOST_SHOWN = 15
"""Actions of a range that are shown."""
LOOKED_AT = 200
"""Points of a range of which is computed what is foreseen."""

Doubles = NDArray[np.float64]


class Plan:
    """See the module's docstring."""

    def __init__(self, experiment: Experiment) -> None:
        self.experiment, self.brain = experiment, experiment.brain
        self.modes: dict[str, Mode] = {mode.name: mode for mode in self.brain.modes()}
        self.variables = self.brain.variables()
        self.books = {m.name: Codebook(self.variables, m.inputs, m.outputs) for m in self.brain.model}
        self.notes = (self.variables["note"].indices or 0) if "note" in self.variables else 0
        self.schedule = _schedule(experiment)
        self.policy = _policy(experiment)
        self.languages: dict[str, Language] = {}
        for phase in () if self.schedule is None else self.schedule.phases:
            if phase.teacher is not None and phase.language is not None:
                self.languages[phase.teacher] = phase.language
        self.actuators = tuple(self.brain.actuators)
        values = [tuple(choice.values[name] for name in self.actuators) for choice in self.brain.choice]
        self.order = sorted(range(len(values)), key=lambda place: (values[place], place))
        """The choices in the order of the actuators' values."""

    def name(self, action: Mapping[str, float], choice: int | None = None) -> str:
        """Return an action in words: the choice's name, or the actuators' values with their units."""
        if choice is not None and choice < len(self.brain.choice):
            return self.brain.choice[choice].name
        parts = []
        for name in self.actuators:
            if name in action:
                parts.append(f"{name} {action[name]:+.2g} {self.brain.actuators[name].unit}".rstrip())
        return ", ".join(parts)

    def choices(self) -> Facts:
        """Return all choices, in the order of their values: each fact (n,)."""
        chosen = [self.brain.choice[place] for place in self.order]
        facts = {name: np.array([choice.values[name] for choice in chosen], np.float64) for name in self.actuators}
        return facts | {"action": np.array(self.order, np.float64)}

    def grid(self) -> Facts:
        """Return at most `MOST_SHOWN` points of the ranges, in order: each fact (n,).

        Of one actuator evenly spread values; of two the lowest, the middle and the highest of each with each; of more
        the middle of all, and of each the lowest and the highest.
        """
        low, high = self._ends()
        middle, dimensions = (low + high) / 2, len(low)
        if dimensions == 1:
            points = np.linspace(low, high, MOST_SHOWN)
        elif dimensions == 2:
            points = np.array([[x, y] for x in (low[0], middle[0], high[0]) for y in (low[1], middle[1], high[1])])
        else:
            rows = [middle]
            for place in range(min(dimensions, (MOST_SHOWN - 1) // 2)):
                for end in (low, high):
                    rows.append(np.where(np.arange(dimensions) == place, end, middle))
            points = np.array(rows)
        return self._facts(points)

    def spread(self, chosen: Mapping[str, float]) -> Facts:
        """Return `LOOKED_AT` points spread over the ranges, the first of which is the chosen action: each fact (n,).

        Of several actuators they are those of Roberts' additive sequence: any first few of them are spread, too.
        """
        low, high = self._ends()
        dimensions = len(low)
        if dimensions == 1:
            unit = np.linspace(0.0, 1.0, LOOKED_AT - 1)[:, None]
        else:
            root = 2.0
            for _ in range(30):  # the root of x^(d + 1) = x + 1
                root = (1.0 + root) ** (1.0 / (dimensions + 1))
            steps = root ** -np.arange(1.0, dimensions + 1.0)
            unit = (0.5 + np.outer(np.arange(LOOKED_AT - 1), steps)) % 1.0
        first = np.array([[chosen[name] for name in self.actuators]])
        return self._facts(np.concatenate([first, low + unit * (high - low)]))

    def uses_note(self, mode: Mode) -> bool:
        """Whether a mode acts upon a note."""
        world = self.books[mode.world]
        valued = self.books[mode.valued_by(world.outputs)]
        return "note" in world.inputs or "note" in valued.inputs

    def _ends(self) -> tuple[Doubles, Doubles]:
        sections = self.brain.actuators.values()
        return np.array([s.low for s in sections]), np.array([s.high for s in sections])

    def _facts(self, points: Doubles) -> Facts:
        return {name: points[:, column] for column, name in enumerate(self.actuators)}


def _policy(experiment: Experiment) -> Policy | None:
    try:
        return experiment.policy()
    except (MdbError, ValueError):
        return None


def _schedule(experiment: Experiment) -> Schedule | None:
    if experiment.teacher is None:
        return None
    try:
        return experiment.schedule()
    except (MdbError, ValueError):  # its policy lies elsewhere, or needs what is not installed
        return None


def number(value: Any, digits: int = 4) -> float | None:
    """Return a number as JSON has it, rounded; None when it is not finite, or is None."""
    if value is None or not math.isfinite(value):
        return None
    return round(float(value), digits)


def numbers(values: NDArray[Any], digits: int = 3) -> Any:
    """Return an array as nested lists of rounded numbers, None where one is not finite."""
    rounded = np.round(np.asarray(values, np.float64), digits)
    if np.isfinite(rounded).all():
        return rounded.tolist()
    known = rounded.astype(object)
    known[~np.isfinite(rounded)] = None
    return known.tolist()
