"""Between the spaces of a Gymnasium environment and named numbers, both ways.

A space is a tree; its leaves are what has numbers: a Box, a Discrete, a MultiBinary, each number of a MultiDiscrete.
Owns what of Gymnasium's spaces can be a body's sensors and actuators, and the words in which the rest is refused. A
part of an observation that cannot be sensed is left out, as long as there are others.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mdb_protocol.messages import VALUE_BOUND
from mdb_sim.body import BodyError

MOST_NUMBERS = 1024
"""In one sensor (see `experiment.sections`), and values of a Discrete."""
MOST_CHOICES = 64
"""Combinations of several Discretes that are listed as choices, all of which are tried; more are searched."""
MOST_ACTUATORS = 256
MOST_LETTERS = 58
"""In a name, so that there is room for a prefix."""
MOST_GRID = 32
"""Rows and columns that an image is seen as, at most."""
EXPECTED = "Box, Discrete, MultiDiscrete, MultiBinary, or a Dict or Tuple of them"
WRAP = "a gymnasium.Wrapper of yours, registered as an environment, can make it one"

Doubles = NDArray[np.float64]
TAKEN = (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary, spaces.Dict, spaces.Tuple)
"""Spaces whose values have the same numbers every time."""


@dataclass(frozen=True, eq=False)
class Leaf:
    """Numbers of a space: `low` and `high` (n,) of each, as the environment gives them.

    `index`: its one number, counted from `low`, says which of some things it is; no order is supposed among them.
    `whole`: whole numbers only. `shape` is that of an image, which is seen as fewer numbers, else None.
    """

    name: str
    low: Doubles
    high: Doubles
    index: bool = False
    whole: bool = False
    shape: tuple[int, ...] | None = None

    @property
    def numbers(self) -> int:
        """How many numbers it has."""
        return len(self.low)

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each number."""
        return (self.name,) if self.numbers == 1 else tuple(f"{self.name}_{place}" for place in range(self.numbers))


def leaves(space: spaces.Space[Any], name: str, grid: int | None = None) -> tuple[Leaf, ...]:
    """Return the leaves of a space in order; those of an only leaf are called `name`, others by their keys.

    grid: of an observation, so many rows and columns an image is seen as; None: of an action, of which nothing can be
    left out. BodyError names what cannot be.
    """
    found = tuple(_leaves(space, "", name, grid))
    if not found:
        raise BodyError(f"{space} has nothing that can be a number; expected {EXPECTED}; {WRAP}")
    names = [leaf.name for leaf in found]
    if len(set(names)) < len(names):
        raise BodyError(f"{space} has names that are the same when written in plain letters: {', '.join(names)}")
    if len(longest := max((each for leaf in found for each in leaf.names), key=len, default="")) > MOST_LETTERS:
        raise BodyError(f"{space} has a name of {len(longest)} letters, {longest}; expected at most {MOST_LETTERS}")
    return found


def left_out(space: spaces.Space[Any], path: str = "") -> tuple[str, ...]:
    """Return the names of an observation's parts that `leaves` leaves out."""
    match space:
        case spaces.Dict():
            parts = [(_joined(path, str(key)), part) for key, part in space.items()]
        case spaces.Tuple():
            parts = [(_joined(path, str(place)), part) for place, part in enumerate(space)]
        case _:
            return (path,) if path and not isinstance(space, TAKEN) else ()
    return tuple(name for path, part in parts for name in left_out(part, path))


def apart(found: tuple[Leaf, ...], taken: Collection[str], prefix: str) -> tuple[Leaf, ...]:
    """Return leaves of which none has a name that is taken: with a prefix where it was."""
    return tuple(
        replace(leaf, name=f"{prefix}_{leaf.name}") if {leaf.name, *leaf.names} & set(taken) else leaf
        for leaf in found
    )


def _leaves(space: spaces.Space[Any], path: str, name: str, grid: int | None) -> Iterator[Leaf]:
    here = path or name
    match space:
        case _ if path and grid is not None and not isinstance(space, TAKEN):
            return
        case spaces.Dict():
            for key, part in space.items():
                yield from _leaves(part, _joined(path, str(key)), name, grid)
        case spaces.Tuple():
            for place, part in enumerate(space):
                yield from _leaves(part, _joined(here, str(place)), name, grid)
        case spaces.Discrete():
            yield _index(here, int(space.start), int(space.n))
        case spaces.MultiDiscrete():
            sizes, starts = space.nvec.ravel().tolist(), np.broadcast_to(space.start, space.nvec.shape).ravel()
            for place, (size, start) in enumerate(zip(sizes, starts.tolist(), strict=True)):
                yield _index(here if len(sizes) == 1 else f"{here}_{place}", int(start), int(size))
        case spaces.MultiBinary():
            count = int(np.prod(space.shape))
            yield _checked(Leaf(here, np.zeros(count), np.ones(count), whole=True))
        case spaces.Box():
            yield _box(here, space, grid)
        case _:
            raise BodyError(
                f"{here} is {space}, a {type(space).__name__}: its length or its kind changes, and a network needs "
                f"the same numbers every time; expected {EXPECTED}; {WRAP}"
            )


def _joined(path: str, key: str) -> str:
    plain = re.sub(r"[^A-Za-z0-9_-]", "_", key)
    return f"{path}_{plain}" if path else plain


def _index(name: str, start: int, count: int) -> Leaf:
    if count > MOST_NUMBERS:
        raise BodyError(
            f"{name} is a Discrete of {count} values, among which nothing tells which are alike; expected at most "
            f"{MOST_NUMBERS}; what its values are made of, as row and column, would do: {WRAP}"
        )
    return Leaf(name, np.array([float(start)]), np.array([float(start + count - 1)]), index=True, whole=True)


def _box(name: str, space: spaces.Box, grid: int | None) -> Leaf:
    low, high = space.low.astype(np.float64), space.high.astype(np.float64)
    whole = bool(np.issubdtype(space.dtype, np.integer)) or space.dtype == np.bool_
    if grid is None or not _is_image(space.shape):
        return _checked(Leaf(name, low.ravel(), high.ravel(), whole=whole))
    return Leaf(name, np.full(grid**2, low.min()), np.full(grid**2, high.max()), shape=space.shape)


def _is_image(shape: tuple[int, ...]) -> bool:
    flat = len(shape) == 2 or (len(shape) == 3 and min(shape) <= 4)
    return flat and sorted(shape)[-2] >= MOST_GRID and int(np.prod(shape)) > MOST_NUMBERS


def _checked(leaf: Leaf) -> Leaf:
    if leaf.numbers > MOST_NUMBERS:
        raise BodyError(
            f"{leaf.name} has {leaf.numbers} numbers; expected at most {MOST_NUMBERS}: leave some out, as by "
            f"gymnasium.wrappers.TransformObservation; {WRAP}"
        )
    return leaf


def ends(leaf: Leaf, limit: float) -> tuple[Doubles, Doubles]:
    """Return lows and highs (n,) that are finite: what has no end, or none that counts, ends at ±`limit`."""
    low = np.where(np.abs(leaf.low) <= VALUE_BOUND, leaf.low, -limit)
    high = np.where(np.abs(leaf.high) <= VALUE_BOUND, leaf.high, limit)
    return low, np.where(high > low, high, low + limit)  # one end of two may have been farther off than the limit


def combinations(found: tuple[Leaf, ...]) -> list[tuple[float, ...]]:
    """Return all actions there are, in order, if each number is one of some things and they are few; else none."""
    if not all(leaf.index or (leaf.whole and leaf.low.min() == 0 and leaf.high.max() == 1) for leaf in found):
        return []
    values = [range(int(leaf.low[i]), int(leaf.high[i]) + 1) for leaf in found for i in range(leaf.numbers)]
    if np.prod([float(len(each)) for each in values]) > (MOST_NUMBERS if len(values) == 1 else MOST_CHOICES):
        return []
    return [tuple(map(float, each)) for each in product(*values)]


def numbers_of(space: spaces.Space[Any], value: Any, grid: int) -> Iterator[float]:
    """Yield an observation's numbers in the order of the leaves; of what counts things, from 0 on."""
    match space:
        case _ if not isinstance(space, TAKEN):
            return
        case spaces.Dict():
            for key, part in space.items():
                yield from numbers_of(part, value[key], grid)
        case spaces.Tuple():
            for part, each in zip(space, value, strict=True):
                yield from numbers_of(part, each, grid)
        case spaces.Discrete():
            yield float(value) - float(space.start)
        case spaces.MultiDiscrete():
            yield from (np.asarray(value, np.float64) - space.start).ravel().tolist()
        case _:
            array = np.asarray(value, np.float64)
            array = shrunk(array, grid) if isinstance(space, spaces.Box) and _is_image(space.shape) else array
            plain = np.nan_to_num(array.ravel(), nan=0.0, posinf=VALUE_BOUND, neginf=-VALUE_BOUND)
            yield from np.clip(plain, -VALUE_BOUND, VALUE_BOUND).tolist()


def shrunk(image: Doubles, grid: int) -> Doubles:
    """Return an image as the mean grey (grid, grid) of its parts."""
    grey = image if image.ndim == 2 else image.mean(axis=int(np.argmin(image.shape)))
    rows = np.array([part.mean(axis=0) for part in np.array_split(grey, grid, axis=0)])
    return np.stack([part.mean(axis=1) for part in np.array_split(rows, grid, axis=1)], axis=1)


def value_of(space: spaces.Space[Any], numbers: Iterator[float]) -> Any:
    """Return the value of a space that takes the next numbers, each as near as it can be."""
    match space:
        case spaces.Dict():
            return {key: value_of(part, numbers) for key, part in space.items()}
        case spaces.Tuple():
            return tuple(value_of(part, numbers) for part in space)
        case spaces.Discrete():
            return space.start + space.dtype.type(round(next(numbers)) - int(space.start))
    count = int(np.prod(space.shape or ()))
    array = np.array([next(numbers) for _ in range(count)]).reshape(space.shape or ())
    if isinstance(space, spaces.Box) and np.issubdtype(space.dtype, np.floating):
        return np.clip(array.astype(space.dtype), space.low, space.high)
    return np.rint(array).astype(space.dtype)
