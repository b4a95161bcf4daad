"""An operator in a real brain: pause, pace, the next phase, and the teacher silenced so that a person is obeyed."""

from pathlib import Path

import pytest

from mdb_deploy.teach.session import TeachingSession
from mdb_deploy.teach.thread import SessionThread
from mdb_protocol import keys, messages
from mdb_protocol.bus import Inbox
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_sim.runs.record import read_record
from mdb_sim.teaching.languages import make_language
from mdb_sim.teaching.policies.pioneer import Reach
from tests.integration.brain import Brain, select_nothing, until

pytestmark = pytest.mark.long

LONG = (
    "experiment.iterations=100000",
    "teacher.phase.alone.start=90000",
    "teacher.phase.second teacher.start=91000",
    "teacher.phase.alone again.start=92000",
    "optimizer.command_patience_s=1.0",
    "optimizer.feedback_patience_s=1.0",
)
PAUSED_S, SLOW_S, LONGER_S = 1.5, 0.5, 4.0


class Operator:
    """One who says how the run goes on, and sees it."""

    def __init__(self, bus: ZenohBus) -> None:
        self.reports: Inbox = bus.subscriber(keys.ITERATION)
        self.phases: Inbox = bus.subscriber(keys.PHASE)
        self._control = bus.publisher(keys.CONTROL)
        self.last: messages.IterationReport | None = None
        self.phase: messages.Phase | None = None

    def say(self, **fields: object) -> None:
        self._control.put(messages.Control(iteration=self.iteration(), **fields))  # type: ignore[arg-type]

    def look(self) -> int:
        """Read what has come; return how many iterations it was."""
        came = list(self.reports.some())
        self.last = came[-1] if came else self.last
        for phase in self.phases.some():
            self.phase = phase
        return len(came)

    def iteration(self) -> int:
        self.look()
        return self.last.iteration if self.last else 0

    def until_iteration(self, iteration: int) -> None:
        until(lambda: self.iteration() >= iteration)

    def moves(self, seconds: float) -> int:
        """How many iterations are done in this time."""
        self.look()
        before = self.iteration()
        select_nothing(seconds)
        return self.iteration() - before


def test_an_operator_pauses_slows_and_ends_phases_and_a_person_takes_over(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        operator = Operator(bus)
        operator.until_iteration(10)

        operator.say(paused=True)
        until(lambda: operator.moves(0.3) == 0)
        assert operator.moves(PAUSED_S) == 0
        operator.say(action_s=SLOW_S)
        assert operator.moves(4 * SLOW_S) <= 4
        operator.say()
        operator.until_iteration(operator.iteration() + 20)

        ended = operator.iteration()
        operator.say(ended=[ended])
        until(lambda: operator.look() is not None and operator.phase and operator.phase.name == "alone")
        assert operator.phase is not None
        assert operator.phase.iteration == ended + 1
        operator.say(ended=[ended, ended + 5])
        until(lambda: operator.look() is not None and operator.phase and operator.phase.name == "second teacher")

        operator.say(ended=[ended, ended + 5], script=False)
        until(lambda: operator.look() is not None and operator.phase and operator.phase.teacher is None)
        people(brain, operator)
        operator.say(ended=[ended, ended + 5])
        until(lambda: operator.look() is not None and operator.last and operator.last.teacher == "two")
        brain.interrupt()
        brain.wait()
    spans = read_record(brain.run).spans
    assert [(span.name, span.teacher) for span in spans[:5]] == [
        ("first teacher", "one"), ("alone", None), ("second teacher", "two"), ("second teacher", None),
        ("second teacher", "two"),
    ]  # fmt: skip
    assert spans[1].start == ended + 1


def people(brain: Brain, operator: Operator) -> None:
    """Ann comes, lets the brain wait for longer than its patience, is obeyed, and leaves."""
    policy = Reach()
    with brain.bus() as bus:
        session = TeachingSession(bus, "ann", make_language("ordered", policy.order), policy, patience_s=(1.0, 1.0))
        session.wait_for_me(True)
        thread = SessionThread(session)
        thread.start()
        try:
            until(lambda: session.view.turn.kind == "play" and operator.moves(0.2) == 0)
            assert operator.moves(LONGER_S) == 0, "it waits"
            assert session.view.turn.until_s is None
            session.command(3)
            until(lambda: session.view.turn.kind == "both")
            assert operator.moves(LONGER_S) == 0, "it waits for her feedback, too"
            last = session.view.turn.iteration - 1
            session.feedback(0.5, last)
            session.command(2)
            until(lambda: session.view.report and session.view.report.iteration >= last)
            report = session.view.report
            assert report is not None
            assert (report.iteration, report.teacher, report.note, report.feedback) == (last, "ann", 3, 0.5)
            session.wait_for_me(False)
            until(lambda: operator.moves(0.5) > 0)
        finally:
            thread.stop()
