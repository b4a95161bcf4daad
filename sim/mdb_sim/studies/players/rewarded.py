"""What a user takes where an environment has a reward: Stable-Baselines3, as it is. Needs the extra `bench`.

DQN where actions are listed, else SAC; or PPO, which needs less computing a step. All with their defaults and a plain
network (MlpPolicy), on the environment as Gymnasium makes it: no teacher, no notes, no held actions. The tuned
settings of RL Zoo are not used. A learner is tried greedily at `Budget.checkpoints` equal steps of its training, in
episodes of their own, and scored as the machine is (`studies.machines`). Training ends when it was competent
`Budget.kept` times running, as a user would end it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mdb_protocol.errors import ConfigError, MdbError
from mdb_services.mechanism.networks import streams
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.record import Episode
from mdb_sim.studies.machines import BY_FILE, BY_REWARD, OFF_POLICY, PPO, REWARD
from mdb_sim.studies.rows import PhaseRow

PLAYERS = tuple(BY_REWARD.values())
"""The players' names in a study's variants."""
TRAINER = "reward"
"""Stands in a row in the place of the teacher."""


@dataclass(frozen=True)
class Budget:
    """How long it is trained and how it is tried."""

    steps: int
    """Steps of the environment at most."""
    checkpoints: int
    episodes: int = 10
    """Episodes at each checkpoint."""
    kept: int = 3
    """Checkpoints running at which it is competent, after which training ends."""


LISTED = Budget(steps=100_000, checkpoints=40)
"""For DQN and PPO, ..."""
RANGED = Budget(steps=20_000, checkpoints=20)
"""... and for SAC, whose step costs about twenty times as much."""


def trained(experiment: Experiment, player: str = OFF_POLICY, budget: Budget | None = None) -> list[PhaseRow]:
    """Train on the environment of an experiment file; return a row for each part of the training and each trial.

    player: one of `PLAYERS`. budget: None for `LISTED` or `RANGED`. ConfigError when the machine has no reward to
    learn from, MdbError when a library is missing.
    """
    machine = BY_FILE.get(experiment.brain.experiment.name)
    score = None if machine is None or not machine.rewarded else machine.score
    if machine is None or score is None:
        raise ConfigError(
            f"{experiment.brain.experiment.name} has no reward of its own; Stable-Baselines3 is compared on machines "
            f"of Gymnasium only: {', '.join(each.file for each in BY_FILE.values() if each.rewarded)}"
        )
    library = _library()
    import gymnasium

    seed = experiment.brain.experiment.seed
    options = experiment.robot.options
    with ExitStack() as stack:

        def make() -> Any:
            return stack.enter_context(closing(gymnasium.make(options["env"], **options.get("make", {}))))

        env = make()
        name = "PPO" if player == PPO else "DQN" if isinstance(env.action_space, gymnasium.spaces.Discrete) else "SAC"
        budget = budget or (RANGED if name == "SAC" else LISTED)
        learner = getattr(library, name)("MlpPolicy", env, seed=seed % 2**31, device="cpu")
        rows = _Rows(experiment)
        tries = [make() for _ in range(budget.episodes)]
        every = max(1, budget.steps // budget.checkpoints)
        competent: list[bool] = []

        def after_step(known: dict[str, Any], _: dict[str, Any]) -> bool:
            """Try it at a checkpoint; return whether training goes on."""
            del known
            at = int(learner.num_timesteps)
            if at % every:
                return True
            found = _tried(learner, tries, options.get("names", ()), streams.key(seed, f"rewarded/{at}"))
            competent.append(rows.add(at, [score(episode) for episode in found]) >= machine.target)
            return len(competent) < budget.kept or not all(competent[-budget.kept :])

        learner.learn(every * budget.checkpoints, callback=after_step)
    return rows.all


def _library() -> Any:
    try:
        import stable_baselines3
    except ImportError as error:
        raise MdbError(
            "the comparison with Stable-Baselines3 needs it and PyTorch; see the extra `bench` in pyproject.toml: "
            "PyTorch's CPU build first, then pip install 'multilevel-darwinist-brain[bench,gymnasium]'"
        ) from error
    return stable_baselines3


def _tried(learner: Any, envs: Sequence[Any], names: Sequence[str], seed: int) -> list[Episode]:
    """Return one greedy episode in each environment, all asked for their actions at once."""
    seen = [env.reset(seed=(seed + place) % 2**31)[0] for place, env in enumerate(envs)]
    places = [[_place(names, observation, 0.0)] for observation in seen]
    ended: dict[int, str] = {}
    while len(ended) < len(envs):
        actions, _ = learner.predict(np.stack(seen), deterministic=True)
        for place, env in enumerate(envs):
            if place in ended:
                continue
            seen[place], reward, terminated, truncated, _ = env.step(actions[place])
            places[place].append(_place(names, seen[place], float(reward)))
            if terminated or truncated:
                ended[place] = "terminated" if terminated else "truncated"
    return [Episode(0, ended[place], False, tuple(each)) for place, each in enumerate(places)]


def _place(names: Sequence[str], observation: Iterable[float], reward: float) -> dict[str, float]:
    return {**dict(zip(names, map(float, observation), strict=False)), REWARD: reward}


class _Rows:
    """The rows of a training: "trained" and "alone" in turn, in steps of the environment."""

    def __init__(self, experiment: Experiment) -> None:
        self._seed, self._body = experiment.brain.experiment.seed, experiment.robot.body
        self.all: list[PhaseRow] = []

    def add(self, at: int, scores: Sequence[float]) -> float:
        """Take a trial after so many steps; return its mean score."""
        before = self.all[-1].stop if self.all else 0
        part = len(self.all) // 2 + 1
        self._add(f"trained {part}", TRAINER, before, at, ())
        self._add(f"alone {part}", None, at, at, scores)
        return float(np.mean(scores))

    def _add(self, name: str, teacher: str | None, start: int, stop: int, scores: Sequence[float]) -> None:
        told = {"seed": self._seed, "body": self._body, "phase": len(self.all), "name": name, "teacher": teacher}
        told |= {"start": start, "stop": stop, "counted_from": start, "judgements": 0.0}
        self.all.append(PhaseRow(**(dict(_nothing()) | told | {"scores": np.array(scores, np.float32)})))


def _nothing() -> Iterator[tuple[str, Any]]:
    """Yield what a row says of that which is not there."""
    empty = {"Marks": np.int8, "Curve": np.float32, "Counts": np.int32}
    for field in fields(PhaseRow):
        kind = str(field.type)
        if kind in empty:
            yield field.name, np.zeros(0, empty[kind])
        elif kind in ("float", "int"):
            yield field.name, math.nan if kind == "float" else 0
        elif kind.startswith("tuple"):
            yield field.name, ()
