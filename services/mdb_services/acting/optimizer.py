"""The action optimizer: the operation cycle (paper, section 2.2), one iteration after the other.

Owns the iteration: perception, command, which mode applies, the best action, the action-perception pair.
Never learns, and never waits for learning except in lockstep. Every wait has a bound; `step` never blocks:
it goes on from the stage the cycle is in with what has come. After its death it goes on from what the memory store
has and what the robot gives back of its last intention, so that a pair is neither lost nor formed twice.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from itertools import islice

import msgspec
import numpy as np
import structlog
from numpy.typing import NDArray

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus
from mdb_protocol.errors import QueryError
from mdb_protocol.keys import Key
from mdb_services.acting.cycle import CurrentModels, Cycle, differs, prequential
from mdb_services.acting.teachers import KEPT_AHEAD, Teachers
from mdb_services.acting.unnamed import Unnamed
from mdb_services.experiment.brain import BrainConfig
from mdb_services.mechanism.choice import Choice, choose
from mdb_services.mechanism.feedback.praise import Praise
from mdb_services.mechanism.networks import streams
from mdb_services.mechanism.networks.encoding import Codebook, gather
from mdb_services.shell.elsewhere import Elsewhere

log = structlog.get_logger()

ROLE = "optimizer"
QUERY_S = 2.0
"""Bound on asking the memory store; without an answer the next step asks again."""
ENDING_S = 5.0
"""Bound on waiting for the last acknowledgements before the experiment is called finished."""
NEVER = -1
"""In place of an iteration, for an action that was not tried yet."""
UNSTORED = 100
"""Pairs without acknowledgement with which the robot still acts, unless the file says `when_full = "act"`."""
KEPT_UNSTORED = 10_000
"""Pairs that are kept for a memory store that does not come back; beyond it the oldest is lost, and counted."""
RESENT_AT_ONCE = 100
"""Pairs without acknowledgement that are sent again together, the oldest first."""


class Optimizer:
    """See the module's docstring."""

    role, instance = ROLE, "action"

    def __init__(
        self,
        bus: Bus,
        config: BrainConfig,
        clock: Callable[[], float] = time.monotonic,
        *,
        expected: frozenset[str] = frozenset(),
    ) -> None:
        """`expected`: tokens of teachers who, in lockstep, are waited for while they are not alive."""
        self.bus = bus
        self._experiment, self._settings = config.experiment, config.optimizer
        self._most_unstored = UNSTORED if config.store.when_full == "stop" else None
        self._joined = False
        self._lockstep = config.lockstep
        self._expected = expected if config.lockstep else frozenset[str]()
        self._modes = config.modes()
        self._clock = clock
        variables = config.variables()
        books = {m.name: Codebook(variables, m.inputs, m.outputs) for m in config.model}
        self._models = CurrentModels(books)
        self._notes = variables["note"].indices if "note" in variables else None
        self._required: dict[str, int] = {}
        self._cycle: Cycle | None = None
        self._next = 0
        self._elsewhere = Elsewhere()
        self._teachers = Teachers(config.optimizer.word, config.optimizer.feedback_window)
        self._unnamed = Unnamed(config)
        self._praise = Praise(config.optimizer.praise_window)
        self._unjudged: dict[int, messages.Pair] = {}
        """The pairs within `feedback_window` that have no feedback yet."""
        self._stamp = 0.0
        self._lost = 0
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
        if not self._joined:
            self._joined = self._join()
            return self._joined
        self._receive()
        self._resend_pairs()
        if self._finishing_s is not None:
            return not self._finished and self._finish()
        return self._cycle is not None and self._go_on(self._cycle)

    def _go_on(self, cycle: Cycle) -> bool:
        """Bring an iteration one stage further, if what that needs is there."""
        if cycle.choice is None:
            return self._act(cycle)
        if cycle.outcome is None:
            return self._resend_action(cycle)
        return self._conclude(cycle)

    def _join(self) -> bool:
        """Go on from the pairs that the memory store has."""
        try:
            answers: list[messages.Progress] = self.bus.query(keys.PROGRESS, QUERY_S)
        except QueryError as error:
            self.bus.refusals.add(keys.PROGRESS.path, f"asking again: {error}")
            return False
        if not answers:
            return False
        progress = answers[0]
        self._next, self._required = progress.iteration, progress.versions
        tried = zip(progress.notes.tolist(), progress.actions.tolist(), progress.iterations.tolist(), strict=True)
        for note, action, iteration in tried:
            if 0 <= action < self._settings.actions:
                self._tried[note if note >= 0 else None][action] = iteration
        self._unjudged = {pair.iteration: pair for pair in progress.unjudged}
        for pair in progress.judged:
            if pair.feedback is not None:
                self._praise.take(pair.iteration, pair.feedback, pair.judges)
        for pair in progress.unjudged:
            self._unnamed.remember(pair)
        if progress.iteration:
            log.info("going on", iteration=progress.iteration)
        return True

    def _receive(self) -> None:
        for model in self._model_inbox.some():
            if (reason := self._models.take(model)) is not None:
                self.bus.refusals.add(keys.CURRENT_MODEL.path, reason)
        for inbox in self._command_inboxes:
            for command in inbox.some():
                self._hear(command)
        for feedback in self._feedback_inbox.some():
            self._judge(feedback)
        for stored in self._stored.some():
            self._acknowledge(stored)
        if (perception := self._perceptions.take()) is not None:
            self._perceive(perception)

    def _acknowledge(self, stored: messages.PairStored) -> None:
        """Take a pair for stored, unless it is what it was before late feedback that is on disk."""
        if stored.iteration >= self._next:
            self.bus.refusals.add(keys.PAIR_STORED.path, f"pair {stored.iteration}; now is {self._next}")
            return
        sent = self._unacknowledged.get(stored.iteration)
        if sent is None:  # it was said again
            return
        if stored.judged or sent[0].feedback is None:
            del self._unacknowledged[stored.iteration]
        self._required = stored.versions

    def _hear(self, command: messages.Command) -> None:
        if command.note is not None and self._notes is not None and command.note >= self._notes:
            reason = f"note {command.note} of teacher {command.teacher}; channels.note has {self._notes} notes"
            self.bus.refusals.add(keys.COMMAND.path, reason)
        elif self._is_far(command.iteration):
            self._refuse(keys.COMMAND, f"command of {command.teacher}", command.iteration)
        elif command.iteration >= self._next:
            self._teachers.hear(command)

    def _judge(self, feedback: messages.Feedback) -> None:
        """Keep feedback for the iteration it names, unless that is long over, or was never.

        What names none waits for the next action: by then all has come that was said before it.
        """
        if feedback.iteration is None:
            self._teachers.judge(feedback)
            if self._cycle is not None:  # what was said before we began is for what we do not know of
                self._unnamed.hear(feedback)
            return
        over = feedback.iteration < self._next - self._settings.feedback_window
        if over or self._is_far(feedback.iteration):
            self._refuse(keys.FEEDBACK, f"feedback of {feedback.teacher}", feedback.iteration)
        else:
            self._teachers.judge(feedback)

    def _is_far(self, iteration: int) -> bool:
        """Whether nobody who sees the robot could mean this iteration yet."""
        return self._cycle is not None and iteration > self._next + KEPT_AHEAD

    def _refuse(self, row: Key, what: str, iteration: int) -> None:
        self.bus.refusals.add(row.path, f"{what} for iteration {iteration}; now is {self._next}")

    def _credit_late_feedback(self) -> None:
        """Send pairs again whose feedback has come since.

        Before an action and after its command, not when it comes: in lockstep that is the same moment every run.
        """
        for iteration, feedback in self._unnamed.credited(self._next):
            self._teachers.credit(iteration, feedback)
        for pair in list(self._unjudged.values()):
            value, judges = self._teachers.verdict(pair.iteration, pair.teacher)
            if value is not None:
                del self._unjudged[pair.iteration]
                self._send_pair(self._measured(msgspec.structs.replace(pair, feedback=value, judges=judges)))

    def _perceive(self, perception: messages.Perception) -> None:
        """Take the outcome of the action, or begin where the robot is when it is further than that.

        The first that is met counts; later one that is more than a step ahead only when it insists.
        """
        now, cycle = self._clock(), self._cycle
        due = self._next if cycle is None or cycle.choice is None else self._next + 1
        most = max(self._experiment.iterations, self._next)
        far = perception.iteration > (most if cycle is None else due + 1)
        if far and not (perception.iteration <= most and self._elsewhere.believed(perception.iteration, now)):
            self._refuse(keys.PERCEPTION, "perception", perception.iteration)
            return
        self._elsewhere.nearer()
        self._stamp = perception.stamp
        if cycle is not None and perception.iteration < due:
            return
        if cycle is None or perception.iteration > due:
            self._begin(perception, now)
        elif cycle.choice is None or cycle.outcome is not None:
            return
        elif not (differs(perception.done, cycle.action) and self._take_up(perception, now)):
            cycle.outcome, cycle.outcome_s = perception, now

    def _begin(self, perception: messages.Perception, now: float) -> None:
        """Begin an iteration; before that end the one that the robot says it has done for us, if it is not stored.

        A robot that has begun anew, or whose last steps did not come to its disk, takes our count with our action.
        """
        if perception.iteration < self._next:
            log.warning("the robot is behind; it goes on here", mine=self._next, robot=perception.iteration)
            perception = msgspec.structs.replace(perception, iteration=self._next, done=None)
        if perception.iteration > self._next and self._take_up(perception, now):
            return
        if self._cycle is not None or self._next not in (0, perception.iteration):
            log.warning("the robot is elsewhere; going on there", mine=self._next, robot=perception.iteration)
        self._next = perception.iteration
        self._cycle = Cycle(perception, now, now)

    def _take_up(self, perception: messages.Perception, now: float) -> bool:
        """Make the cycle of which the robot shows the outcome, from what was meant by its action, if it says that."""
        action = perception.done
        if action is None or action.intention is None or action.iteration != perception.iteration - 1:
            return False
        self._next = action.iteration  # what is between was sent, and may be stored by now
        meant = action.intention
        before = messages.Perception(iteration=action.iteration, event="none", outcome={}, reading=meant.before)
        self._cycle = Cycle(
            before,
            now,
            now,
            note=meant.note,
            teacher=meant.teacher,
            holder=meant.holder,
            choice=Choice(action.action, meant.mode, meant.explored, meant.predicted),
            versions=meant.versions,
            acted_s=now,
            sent_s=now,
            action=action,
            outcome=perception,
            outcome_s=now,
            taken_up=True,
        )
        self._teachers.holder = meant.holder
        self._tried[meant.note][action.action] = action.iteration
        return True

    def _act(self, cycle: Cycle) -> bool:
        """Choose and send the action once command and, in lockstep, models are there or their time is up."""
        iteration = cycle.perception.iteration
        if iteration >= self._experiment.iterations:
            self._finishing_s = self._clock()
            return True
        if self._waits_for_store():
            return False
        if not self._command_is_in(cycle):
            return False
        self._credit_late_feedback()
        if not self._models_are_in(cycle):
            return False
        command = self._teachers.word(iteration)
        cycle.note, cycle.teacher = (command.note, command.teacher) if command is not None else (None, None)
        cycle.holder = self._teachers.holder
        cycle.models, cycle.versions = dict(self._models.usable), dict(self._models.versions)
        cycle.choice = choose(
            self._modes,
            cycle.models,
            gather(before=cycle.perception.reading, note=cycle.note),
            self._tried[cycle.note],
            streams.generator(self._experiment.seed, "optimizer", iteration),
            errors=self._models.errors,
            forced_exploration=iteration < self._settings.random_iterations,
        )
        self._tried[cycle.note][cycle.choice.action] = iteration
        cycle.acted_s = cycle.sent_s = self._clock()
        self._send_action(cycle)
        return True

    def _waits_for_store(self) -> bool:
        """Whether so much is not stored that the robot is not to act."""
        return self._most_unstored is not None and len(self._unacknowledged) > self._most_unstored

    def _command_is_in(self, cycle: Cycle) -> bool:
        if self._teachers.settled(cycle.perception.iteration, self._alive()):
            return True
        return self._time_is_up(cycle, "command", cycle.begun_s, self._settings.command_patience_s)

    def _alive(self) -> frozenset[str]:
        """Who is alive, or will be: when teacher or router have died and come back, lockstep must not tell."""
        return self.bus.alive() | self._expected

    def _models_are_in(self, cycle: Cycle) -> bool:
        if not self._lockstep:
            return True
        if not self._unacknowledged and all(
            self._models.versions.get(name, 0) >= version for name, version in self._required.items()
        ):
            return True
        return self._time_is_up(cycle, "models", cycle.begun_s, self._settings.lockstep_patience_s)

    def _time_is_up(self, cycle: Cycle, what: str, since_s: float, patience_s: float) -> bool:
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

    def _send_action(self, cycle: Cycle) -> None:
        """Send the action with the stamp of the newest perception, which is how long it is valid from."""
        assert cycle.choice is not None
        choice = cycle.choice
        cycle.action = messages.Action(
            iteration=cycle.perception.iteration,
            action=choice.action,
            valid_for_s=self._settings.action_valid_s,
            stamp=self._stamp,
            intention=messages.Intention(
                before=cycle.perception.reading,
                note=cycle.note,
                teacher=cycle.teacher,
                holder=cycle.holder,
                mode=choice.mode,
                explored=choice.explored,
                predicted=choice.predicted,
                versions=cycle.versions,
            ),
        )
        self._actions.put(cycle.action)

    def _resend_action(self, cycle: Cycle) -> bool:
        if self._clock() - cycle.sent_s >= self._settings.resend_s:
            cycle.sent_s = self._clock()
            self._send_action(cycle)
        return False

    def _conclude(self, cycle: Cycle) -> bool:
        """Form the pair once the feedback is in or its time is up; begin the next iteration."""
        iteration = cycle.perception.iteration
        assert cycle.choice is not None
        assert cycle.outcome is not None
        if cycle.taken_up and not cycle.models:
            if not self._models_are_in(cycle):
                return False
            cycle.models = dict(self._models.usable)
        if (
            not self._teachers.answered(iteration, cycle.teacher)
            and self._teachers.is_there(cycle.teacher, self._alive())
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
        pair = self._measured(pair)
        self._report(cycle, pair)  # before the pair: of what is stored the report is out
        self._send_pair(pair)
        self._next = iteration + 1
        self._remember(pair)
        self._cycle = Cycle(cycle.outcome, cycle.outcome_s, self._clock())
        return True

    def _measured(self, pair: messages.Pair) -> messages.Pair:
        """Return a pair with the best praise of late, by which its own is measured."""
        if pair.feedback is None:
            return pair
        self._praise.take(pair.iteration, pair.feedback, pair.judges)
        return msgspec.structs.replace(pair, best=self._praise.best(pair.iteration))

    def _send_pair(self, pair: messages.Pair) -> None:
        self._unacknowledged[pair.iteration] = pair, self._clock()
        if len(self._unacknowledged) > KEPT_UNSTORED:
            del self._unacknowledged[next(iter(self._unacknowledged))]
            self._lost += 1
        self._pairs.put(pair)

    def _remember(self, pair: messages.Pair) -> None:
        """Keep a pair as long as feedback may still come for it."""
        if pair.feedback is None:
            self._unjudged[pair.iteration] = pair
        self._unnamed.remember(pair)
        oldest = self._next - self._settings.feedback_window
        self._unjudged = {i: kept for i, kept in self._unjudged.items() if i >= oldest}
        self._praise.forget(oldest)
        self._teachers.forget(before=self._next, feedback_before=oldest)

    def _report(self, cycle: Cycle, pair: messages.Pair) -> None:
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
                prequential=prequential(cycle.models, pair),
                versions=pair.versions,
                teacher=pair.teacher,
                judges=pair.judges,
                holder=cycle.holder,
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
        """Iteration, pairs without acknowledgement, whether acting waits for it, pairs lost, waits given up, versions
        behind, how late teachers are who name no iteration.
        """
        gave_up = {f"gave_up.{what}": float(count) for what, count in self._gave_up.items()}
        waiting = float(len(self._unacknowledged))
        counts = {"iteration": float(self._next), "unacknowledged": waiting, "lost": float(self._lost)}
        counts["waits_for_store"] = float(self._waits_for_store())
        have = self._models.versions
        behind = {f"behind.{name}": float(max(v - have.get(name, 0), 0)) for name, v in self._required.items()}
        return counts | gave_up | behind | self._unnamed.values()

    def close(self) -> None:
        """Nothing to free."""
