"""What comes to the optimizer: models, commands, feedback, acknowledgements, each kept where it belongs or refused.

Owns the inboxes but the robot's. Decides nothing.
"""

from __future__ import annotations

from collections.abc import Callable

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus
from mdb_protocol.keys import Key
from mdb_services.acting.models import CurrentModels
from mdb_services.acting.outbox import Outbox
from mdb_services.acting.teachers import KEPT_AHEAD, Teachers
from mdb_services.acting.verdicts import Verdicts


class Intake:
    """See the module's docstring."""

    def __init__(
        self,
        bus: Bus,
        models: CurrentModels,
        teachers: Teachers,
        verdicts: Verdicts,
        outbox: Outbox,
        *,
        notes: int | None,
        window: int,
        clock: Callable[[], float],
    ) -> None:
        """`notes`: how many there are; None: any. `window`: feedback so many iterations late still counts."""
        self._bus, self._models, self._teachers = bus, models, teachers
        self._verdicts, self._outbox = verdicts, outbox
        self._notes, self._window, self._clock = notes, window, clock
        self._model_inbox = bus.subscriber(keys.CURRENT_MODEL)
        self._command_inboxes = bus.subscriber(keys.COMMAND), bus.subscriber(keys.HEARD)
        self._feedback_inbox = bus.subscriber(keys.FEEDBACK)
        self._stored = bus.subscriber(keys.PAIR_STORED)
        self._now = 0
        self._began = False

    def take(self, now: int, *, began: bool) -> None:
        """Take all that has come. `now` is the present iteration; before we `began` it may be far behind."""
        self._now, self._began = now, began
        for model in self._model_inbox.some():
            if (reason := self._models.take(model)) is not None:
                self._bus.refusals.add(keys.CURRENT_MODEL.path, reason)
        for inbox in self._command_inboxes:
            for command in inbox.some():
                self._hear(command)
        for feedback in self._feedback_inbox.some():
            self._judge(feedback)
        for stored in self._stored.some():
            self._acknowledge(stored)

    def refuse(self, row: Key, what: str, iteration: int) -> None:
        """Count what is for an iteration that it cannot be for."""
        self._bus.refusals.add(row.path, f"{what} for iteration {iteration}; now is {self._now}")

    def _hear(self, command: messages.Command) -> None:
        if command.note is not None and self._notes is not None and command.note >= self._notes:
            reason = f"note {command.note} of teacher {command.teacher}; channels.note has {self._notes} notes"
            self._bus.refusals.add(keys.COMMAND.path, reason)
        elif self._is_far(command.iteration):
            self.refuse(keys.COMMAND, f"command of {command.teacher}", command.iteration)
        elif command.iteration < self._now:
            pass
        elif command.later:
            self._teachers.ask(command, self._clock())
        else:
            self._teachers.hear(command)

    def _judge(self, feedback: messages.Feedback) -> None:
        """Keep feedback, unless the iteration it names is long over, or was never."""
        named = feedback.iteration
        if named is not None and (named < self._now - self._window or self._is_far(named)):
            self.refuse(keys.FEEDBACK, f"feedback of {feedback.teacher}", named)
        elif feedback.later:
            self._teachers.ask(feedback, self._clock())
        else:
            self._verdicts.hear(feedback, began=self._began)

    def _is_far(self, iteration: int) -> bool:
        """Whether nobody who sees the robot could mean this iteration yet."""
        return self._began and iteration > self._now + KEPT_AHEAD

    def _acknowledge(self, stored: messages.PairStored) -> None:
        if stored.iteration >= self._now:
            self._bus.refusals.add(keys.PAIR_STORED.path, f"pair {stored.iteration}; now is {self._now}")
        elif self._outbox.acknowledge(stored):
            self._models.required = stored.versions
