"""What the optimizer waits for, and for how long: every wait has a bound.

Owns whether a wait is over and which were in vain. Pure but for the clock and who is alive, which are handed in.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import structlog

from mdb_services.acting.models import CurrentModels
from mdb_services.acting.outbox import UNSTORED, Outbox
from mdb_services.acting.stages import Acting, Deciding
from mdb_services.acting.teachers import Teachers
from mdb_services.experiment.brain import BrainConfig

log = structlog.get_logger()

ASKED_S = 2.0
"""A teacher who asks to be waited for is waited for at least so long, for he asks about once a second (ours)."""
MOST_ASKED_S = 600.0
"""From one perception on, for the feedback and the next command, it is waited so long at most, however often somebody
asks for it (ours)."""


class Waits:
    """See the module's docstring."""

    def __init__(
        self,
        config: BrainConfig,
        clock: Callable[[], float],
        alive: Callable[[], frozenset[str]],
        *,
        models: CurrentModels,
        teachers: Teachers,
        outbox: Outbox,
    ) -> None:
        """`alive` gives the tokens of all who are there, or will be."""
        self._settings, self._lockstep = config.optimizer, config.lockstep
        self._most_unstored = UNSTORED if config.store.when_full == "stop" else None
        self._clock, self._alive = clock, alive
        self._models, self._teachers, self._outbox = models, teachers, outbox
        self._in_vain: dict[str, int] = {}

    def for_store(self) -> bool:
        """Whether so much is not stored that the robot is not to act."""
        return self._most_unstored is not None and len(self._outbox) > self._most_unstored

    def for_command(self, deciding: Deciding) -> bool:
        """Whether a command may still come for an action that is due."""
        iteration, patience_s = deciding.perception.iteration, self._settings.command_patience_s
        alive = self._alive()
        return not self._teachers.settled(iteration, alive) and self._goes_on(
            deciding.gave_up,
            "command",
            iteration,
            deciding.begun_s,
            patience_s,
            asked_s=self._teachers.asked_s(iteration, alive),
            perceived_s=deciding.started_s,
        )

    def for_feedback(self, acted: Acting, outcome_s: float) -> bool:
        """Whether the teacher who commanded may still say what he thinks of the outcome that came at `outcome_s`."""
        teacher, patience_s = acted.meant.teacher, self._settings.feedback_patience_s
        return (
            not self._teachers.answered(acted.iteration, teacher)
            and self._teachers.is_there(teacher, self._alive())
            and self._goes_on(
                acted.gave_up,
                "feedback",
                acted.iteration,
                outcome_s,
                patience_s,
                asked_s=self._teachers.asked_feedback_s(acted.iteration, teacher),
                perceived_s=outcome_s,
            )
        )

    def for_models(self, gave_up: set[str], iteration: int, since_s: float) -> bool:
        """Whether, in lockstep, models are learning yet what is stored, or pairs are not stored yet."""
        if not self._lockstep or (not len(self._outbox) and self._models.are_in):
            return False
        return self._goes_on(gave_up, "models", iteration, since_s, self._settings.lockstep_patience_s)

    def _goes_on(
        self,
        gave_up: set[str],
        what: str,
        iteration: int,
        since_s: float,
        patience_s: float,
        *,
        asked_s: float = -math.inf,
        perceived_s: float = -math.inf,
    ) -> bool:
        """Whether to wait on; in lockstep with its own patience, since a slow machine must not change the run.

        `asked_s`: when who is waited for asked for it last; from then on he has his time anew, but not for longer
        than `MOST_ASKED_S` after `perceived_s`, when what he is to answer was shown.
        """
        if self._lockstep:
            patience_s = max(patience_s, self._settings.lockstep_patience_s)
        asked_until_s = min(asked_s + max(patience_s, ASKED_S), perceived_s + MOST_ASKED_S)
        if self._clock() < max(since_s + patience_s, asked_until_s):
            return True
        if what not in gave_up:
            gave_up.add(what)
            self._in_vain[what] = self._in_vain.get(what, 0) + 1
            log.warning("it did not come in time", what=what, iteration=iteration, patience_s=patience_s)
        return False

    def values(self) -> dict[str, float]:
        """Whether acting waits for the memory store, and how often what was waited for in vain."""
        in_vain = {f"gave_up.{what}": float(count) for what, count in self._in_vain.items()}
        return {"waits_for_store": float(self.for_store())} | in_vain
