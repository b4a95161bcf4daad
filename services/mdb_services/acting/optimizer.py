"""The action optimizer: the operation cycle (paper, section 2.2), one iteration after the other.

Owns the iteration: perception, command, which mode applies, the best action, the action-perception pair. The stages
of the cycle are in `stages`; `step` takes what has come, then goes on from the present stage if what that needs is
there. Never learns, and never waits for learning except in lockstep. Every wait has a bound: no stage blocks, and
joining asks the memory store for `QUERY_S` at most. After its death it goes on from what the memory store has and
what the robot gives back of its last intention, so that a pair is neither lost nor formed twice.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import msgspec
import structlog

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus
from mdb_protocol.errors import QueryError
from mdb_services.acting.intake import Intake
from mdb_services.acting.models import CurrentModels, prequential
from mdb_services.acting.outbox import Outbox
from mdb_services.acting.stages import NEXT, Acting, Deciding, Ended, Ending, Joining, Judging, Meeting, Stage
from mdb_services.acting.teachers import Teachers
from mdb_services.acting.verdicts import Verdicts
from mdb_services.acting.waits import Waits
from mdb_services.experiment.brain import BrainConfig
from mdb_services.mechanism.actions.choice import Choice, choose
from mdb_services.mechanism.networks import streams
from mdb_services.mechanism.networks.encoding import Codebook, gather
from mdb_services.shell.elsewhere import Elsewhere
from mdb_services.shell.heartbeat import SILENT_S

log = structlog.get_logger()

ROLE = "optimizer"
QUERY_S = 2.0
"""Bound on asking the memory store; without an answer the next step asks again."""
ENDING_S = 5.0
"""Bound on waiting for the last acknowledgements before the experiment is called finished."""


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
        expected = expected if config.lockstep else frozenset()
        self._modes = config.modes()
        self._clock = clock
        variables = config.variables()
        self._models = CurrentModels({m.name: Codebook(variables, m.inputs, m.outputs) for m in config.model})
        self._stage: Stage = Joining()
        self._next = 0
        """The iteration whose pair is the next one."""
        self._stamp = 0.0
        """That of the newest perception."""
        self._elsewhere = Elsewhere()
        self._teachers = Teachers(config.optimizer.word, config.optimizer.feedback_window)
        self._verdicts = Verdicts(config, self._teachers)
        self._space = config.space()
        self._perceptions = bus.subscriber(keys.PERCEPTION)
        self._actions = bus.publisher(keys.ACTION)
        self._outbox = Outbox(bus.publisher(keys.PAIR), config.optimizer.resend_s)
        # Of who has died and comes back, lockstep must not tell.
        self._waits = Waits(
            config,
            clock,
            lambda: bus.alive() | expected,
            models=self._models,
            teachers=self._teachers,
            outbox=self._outbox,
        )
        self._intake = Intake(
            bus,
            self._models,
            self._teachers,
            self._verdicts,
            self._outbox,
            notes=variables["note"].indices if "note" in variables else None,
            window=config.optimizer.feedback_window,
            clock=clock,
        )
        self._reports = bus.publisher(keys.ITERATION)
        self._timings = bus.publisher(keys.TIMING)
        self._end = bus.publisher(keys.FINISHED)
        self._work: dict[type, Callable[[Any], bool]] = {
            Joining: self._join,
            Meeting: lambda _: False,
            Deciding: self._act,
            Acting: self._resend_action,
            Judging: self._conclude,
            Ending: self._finish,
            Ended: lambda _: False,
        }
        """What each stage does; True: at once the next stage, or this one again."""

    def step(self) -> bool:
        """Take what has come, then go on from the present stage."""
        if not isinstance(self._stage, Joining):
            self._intake.take(self._next, began=self._began)
            due = self._due
            perception = self._perceptions.take(lambda shown: abs(shown.iteration - due) <= 1)
            if perception is not None and not isinstance(self._stage, Ending | Ended):
                self._perceive(perception)
            self._outbox.resend(self._clock())
        return self._work[type(self._stage)](self._stage)

    def _enter(self, stage: Stage) -> None:
        assert type(stage) in NEXT[type(self._stage)], f"{self._stage} -> {stage}"
        self._stage = stage

    @property
    def _began(self) -> bool:
        """Whether we have met the robot."""
        return not isinstance(self._stage, Joining | Meeting)

    @property
    def _due(self) -> int:
        """The iteration that the robot is to show next."""
        return self._next + isinstance(self._stage, Acting | Judging)

    # ---- joining ----

    def _join(self, _: Joining) -> bool:
        """Go on from the pairs that the memory store has."""
        try:
            answers: list[messages.Progress] = self.bus.query(keys.PROGRESS, QUERY_S)
        except QueryError as error:
            self.bus.refusals.add(keys.PROGRESS.path, f"asking again: {error}")
            return False
        if not answers:
            return False
        progress = answers[0]
        self._next, self._models.required = progress.iteration, progress.versions
        for pair in sorted((*progress.judged, *progress.unjudged), key=lambda pair: pair.iteration):
            self._space.remember(pair.note, pair.iteration, pair.action, pair.choice)
        tried = zip(progress.notes.tolist(), progress.choices.tolist(), progress.iterations.tolist(), strict=True)
        for note, choice, iteration in tried:
            self._space.remember(note if note >= 0 else None, iteration, {}, choice)
        self._verdicts.go_on(progress)
        if progress.iteration:
            log.info("going on", iteration=progress.iteration)
        self._enter(Meeting())
        return True

    # ---- what the robot shows ----

    def _perceive(self, perception: messages.Perception) -> None:
        """Take the outcome of the action, or begin where the robot is when it is further than that.

        The first that is met counts; later one that is more than a step ahead only when it insists.
        """
        now, stage, shown = self._clock(), self._stage, perception.iteration
        due = self._due
        most = max(self._experiment.iterations, self._next)
        far = not due - 1 <= shown <= due + 1 if self._began else shown > most
        if far and not (shown <= most and self._elsewhere.believed(shown, now)):
            self._intake.refuse(keys.PERCEPTION, "perception", shown)
            return
        self._elsewhere.nearer()
        self._stamp = perception.stamp
        if shown > due or not self._began:
            self._begin(perception, now)
        elif shown == due and isinstance(stage, Deciding):
            stage.perception = perception  # a robot that goes on while it waits perceives something else
        elif (
            shown == due
            and isinstance(stage, Acting)
            and not (differs(perception.done, stage.action) and self._take_up(perception, now))
        ):
            self._enter(Judging(acted=stage, outcome=perception, outcome_s=now))

    # ---- an iteration begins ----

    def _begin(self, perception: messages.Perception, now: float) -> None:
        """Begin an iteration. Before it the last one is ended, if the robot has done its action and it is not stored.

        A robot that has begun anew, or whose last steps did not come to its disk, takes our count with our action.
        """
        if perception.iteration < self._next:
            log.warning(
                "the robot counts less; the brain keeps its count", mine=self._next, robot=perception.iteration
            )
            perception = msgspec.structs.replace(perception, iteration=self._next, done=None)
        if perception.iteration > self._next and self._take_up(perception, now):
            return
        if self._began or self._next not in (0, perception.iteration):
            log.warning("the robot counts otherwise; its count is taken", mine=self._next, robot=perception.iteration)
        self._next = perception.iteration
        self._enter(Deciding(perception=perception, started_s=now, begun_s=now))

    def _take_up(self, perception: messages.Perception, now: float) -> bool:
        """Judge the action of which the robot shows the outcome, if it says what was meant with it; else False."""
        action = perception.done
        if action is None or action.intention is None or action.iteration != perception.iteration - 1:
            return False
        self._next = action.iteration  # what is between was sent, and may be stored by now
        meant = action.intention
        choice = Choice(action.action, action.choice, meant.mode, meant.explored, meant.predicted)
        acted = Acting(action=action, meant=meant, choice=choice, models=None, started_s=now, acted_s=now, sent_s=now)
        self._enter(Judging(acted=acted, outcome=perception, outcome_s=now))
        self._teachers.holder = meant.holder
        self._space.remember(meant.note, action.iteration, action.action, action.choice)
        return True

    # ---- the action ----

    def _act(self, deciding: Deciding) -> bool:
        """Choose and send the action once command and, in lockstep, models are there or their time is up."""
        iteration, now = deciding.perception.iteration, self._clock()
        if iteration >= self._experiment.iterations:
            self._enter(Ending(since_s=now))
            return True
        if self._waits.for_store() or self._waits.for_command(deciding):
            return False
        for pair in self._verdicts.late(self._next):
            self._outbox.send(pair, now)
        if self._waits.for_models(deciding.gave_up, iteration, deciding.begun_s):
            return False
        self._enter(self._chosen(deciding, iteration))
        return True

    def _chosen(self, deciding: Deciding, iteration: int) -> Acting:
        """Choose the action and send it."""
        command = self._teachers.word(iteration)
        note, teacher = (command.note, command.teacher) if command is not None else (None, None)
        reading, models = deciding.perception.reading, dict(self._models.usable)
        choice = choose(
            self._modes,
            models,
            gather(before=reading, note=note),
            self._space,
            note=note,
            rng=streams.generator(self._experiment.seed, "optimizer", iteration),
            errors=self._models.errors,
            forced_exploration=iteration < self._settings.random_iterations,
        )
        self._space.remember(note, iteration, choice.action, choice.choice)
        meant = messages.Intention(
            before=reading,
            note=note,
            teacher=teacher,
            holder=self._teachers.holder,
            mode=choice.mode,
            explored=choice.explored,
            predicted=choice.predicted,
            versions=dict(self._models.versions),
        )
        now = self._clock()
        return Acting(
            action=self._send_action(iteration, choice, meant),
            meant=meant,
            choice=choice,
            models=models,
            started_s=deciding.started_s,
            acted_s=now,
            sent_s=now,
            gave_up=deciding.gave_up,
        )

    def _send_action(self, iteration: int, choice: Choice, meant: messages.Intention) -> messages.Action:
        """Send an action with the stamp of the newest perception, which is how long it is valid from."""
        sent = messages.Action(
            iteration=iteration,
            action=choice.action,
            choice=choice.choice,
            valid_for_s=self._settings.action_valid_s,
            stamp=self._stamp,
            intention=meant,
        )
        self._actions.put(sent)
        return sent

    def _resend_action(self, acting: Acting) -> bool:
        if self._clock() - acting.sent_s >= self._settings.resend_s:
            acting.sent_s = self._clock()
            acting.action = self._send_action(acting.iteration, acting.choice, acting.meant)
        return False

    # ---- the pair ----

    def _conclude(self, judging: Judging) -> bool:
        """Form the pair once the feedback is in or its time is up; begin the next iteration."""
        acted = judging.acted
        if acted.models is None:
            if self._waits.for_models(acted.gave_up, acted.iteration, acted.started_s):
                return False
            acted.models = dict(self._models.usable)
        if self._waits.for_feedback(acted, judging.outcome_s):
            return False
        pair = messages.Pair(
            iteration=acted.iteration,
            before=acted.meant.before,
            note=acted.meant.note,
            action=acted.choice.action,
            choice=acted.choice.choice,
            after=judging.outcome.outcome,
            feedback=None,
            versions=acted.meant.versions,
            teacher=acted.meant.teacher,
        )
        pair = self._verdicts.judged(pair)
        self._report(
            acted, pair, judging.outcome, prequential(acted.models, pair)
        )  # first: of what is stored it is out
        self._outbox.send(pair, self._clock())
        self._tell_times(acted)
        self._next = pair.iteration + 1
        self._verdicts.remember(pair, self._next)
        self._enter(Deciding(perception=judging.outcome, started_s=judging.outcome_s, begun_s=self._clock()))
        return True

    def _report(
        self, acted: Acting, pair: messages.Pair, outcome: messages.Perception, errors: dict[str, float]
    ) -> None:
        self._reports.put(
            messages.IterationReport(
                iteration=pair.iteration,
                mode=acted.choice.mode,
                action=pair.action,
                choice=pair.choice,
                explored=acted.choice.explored,
                predicted=acted.choice.predicted,
                note=pair.note,
                feedback=pair.feedback,
                event=outcome.event,
                prequential=errors,
                versions=pair.versions,
                teacher=pair.teacher,
                judges=pair.judges,
                holder=acted.meant.holder,
            )
        )

    def _tell_times(self, acted: Acting) -> None:
        self._timings.put(
            messages.Timing(
                iteration=acted.iteration,
                perception_to_action_s=acted.acted_s - acted.started_s,
                cycle_s=self._clock() - acted.started_s,
            )
        )

    # ---- the end ----

    def _finish(self, ending: Ending) -> bool:
        waited_s = self._clock() - ending.since_s
        learning = self._waits.for_models(ending.gave_up, self._next, ending.since_s)
        if waited_s < ENDING_S and (len(self._outbox) or learning):
            return False
        if len(self._outbox):
            log.error("pairs without acknowledgement at the end", iterations=self._outbox.iterations())
        self._end.put(messages.Finished(iterations=self._experiment.iterations))
        self._enter(Ended())
        return True

    def next_s(self) -> float:
        """See `Bounded`: the memory store is asked while joining."""
        return SILENT_S + (QUERY_S if isinstance(self._stage, Joining) else 0.0)

    def values(self) -> dict[str, float]:
        """Iteration, pairs without acknowledgement, whether acting waits for it, pairs lost, waits given up, versions
        behind, how late teachers are who name no iteration.
        """
        counts = {"iteration": self._next, "unacknowledged": len(self._outbox), "lost": self._outbox.lost}
        counts |= {f"behind.{name}": versions for name, versions in self._models.behind().items()}
        values = {name: float(count) for name, count in counts.items()}
        return values | self._waits.values() | self._verdicts.values()

    def close(self) -> None:
        """Nothing to free."""


def differs(done: messages.Action | None, wanted: messages.Action) -> bool:
    """Whether the robot did something else than was wanted: what an optimizer before us had wanted."""
    if done is None:
        return False
    return (done.action, done.choice, done.intention) != (wanted.action, wanted.choice, wanted.intention)
