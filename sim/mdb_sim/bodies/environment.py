"""A Gymnasium environment as a body: any one of a Box of observations and Discrete or Box actions.

Owns the way between the contract and `gymnasium.Env`. An episode's seed is a pure function of the run's seed and the
episode's number. It goes on after a death by doing the episode's actions again. The environment's reward goes into
the scene, for measurements; neither brain nor teacher is given it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import msgspec
import numpy as np

from mdb_protocol.messages import MAX_IMAGE, VALUE_BOUND
from mdb_services.mechanism.networks import streams
from mdb_sim.body import NOTHING, Actuator, BodyError, Numbers, Outcome, Reading, Resting, Sensor, Spec, check

OBSERVATION = "observation"
"""The sensor when the numbers of an observation have no names: they are one vector."""
REWARD = "reward"
"""The scene's number for the environment's reward of the last action."""
LONGEST = 20_000
"""Actions of an episode that are kept to be done again; a longer one begins anew after a death."""


class _State(msgspec.Struct, frozen=True):
    """All from which a body goes on."""

    seed: int
    episode: int
    actions: list[list[float]]


class GymnasiumBody(Resting):
    """See the module's docstring.

    env: its id, with `make` passed to `gymnasium.make`. names: of the observation's numbers, each a sensor then.
    actuators: names, one for Discrete, one for each number of a Box. terminated, truncated: the events' words.
    repeat: an action is held for so many steps of the environment.
    """

    def __init__(
        self,
        env: str,
        *,
        names: Sequence[str] = (),
        actuators: Sequence[str] = ("motor",),
        terminated: str = "terminated",
        truncated: str = "truncated",
        repeat: int = 1,
        make: Mapping[str, Any] | None = None,
    ) -> None:
        """BodyError when the environment cannot be had, or its spaces are of another kind."""
        if repeat < 1:
            raise BodyError(f"robot.options.repeat is {repeat}; expected 1 or more")
        try:
            self._env = gymnasium.make(env, **({"render_mode": "rgb_array"} | dict(make or {})))
        except gymnasium.error.Error as error:
            raise BodyError(f"robot.options.env = {env!r}: {error}") from error
        self._events, self._repeat = (terminated, truncated), repeat
        self._names, self._spec = tuple(names), _spec(self._env, tuple(names), tuple(actuators), self._events)
        self._discrete = isinstance(self._env.action_space, gymnasium.spaces.Discrete)
        self._seed: int | None = None
        self._episode = 0
        self._actions: list[list[float]] = []
        self._observation: np.ndarray = np.zeros(0)
        self._reward = 0.0
        self._over = self._closed = False

    @property
    def spec(self) -> Spec:
        """See `Body.spec`."""
        return self._spec

    def reset(self, seed: int, episode: int) -> Reading:
        """See `Body.reset`."""
        self._open()
        if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**64 or episode < 0:
            raise BodyError(f"seed={seed!r}, episode={episode!r}; expected ints, the seed from 0 to 2**64 - 1")
        self._seed, self._episode = seed, episode
        self._observation, _ = self._env.reset(seed=streams.key(seed, f"episode/{episode}") % 2**31)
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
        given = int(action[0]) if self._discrete else np.array(action, self._env.action_space.dtype)
        self._reward, event = 0.0, NOTHING
        for _ in range(self._repeat):
            self._observation, reward, terminated, truncated, _ = self._env.step(given)
            self._reward += float(reward)
            if terminated or truncated:
                self._over = True
                event = self._events[0] if terminated else self._events[1]
                break
        return Outcome(event, self._reading())

    def scene(self) -> Numbers:
        """See `Body.scene`: the observation's numbers, and the reward."""
        self._begun()
        numbers = dict(zip(_numbers(self._env, self._names), self._plain(), strict=True))
        return {**numbers, REWARD: self._reward}

    def image(self) -> np.ndarray | None:
        """See `Imaging.image`: the environment's own, made smaller; None without what it draws with, as pygame."""
        self._begun()
        try:
            image = np.asarray(self._env.render(), dtype=np.uint8)[..., :3]
        except gymnasium.error.DependencyNotInstalled:
            return None
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
            self._env.close()
        self._closed = True

    def _plain(self) -> list[float]:
        plain: list[float] = np.clip(np.float64(self._observation).ravel(), -VALUE_BOUND, VALUE_BOUND).tolist()
        return plain

    def _reading(self) -> Reading:
        if self._names:
            return dict(zip(self._names, self._plain(), strict=True))
        return {OBSERVATION: self._plain()}

    def _begun(self) -> int:
        """The run's seed; an error when there is no run yet."""
        self._open()
        if self._seed is None:
            raise BodyError("no episode has begun; call reset(seed, 0) or restore(state) first")
        return self._seed

    def _open(self) -> None:
        if self._closed:
            raise BodyError("the environment is closed; make another one")


def _spec(
    env: gymnasium.Env[Any, Any], names: tuple[str, ...], actuators: tuple[str, ...], events: tuple[str, str]
) -> Spec:
    seen, done = env.observation_space, env.action_space
    if not isinstance(seen, gymnasium.spaces.Box):
        raise BodyError(f"its observations are {seen}; expected a Box; a gymnasium wrapper can make it one")
    size = int(np.prod(seen.shape))
    if names and len(names) != size:
        raise BodyError(f"robot.options.names has {len(names)} names; an observation has {size} numbers")
    low, high = (np.clip(bound.ravel(), -VALUE_BOUND, VALUE_BOUND).tolist() for bound in (seen.low, seen.high))
    if names:
        sensors = tuple(Sensor(name=n, low=lo, high=hi) for n, lo, hi in zip(names, low, high, strict=True))
    else:
        sensors = (Sensor(name=OBSERVATION, low=min(low), high=max(high), numbers=size),)
    made, choices = _actuators(done, actuators)
    return Spec(
        sensors=sensors,
        actuators=made,
        choices=choices,
        events=events,
        final=events,
        scene=(*_numbers(env, names), REWARD),
    )


def _actuators(space: Any, names: tuple[str, ...]) -> tuple[tuple[Actuator, ...], tuple[Numbers, ...]]:
    if isinstance(space, gymnasium.spaces.Discrete):
        if len(names) != 1:
            raise BodyError(f"robot.options.actuators is {list(names)}; a Discrete action space has one actuator")
        first, count = int(space.start), int(space.n)
        choices = tuple({names[0]: float(value)} for value in range(first, first + count))
        return (Actuator(name=names[0], low=float(first), high=float(first + count - 1)),), choices
    if not isinstance(space, gymnasium.spaces.Box):
        raise BodyError(f"its actions are {space}; expected Discrete or Box; a gymnasium wrapper can make it one")
    if len(names) != int(np.prod(space.shape)):
        raise BodyError(
            f"robot.options.actuators is {list(names)}; an action has {int(np.prod(space.shape))} numbers"
        )
    bounds = zip(names, space.low.ravel().tolist(), space.high.ravel().tolist(), strict=True)
    return tuple(Actuator(name=name, low=low, high=high) for name, low, high in bounds), ()


def _numbers(env: gymnasium.Env[Any, Any], names: tuple[str, ...]) -> tuple[str, ...]:
    size = int(np.prod(env.observation_space.shape or ()))
    return names or tuple(f"{OBSERVATION}_{place}" for place in range(size))
