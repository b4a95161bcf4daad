"""A Gymnasium environment as a body: any one whose spaces have the same numbers every time (see `spaces`).

Owns the way between the contract and `gymnasium.Env`. An episode's seed is a pure function of the run's seed and the
episode's number. It goes on after a death by doing the episode's actions again. The environment's reward goes into
the scene: the brain never sees it, a teacher may.
"""

from __future__ import annotations

import os
import re
import traceback
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import msgspec
import numpy as np
import structlog

from mdb_protocol.messages import MAX_IMAGE, VALUE_BOUND
from mdb_services.mechanism.networks import streams
from mdb_services.mechanism.networks.encoding import NOT_SENSED
from mdb_sim.bodies.spaces import (
    MOST_ACTUATORS,
    MOST_GRID,
    Leaf,
    apart,
    combinations,
    ends,
    leaves,
    numbers_of,
    value_of,
)
from mdb_sim.body import (
    NOTHING,
    Actuator,
    BodyError,
    Numbers,
    Outcome,
    Reading,
    Resting,
    Sensor,
    Spec,
    check,
    check_episode,
)

log = structlog.get_logger()

OBSERVATION = "observation"
"""The sensor when an observation is one space, and its numbers have no names: they are one vector."""
MOTOR = "motor"
"""The actuator when an action is one space."""
RATE = "_rate"
"""After a number's name: its change in the last step."""
MOST_SHOWN = 250
"""Numbers of an observation that are in the scene."""
REWARD = "reward"
"""The scene's number for the environment's reward of the last action."""
COLOURS = re.compile(r"\x1b\[[0-9;]*m")
LONGEST = 20_000
"""Actions of an episode that are kept to be done again; a longer one begins anew after a death."""
INSTALL = "pip install 'multilevel-darwinist-brain[gymnasium]'"
"""What brings all with which Gymnasium's own environments are made and drawn."""


class _State(msgspec.Struct, frozen=True):
    """All from which a body goes on."""

    seed: int
    episode: int
    actions: list[list[float]]


class GymnasiumBody(Resting):
    """See the module's docstring. `env`, `seen` and `done` are the environment, and what it gives and takes.

    env: its id, with `make` passed to `gymnasium.make`. names: of the observation's numbers, each a sensor then;
    without, each of its spaces is one, by its key; with "seen_" before it where the name means something else.
    rates: of these names the change in the last step of the environment is sensed, too, as NAME_rate; 0 at first.
    actuators: names, one for each number of an action. terminated, truncated: the events' words. repeat: an action is
    held for so many steps of the environment. limit: an actuator whose range has no end goes to ±limit. grid: an
    image is seen as so many rows and columns of grey.
    """

    simulated = True

    def __init__(
        self,
        env: str,
        *,
        names: Sequence[str] = (),
        rates: Sequence[str] = (),
        actuators: Sequence[str] = (),
        terminated: str = "terminated",
        truncated: str = "truncated",
        repeat: int = 1,
        limit: float = 1.0,
        grid: int = 12,
        make: Mapping[str, Any] | None = None,
    ) -> None:
        """BodyError when the environment cannot be had, or its spaces are of another kind."""
        if repeat < 1 or limit <= 0.0 or not 1 <= grid <= MOST_GRID:
            raise BodyError(
                f"robot.options: repeat is {repeat}, limit {limit}, grid {grid}; expected repeat of 1 or more, limit "
                f"above 0, grid of 1 to {MOST_GRID}"
            )
        self.env, self.grid = _made(env, dict(make or {})), grid
        self._events, self._repeat = (terminated, truncated), repeat
        try:
            self.done = apart(leaves(self.env.action_space, MOTOR), NOT_SENSED, "do")
            told = actuators or tuple(name for leaf in self.done for name in leaf.names)
            self.seen = apart(
                leaves(self.env.observation_space, OBSERVATION, grid), {*NOT_SENSED, *told, REWARD}, "seen"
            )
            self._names, self._spec = _spec(
                self.seen, self.done, tuple(names), tuple(actuators), events=self._events, limit=limit
            )
            self._rates = _rates(tuple(names), rates)
            self._spec = msgspec.structs.replace(
                self._spec, sensors=(*self._spec.sensors, *_rate_sensors(self._spec, self._rates))
            )
        except BodyError as error:
            self.env.close()
            raise BodyError(f"robot.options.env = {env!r}: {error}") from error
        self._named = bool(names)
        self._seed: int | None = None
        self._episode = 0
        self._actions: list[list[float]] = []
        self._observation: Any = None
        self._before: list[float] = []
        """The observation's numbers a step before, where rates are sensed."""
        self._reward = 0.0
        self._over = self._closed = False
        self._dark = ""
        """Why no image can be made here."""

    @property
    def spec(self) -> Spec:
        """See `Body.spec`."""
        return self._spec

    def reset(self, seed: int, episode: int) -> Reading:
        """See `Body.reset`."""
        self._open()
        check_episode(seed, episode)
        self._seed, self._episode = seed, episode
        self._observation, _ = self.env.reset(seed=streams.key(seed, f"episode/{episode}") % 2**31)
        self._before = self._plain() if self._rates else []
        self._actions, self._reward, self._over = [], 0.0, False
        return self._reading()

    def act(self, values: Mapping[str, float]) -> Outcome:
        """See `Body.act`."""
        self._begun()
        if self._over:
            raise BodyError("the episode is over; call reset(seed, episode) for the next one")
        check(self._spec, values)
        action = [float(values[actuator.name]) for actuator in self._spec.actuators]
        self._actions.append(action)
        return self._do(action)

    def _do(self, action: list[float]) -> Outcome:
        """Hold an action."""
        given = value_of(self.env.action_space, iter(action))
        self._reward, event = 0.0, NOTHING
        for _ in range(self._repeat):
            self._before = self._plain() if self._rates else []
            self._observation, reward, terminated, truncated, _ = self.env.step(given)
            self._reward += float(reward)
            if terminated or truncated:
                self._over = True
                event = self._events[0] if terminated else self._events[1]
                break
        return Outcome(event, self._reading())

    def scene(self) -> Numbers:
        """See `Body.scene`: the observation's numbers, the first of very many, and the reward."""
        self._begun()
        reward = float(np.clip(np.nan_to_num(self._reward), -VALUE_BOUND, VALUE_BOUND))
        return {**dict(zip(self._names[:MOST_SHOWN], self._plain(), strict=False)), REWARD: reward}

    def image(self) -> np.ndarray:
        """See `Imaging.image`: the environment's own, made smaller; BodyError without what it draws with."""
        self._begun()
        if self._dark:  # asked once: to ask some again is slow, and no better
            raise BodyError(self._dark)
        try:
            os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # it greets on standard output
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what cannot be drawn is said below
                image = np.asarray(self.env.render(), dtype=np.uint8)[..., :3]
        except Exception as error:  # whatever it draws with: a missing display or library stops no robot
            self._dark = f"the environment cannot be drawn here: {_reason(error)}"
            raise BodyError(self._dark) from error
        if image.ndim != 3:
            raise BodyError(f"the environment gives an image of {image.shape}; expected rows and columns of 3 bytes")
        step = -(-max(image.shape[:2]) // MAX_IMAGE)
        return np.ascontiguousarray(image[::step, ::step])

    def state(self) -> bytes | None:
        """See `Body.state`."""
        if len(self._actions) > LONGEST:
            return None
        return msgspec.msgpack.encode(_State(self._begun(), self._episode, self._actions))

    def restore(self, state: bytes) -> None:
        """See `Body.restore`: the actions of the episode are done again."""
        try:
            found = msgspec.msgpack.decode(state, type=_State)
        except (msgspec.ValidationError, msgspec.DecodeError) as error:
            raise BodyError(f"no state of an environment: {error}; expected what `state` gave") from error
        names = [actuator.name for actuator in self._spec.actuators]
        for action in found.actions:
            if len(action) != len(names):
                raise BodyError("the state is of another environment; expected what `state` of one alike gave")
            check(self._spec, dict(zip(names, action, strict=True)))
        self.reset(found.seed, found.episode)
        for action in found.actions:
            self._actions.append(action)
            self._do(action)

    def close(self) -> None:
        """See `Body.close`."""
        if not self._closed:
            self.env.close()
        self._closed = True

    def _plain(self) -> list[float]:
        return list(numbers_of(self.env.observation_space, self._observation, self.grid))

    def _reading(self) -> Reading:
        plain = self._plain()
        if self._named:
            found = dict(zip(self._names, plain, strict=True))
            before = dict(zip(self._names, self._before, strict=True)) if self._rates else {}
            return {**found, **{name + RATE: found[name] - before[name] for name in self._rates}}
        reading: Reading = {}
        for leaf in self.seen:
            mine, plain = plain[: leaf.numbers], plain[leaf.numbers :]
            reading[leaf.name] = mine if leaf.numbers > 1 else mine[0]
        return reading

    def _begun(self) -> int:
        """The run's seed; an error when there is no run yet."""
        self._open()
        if self._seed is None:
            raise BodyError("no episode has begun; call reset(seed, 0) or restore(state) first")
        return self._seed

    def _open(self) -> None:
        if self._closed:
            raise BodyError("the environment is closed; make another one")


def _made(env: str, make: dict[str, Any]) -> gymnasium.Env[Any, Any]:
    """Make an environment that can show images, or else one that cannot; BodyError tells why there is none.

    What Gymnasium warns of, as of an old version, is said in the log once and in one line.
    """
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            made = gymnasium.make(env, **({"render_mode": "rgb_array"} | make))
        except Exception:  # it is asked again without; environments of others raise what they like
            try:
                made = gymnasium.make(env, **make)
            except Exception as error:
                raise BodyError(f"robot.options.env = {env!r} cannot be made: {_reason(error)}") from error
    for said in dict.fromkeys(COLOURS.sub("", str(warning.message)) for warning in warned):
        if "render_mode" not in said:  # one that cannot show images will do
            log.warning(said.removeprefix("WARN: "), env=env)
    return made


def _reason(error: Exception) -> str:
    """Return what went wrong in an environment, and what would help where we know it."""
    reason = str(error) or f"{type(error).__name__} {_place(error)}"
    if isinstance(error, gymnasium.error.DependencyNotInstalled):
        return f"{reason}; of this project: {INSTALL}"
    if "OpenGL" in reason:
        return f"{reason}; on a machine without a display, set MUJOCO_GL=egl"
    return reason


def _place(error: Exception) -> str:
    """Return where an error that says nothing arose."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"in {last.filename}, line {last.lineno}: {last.line}"


def _spec(
    seen: tuple[Leaf, ...],
    done: tuple[Leaf, ...],
    names: tuple[str, ...],
    actuators: tuple[str, ...],
    *,
    events: tuple[str, str],
    limit: float,
) -> tuple[tuple[str, ...], Spec]:
    """Return the names of an observation's numbers, and the spec."""
    own = tuple(name for leaf in seen for name in leaf.names)
    if names and len(names) != len(own):
        raise BodyError(f"robot.options.names has {len(names)} names; an observation has {len(own)} numbers")
    sensors = tuple(sensor for leaf in seen for sensor in _sensors(leaf))
    if names:
        parts = [part for leaf in seen for part in _sensors(leaf, each=True)]
        sensors = tuple(
            Sensor(name=name, low=part.low, high=part.high) for name, part in zip(names, parts, strict=True)
        )
    made, choices = _actuators(done, actuators, limit)
    shown = names or own
    spec = Spec(
        sensors=sensors,
        actuators=made,
        choices=choices,
        events=events,
        final=events,
        scene=(*shown[:MOST_SHOWN], REWARD),
    )
    return shown, spec


def _rates(names: tuple[str, ...], rates: Sequence[str]) -> tuple[str, ...]:
    """Return the numbers whose rates are sensed, in order; BodyError when one is unknown or a name is twice there."""
    unknown = sorted(set(rates) - set(names))
    taken = sorted({name + RATE for name in rates} & set(names))
    if unknown or taken or len(set(rates)) < len(rates):
        raise BodyError(
            f"robot.options.rates is {list(rates)}; expected some of robot.options.names "
            f"({', '.join(names) or 'none'}), each once, and none of which NAME{RATE} is there, too"
        )
    return tuple(rates)


def _rate_sensors(spec: Spec, rates: tuple[str, ...]) -> list[Sensor]:
    """Return the sensors of the rates: in a step a number can go from one end to the other."""
    of = {sensor.name: sensor for sensor in spec.sensors}
    widths = {name: min(of[name].high - of[name].low, VALUE_BOUND) for name in rates}
    return [Sensor(name=name + RATE, low=-width, high=width) for name, width in widths.items()]


def _sensors(leaf: Leaf, *, each: bool = False) -> list[Sensor]:
    """Return the sensor that a leaf is, or one for each of its numbers."""
    low, high = (np.clip(bound, -VALUE_BOUND, VALUE_BOUND).tolist() for bound in (leaf.low, leaf.high))
    if leaf.index:
        low, high = [0.0], [high[0] - low[0]]
    if each:
        bounds = zip(leaf.names, low, high, strict=True)
        return [Sensor(name=name, low=lowest, high=highest) for name, lowest, highest in bounds]
    return [Sensor(name=leaf.name, low=min(low), high=max(high), numbers=leaf.numbers)]


def _actuators(
    done: tuple[Leaf, ...], names: tuple[str, ...], limit: float
) -> tuple[tuple[Actuator, ...], tuple[Numbers, ...]]:
    own = tuple(name for leaf in done for name in leaf.names)
    if not own or len(own) > MOST_ACTUATORS:
        raise BodyError(f"an action has {len(own)} numbers; expected 1 to {MOST_ACTUATORS}")
    if names and len(names) != len(own):
        raise BodyError(
            f"robot.options.actuators is {list(names)}; an action has {len(own)} numbers ({', '.join(own)}), and "
            "each is an actuator"
        )
    names = names or own
    bounds = [bound for leaf in done for bound in zip(*ends(leaf, limit), strict=True)]
    made = tuple(
        Actuator(name=name, low=float(low), high=float(high)) for name, (low, high) in zip(names, bounds, strict=True)
    )
    choices = tuple(dict(zip(names, values, strict=True)) for values in combinations(done))
    return made, choices
