"""The machines that are taught by an experiment file alone: how long, what is competent, what is to be reached.

Owns the table, the schedule in which each is taught and tried alone in turn, and the score of an episode. To add a
machine, add a line to `MACHINES`. Plain data and pure functions; the files are those of `deploy/experiments`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.record import Episode, RunRecord
from mdb_sim.studies.catalogue import Variant

REWARD = "reward"
"""The scene's number for the environment's reward of the last action."""
CLOSE_M = 0.03
"""An arm's tip as near as this has reached its target."""
BAND_M = (0.4, 1.0)
"""So far from its wall a robot that follows it at 0.7 m is well placed."""
ALONE = "alone"
RETURN = "return"
"""The measure that is a sum of rewards; all others of an episode are from 0 to 1."""

Score = Callable[[Episode], float]


def reward(episode: Episode) -> float:
    """Return the sum of the environment's rewards: Gymnasium's return."""
    return sum(place[REWARD] for place in episode.places[1:])


def no_bump(episode: Episode) -> float:
    """Return 0 when it ended with a bump, else 1."""
    return float(episode.event != "bump")


def success(episode: Episode) -> float:
    """Return 1 when it ended with a success, else 0."""
    return float(episode.success)


def close(episode: Episode) -> float:
    """Return 1 when the tip was at its target in the end, else 0."""
    last = episode.places[-1]
    return float(math.hypot(last["dx"], last["dy"]) < CLOSE_M)


def in_band(episode: Episode) -> float:
    """Return the share of steps at the right distance from the nearest wall of an arena of 10 m."""
    away_m = [5.0 - max(abs(place["x_m"]), abs(place["y_m"])) for place in episode.places[1:]]
    return float(np.mean([BAND_M[0] <= far_m <= BAND_M[1] for far_m in away_m]))


@dataclass(frozen=True)
class Machine:
    """How a machine is taught and measured. `score`: of an episode; None: successes as a share of the ideal's."""

    file: str
    what: str
    score: Score | None
    measure: str
    target: float
    forced: int
    """Iterations of forced exploration, while it is taught, ..."""
    taught: int
    """... after them so many taught in all, ..."""
    tried: int
    """... with so many alone after each of its parts, ..."""
    last: int
    """... and so many at the end."""
    parts: int = 5
    """Where a robot alone comes to states that it was never judged in, a teacher has to come back more often."""
    language: str = "random"
    settings: tuple[str, ...] = ()
    """What else is not as in the file."""

    @property
    def rewarded(self) -> bool:
        """Whether it is an environment of Gymnasium, which has a reward of its own."""
        return self.score in (reward, close)


TWIN = ("robot.body=kinematic",)
MACHINES: tuple[Machine, ...] = (
    Machine(
        "paper",
        "Pioneer 2 reaches an object",
        None,
        "captures, share of the ideal",
        0.97,
        200,
        300,
        150,
        500,
        settings=TWIN,
    ),
    Machine(
        "avoid", "Pioneer 2 avoids it", no_bump, "episodes without a bump", 0.95, 200, 500, 200, 1000, settings=TWIN
    ),
    Machine(
        "follow-wall",
        "Pioneer 2 follows the wall",
        in_band,
        "steps in the band",
        0.8,
        200,
        500,
        200,
        1000,
        settings=TWIN,
    ),
    Machine("cartpole", "CartPole-v1", reward, RETURN, 475.0, 100, 500, 1100, 3500),
    Machine("mountaincar", "MountainCar-v0", reward, RETURN, -130.0, 50, 1000, 500, 2000),
    Machine("mountaincar-continuous", "MountainCarContinuous-v0", reward, RETURN, 90.0, 50, 1000, 1000, 3000),
    Machine("acrobot", "Acrobot-v1", reward, RETURN, -110.0, 50, 1000, 500, 2000),
    Machine("pendulum", "Pendulum-v1, a torque in a range", reward, RETURN, -250.0, 50, 2000, 400, 2000, parts=10),
    Machine("arm", "KUKA iiwa reaches a point", success, "points reached within 3 cm", 0.9, 200, 1300, 150, 400),
    Machine(
        "reacher",
        "arm of Reacher-v5 brings its tip to a place",
        close,
        "episodes that end within 3 cm",
        0.8,
        200,
        2000,
        150,
        1000,
        language="ordered",
    ),
    Machine("car", "racing car drives to a ball", None, "captures, share of the ideal", 0.8, 200, 300, 100, 400),
)
BY_FILE = {machine.file: machine for machine in MACHINES}


def settings_of(machine: Machine) -> tuple[str, ...]:
    """Return the settings by which it is taught and tried alone in turn; nothing is forced when it is alone."""
    at, entries = 0, []
    for part in range(machine.parts):
        entries.append(f'{{start={at}, name="taught {part + 1}", teacher="one", language="{machine.language}"}}')
        at += machine.taught // machine.parts + (machine.forced if part == 0 else 0)
        entries.append(f'{{start={at}, name="{ALONE} {part + 1}"}}')
        at += machine.last if part == machine.parts - 1 else machine.tried
    phases = f"teacher.phase=[{', '.join(entries)}]"
    return f"experiment.iterations={at}", f"optimizer.random_iterations={machine.forced}", phases, *machine.settings


def measured(record: RunRecord) -> tuple[Score | None, str]:
    """Return the score of a run's episodes and its name: the table's, or else the return where there is a reward.

    None: an episode says nothing but whether it was a success, and these are counted.
    """
    machine = BY_FILE.get(record.experiment.brain.experiment.name)
    if machine is not None:
        return machine.score, machine.measure
    rewarded = REWARD in next(iter(record.scenes.values())).now if record.scenes else False
    return (reward, RETURN) if rewarded else (None, "successes")


def to_be_shown(episodes: Sequence[Episode], score: Score | None) -> list[tuple[str, Episode, float | None]]:
    """Return the episode of the median score, and the worst if it is worse; of equals the longer is the worse."""
    of = score or success
    ranked = sorted(episodes, key=lambda episode: (of(episode), -episode.steps))
    if not ranked:
        return []
    middle, worst = ranked[len(ranked) // 2], ranked[0]
    found = [("median", middle)] + ([("worst", worst)] if of(worst) < of(middle) else [])
    return [(what, episode, None if score is None else score(episode)) for what, episode in found]


# ---- the studies of them ----

STUDIES = ("machines", "rivals")
"""Their names in the catalogue. Each variant has a file and a body of its own."""
OFF_POLICY, PPO = "dqn-or-sac", "ppo"
BY_REWARD = {"Stable-Baselines3 (DQN or SAC)": OFF_POLICY, "Stable-Baselines3 (PPO)": PPO}
"""Who learns by the environment's reward alone, with their names as players, see `running.BRAIN`."""
PLAYERS = {"ours": "brain", "TAMER-like": "tamer", **BY_REWARD}
"""Beside them who learns by notes and feedback, and by feedback alone."""


def taught(experiment: Experiment) -> list[Variant]:
    """Each machine by its own file, taught and tried alone in turn."""
    del experiment
    return [Variant(machine.what, settings_of(machine), file=machine.file) for machine in MACHINES]


def rivals(experiment: Experiment) -> list[Variant]:
    """The same, and each machine with the other learners; who learns by a reward only where there is one."""
    return [
        Variant(
            f"{variant.name}: {who}",
            variant.overrides,
            player=player,
            file=variant.file,
            applies=machine.rewarded or who not in BY_REWARD,
        )
        for machine, variant in zip(MACHINES, taught(experiment), strict=True)
        for who, player in PLAYERS.items()
    ]
