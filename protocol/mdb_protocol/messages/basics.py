"""What messages have in common: names, bounds, checks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

Iteration = Annotated[int, Meta(ge=0, le=2**53)]
Count = Annotated[int, Meta(ge=0, le=2**53)]
Index = Annotated[int, Meta(ge=0, le=2**31)]
Name = Annotated[str, Meta(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_.-]+\Z")]
Text = Annotated[str, Meta(max_length=4096)]
Event = Name
"""A word of the robot's own for what happened; `NOTHING` when nothing did."""
VALUE_BOUND = 1e6
"""Sensor and model values beyond this are refused: no sensor of a robot means them."""
Number = Annotated[float, Meta(ge=-VALUE_BOUND, le=VALUE_BOUND)]
Vector = Annotated[list[Number], Meta(max_length=4096)]
Reading = Annotated[dict[Name, Number | Vector], Meta(max_length=256)]
"""What sensors gave, a number or a vector each. A sensor that perceives nothing is left out."""
Values = Annotated[dict[Name, Number], Meta(max_length=256)]
"""Numbers by name: of actuators, or of what is true in a scene."""
Choice = Annotated[int, Meta(ge=0, le=1023)]
Versions = Annotated[dict[Name, Count], Meta(max_length=256)]
Judges = Annotated[list[Name], Meta(max_length=256)]
Layers = Annotated[list[Annotated[int, Meta(ge=0, le=4096)]], Meta(min_length=2, max_length=8)]
NOTHING = "none"
"""The event of an action after which nothing happened."""
MOST_SUPPORT = 100_000
"""Pairs in the largest memory that an experiment may ask for."""


def check_finite(what: str, values: Mapping[str, float | list[float]] | Mapping[str, float] | float | None) -> None:
    """Raise ValueError when a number is not finite or is beyond `VALUE_BOUND`."""
    if values is None:
        return
    for name, value in ((what, values),) if isinstance(values, float | int) else values.items():
        for number in value if isinstance(value, list) else (value,):
            if not -VALUE_BOUND <= number <= VALUE_BOUND:  # nor is what is no number
                raise ValueError(f"{what}: {name} is {number!r}; expected a finite number within ±{VALUE_BOUND:g}")


def check_stamp(stamp: float) -> None:
    """Raise ValueError when a time in seconds is not finite: nothing would ever be too late for it."""
    if not math.isfinite(stamp):
        raise ValueError(f"stamp is {stamp!r}; expected a finite number of seconds")


def check_later(later: bool, what: str, value: float | None) -> None:
    """Raise ValueError when somebody asks to be waited for, and says at once what is waited for."""
    if later and value is not None:
        raise ValueError(f"later is true and {what} is {value!r}; expected no {what} where it is to be waited for")


def check_array(what: str, array: np.ndarray, kind: str, ndim: int) -> None:
    """Raise ValueError unless `array` has the dtype kind ("f", "i", "u"), dimensions and finite values."""
    if array.dtype.kind != kind or array.ndim != ndim:
        raise ValueError(f"{what}: got {array.ndim} dimensions of {array.dtype}; expected {ndim} of kind {kind!r}")
    if kind == "f" and not np.maximum.reduce(np.abs(array), axis=None, initial=0.0) <= VALUE_BOUND:  # nor is NaN
        raise ValueError(f"{what}: holds values that are not finite or beyond ±{VALUE_BOUND:g}")


def check_rows(what: str, *arrays: np.ndarray) -> None:
    """Raise ValueError unless all arrays have as many rows."""
    if len({len(array) for array in arrays}) > 1:
        raise ValueError(f"{what}: arrays of {[len(array) for array in arrays]} rows; expected as many of each")


def check_weights(layers: list[int], weights: np.ndarray) -> None:
    """Raise ValueError unless weights (n,) are those of a network of these layers."""
    check_array("weights", weights, "f", 1)
    expected = sum((i + 1) * o for i, o in pairwise(layers))
    if len(weights) != expected:
        raise ValueError(f"weights: got {len(weights)}, but layers {layers} need {expected}")


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """Base of all messages."""
