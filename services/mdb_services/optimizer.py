"""The action optimizer: the operation cycle (paper, section 2.2), one iteration after the other.

Owns the iteration: perception, command, which mode applies, the best action, the action-perception pair.
Never learns, and never waits for learning except in lockstep. Every wait has a bound; `step` never blocks:
it goes on from the stage the cycle is in with what has come.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import islice

import msgspec
import numpy as np
import structlog
from numpy.typing import NDArray

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus
from mdb_services.config import BrainConfig
from mdb_services.mechanism import streams
from mdb_services.mechanism.choice import Choice, choose
from mdb_services.mechanism.encoding import Codebook, Facts, gather
from mdb_services.mechanism.network import Network
from mdb_services.teachers import Teachers

log = structlog.get_logger()

ROLE = "optimizer"
ENDING_S = 5.0
"""Bound on waiting for the last acknowledgements before the experiment is called finished."""
NEVER = -1
"""In place of an iteration, for an action that was not tried yet."""
RESENT_AT_ONCE = 100
"""Pairs without acknowledgement that are sent again together, the oldest first."""


@dataclass
class _Cycle:
    """One iteration in the making."""

    perception: messages.Perception
    started_s: float
    """When the perception came."""
    begun_s: float
    """When the cycle before was done: from here on a command is awaited."""
    gave_up: set[str] = field(default_factory=set)
    command: messages.Command | None = None
    choice: Choice | None = None
    models: dict[str, tuple[Codebook, Network]] = field(default_factory=dict)
    versions: dict[str, int] = field(default_factory=dict)
    acted_s: float = 0.0
    sent_s: float = 0.0
    outcome: messages.Perception | None = None
    outcome_s: float = 0.0

    @property
    def note(self) -> int | None:
        """The note of the teacher who is obeyed, or None."""
        return self.command.note if self.command else None

    @property
    def teacher(self) -> str | None:
        """The teacher who is obeyed, or None."""
        return self.command.teacher if self.command else None


@dataclass
class _CurrentModels:
    """The newest valid model of each name, ready to use."""

    codebooks: dict[str, Codebook]
    usable: dict[str, tuple[Codebook, Network]] = field(default_factory=dict)
    versions: dict[str, int] = field(default_factory=dict)

    def take(self, model: messages.CurrentModel) -> str | None:
        """Use a model from now on; return what is wrong with it instead, if anything is."""
        codebook = self.codebooks.get(model.model)
        if codebook is None:
            return f"no model {model.model!r} in this experiment"
        if (model.layers[0], model.layers[-1]) != (codebook.width, len(codebook.outputs)):
            return (
                f"model {model.model} has layers {model.layers}, not {codebook.width} in, {len(codebook.outputs)} out"
            )
        try:
            self.usable[model.model] = codebook, Network.from_arrays(model.layers, model.weights)
        except ValueError as error:
            return str(error)
        self.versions[model.model] = model.version
        return None


class Optimizer:
    """See the module's docstring."""

    role, instance = ROLE, "action"

    def __init__(self, bus: Bus, config: BrainConfig, clock: Callable[[], float] = time.monotonic) -> None:
        self.bus = bus
        self._experiment, self._settings = config.experiment, config.optimizer
        self._lockstep = config.lockstep
        self._modes = config.modes()
        self._clock = clock
        variables = config.variables()
        books = {m.name: Codebook(variables, m.inputs, m.outputs) for m in config.model}
        self._models = _CurrentModels(books)
        self._notes = variables["note"].indices if "note" in variables else None
        self._required: dict[str, int] = {}
        self._cycle: _Cycle | None = None
        self._next = 0
        self._teachers = Teachers(config.optimizer.word)
        self._unjudged: dict[int, messages.Pair] = {}
        """The pairs within `feedback_window` that have no feedback yet."""
        self._unacknowledged: dict[int, tuple[messages.Pair, float]] = {}
        self._tried: defaultdict[int | None, NDArray[np.int64]] = defaultdict(
            lambda: np.full(config.optimizer.actions, NEVER)
        )
        self._finishing_s: float | None = None
        self._finished = False
        self._gave_up: dict[str, int] = {}
        self._model_inbox = bus.subscriber(keys.CURRENT_MODEL)
        self._perceptions = bus.subscriber(keys.PERCEPTION)
        self._command_inboxes = bus.subscriber(keys.COMMAND), bus.subscriber(keys.HEARD)
        self._feedback_inbox = bus.subscriber(keys.FEEDBACK)
        self._stored = bus.subscriber(keys.PAIR_STORED)
        self._actions = bus.publisher(keys.ACTION)
        self._pairs = bus.publisher(keys.PAIR)
        self._reports = bus.publisher(keys.ITERATION)
        self._timings = bus.publisher(keys.TIMING)
        self._end = bus.publisher(keys.FINISHED)

    def step(self) -> bool:
        """Take what has come, then bring the cycle as far as it goes."""
        self._receive()
        self._resend_pairs()
        if self._finished:
            return False
        if self._finishing_s is not None:
            return self._finish()
        if self._cycle is None:
            return False
        if self._cycle.choice is None:
            return self._act(self._cycle)
        if self._cycle.outcome is None:
            return self._resend_action(self._cycle)
        return self._conclude(self._cycle)

    def _receive(self) -> None:
        while (model := self._model_inbox.take()) is not None:
            if (reason := self._models.take(model)) is not None:
                self.bus.refusals.add(keys.CURRENT_MODEL.path, reason)
        for inbox in self._command_inboxes:
            while (command := inbox.take()) is not None:
                self._hear(command)
        while (feedback := self._feedback_inbox.take()) is not None:
            self._judge(feedback)
        while (stored := self._stored.take()) is not None:
            self._acknowledge(stored)
        if (perception := self._perceptions.take()) is not None:
            self._perceive(perception)

    def _acknowledge(self, stored: messages.PairStored) -> None:
        """Take a pair for stored, unless it is what it was before late feedback that is on disk."""
        sent = self._unacknowledged.get(stored.iteration)
        if sent is not None and (stored.judged or sent[0].feedback is None):
            del self._unacknowledged[stored.iteration]
        self._required = stored.versions

    def _hear(self, command: messages.Command) -> None:
        if command.note is not None and self._notes is not None and command.note >= self._notes:
            reason = f"note {command.note} of teacher {command.teacher}; channels.note has {self._notes} notes"
            self.bus.refusals.add(keys.COMMAND.path, reason)
        elif command.iteration >= self._next:
            self._teachers.hear(command)

    def _judge(self, feedback: messages.Feedback) -> None:
        """Keep feedback for the iteration it names; credit it at once to a pair that is formed already."""
        if feedback.iteration < self._next and feedback.iteration not in self._unjudged:
            if feedback.iteration < self._next - self._settings.feedback_window:
                reason = f"feedback of {feedback.teacher} for iteration {feedback.iteration}; now is {self._next}"
                self.bus.refusals.add(keys.FEEDBACK.path, reason)
            return
        self._teachers.judge(feedback)
        pair = self._unjudged.get(feedback.iteration)
        if pair is None:
            return
        value, judges = self._teachers.verdict(pair.iteration, pair.teacher)
        if value is not None:
            del self._unjudged[pair.iteration]
            self._send_pair(msgspec.structs.replace(pair, feedback=value, judges=judges))

    def _perceive(self, perception: messages.Perception) -> None:
        """Take the outcome of the action, or begin where the robot is when it is further than that."""
        now, cycle = self._clock(), self._cycle
        due = self._next if cycle is None or cycle.choice is None else self._next + 1
        if cycle is None or perception.iteration > due:
            if cycle is not None:
                log.warning("the robot is further; going on there", mine=self._next, robot=perception.iteration)
            self._next = perception.iteration
            self._cycle = _Cycle(perception, now, now)
        elif cycle.choice is not None and cycle.outcome is None and perception.iteration == due:
            cycle.outcome, cycle.outcome_s = perception, now

    def _act(self, cycle: _Cycle) -> bool:
        """Choose and send the action once command and, in lockstep, models are there or their time is up."""
        iteration = cycle.perception.iteration
        if iteration >= self._experiment.iterations:
            self._finishing_s = self._clock()
            return True
        if not (self._command_is_in(cycle) and self._models_are_in(cycle)):
            return False
        cycle.command = self._teachers.word(iteration)
        cycle.models, cycle.versions = dict(self._models.usable), dict(self._models.versions)
        cycle.choice = choose(
            self._modes,
            cycle.models,
            gather(before=cycle.perception.reading, note=cycle.note),
            self._tried[cycle.note],
            streams.generator(self._experiment.seed, "optimizer", iteration),
            forced_exploration=iteration < self._settings.random_iterations,
        )
        self._tried[cycle.note][cycle.choice.action] = iteration
        cycle.acted_s = cycle.sent_s = self._clock()
        self._send_action(cycle)
        return True

    def _command_is_in(self, cycle: _Cycle) -> bool:
        if self._teachers.settled(cycle.perception.iteration, self.bus.alive()):
            return True
        return self._time_is_up(cycle, "command", cycle.begun_s, self._settings.command_patience_s)

    def _models_are_in(self, cycle: _Cycle) -> bool:
        if not self._lockstep:
            return True
        if not self._unacknowledged and all(
            self._models.versions.get(name, 0) >= version for name, version in self._required.items()
        ):
            return True
        return self._time_is_up(cycle, "models", cycle.begun_s, self._settings.lockstep_patience_s)

    def _time_is_up(self, cycle: _Cycle, what: str, since_s: float, patience_s: float) -> bool:
        """Whether to go on without; in lockstep, where a slow machine must not change the run, not before its own."""
        if self._lockstep:
            patience_s = max(patience_s, self._settings.lockstep_patience_s)
        if self._clock() - since_s < patience_s:
            return False
        if what not in cycle.gave_up:
            cycle.gave_up.add(what)
            self._gave_up[what] = self._gave_up.get(what, 0) + 1
            log.warning("waited in vain; going on without", what=what, iteration=self._next, patience_s=patience_s)
        return True

    def _send_action(self, cycle: _Cycle) -> None:
        assert cycle.choice is not None
        self._actions.put(
            messages.Action(
                iteration=cycle.perception.iteration,
                action=cycle.choice.action,
                valid_for_s=self._settings.action_valid_s,
            )
        )

    def _resend_action(self, cycle: _Cycle) -> bool:
        if self._clock() - cycle.sent_s >= self._settings.resend_s:
            cycle.sent_s = self._clock()
            self._send_action(cycle)
        return False

    def _conclude(self, cycle: _Cycle) -> bool:
        """Form the pair once the feedback is in or its time is up; begin the next iteration."""
        iteration = cycle.perception.iteration
        assert cycle.choice is not None
        assert cycle.outcome is not None
        if (
            not self._teachers.answered(iteration, cycle.teacher)
            and self._teachers.is_there(cycle.teacher, self.bus.alive())
            and not self._time_is_up(cycle, "feedback", cycle.outcome_s, self._settings.feedback_patience_s)
        ):
            return False
        value, judges = self._teachers.verdict(iteration, cycle.teacher)
        pair = messages.Pair(
            iteration=iteration,
            before=cycle.perception.reading,
            note=cycle.note,
            action=cycle.choice.action,
            after=cycle.outcome.outcome,
            feedback=value,
            versions=cycle.versions,
            teacher=cycle.teacher,
            judges=judges,
        )
        self._send_pair(pair)
        self._report(cycle, pair)
        self._next = iteration + 1
        self._remember(pair)
        self._cycle = _Cycle(cycle.outcome, cycle.outcome_s, self._clock())
        return True

    def _send_pair(self, pair: messages.Pair) -> None:
        self._unacknowledged[pair.iteration] = pair, self._clock()
        self._pairs.put(pair)

    def _remember(self, pair: messages.Pair) -> None:
        """Keep a pair as long as feedback may still come for it."""
        if pair.feedback is None:
            self._unjudged[pair.iteration] = pair
        oldest = self._next - self._settings.feedback_window
        self._unjudged = {i: kept for i, kept in self._unjudged.items() if i >= oldest}
        self._teachers.forget(before=self._next, feedback_before=oldest)

    def _report(self, cycle: _Cycle, pair: messages.Pair) -> None:
        assert cycle.choice is not None
        assert cycle.outcome is not None
        choice = cycle.choice
        self._reports.put(
            messages.IterationReport(
                iteration=pair.iteration,
                mode=choice.mode,
                action=choice.action,
                explored=choice.explored,
                predicted=choice.predicted,
                note=pair.note,
                feedback=pair.feedback,
                event=cycle.outcome.event,
                prequential=_prequential(cycle.models, pair),
                versions=pair.versions,
                teacher=pair.teacher,
                judges=pair.judges,
                holder=self._teachers.holder,
            )
        )
        self._timings.put(
            messages.Timing(
                iteration=pair.iteration,
                perception_to_action_s=cycle.acted_s - cycle.started_s,
                cycle_s=self._clock() - cycle.started_s,
            )
        )

    def _resend_pairs(self) -> None:
        now = self._clock()
        for iteration, (pair, sent_s) in list(islice(self._unacknowledged.items(), RESENT_AT_ONCE)):
            if now - sent_s >= self._settings.resend_s:
                self._unacknowledged[iteration] = pair, now
                self._pairs.put(pair)

    def _finish(self) -> bool:
        assert self._finishing_s is not None
        assert self._cycle is not None
        waited_s = self._clock() - self._finishing_s
        if waited_s < ENDING_S and (self._unacknowledged or not self._models_are_in(self._cycle)):
            return False
        if self._unacknowledged:
            log.error("pairs without acknowledgement at the end", iterations=sorted(self._unacknowledged))
        self._end.put(messages.Finished(iterations=self._experiment.iterations))
        self._finished = True
        return True

    def values(self) -> dict[str, float]:
        """Iteration, pairs not acknowledged yet, and how often a wait was given up."""
        gave_up = {f"gave_up.{what}": float(count) for what, count in self._gave_up.items()}
        waiting = float(len(self._unacknowledged))
        return {"iteration": float(self._next), "unacknowledged": waiting, **gave_up}

    def close(self) -> None:
        """Nothing to free."""


def _prequential(models: dict[str, tuple[Codebook, Network]], pair: messages.Pair) -> dict[str, float]:
    """Return each model's mean squared error on a pair that it has not learnt yet."""
    facts: Facts = gather(
        before=pair.before, after=pair.after, note=pair.note, action=pair.action, feedback=pair.feedback
    )
    errors = {}
    for name, (codebook, network) in models.items():
        inputs, targets = codebook.input_rows(facts), codebook.target_rows(facts)
        if inputs is not None and targets is not None:
            errors[name] = float(np.square(network.predict(inputs) - targets).mean())
    return errors
