"""The contract every body keeps, and the values that cross it. Knows no robot, no service, no file.

A body is a machine in its world: a simulated one, a real one, or an environment of somebody else's. It is told values
for its actuators and says what its sensors perceive; what is true for a bystander is its scene. It knows neither
models nor rewards nor languages, and counts nothing: iterations, episodes and successes are counted by the robot
service. `tests/conformance/body_conformance.py` holds a body to this page (after dm_env's conformance suite).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import msgspec
import numpy as np

from mdb_protocol.messages import NOTHING, Drawing, Picture

Reading = dict[str, float | list[float]]
"""What sensors perceive, by name: a number, or a vector. A sensor that perceives nothing is left out."""
Numbers = dict[str, float]
"""The values of actuators, or what is true in a scene, by name."""


class BodyError(ValueError):
    """A body was asked for something it cannot do; the message tells what was expected and how to mend it."""


class Sensor(msgspec.Struct, frozen=True, kw_only=True):
    """What a body perceives: `numbers` of them, each from `low` to `high` as a rule, in `unit`."""

    name: str
    low: float
    high: float
    unit: str = ""
    numbers: int = 1


class Actuator(msgspec.Struct, frozen=True, kw_only=True):
    """What a body can be told: a value from `low` to `high`, in `unit`."""

    name: str
    low: float
    high: float
    unit: str = ""


class Spec(msgspec.Struct, frozen=True, kw_only=True):
    """What a body has: against this an experiment file is checked before anything starts."""

    sensors: tuple[Sensor, ...]
    actuators: tuple[Actuator, ...]
    choices: tuple[Numbers, ...] = ()
    """The only actions that it can carry out; none: every one in its actuators' ranges."""
    events: tuple[str, ...] = ()
    """Its own words for what can happen, beside `NOTHING`, ..."""
    final: tuple[str, ...] = ()
    """... and those of them after which it can only begin an episode anew."""
    scene: tuple[str, ...] = ()
    """The names of its scene's numbers."""
    changes: tuple[str, ...] = ()
    """What of it can be changed while it runs."""


class Outcome(NamedTuple):
    """What an action led to: an event of the body's own, `NOTHING` as a rule, and what is perceived there."""

    event: str
    reading: Reading


def check(spec: Spec, values: Mapping[str, float]) -> None:
    """Raise BodyError when a body of this kind cannot carry out an action."""
    if set(values) != {actuator.name for actuator in spec.actuators}:
        expected = ", ".join(actuator.name for actuator in spec.actuators)
        raise BodyError(f"action {dict(values)!r}; expected a value for each of {expected}, and for nothing else")
    for actuator in spec.actuators:
        value, expected = values[actuator.name], f"{actuator.low:g} to {actuator.high:g} {actuator.unit}".rstrip()
        if not actuator.low <= value <= actuator.high:
            raise BodyError(f"{actuator.name} = {value!r}; expected {expected}")
    if spec.choices and dict(values) not in spec.choices:
        raise BodyError(f"action {dict(values)!r} is none of the {len(spec.choices)} that this body can carry out")


def check_episode(seed: int, episode: int) -> None:
    """Raise BodyError when these are no seed of a run, or no number of an episode."""
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**64 or episode < 0:
        raise BodyError(
            f"seed={seed!r}, episode={episode!r}; expected ints, the seed 0 to 2**64 - 1, the episode 0 or more"
        )


class Body(Protocol):
    """A machine in its world. One thread uses it at a time, but for `halt`."""

    @property
    def spec(self) -> Spec:
        """What it has; always the same."""

    def reset(self, seed: int, episode: int) -> Reading:
        """Begin an episode of a run; return what is perceived there.

        The same seed and episode put the same body at the same place. Episode 0 begins the run. A machine that cannot
        be put anywhere goes on where it stands.
        """

    def act(self, values: Mapping[str, float]) -> Outcome:
        """Carry out an action, come to rest, perceive. BodyError when values or moment are wrong: nothing is done."""

    def halt(self) -> None:
        """Bring the actuators to rest, now; from any thread, and while `act` runs, which then returns soon."""

    def scene(self) -> Numbers:
        """Return what is true now: for the teacher and the log. The brain never sees it."""

    def state(self) -> bytes | None:
        """Return all from which `restore` goes on, value by value; None: it cannot be put back."""

    def restore(self, state: bytes) -> None:
        """Go on from a state of a body made alike. BodyError when it is none."""

    def close(self) -> None:
        """Free what the body holds; calling it twice is harmless."""


@runtime_checkable
class Changeable(Protocol):
    """A body of which something can be changed while it runs."""

    def change(self, **settings: Any) -> None:
        """Change what `Spec.changes` names. BodyError when a name or a value is wrong: nothing is changed."""


@runtime_checkable
class Sensing(Protocol):
    """A body that can take a reading where it stands."""

    def sense(self) -> Reading:
        """Return a fresh reading; it moves nothing and changes nothing of what comes."""


@runtime_checkable
class Drawable(Protocol):
    """A body that can draw its scene."""

    def draw(self, reading: Reading) -> Drawing:
        """Return the scene as shapes, and in it what is perceived."""


@runtime_checkable
class Imaging(Protocol):
    """A body that can show an image of its scene."""

    def image(self) -> np.ndarray:
        """Return an image (rows, columns, 3) of bytes, at most `messages.MAX_IMAGE` of each.

        BodyError tells why it cannot be made here.
        """


def picture_of(body: Body, reading: Reading, iteration: int) -> Picture:
    """Return what a body shows of its scene: drawing, image, or neither. BodyError: no image can be made here."""
    drawing = body.draw(reading) if isinstance(body, Drawable) else None
    image = body.image() if drawing is None and isinstance(body, Imaging) else None
    return Picture(iteration=iteration, drawing=drawing, image=image)


class Resting:
    """What most bodies have in common: they rest after each action, so that there is nothing to halt."""

    def halt(self) -> None:
        """See `Body.halt`."""


class Unrestorable:
    """What machines have in common that cannot be put back."""

    def state(self) -> bytes | None:
        """See `Body.state`."""
        return None

    def restore(self, state: bytes) -> None:
        """See `Body.restore`."""
        raise BodyError(
            f"this machine cannot be put back (got a state of {len(state)} bytes); it goes on where it is"
        )


__all__ = [
    "NOTHING",
    "Actuator",
    "Body",
    "BodyError",
    "Changeable",
    "Drawable",
    "Imaging",
    "Numbers",
    "Outcome",
    "Reading",
    "Resting",
    "Sensing",
    "Sensor",
    "Spec",
    "Unrestorable",
    "check",
    "check_episode",
    "picture_of",
]
