"""A strong player without evolution: a Gaussian-process bandit for the teacher, a Gaussian process when alone.

Owns both, in numpy alone. It sees what the brain sees: readings, notes, feedback. Taught, it knows that actions
lie in an order (as the brain's action channel says) and that notes do not; it takes the action with the highest
upper confidence bound (UCB). It forgets when what it hears no longer fits: two great surprises among five.
Alone, it foresees the feedback of each action straight from the reading, by a Gaussian process over the pairs
that it was taught, and takes the best. The constants are ours, of seven sets tried
on seeds 801 to 806 the best.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.networks import streams
from mdb_sim.bodies.pioneer.perceive import unfold
from mdb_sim.body import Numbers, Reading
from mdb_sim.runs.experiment import Experiment
from mdb_sim.teaching.schedule import Schedule

Array = NDArray[np.float64]

SIGNAL, NOISE = 0.8, 0.1
"""Standard deviations of the feedback, and of what cannot be foreseen of it."""
RANKS = 1.5
"""Length scale over the order of the actions, in places."""
OPTIMISM = 1.0
"""Standard deviations that the upper confidence bound adds."""
GREAT, SURPRISES, OF = 0.5, 2, 5
"""A teacher has changed when so many of the last so many errors, foreseen with confidence, were as great."""
CONFIDENT = 0.3
"""Standard deviation below which a prediction is one that can be surprised."""
MOST = 600
"""Pairs that are kept for acting alone, the newest."""
SCALES = np.array([0.6, 0.6, 0.4, 1.5])
"""Length scales over cosine and sine of the angle, turn (in right angles) and distance (m)."""


def posterior(kernel: Array, places: NDArray[np.int64], values: Array, noise: float) -> tuple[Array, Array]:
    """Return mean and standard deviation (n,) over n points after values (m,) seen at places (m,), indices of them.

    kernel: prior covariance of the points (n, n).
    """
    if not len(places):
        return np.zeros(len(kernel)), np.sqrt(np.diag(kernel))
    between = kernel[:, places]
    gain = np.linalg.solve(kernel[np.ix_(places, places)] + noise**2 * np.eye(len(places)), between.T).T
    variance = np.diag(kernel) - np.sum(gain * between, axis=1)
    return gain @ values, np.sqrt(np.maximum(variance, 0.0))


class Bandit:
    """One Gaussian process a note, over the actions in their order."""

    def __init__(self, ranks: tuple[int, ...]) -> None:
        gaps = np.subtract.outer(np.array(ranks), np.array(ranks)) / RANKS
        self._kernel = SIGNAL**2 * np.exp(-0.5 * gaps**2)
        self._heard: list[tuple[int, int, float]] = []
        self._recent: deque[tuple[bool, int]] = deque(maxlen=OF)

    def foreseen(self, note: int) -> tuple[Array, Array]:
        """Return mean and standard deviation of the feedback of each action (actions,) after a note."""
        of = [(action, value) for about, action, value in self._heard if about == note]
        places = np.array([action for action, _ in of], dtype=np.int64)
        return posterior(self._kernel, places, np.array([value for _, value in of]), NOISE)

    def act(self, note: int) -> int:
        """Return the action with the highest upper confidence bound; the first of equals."""
        mean, deviation = self.foreseen(note)
        return int(np.argmax(mean + OPTIMISM * deviation))

    def learn(self, note: int, action: int, feedback: float) -> None:
        """Take one feedback; forget what was before when this does not fit."""
        mean, deviation = self.foreseen(note)
        surprised = bool(deviation[action] < CONFIDENT and abs(feedback - mean[action]) > GREAT)
        self._recent.append((surprised, len(self._heard)))
        self._heard.append((note, action, feedback))
        begun = [place for great, place in self._recent if great]
        if len(begun) >= SURPRISES:
            self._heard = self._heard[begun[0] :]
            self._recent.clear()


class Induced:
    """What feedback each action would earn, foreseen from the reading alone."""

    def __init__(self, turns_rad: tuple[float, ...]) -> None:
        self._turns = np.array(turns_rad) / (0.5 * math.pi)
        self._rows: deque[Array] = deque(maxlen=MOST)
        self._values: deque[float] = deque(maxlen=MOST)
        self._fitted: Array | None = None

    def learn(self, reading: Reading, action: int, feedback: float) -> None:
        """Take one pair."""
        self._rows.append(self._inputs(reading)[action])
        self._values.append(feedback)
        self._fitted = None

    def act(self, reading: Reading) -> int | None:
        """Return the action that promises most; None before anything was learnt."""
        if not self._rows:
            return None
        rows = np.array(self._rows)
        if self._fitted is None:
            covariance = _covariance(rows, rows) + NOISE**2 * np.eye(len(rows))
            self._fitted = np.linalg.solve(covariance, np.array(self._values))
        return int(np.argmax(_covariance(self._inputs(reading), rows) @ self._fitted))

    def _inputs(self, reading: Reading) -> Array:
        """Return a row of inputs (actions, 4) for each action."""
        angle_rad, n = unfold(reading), len(self._turns)
        fixed = [math.cos(angle_rad), math.sin(angle_rad)]
        return np.column_stack([np.tile(fixed, (n, 1)), self._turns, np.full(n, reading["distance"])])


def _covariance(some: Array, others: Array) -> Array:
    gaps = (some[:, None, :] - others[None, :, :]) / SCALES
    return np.asarray(SIGNAL**2 * np.exp(-0.5 * np.sum(gaps**2, axis=2)), dtype=np.float64)


class GaussianPlayer:
    """See the module's docstring; keeps the contract `baselines.Player`."""

    def __init__(self, experiment: Experiment, schedule: Schedule) -> None:
        del schedule
        self._choices = [choice.values for choice in experiment.brain.choice]
        turns_deg = [values["turn"] for values in self._choices]
        ranks = tuple(sorted(turns_deg).index(turn) for turn in turns_deg)
        self._seed = experiment.brain.experiment.seed
        self._window = experiment.brain.optimizer.feedback_window
        self._bandit, self._induced = Bandit(ranks), Induced(tuple(map(math.radians, turns_deg)))
        self._done: dict[int, tuple[Reading, int, int]] = {}

    def act(self, iteration: int, reading: Reading, note: int | None, truth: Numbers) -> Numbers:
        """Obey a note as well as is known, else do what would earn most here, else anything."""
        del truth
        if note is not None:
            return self._choices[self._bandit.act(note)]
        action = self._induced.act(reading) if reading else None
        if action is None:
            action = int(streams.generator(self._seed, "baseline/gaussian", iteration).integers(len(self._choices)))
        return self._choices[action]

    def did(self, iteration: int, reading: Reading, note: int | None, action: Numbers) -> None:
        """Remember what a late feedback may be about."""
        if note is not None:
            self._done[iteration] = reading, note, self._choices.index(action)
        self._done.pop(iteration - self._window - 1, None)

    def learn(self, iteration: int, feedback: float) -> None:
        """Take the feedback for the action of an iteration."""
        if iteration not in self._done:
            return
        reading, note, action = self._done.pop(iteration)
        self._bandit.learn(note, action, feedback)
        if reading:
            self._induced.learn(reading, action, feedback)
