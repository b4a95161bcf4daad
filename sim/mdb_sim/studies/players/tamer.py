"""A learner in the manner of TAMER: foresees a teacher's feedback from state and action, and does what promises most.

After Knox and Stone, "Interactively shaping agents via human reinforcement: the TAMER framework" (2009): feedback is
regressed on state and action, and is not discounted. The regressor is what a user would take today, a network as in
Deep TAMER (Warnell et al., 2018): scikit-learn's MLPRegressor, trained on minibatches of all that was judged. In
TAMER nobody commands: the state is what is sensed, never the note, and it acts in the same way with the teacher and
without. Feedback here names its action, so no credit is shared out. Ours is that it tries any action at all now and
then while somebody judges, or it would see good actions only; the brain babbles for the same reason. The constants
are ours, set once and not tuned. Needs scikit-learn.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdb_protocol.errors import MdbError
from mdb_services.experiment.brain import BrainConfig
from mdb_services.mechanism.actions.foresight import Foreseen
from mdb_services.mechanism.networks import streams
from mdb_services.mechanism.networks.encoding import DERIVED, NOT_SENSED, Codebook, Facts, gather
from mdb_sim.body import Numbers, Reading
from mdb_sim.runs.experiment import Experiment
from mdb_sim.teaching.schedule import Schedule

HIDDEN = (64, 64)
"""Units of the network; the rest is scikit-learn's default."""
BATCH, UPDATES = 64, 10
"""Judgements in a minibatch, and minibatches learnt after each judgement."""
TRIES = 0.1
"""How often any action at all is done while somebody judges."""


class TamerPlayer:
    """See the module's docstring; keeps the contract `baselines.Player`."""

    def __init__(self, experiment: Experiment, schedule: Schedule) -> None:
        """MdbError when scikit-learn is missing."""
        brain = experiment.brain
        self._seed, self._schedule, self._space = brain.experiment.seed, schedule, brain.space()
        self._window = brain.optimizer.feedback_window
        self._choices = [choice.values for choice in brain.choice]
        self._codebook = Codebook(brain.variables(), inputs_of(brain), ())
        self._regressor = _regressor(self._seed)
        self._done: dict[int, NDArray[np.float64]] = {}
        self._rows: list[NDArray[np.float64]] = []
        self._values: list[float] = []

    def act(self, iteration: int, reading: Reading, note: int | None, truth: Numbers) -> Numbers:
        """Do what promises most, whatever was said; anything while nothing is known."""
        del note, truth
        rng = streams.generator(self._seed, "baseline/tamer", iteration)
        anything = self._space.random(rng)
        tries = rng.random() < TRIES and self._schedule.at(iteration).teacher is not None
        looked = self._space.look(lambda tried: self._foreseen(reading, tried), rng) if self._rows else None
        if looked is None or tries:
            return self._space.values(anything, 0)
        actions, foreseen = looked
        return self._space.values(actions, foreseen.best(0.0))

    def did(self, iteration: int, reading: Reading, note: int | None, action: Numbers) -> None:
        """Remember what a late feedback may be about."""
        del note
        facts = {name: np.array([value]) for name, value in action.items()}
        if self._choices:
            facts["action"] = np.array([float(self._choices.index(action))])
        rows = self._inputs(reading, facts)
        if rows is not None:
            self._done[iteration] = rows[0]
        self._done.pop(iteration - self._window - 1, None)

    def learn(self, iteration: int, feedback: float) -> None:
        """Take the feedback for the action of an iteration, unless a sensor perceived nothing: that is no state."""
        row = self._done.pop(iteration, None)
        if row is None:
            return
        self._rows.append(row)
        self._values.append(feedback)
        rng = streams.generator(self._seed, "baseline/tamer/memory", iteration)
        rows, values = np.array(self._rows), np.array(self._values)
        for _ in range(UPDATES):
            places = rng.integers(len(values), size=min(BATCH, len(values)))
            self._regressor.partial_fit(rows[places], values[places])

    def _foreseen(self, reading: Reading, tried: Facts) -> Foreseen | None:
        rows = self._inputs(reading, tried)
        if rows is None:
            return None
        promises = self._regressor.predict(rows)
        return Foreseen(promises, np.ones(len(rows)), np.zeros(len(rows)))

    def _inputs(self, reading: Reading, tried: Facts) -> NDArray[np.float64] | None:
        """Return rows (n, inputs) of a state with each of n actions; None when a sensor perceives nothing."""
        count = len(next(iter(tried.values())))
        known = {name: np.repeat(values, count, axis=0) for name, values in gather(before=reading).items()}
        rows = self._codebook.input_rows(known | tried)
        return None if rows is None else rows.astype(np.float64)


def inputs_of(brain: BrainConfig) -> tuple[str, ...]:
    """Return the variables of state and action: all that is sensed, and all by which an action is written."""
    sensed = [name for name in brain.channels if name not in NOT_SENSED and not name.startswith(DERIVED)]
    return (*sensed, "action") if brain.choice and "action" in brain.channels else tuple(sensed)


def _regressor(seed: int) -> Any:
    try:
        from sklearn.neural_network import MLPRegressor
    except ImportError as error:
        raise MdbError(
            "the TAMER-like learner needs scikit-learn; run pip install 'multilevel-darwinist-brain[bench]', or "
            "scikit-learn alone"
        ) from error
    return MLPRegressor(hidden_layer_sizes=HIDDEN, random_state=streams.key(seed, "baseline/tamer") % 2**32)
