"""Dead-man's switch and frozen processes: a robot that nobody guides stands still, and nothing stale is done."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import pytest

from mdb_protocol import messages
from mdb_services.acting.outbox import UNSTORED
from tests.integration.brain import Brain, until
from tests.integration.ears import Ears, frozen, longest_gap_s, of, stored_iterations
from tests.integration.test_survival import LONG

pytestmark = pytest.mark.long

VALID_S = 1.0
"""`optimizer.action_valid_s` of the experiment."""
SCHEDULING_S = 0.5
"""What a busy machine may take."""


class Watched(NamedTuple):
    """A brain, and somebody who hears all that is said in it."""

    brain: Brain
    ears: Ears


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watched]:
    """One brain for all of them: each goes on where the one before has left it."""
    with Brain(tmp_path_factory.mktemp("brain"), *LONG, "robot.action_s=0") as brain:
        ears = Ears(brain.bus(), brain.bus)
        yield Watched(brain, ears)
        ears.bus.close()


@pytest.fixture
def ears(watched: Watched) -> Iterator[Ears]:
    """Hears from now on; a test that fails shows what the brain said."""
    watched.ears.listen(0.1)
    watched.ears.heard.clear()
    goes_on(watched.ears)
    yield watched.ears
    sys.stdout.write(watched.brain.output())


def pid_of(brain: Brain, ears: Ears, role: str, instance: str) -> int:
    status = until(lambda: brain.status(ears.bus, role, instance))
    assert isinstance(status, messages.Status)
    return status.pid


def robots(brain: Brain, ears: Ears) -> dict[str, float]:
    status = until(lambda: brain.status(ears.bus, "robot", "body"))
    assert isinstance(status, messages.Status)
    return status.values


@contextmanager
def unattended(brain: Brain) -> Iterator[None]:
    """Nobody is started again, and who is frozen is not ended, for the supervisor is frozen, too."""
    with frozen(brain.process.pid):
        yield


def goes_on(ears: Ears, more: int = 20) -> None:
    """Return when so many iterations were done from now on."""
    first = len(ears.heard)
    until(lambda: ears.listen(0.1) and len(of(ears.heard[first:], messages.IterationReport)) >= more)


def stands(ears: Ears, seconds: float) -> int:
    """Listen; the robot must show that it is still where it was, and the same all the time. Return the iteration."""
    shown = of(ears.listen(seconds), messages.Perception)
    assert len(shown) >= int(seconds / 0.5), "it shows again what it perceives"
    assert {p.iteration for p in shown} == {shown[0].iteration}
    assert len({p.stamp for p in shown}) == len(shown)
    return shown[0].iteration


@pytest.mark.parametrize(("role", "instance"), [("optimizer", "action"), ("memory", "store"), ("robot", "body")])
def test_who_hangs_is_replaced_and_nobody_else_is(watched: Watched, ears: Ears, role: str, instance: str) -> None:
    """Before the others: a reader who was frozen may find a router that gives it nothing any more, which is replaced
    seconds later (`mdb_protocol.probing`)."""
    brain, _ = watched
    before = {child.pid for child in brain.children()}
    hung = pid_of(brain, ears, role, instance)
    os.kill(hung, signal.SIGSTOP)
    until(lambda: hung not in {child.pid for child in brain.children()})
    goes_on(ears)
    assert pid_of(brain, ears, role, instance) != hung
    assert before - {child.pid for child in brain.children()} == {hung}


def test_without_an_optimizer_the_robot_stands_still_and_with_the_next_one_it_goes_on(
    watched: Watched, ears: Ears
) -> None:
    brain, _ = watched
    optimizer = pid_of(brain, ears, "optimizer", "action")
    with unattended(brain):
        os.kill(optimizer, signal.SIGKILL)
        ears.listen(0.3)
        stood = stands(ears, 2.0)
    goes_on(ears)
    assert pid_of(brain, ears, "optimizer", "action") != optimizer
    done = {p.done.iteration for p in of(ears.heard, messages.Perception) if p.done is not None}
    assert stood in done


def test_a_frozen_optimizer_moves_nothing_then_and_nothing_stale_after(watched: Watched, ears: Ears) -> None:
    brain, _ = watched
    optimizer = pid_of(brain, ears, "optimizer", "action")
    with unattended(brain), frozen(optimizer):
        ears.listen(0.3)
        stands(ears, 2.5)
    goes_on(ears)
    check_nothing_stale(ears)


def test_a_robot_that_was_frozen_does_none_of_the_actions_that_came_meanwhile(watched: Watched, ears: Ears) -> None:
    brain, _ = watched
    robot, optimizer = pid_of(brain, ears, "robot", "body"), pid_of(brain, ears, "optimizer", "action")
    late = robots(brain, ears)["late"]
    with unattended(brain):
        with frozen(optimizer):
            ears.listen(0.3)
            stood = stands(ears, 0.6)
            os.kill(robot, signal.SIGSTOP)
        try:  # the optimizer answers what the robot had shown before it froze, again and again
            meanwhile = of(ears.listen(3.0), messages.Action)
        finally:
            os.kill(robot, signal.SIGCONT)
    waiting = [action for action in meanwhile if action.iteration == stood]
    assert len(waiting) >= 3, "actions came while it was frozen"
    stale = max(action.stamp for action in waiting)
    goes_on(ears)
    assert robots(brain, ears)["late"] > late
    done = [p.done for p in of(ears.heard, messages.Perception) if p.done is not None]
    (first,) = {action.stamp for action in done if action.iteration == stood}
    assert first > stale + 2.0, "what was done in the end answered what the robot showed after it had woken"
    check_nothing_stale(ears)


def check_nothing_stale(ears: Ears) -> None:
    """Every action was done within its time, by the robot's own clock."""
    first_shown: dict[int, messages.Perception] = {}
    for shown in of(ears.heard, messages.Perception):
        first_shown.setdefault(shown.iteration, shown)
    late = [
        shown.stamp - shown.done.stamp
        for shown in first_shown.values()
        if shown.done is not None and shown.stamp - shown.done.stamp > VALID_S + SCHEDULING_S
    ]
    assert len(first_shown) > 20
    assert late == []


def test_a_frozen_memory_store_stops_the_robot_in_time_and_costs_no_pair(watched: Watched, ears: Ears) -> None:
    brain, _ = watched
    memory = pid_of(brain, ears, "memory", "store")
    with unattended(brain), frozen(memory):
        ears.listen(4.0)
        ahead = of(ears.heard, messages.IterationReport)[-1].iteration - last_stored(ears)
        assert 0 < ahead <= UNSTORED + 1
    goes_on(ears, UNSTORED + 50)
    optimizer = until(lambda: brain.status(ears.bus, "optimizer", "action"))
    assert isinstance(optimizer, messages.Status)
    assert optimizer.values["lost"] == 0
    acknowledged = {stored.iteration for stored in of(ears.heard, messages.PairStored)}
    on_disk = stored_iterations(brain.run)
    assert acknowledged <= set(on_disk)
    assert on_disk == list(range(len(on_disk)))


def last_stored(ears: Ears) -> int:
    return max(stored.iteration for stored in of(ears.heard, messages.PairStored))


@pytest.mark.parametrize(
    ("role", "instance", "bound_s"),
    [("evolver", "communication", 0.5), ("recorder", "log", 1.0), ("teacher", "script", 4.0)],
)
def test_who_is_frozen_holds_up_acting_for_a_bounded_time(
    watched: Watched, ears: Ears, role: str, instance: str, bound_s: float
) -> None:
    """A reader that takes nothing costs 0.3 s, a teacher the patience (2 s) until his token is gone (lease 2 s)."""
    brain, _ = watched
    began_s = ears.heard[-1].at_s
    before = longest_gap_s(ears.heard, messages.IterationReport, ears.heard[0].at_s, began_s)
    one = pid_of(brain, ears, role, instance)
    with unattended(brain), frozen(one):
        ears.listen(bound_s + 1.5)
    ended_s = ears.heard[-1].at_s
    gap_s = longest_gap_s(ears.heard, messages.IterationReport, began_s, ended_s)
    said = f"{role} frozen: longest gap {gap_s:.2f} s, before {before:.2f} s"
    assert gap_s < bound_s + max(before, SCHEDULING_S), said
    goes_on(ears)


@pytest.mark.edge("a start that fails, a process that hangs", "everybody asleep for a while: nobody is replaced")
def test_after_a_sleep_of_everybody_nobody_is_replaced(watched: Watched, ears: Ears) -> None:
    brain, _ = watched
    before, said = {child.pid for child in brain.children()}, len(brain.output())
    with ExitStack() as asleep:
        for pid in (brain.process.pid, *before):
            asleep.enter_context(frozen(pid))
        ears.listen(4.0)
    goes_on(ears)
    since = brain.output()[said:]
    assert "it hung" not in since
    # All leases have ended: now and then Zenoh connects one again and gives him nothing, which is found by asking.
    assert {child.pid for child in brain.children()} == before or "nothing any more" in since
