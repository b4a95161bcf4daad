"""Actions that take long, periods that do not wait, changes: the robot service where time matters."""

import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest

from mdb_protocol import keys, messages
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_sim.body import NOTHING, Actuator, BodyError, Numbers, Outcome, Reading, Sensor, Spec
from mdb_sim.robot.clock import Clock
from mdb_sim.robot.course import Rules
from mdb_sim.robot.service import RobotService

BRAIN = "test"
BOUND_S = 10.0


class Slow:
    """A body whose actions go on until a test lets them end, or it is halted."""

    spec = Spec(
        sensors=(Sensor(name="height", low=0.0, high=9.0),),
        actuators=(Actuator(name="lift", low=0.0, high=1.0),),
        events=("top",),
        scene=("height",),
        changes=("weight",),
    )

    def __init__(self, *, waits: bool = True) -> None:
        self.done: list[float] = []
        self.halts = 0
        self.changed: dict[str, Any] = {}
        self.over = threading.Event()
        self.begun = threading.Event()
        self._waits = waits
        self.closed = False

    def reset(self, seed: int, episode: int) -> Reading:
        del seed, episode
        return {"height": 0.0}

    def act(self, values: Mapping[str, float]) -> Outcome:
        self.begun.set()
        if self._waits:
            assert self.over.wait(BOUND_S)
            self.over.clear()
        self.done.append(values["lift"])
        return Outcome(NOTHING, {"height": sum(self.done)})

    def halt(self) -> None:
        self.halts += 1
        self.over.set()

    def scene(self) -> Numbers:
        return {"height": sum(self.done), **self.changed}

    def state(self) -> bytes | None:
        return None

    def restore(self, state: bytes) -> None:
        raise BodyError(f"it cannot be put back to {state!r}")

    def change(self, **settings: Any) -> None:
        if set(settings) != {"weight"}:
            raise BodyError("expected weight")
        self.changed |= settings

    def close(self) -> None:
        self.closed = True


class Rig:
    """The service in this thread, its actions in another, and a clock of the test's own."""

    def __init__(self, body: Slow, **options: Any) -> None:
        self.body, self.now = body, 100.0
        self.fabric = Fabric()
        self.world = MemoryBus(self.fabric, BRAIN)
        self.perceptions = self.world.subscriber(keys.PERCEPTION)
        self.scenes = self.world.subscriber(keys.SCENE)
        bus = MemoryBus(self.fabric, BRAIN)
        self.service = RobotService(bus, body, Rules(), 1, clock=lambda: self.now, **options)
        self.newest: messages.Perception = self.perceptions.take()

    def say(self, iteration: int, lift: float = 1.0) -> None:
        action = messages.Action(iteration=iteration, action={"lift": lift}, valid_for_s=9.0, stamp=self.now)
        self.world.publisher(keys.ACTION).put(action)

    def step(self) -> messages.Perception:
        self.service.step()
        self.newest = self.perceptions.take() or self.newest
        return self.newest

    def until(self, true: Callable[[], bool]) -> None:
        """Step until something is so that another thread does."""
        for _ in range(int(BOUND_S * 1000)):
            self.step()
            if true():
                return
            self.service.bus.wait(0.001)
        pytest.fail("it never came true")


@pytest.fixture
def slow() -> Iterator[Rig]:
    rig = Rig(Slow(), threaded=True, hold_s=1.0)
    yield rig
    rig.service.close()


def test_while_the_body_acts_the_service_answers(slow: Rig) -> None:
    slow.say(0)
    slow.until(slow.body.begun.is_set)
    asked = MemoryBus(slow.fabric, BRAIN)
    slow.service.bus.queryable(
        keys.STATUS,
        lambda: messages.Status(
            role="robot", instance="body", pid=1, uptime_s=0.0, values=slow.service.values(), refused={}
        ),
        role="robot",
        instance="body",
    )
    (status,) = asked.query(keys.STATUS, 1.0, role="robot", instance="body")
    assert status.values["iteration"] == 0
    slow.body.over.set()
    slow.until(lambda: slow.newest.iteration == 1)
    assert slow.newest.reading == {"height": 1.0}


def test_while_the_body_acts_the_last_picture_stays(slow: Rig) -> None:
    pictures, watcher = slow.world.subscriber(keys.PICTURE), MemoryBus(slow.fabric, BRAIN)
    watcher.token("viewer", "eve")
    slow.say(0)
    slow.until(slow.body.begun.is_set)
    pictures.take()
    shown = slow.newest.stamp
    slow.now += 0.5
    slow.until(lambda: slow.newest.stamp > shown)
    assert pictures.take() is None
    slow.body.over.set()
    slow.until(lambda: slow.newest.iteration == 1)
    assert pictures.take() is not None


def test_an_action_that_is_carried_out_is_not_begun_again(slow: Rig) -> None:
    slow.say(0)
    slow.until(slow.body.begun.is_set)
    slow.say(0)
    slow.step()
    slow.body.over.set()
    slow.until(lambda: slow.newest.iteration == 1)
    slow.step()
    assert slow.body.done == [1.0]
    assert slow.service.bus.refusals.counts == {}


def test_an_action_whose_commander_is_silent_is_interrupted(slow: Rig) -> None:
    slow.say(0)
    slow.until(slow.body.begun.is_set)
    slow.now += 0.9
    slow.step()
    assert slow.body.halts == 0
    slow.say(0)  # it is sent again as long as somebody wants it
    slow.step()
    slow.now += 0.9
    slow.step()
    assert slow.body.halts == 0
    slow.now += 0.3
    slow.step()
    assert slow.body.halts == 1
    slow.until(lambda: slow.newest.iteration == 1)
    assert slow.service.values()["halts"] == 1


def test_closing_interrupts_and_waits(slow: Rig) -> None:
    slow.say(0)
    slow.until(slow.body.begun.is_set)
    slow.service.close()
    assert slow.body.halts == 1
    assert slow.body.done == [1.0], "the action was over before the body was freed"
    assert slow.body.closed


def test_a_body_at_rest_is_halted_once_when_nobody_commands_it() -> None:
    rig = Rig(Slow(waits=False))
    rig.say(0)
    assert rig.step().iteration == 1
    for _ in range(5):
        rig.now += 1.0
        rig.step()
    assert rig.body.halts == 1
    rig.say(1)
    rig.step()
    rig.now += 1.0
    rig.step()
    assert rig.body.halts == 2


# ---- every period ----


def clocked(**options: Any) -> Rig:
    return Rig(Slow(waits=False), period_s=0.1, hold_s=0.25, **options)


def test_in_each_period_the_action_that_came_is_done_once() -> None:
    rig = clocked()
    rig.step()
    assert rig.body.done == []
    rig.say(0, 0.5)
    assert rig.step().iteration == 0, "not before the period is over"
    rig.now += 0.1
    assert rig.step().iteration == 1
    assert rig.step().iteration == 1
    assert rig.body.done == [0.5]


def test_an_action_that_does_not_come_is_held_and_then_the_body_is_halted() -> None:
    rig = clocked()
    rig.say(0, 0.5)
    rig.step()
    for _ in range(6):
        rig.now += 0.1
        rig.step()
    assert rig.body.done == [0.5] * 3, "two periods more, within hold_s"
    assert rig.body.halts == 1
    assert rig.newest.iteration == 1, "what was held is no iteration more"
    assert rig.newest.reading == {"height": 1.5}
    rig.say(1, 1.0)
    rig.step()
    rig.now += 0.1
    assert rig.step().iteration == 2


def test_periods_that_were_slept_through_are_left_out_and_counted() -> None:
    rig = clocked()
    rig.step()
    rig.now += 0.35
    rig.step()
    values = rig.service.values()
    assert (values["periods"], values["missed_share"]) == (4, 0.5)
    assert rig.service.due_in_s() == pytest.approx(0.05)


def test_a_period_in_which_the_last_action_is_not_over_is_missed() -> None:
    rig = Rig(Slow(), period_s=0.1, threaded=True)
    rig.say(0)
    rig.now += 0.1
    rig.until(rig.body.begun.is_set)
    rig.now += 0.1
    rig.step()
    assert rig.service.values()["missed_share"] > 0
    rig.service.close()


def test_the_clock_tells_how_late_periods_begin() -> None:
    clock = Clock(1.0, 0.0)
    for now_s in (0.0, 1.1, 2.3):
        assert clock.tick(now_s)
        assert not clock.tick(now_s)
    assert clock.values()["jitter_p50_s"] == pytest.approx(0.1)
    assert clock.values()["missed_share"] == 0


# ---- changes ----


def test_a_change_that_is_asked_for_is_made_and_shown() -> None:
    rig = Rig(Slow(waits=False))
    rig.world.publisher(keys.CHANGE).put(messages.Change(settings={"weight": 2}))
    rig.step()
    assert rig.body.changed == {"weight": 2}
    assert rig.scenes.take().now["weight"] == 2
    assert rig.service.values()["changes"] == 1


def test_a_change_that_cannot_be_is_refused_and_counted() -> None:
    rig = Rig(Slow(waits=False))
    rig.world.publisher(keys.CHANGE).put(messages.Change(settings={"wings": 2}))
    rig.step()
    assert rig.body.changed == {}
    assert rig.service.bus.refusals.counts[keys.CHANGE.path] == 1


def test_a_change_waits_until_an_action_is_over(slow: Rig) -> None:
    slow.say(0)
    slow.until(slow.body.begun.is_set)
    slow.world.publisher(keys.CHANGE).put(messages.Change(settings={"weight": 2}))
    slow.step()
    assert slow.body.changed == {}
    slow.body.over.set()
    slow.until(lambda: slow.body.changed == {"weight": 2})


def test_the_file_changes_the_body_before_the_action_of_an_iteration() -> None:
    rig = Rig(Slow(waits=False), changes={2: {"weight": 3}})
    for iteration in range(3):
        rig.say(iteration)
        rig.step()
        assert bool(rig.body.changed) == (iteration >= 1)


def test_an_action_under_way_comes_to_its_end_in_a_pause_and_no_other_begins(slow: Rig) -> None:
    control = slow.world.publisher(keys.CONTROL)
    slow.say(0)
    slow.until(slow.body.begun.is_set)
    control.put(messages.Control(iteration=0, paused=True))
    for _ in range(4):
        slow.now += 0.5
        slow.say(0)  # the brain is there and says it again
        slow.step()
    assert slow.body.halts == 0
    slow.body.over.set()
    slow.until(lambda: slow.newest.iteration == 1)
    slow.say(1)
    slow.step()
    assert slow.body.done == [1.0]
    slow.body.begun.clear()
    control.put(messages.Control(iteration=1))
    slow.say(1)
    slow.until(slow.body.begun.is_set)
    slow.body.over.set()
    slow.until(lambda: slow.newest.iteration == 2)


def test_a_shorter_time_holds_for_the_action_that_goes_on() -> None:
    rig = Rig(Slow(waits=False), threaded=True, hold_s=100.0, action_s=60.0)
    rig.say(0)
    rig.until(lambda: rig.body.done == [1.0])
    rig.world.publisher(keys.CONTROL).put(messages.Control(iteration=0, action_s=0.0))
    rig.until(lambda: rig.newest.iteration == 1)
    assert rig.service.next_s() > 0.0
    rig.service.close()


def test_in_a_pause_a_clocked_robot_holds_nothing() -> None:
    rig = Rig(Slow(waits=False), period_s=0.1, hold_s=100.0)
    rig.say(0)
    for _ in range(3):
        rig.now += 0.1
        rig.step()
    held = len(rig.body.done)
    assert held > 1, "the last action is held"
    rig.world.publisher(keys.CONTROL).put(messages.Control(iteration=1, paused=True))
    halts = rig.body.halts
    for _ in range(5):
        rig.say(1)
        rig.now += 0.1
        rig.step()
    assert len(rig.body.done) == held
    assert rig.body.halts == halts + 1
