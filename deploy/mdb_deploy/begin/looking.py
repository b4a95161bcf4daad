"""A look at a Gymnasium environment: what it has, by its spaces, and what these do not say, by acting at random.

Owns `Machine`, all that a file is written from. Knows nothing of the file.
"""

from __future__ import annotations

import math
import sys
import time
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mdb_deploy.begin.known import Names, names_of
from mdb_protocol.errors import MdbError
from mdb_protocol.messages import NOTHING, VALUE_BOUND
from mdb_sim.bodies.environment import REWARD, GymnasiumBody
from mdb_sim.bodies.spaces import Leaf, left_out
from mdb_sim.body import Actuator, BodyError, Numbers, Sensor, Spec

ACTIONS = 600
"""Actions at random, from which is told what the spaces do not say."""
OF_IMAGES = 100
"""The same, of an environment that draws an image for each."""
LOOK_S, FEWEST = 20.0, 50
"""In an environment that is slow it is acted for so long, but so often at the least."""
SEED = 1
TERMINATED, TRUNCATED = "terminated", "truncated"
NAMED_APART = 48
"""More numbers than these are one vector in the file: it is to be read by people."""
LIKE_USUAL = 0.05
"""An episode's last reward that is so near the usual one, by the spread, does not tell the end apart."""


@dataclass(frozen=True)
class Variable:
    """A sensor: `things` it tells apart (0: it is a number), or its range, which may have been `measured`."""

    name: str
    low: float
    high: float
    numbers: int = 1
    things: int = 0
    measured: bool = False


@dataclass(frozen=True)
class Reward:
    """What the environment's rewards were: the `usual` one, and how far from it great ones are.

    `ending`: what an episode's end is worth if its reward does not say; None: it does.
    """

    usual: float
    spread: float
    ending: float | None


@dataclass(frozen=True)
class Machine:
    """An environment as a robot."""

    env: str
    variables: tuple[Variable, ...]
    named: bool
    """Whether each number has a name, by which it is a sensor."""
    actuators: tuple[Actuator, ...]
    endless: bool
    """Whether an actuator's range has no end of its own."""
    choices: tuple[tuple[str, Numbers], ...]
    longest: int | None
    """Actions in an episode, if the environment ends it by itself."""
    reward: Reward
    image: bool
    left_out: tuple[str, ...]
    """Parts of an observation that have no numbers which could be sensed."""


def look(env: str, folder: Path) -> Machine:
    """Return what a Gymnasium environment is as a robot; MdbError tells why it can be none, and what would do.

    A module that registers it may lie in the folder, where it is found again when the experiment is run.
    """
    if str(folder.resolve()) not in sys.path:
        sys.path.append(str(folder.resolve()))
    names = names_of(env)
    try:
        try:
            body = GymnasiumBody(env, names=names.numbers, actuators=names.actuators)
        except BodyError:  # another version, or one of yours with the name of one of theirs
            body, names = GymnasiumBody(env), Names()
    except BodyError as error:
        raise MdbError(_mended(str(error))) from error
    try:
        return _machine(env, body, names)
    finally:
        body.close()


def _mended(reason: str) -> str:
    """Add what to do where an environment itself is not to be had."""
    if "doesn't exist" in reason or "not found" in reason.lower():
        return (
            f"{reason} `python -c 'import gymnasium; gymnasium.pprint_registry()'` lists those that there are. One "
            "that another package registers, or a module of yours, is named with it: gymnasium:MODULE:ENV, as "
            "gymnasium:ale_py:ALE/Pong-v5 or gymnasium:minigrid:MiniGrid-Empty-8x8-v0"
        )
    if "No module named" in reason:
        return f"{reason.rstrip('.')}. Install it with pip, or put it into the folder if it is yours"
    return reason


def _machine(env: str, body: GymnasiumBody, names: Names) -> Machine:
    seen, done, spec = body.seen, body.done, body.spec
    if len(spec.choices) == 1:
        raise MdbError(f"{env}: there is one action only, so that nothing can be learnt; give another environment")
    image = any(leaf.shape is not None for leaf in seen)
    named = bool(names.numbers) or (not image and 1 < sum(leaf.numbers for leaf in seen) <= NAMED_APART)
    if named and not names.numbers:
        body.close()
        own = tuple(name for leaf in seen for name in leaf.names)
        body = GymnasiumBody(env, names=own, actuators=names.actuators)
    values, rewards, last = _act(body, OF_IMAGES if image else ACTIONS)
    sensors = body.spec.sensors
    kinds = [leaf for leaf in seen for _ in range(leaf.numbers)] if named else list(seen)
    variables = tuple(_variable(s, leaf, values[s.name]) for s, leaf in zip(sensors, kinds, strict=True))
    limited = all(abs(bound) <= VALUE_BOUND for leaf in done for bound in (*leaf.low, *leaf.high))
    spec_of_env = body.env.spec
    longest = None if spec_of_env is None else spec_of_env.max_episode_steps
    body.close()
    return Machine(
        env,
        variables,
        named,
        spec.actuators,
        not limited,
        _named(spec, names),
        longest,
        _reward(rewards, last),
        image,
        left_out(body.env.observation_space),
    )


def _act(body: GymnasiumBody, actions: int) -> tuple[dict[str, list[float]], list[float], list[float]]:
    """Act at random; return what each sensor gave, the rewards, and those with which an episode came to its end."""
    rng = np.random.default_rng(SEED)
    values: defaultdict[str, list[float]] = defaultdict(list)
    rewards, last, episode = [], [], 0
    reading = body.reset(SEED, episode)
    until_s = time.monotonic() + LOOK_S
    for done in range(actions):
        if done >= FEWEST and time.monotonic() > until_s:
            break
        for name, value in reading.items():
            values[name] += value if isinstance(value, list) else [value]
        outcome = body.act(_any(body.spec, rng))
        reading = outcome.reading
        rewards.append(body.scene()[REWARD])
        last += rewards[-1:] if outcome.event == TERMINATED else []
        if outcome.event != NOTHING:
            episode += 1
            reading = body.reset(SEED, episode)
    return values, rewards, last


def _any(spec: Spec, rng: np.random.Generator) -> Numbers:
    if spec.choices:
        return dict(spec.choices[int(rng.integers(len(spec.choices)))])
    return {actuator.name: float(rng.uniform(actuator.low, actuator.high)) for actuator in spec.actuators}


def _variable(sensor: Sensor, leaf: Leaf, values: list[float]) -> Variable:
    if leaf.index:
        return Variable(sensor.name, 0.0, sensor.high, things=int(sensor.high) + 1)
    if max(-sensor.low, sensor.high) < VALUE_BOUND and sensor.low < sensor.high:
        return Variable(sensor.name, sensor.low, sensor.high, sensor.numbers)
    low, high = np.percentile(values, (1.0, 99.0)).tolist() if sensor.numbers > 1 else (min(values), max(values))
    most = rounded(1.25 * max(-low, high))
    return Variable(sensor.name, -most if low < 0.0 else 0.0, most, sensor.numbers, measured=True)


def rounded(value: float) -> float:
    """Return a positive number with two digits that is about as great; 1 for nothing."""
    if value <= 0.0:
        return 1.0
    digits = 1 - math.floor(math.log10(value))
    return round(value, digits)


def _named(spec: Spec, names: Names) -> tuple[tuple[str, Numbers], ...]:
    if len(names.choices) == len(spec.choices):
        return tuple(zip(names.choices, spec.choices, strict=True))
    words = (" ".join(_words(choice, len(spec.actuators) > 1)) for choice in spec.choices)
    return tuple(zip(words, spec.choices, strict=True))


def _words(choice: Numbers, several: bool) -> Iterable[str]:
    return (f"{value:g}" if several else f"{name} {value:g}" for name, value in choice.items())


def _reward(rewards: list[float], last: list[float]) -> Reward:
    """Tell what rewards mean from those of random actions (ours)."""
    usual = float(np.median(rewards))
    spread = float(np.percentile(np.abs(np.array(rewards) - usual), 95))
    spread = spread or max(abs(reward - usual) for reward in rewards) or 1.0
    told = last and abs(float(np.median(last)) - usual) > LIKE_USUAL * spread
    return Reward(usual, spread, None if told else (1.0 if usual < 0.0 else -1.0))
