"""What machines of pybullet_data have in common: a world with a floor, episodes, and a state to go on from.

Owns the physics client and the bookkeeping of the contract. A machine rests after each action, and every action
begins from one saved state of rest, so that what is remembered of it is where it stands: a few named numbers. Every
pybullet call names its own physics client, so that several machines in one process do not mix.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np
import pybullet
import pybullet_data

from mdb_services.mechanism.networks import streams
from mdb_sim.bodies.bullet import client
from mdb_sim.body import BodyError, Numbers, Outcome, Reading, Resting, Spec, check, check_episode

SOLVER_ITERATIONS = 50
"""As for the Pioneer (sim/README.md, "Physics")."""


class _State(msgspec.Struct, frozen=True):
    """All from which a machine goes on."""

    seed: int
    at: Numbers


class BulletMachine(Resting, abc.ABC):
    """A `mdb_sim.body.Body` but for what the machine is: one fills in its spec, where it begins, and how it moves."""

    simulated = True
    spec: Spec
    get_ready = staticmethod(client.get_ready)
    places: tuple[str, ...]
    """The names of the numbers that tell where machine and thing are."""

    def __init__(self, model: str, height_m: float, hz: int, *, fixed: bool) -> None:
        """model: its file in pybullet_data; `fixed` to the floor, or free."""
        self._client = client.connect()
        self._seed: int | None = None
        self._at: Numbers = {}
        pybullet.setGravity(0.0, 0.0, -9.81, physicsClientId=self._client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=1.0 / hz,
            numSolverIterations=SOLVER_ITERATIONS,
            enableConeFriction=0,
            deterministicOverlappingPairs=1,
            physicsClientId=self._client,
        )
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=self._client)
        floor = pybullet.createMultiBody(0.0, plane, physicsClientId=self._client)
        pybullet.changeDynamics(floor, -1, lateralFriction=1.0, physicsClientId=self._client)
        path = Path(pybullet_data.getDataPath()) / model
        self._machine: int = pybullet.loadURDF(
            str(path), basePosition=(0.0, 0.0, height_m), useFixedBase=fixed, physicsClientId=self._client
        )

    @abc.abstractmethod
    def begin(self, rng: np.random.Generator) -> Numbers:
        """Draw where an episode begins."""

    @abc.abstractmethod
    def place(self, at: Numbers) -> None:
        """Put the machine and its thing there, at rest."""

    @abc.abstractmethod
    def move(self, at: Numbers, values: Mapping[str, float]) -> Numbers:
        """Carry out an action from where the machine was put; return where it came to rest."""

    @abc.abstractmethod
    def event(self) -> str:
        """Return what has happened, where the machine stands now."""

    @abc.abstractmethod
    def reading(self) -> Reading:
        """Return what is perceived there."""

    @abc.abstractmethod
    def scene(self) -> Numbers:
        """See `Body.scene`."""

    @property
    def at(self) -> Numbers:
        """Where machine and thing are; an error when there is no run yet."""
        self._open()
        if self._seed is None:
            raise BodyError("no episode has begun; call reset(seed, 0) or restore(state) first")
        return self._at

    def reset(self, seed: int, episode: int) -> Reading:
        """See `Body.reset`."""
        self._open()
        check_episode(seed, episode)
        self._put(seed, self.begin(streams.generator(seed, "placement", episode)))
        return self.reading()

    def act(self, values: Mapping[str, float]) -> Outcome:
        """See `Body.act`."""
        at = self.at
        check(self.spec, values)
        self.place(at)
        self._at = self.move(at, values)
        self.place(self._at)
        return Outcome(self.event(), self.reading())

    def state(self) -> bytes | None:
        """See `Body.state`."""
        at = self.at
        return msgspec.msgpack.encode(_State(self._seed or 0, at))

    def restore(self, state: bytes) -> None:
        """See `Body.restore`."""
        self._open()
        try:
            found = msgspec.msgpack.decode(state, type=_State)
        except (msgspec.ValidationError, msgspec.DecodeError) as error:
            raise BodyError(f"no state of this machine: {error}; expected what `state` gave") from error
        if set(found.at) != set(self.places) or not np.isfinite(list(found.at.values())).all():
            raise BodyError(f"a state of {sorted(found.at)}; expected finite numbers {', '.join(self.places)}")
        self._put(found.seed, found.at)

    def close(self) -> None:
        """See `Body.close`."""
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
        self._client = -1

    def step(self) -> None:
        """Do one step of physics."""
        pybullet.stepSimulation(physicsClientId=self._client)

    def _put(self, seed: int, at: Numbers) -> None:
        self._seed, self._at = seed, at
        self.place(at)

    def _open(self) -> None:
        if self._client < 0:
            raise BodyError("the machine is closed; make another one")
