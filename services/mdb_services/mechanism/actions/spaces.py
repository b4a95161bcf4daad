"""What can be done: some choices, or every point in the ranges of the actuators.

An action is a value for each actuator (paper, section 2.1: "a set of commands applied to the actuators"). A space
says which actions are looked at, and remembers which were tried under each command. That all choices are looked at is
the paper's (section 3), the rest ours. `tests/conformance` holds each space to the same rules. Pure: random numbers
are handed in.
"""

from __future__ import annotations

import abc
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.actions.foresight import Foreseen
from mdb_services.mechanism.networks.encoding import Facts

Values = dict[str, float]
Doubles = NDArray[np.float64]
Foresee = Callable[[Facts], Foreseen | None]
"""What a mode foresees for actions, each fact (n,); None when it cannot."""

NOT_TRIED = -1
"""In place of an iteration, for an action that was not tried yet."""
REMEMBERED = 64
"""Actions of a range that are remembered under each command, the newest."""


class Space(abc.ABC):
    """See the module's docstring."""

    def __init__(self, actuators: Sequence[str]) -> None:
        self.actuators = tuple(actuators)

    @abc.abstractmethod
    def random(self, rng: np.random.Generator) -> Facts:
        """Return one action, each fact (1,): any, each as likely. Draws one number from a space of choices."""

    @abc.abstractmethod
    def look(self, foresee: Foresee, rng: np.random.Generator) -> tuple[Facts, Foreseen] | None:
        """Return actions worth looking at, each fact (n,), and what is foreseen of them; None when nothing is."""

    @abc.abstractmethod
    def remember(self, note: int | None, iteration: int, values: Mapping[str, float], choice: int | None) -> None:
        """Remember that an action was taken under a note. What is none of this space is passed over."""

    @abc.abstractmethod
    def longest_ago(self, note: int | None, actions: Facts) -> NDArray[np.intp]:
        """Return the places of the actions that are least like what was tried under a note, one at least (m,)."""

    def values(self, actions: Facts, place: int) -> Values:
        """Return the actuators' values of one of some actions."""
        return {name: float(actions[name][place]) for name in self.actuators}

    def choice(self, actions: Facts, place: int) -> int | None:
        """Return which choice one of some actions is; None in a range."""
        return int(actions["action"][place]) if "action" in actions else None


class Choices(Space):
    """Some actions, all of which are tried in the models (paper, section 3)."""

    def __init__(self, choices: Sequence[Mapping[str, float]]) -> None:
        """Take one action at least; all have the same actuators."""
        super().__init__(tuple(choices[0]))
        self._all: Facts = {name: np.array([c[name] for c in choices], np.float64) for name in self.actuators}
        self._all["action"] = np.arange(len(choices), dtype=np.float64)
        self._last: defaultdict[int | None, NDArray[np.int64]] = defaultdict(lambda: np.full(len(choices), NOT_TRIED))

    def random(self, rng: np.random.Generator) -> Facts:
        """See `Space.random`."""
        place = int(rng.integers(len(self._all["action"])))
        return {name: values[place : place + 1] for name, values in self._all.items()}

    def look(self, foresee: Foresee, rng: np.random.Generator) -> tuple[Facts, Foreseen] | None:
        """See `Space.look`: all of them, in their order."""
        del rng
        foreseen = foresee(self._all)
        return None if foreseen is None else (self._all, foreseen)

    def remember(self, note: int | None, iteration: int, values: Mapping[str, float], choice: int | None) -> None:
        """See `Space.remember`."""
        del values
        if choice is not None and 0 <= choice < len(self._last[note]):
            self._last[note][choice] = iteration

    def longest_ago(self, note: int | None, actions: Facts) -> NDArray[np.intp]:
        """See `Space.longest_ago`: those that were tried longest ago."""
        del actions
        last = self._last[note]
        return np.flatnonzero(last == last.min())


class Ranges(Space):
    """Every point between the lowest and the highest value of each actuator, searched anew for each action.

    `evaluations` bounds how many points are foreseen for an action; `method` names one of `SEARCHES`.
    """

    def __init__(self, ranges: Mapping[str, tuple[float, float]], method: str, evaluations: int) -> None:
        super().__init__(tuple(ranges))
        if method == "cma":
            need_cmaes()
        self._low = np.array([low for low, _ in ranges.values()], np.float64)
        self._high = np.array([high for _, high in ranges.values()], np.float64)
        self._width = self._high - self._low
        self._search, self._evaluations = SEARCHES[method], evaluations
        self._tried: defaultdict[int | None, deque[Doubles]] = defaultdict(lambda: deque(maxlen=REMEMBERED))

    def random(self, rng: np.random.Generator) -> Facts:
        """See `Space.random`."""
        return self._facts(rng.random((1, len(self._low))))

    def look(self, foresee: Foresee, rng: np.random.Generator) -> tuple[Facts, Foreseen] | None:
        """See `Space.look`."""
        seen: list[tuple[Doubles, Foreseen]] = []

        def promises(points: Doubles) -> Doubles:
            foreseen = foresee(self._facts(points))
            if foreseen is None:
                raise _NothingForeseenError
            seen.append((points, foreseen))
            return foreseen.promise

        try:
            self._search(promises, len(self._low), self._evaluations, rng)
        except _NothingForeseenError:
            return None
        parts = zip(*(foreseen for _, foreseen in seen), strict=True)
        return self._facts(np.concatenate([points for points, _ in seen])), Foreseen(*map(np.concatenate, parts))

    def remember(self, note: int | None, iteration: int, values: Mapping[str, float], choice: int | None) -> None:
        """See `Space.remember`."""
        del iteration, choice
        point = np.array([values.get(name, np.nan) for name in self.actuators])
        if ((point >= self._low) & (point <= self._high)).all():
            self._tried[note].append((point - self._low) / self._width)

    def longest_ago(self, note: int | None, actions: Facts) -> NDArray[np.intp]:
        """See `Space.longest_ago`: the one that is farthest from all that were tried of late, all if none was."""
        count = len(next(iter(actions.values())))
        if not self._tried[note]:
            return np.arange(count)
        points = (np.column_stack([actions[name] for name in self.actuators]) - self._low) / self._width
        gaps = np.square(points[:, None, :] - np.array(self._tried[note])).sum(axis=2).min(axis=1)
        return np.flatnonzero(gaps == gaps.max())

    def _facts(self, points: Doubles) -> Facts:
        """Return points of the unit cube (n, actuators) as facts."""
        values = np.clip(self._low + points * self._width, self._low, self._high)
        return {name: values[:, column] for column, name in enumerate(self.actuators)}


class _NothingForeseenError(Exception):
    """The mode cannot foresee anything here."""


Promises = Callable[[Doubles], Doubles]
"""What points of the unit cube (n, d) promise (n,), the more the better."""
Search = Callable[[Promises, int, int, np.random.Generator], None]
"""Asks for the promises of points of the unit cube of so many dimensions; of so many points at most."""

FIRST = 0.5
"""Share of the evaluations that are spread over the whole range; the rest looks around the best."""
ROUNDS = 4
NARROWER = 0.4
"""Each round looks so much nearer around the best."""


def refine(promises: Promises, dimensions: int, evaluations: int, rng: np.random.Generator) -> None:
    """Spread points evenly, each with a random part; then look nearer and nearer around the best (ours)."""
    from_all = max(2, int(evaluations * FIRST))
    points = _spread(from_all, dimensions, rng)
    values = promises(points)
    each, width = (evaluations - from_all) // ROUNDS, 0.5
    for _ in range(ROUNDS if each else 0):
        best = points[int(np.argmax(values))]
        width *= NARROWER
        around = np.clip(best + rng.uniform(-width, width, (each, dimensions)), 0.0, 1.0)
        points, values = np.concatenate([points, around]), np.concatenate([values, promises(around)])


def _spread(count: int, dimensions: int, rng: np.random.Generator) -> Doubles:
    """Return points (count, dimensions) of a Latin hypercube: in each dimension one in each of `count` parts."""
    parts = np.stack([rng.permutation(count) for _ in range(dimensions)], axis=1)
    return (parts + rng.random((count, dimensions))) / count


def cma(promises: Promises, dimensions: int, evaluations: int, rng: np.random.Generator) -> None:
    """Search by CMA-ES (the `cmaes` package), from the middle of the range.

    In one dimension, and with fewer evaluations than it needs for a generation, as `refine`.
    """
    if dimensions < 2 or evaluations < 4 + int(3 * np.log(dimensions)):
        refine(promises, dimensions, evaluations, rng)
        return
    seed = int(rng.integers(2**31))
    optimizer = need_cmaes()(
        mean=np.full(dimensions, 0.5), sigma=0.3, bounds=np.array([[0.0, 1.0]] * dimensions), seed=seed
    )
    for _ in range(evaluations // optimizer.population_size):
        points = np.array([optimizer.ask() for _ in range(optimizer.population_size)])
        optimizer.tell([(p, -v) for p, v in zip(points, promises(points).tolist(), strict=True)])


def need_cmaes() -> Any:
    """Return the class of the `cmaes` package; ModuleNotFoundError names the extra when it is not installed."""
    try:
        from cmaes import CMA
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "search method 'cma' needs the package cmaes: pip install 'multilevel-darwinist-brain[learners]'",
            name="cmaes",
        ) from error
    return CMA


SEARCHES: dict[str, Search] = {"refine": refine, "cma": cma}
"""How a range is searched, by name."""
