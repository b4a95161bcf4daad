"""The robot service: each action is done once, and whatever else comes is answered or refused."""

import errno
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from structlog.testing import capture_logs

from mdb_protocol import keys, messages
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.shell.elsewhere import BELIEVED_AFTER_S
from mdb_sim.bodies.finding import make_body
from mdb_sim.bodies.pioneer.world import Placement, Pose
from mdb_sim.body import NOTHING, Actuator, BodyError, Numbers, Outcome, Reading, Sensor, Spec
from mdb_sim.robot.course import Rules
from mdb_sim.robot.service import SHOWN_AGAIN_S, RobotService
from mdb_sim.robot.state_file import StateFile
from mdb_sim.studies.twins import PAPERS_RULES
from mdb_sim.teaching.policies.pioneer import PAPERS_TURNS_DEG

BRAIN, SEED = "test", 7
MOST = 2.0
BOUND_S = 10.0


@dataclass
class Rail:
    """A body on rails: an action moves it by its value."""

    done: list[float] = field(default_factory=list)
    resets: list[tuple[int, int]] = field(default_factory=list)
    x_m: float = 0.0
    halts: int = 0
    broken: bool = False
    closed: bool = False

    @property
    def spec(self) -> Spec:
        sensor, move = Sensor(name="distance", low=0.0, high=9.0), Actuator(name="move", low=0.0, high=MOST)
        return Spec(sensors=(sensor,), actuators=(move,), scene=("x_m",))

    def reset(self, seed: int, episode: int) -> Reading:
        self.resets.append((seed, episode))
        self.x_m = 0.0
        return {"distance": 1.0}

    def act(self, values: Mapping[str, float]) -> Outcome:
        if self.broken:
            raise BodyError("the motors are off")
        if values.keys() != {"move"} or not 0.0 <= values["move"] <= MOST:
            raise BodyError(f"expected move = 0 to {MOST}")
        self.done.append(values["move"])
        self.x_m += values["move"]
        return Outcome(NOTHING, {"distance": 1.0 + self.x_m})

    def halt(self) -> None:
        assert not self.closed
        self.halts += 1

    def scene(self) -> Numbers:
        return {"x_m": self.x_m}

    def state(self) -> bytes | None:
        return str(self.x_m).encode()

    def restore(self, state: bytes) -> None:
        self.x_m = float(state)

    def close(self) -> None:
        self.closed = True


def order(iteration: int, values: float | Numbers, stamp: float) -> messages.Action:
    action = values if isinstance(values, dict) else {"move": float(values)}
    return messages.Action(iteration=iteration, action=action, valid_for_s=1.0, stamp=stamp)


class Rig:
    def __init__(self, body: Any = None, rules: Rules | None = None, **options: Any) -> None:
        self.body = body or Rail()
        self.fabric = Fabric()
        self.brain = MemoryBus(self.fabric, BRAIN)
        self.perceptions = self.brain.subscriber(keys.PERCEPTION)
        self.scenes = self.brain.subscriber(keys.SCENE)
        self.pictures = self.brain.subscriber(keys.PICTURE)
        self.actions = self.brain.publisher(keys.ACTION)
        self.now = 100.0
        self.service = RobotService(
            MemoryBus(self.fabric, BRAIN),
            self.body,
            rules or Rules(),
            SEED,
            clock=lambda: self.now,
            **options,
        )

    def act(self, iteration: int, values: float | Numbers = 1.0, *, age_s: float = 0.0) -> messages.Perception | None:
        """Say an action that answers what was shown so long ago; return what is shown then."""
        self.actions.put(order(iteration, values, self.now - age_s))
        assert self.service.step() is True
        perception: messages.Perception | None = self.perceptions.take()
        return perception


def test_the_first_perception_is_shown_before_any_action() -> None:
    rig = Rig()
    assert rig.perceptions.take().iteration == 0
    scene = rig.scenes.take()
    assert (scene.iteration, scene.action, scene.before) == (0, None, None)
    assert rig.service.step() is False


def test_an_action_gives_a_perception_and_a_scene() -> None:
    rig = Rig()
    perception = rig.act(0, 2)
    assert perception is not None
    assert (perception.iteration, perception.reading) == (1, {"distance": 3.0})
    scene = rig.scenes.take()
    assert (scene.iteration, scene.action) == (1, {"move": 2.0})
    assert (scene.before, scene.reached, scene.now) == ({"x_m": 0.0}, {"x_m": 2.0}, {"x_m": 2.0})


def test_an_action_sent_again_is_done_once_and_its_perception_shown_again() -> None:
    rig = Rig()
    first = rig.act(0)
    assert rig.act(0) == first
    assert rig.act(0, 2) == first, "another action for an iteration that is over"
    second = rig.act(1)
    assert rig.act(0) == second
    assert rig.body.done == [1, 1]


def test_of_actions_that_came_together_the_newest_is_done() -> None:
    rig = Rig()
    rig.actions.put(order(0, 1, rig.now))
    rig.act(0, 2)
    assert rig.body.done == [2]


@pytest.mark.parametrize("values", [{"move": 3.0}, {"move": -0.1}, {"steer": 1.0}, {"move": 1.0, "steer": 1.0}, {}])
def test_actions_that_the_body_lacks_are_refused_and_counted(values: Numbers) -> None:
    rig = Rig()
    rig.perceptions.take()
    assert rig.act(0, values) is None
    assert rig.act(5, values) is None
    assert rig.service.values()["iteration"] == 0, "nor does it catch up for them"
    assert (rig.body.done, rig.body.resets) == ([], [(SEED, 0)])
    assert rig.service.bus.refusals.counts[keys.ACTION.path] == 2
    perception = rig.act(0, 2)
    assert perception is not None
    assert (perception.iteration, rig.body.done) == (1, [2.0])


def test_a_body_that_cannot_act_is_counted_and_asked_again() -> None:
    rig = Rig()
    rig.perceptions.take()
    rig.body.broken = True
    assert rig.act(0) is None
    assert rig.act(0) is None
    assert rig.service.bus.refusals.counts[keys.ACTION.path] == 2
    rig.body.broken = False
    perception = rig.act(0)
    assert perception is not None
    assert perception.iteration == 1


def test_a_fresh_body_goes_on_with_the_brains_iteration() -> None:
    rig = Rig()
    perception = rig.act(57)
    assert perception is not None
    assert (perception.iteration, rig.body.x_m) == (58, 1.0)
    rig.act(58)
    assert (rig.service.values()["iteration"], rig.body.x_m) == (59, 2.0)
    assert rig.body.resets == [(SEED, 0)], "where it stands"


def test_a_body_that_has_acted_takes_another_count_only_from_a_brain_that_insists() -> None:
    rig = Rig()
    rig.act(0)
    rig.perceptions.take()
    for far in (57, 2**53):
        assert rig.act(far) is None
    for _ in range(20):
        assert rig.act(57) is None
        assert rig.act(0) is not None, "what it did is shown again, and is no word of another count"
        rig.now += 0.1
        assert rig.act(2**53) is None
    assert (rig.service.values()["iteration"], rig.body.done) == (1, [1.0])
    assert rig.service.bus.refusals.counts[keys.ACTION.path] == 42
    perception = None
    for _ in range(round(BELIEVED_AFTER_S / 0.5) + 2):
        perception = perception or rig.act(57)
        rig.now += 0.5
    assert perception is not None
    assert (perception.iteration, rig.body.done) == (58, [1.0, 1.0])
    assert rig.body.resets == [(SEED, 0)], "where it stands"


def test_an_action_with_a_stamp_that_this_robot_never_gave_is_not_done() -> None:
    rig = Rig()
    rig.perceptions.take()
    for stamp in (rig.now + 0.1, 1e300, -1e300):
        rig.actions.put(order(0, 2, stamp))
        rig.service.step()
    assert (rig.body.done, rig.service.values()["late"]) == ([], 3.0)


def test_an_action_takes_its_time_on_the_wall() -> None:
    rig, took_s = Rig(action_s=0.5), []
    for _ in range(2):
        begun_s = time.perf_counter()
        rig.act(0)
        took_s.append(time.perf_counter() - begun_s)
    assert took_s[0] >= 0.5
    assert took_s[1] < 0.5, "it is not done twice"


def test_the_same_actions_give_the_same_perceptions() -> None:
    def run() -> list[messages.Perception | None]:
        rig = Rig(make_body("kinematic", {}), PAPERS_RULES)
        return [rig.act(i, {"turn": PAPERS_TURNS_DEG[i % 7]}) for i in range(20)]

    assert run() == run()


def test_closing_frees_the_body_and_values_say_where_it_is() -> None:
    rig = Rig()
    rig.act(0)
    assert rig.service.values()["iteration"] == 1
    rig.service.close()
    assert rig.body.closed


def test_an_action_that_answers_what_was_shown_too_long_ago_is_not_done() -> None:
    rig = Rig()
    rig.perceptions.take()
    again = rig.act(0, 2, age_s=1.1)
    assert again is not None
    assert (again.iteration, again.stamp) == (0, rig.now), "it is shown again, so that a fresh action can answer"
    assert (rig.body.done, rig.service.values()["late"]) == ([], 1.0)
    rig.act(0, 2, age_s=0.9)
    assert rig.body.done == [2]


def test_a_process_that_was_frozen_does_nothing_of_what_came_meanwhile() -> None:
    rig = Rig()
    shown = rig.perceptions.take()
    rig.actions.put(order(0, 2, shown.stamp))
    rig.now += 3600.0
    assert rig.service.step() is True
    assert rig.body.done == []


def test_what_is_perceived_is_shown_again_while_no_action_comes() -> None:
    rig = Rig()
    first, _ = rig.perceptions.take(), rig.scenes.take()
    rig.service.step()
    assert rig.perceptions.take() is None
    rig.now += SHOWN_AGAIN_S
    rig.service.step()
    again = rig.perceptions.take()
    assert again == replace_stamp(first, rig.now)
    assert rig.scenes.take() is not None
    assert rig.body.done == []


def replace_stamp(perception: messages.Perception, stamp: float) -> messages.Perception:
    return msgspec.structs.replace(perception, stamp=stamp)


@pytest.mark.parametrize("body", ["kinematic", "pybullet"])
def test_a_killed_robot_goes_on_where_it_was(body: str, tmp_path: Path) -> None:
    if body == "pybullet":
        pytest.importorskip("pybullet", reason="needs the pybullet extra (Python 3.11)")
    actions = [{"turn": PAPERS_TURNS_DEG[(3 * i) % 7]} for i in range(60)]
    straight = Rig(make_body(body, {}), PAPERS_RULES)
    expected = [straight.act(i, action) for i, action in enumerate(actions)]
    file = StateFile(tmp_path / "robot.state")
    rig = Rig(make_body(body, {}), PAPERS_RULES, file=file)
    got = []
    for i, action in enumerate(actions):
        if i % 7 == 3:
            rig = Rig(make_body(body, {}), PAPERS_RULES, file=file)
            shown = rig.perceptions.take()
            assert shown == got[-1], "what it showed last, the optimizer's intention with it"
        got.append(rig.act(i, action))
    assert got == expected
    successes = [rig.service.values()["successes"], straight.service.values()["successes"]]
    assert successes[0] == successes[1]
    assert {step.event for step in expected if step is not None} > {"none"}, "new placements are drawn as before"


def test_a_damaged_state_is_set_aside_and_the_robot_begins_anew(tmp_path: Path) -> None:
    path = tmp_path / "robot.state"
    rig = Rig(file=StateFile(path))
    rig.act(0)
    path.write_bytes(path.read_bytes()[:30])
    rig = Rig(file=StateFile(path))
    assert rig.perceptions.take().iteration == 0
    assert (tmp_path / "robot.damaged").exists()
    rig.act(0)
    assert StateFile(path).read() is not None


class FullDisk(StateFile):
    """A disk that takes nothing for a while."""

    full = True

    def write(self, state: messages.RobotState) -> None:
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        super().write(state)


def test_a_robot_whose_disk_is_full_acts_and_says_so_once(tmp_path: Path) -> None:
    file = FullDisk(tmp_path / "robot.state")
    rig = Rig(file=file)
    with capture_logs() as lines:
        for i in range(5):
            rig.act(i)
        values = rig.service.values()
        assert (values["unwritten"], values["disk_refuses"]) == (5.0, 1.0)
        file.full = False
        rig.act(5)
    values = rig.service.values()
    assert (values["unwritten"], values["disk_refuses"]) == (5.0, 0.0)
    assert [line["log_level"] for line in lines] == ["error", "info"]
    state = file.read()
    assert state is not None
    assert state.perception.iteration == 6


def far_away() -> bytes | None:
    """The state of a robot in a larger arena, outside the usual one."""
    robot = make_body("kinematic", {"arena_m": 100.0})
    robot.put(Placement(Pose(40.0, 0.0, 0.0), 41.0, 0.0), SEED)  # type: ignore[attr-defined]
    return robot.state()


@pytest.mark.parametrize("body", [b"nothing", far_away()])
def test_a_state_that_the_body_cannot_take_is_left(body: bytes, tmp_path: Path) -> None:
    file = StateFile(tmp_path / "robot.state", power_safe=True)
    rig = Rig(file=file)
    rig.act(0)
    state = file.read()
    assert state is not None
    file.write(msgspec.structs.replace(state, body=body))
    with capture_logs() as lines:
        rig = Rig(make_body("kinematic", {}), file=file)
    assert rig.perceptions.take().iteration == 0
    assert [line["log_level"] for line in lines] == ["warning"]
    assert rig.act(0, {"turn": 0.0}) is not None


def test_a_machine_that_cannot_be_put_back_goes_on_with_its_count_where_it_stands(tmp_path: Path) -> None:
    class Machine(Rail):
        def state(self) -> bytes | None:
            return None

    file = StateFile(tmp_path / "robot.state")
    rig = Rig(Machine(), file=file)
    for i in range(3):
        last = rig.act(i)
    rig = Rig(machine := Machine(), file=file)
    assert rig.perceptions.take() == last
    assert (rig.service.values()["iteration"], machine.x_m) == (3, 0.0)
    perception = rig.act(3)
    assert perception is not None
    assert perception.iteration == 4


# ---- episodes, successes ----


def test_episodes_end_and_successes_count_by_the_rules_of_the_experiment() -> None:
    rig = Rig(rules=Rules(frozenset({"timeout"}), longest=2))
    rig.scenes.take()
    rig.act(0)
    perception = rig.act(1, 2)
    assert perception is not None
    assert (perception.event, perception.outcome, perception.reading) == (
        "timeout", {"distance": 4.0}, {"distance": 1.0},
    )  # fmt: skip
    scene = rig.scenes.take()
    assert (scene.episode, scene.successes, scene.success, scene.ended) == (1, 1, True, True)
    assert (scene.reached, scene.now) == ({"x_m": 3.0}, {"x_m": 0.0})
    assert rig.body.resets == [(SEED, 0), (SEED, 1)]
    assert rig.service.values()["successes"] == 1.0


def test_what_the_optimizer_meant_travels_through_unread() -> None:
    rig = Rig()
    rig.perceptions.take()
    meant = messages.Intention(
        before={"distance": 1.0}, note=3, teacher="anna", holder="anna", mode="taught", explored=False,
        predicted=0.5, versions={"object": 4},
    )  # fmt: skip
    action = msgspec.structs.replace(order(0, 1, rig.now), choice=2, intention=meant)
    rig.actions.put(action)
    rig.service.step()
    perception = rig.perceptions.take()
    assert perception.done == action


# ---- a body that nobody commands ----


def test_a_body_that_nobody_commands_is_halted_once_after_each_action() -> None:
    rig = Rig()

    def waits() -> int:
        for _ in range(5):
            rig.now += SHOWN_AGAIN_S
            rig.service.step()
        return rig.body.halts

    assert waits() == 0, "it has not moved yet"
    rig.act(0)
    assert rig.body.halts == 0
    assert waits() == 1
    rig.act(1)
    assert waits() == 2
    assert rig.service.values()["halts"] == 2.0


def test_a_closed_service_has_halted_its_body_first() -> None:
    rig = Rig()
    rig.act(0)
    rig.service.close()
    assert (rig.body.halts, rig.body.closed) == (1, True)


# ---- pictures ----


@pytest.mark.parametrize(
    ("role", "instance", "shown"),
    [
        ("teacher", "anna", True),
        ("viewer", "eve", True),
        ("teacher", "script", False),
        ("optimizer", "action", False),
    ],
)
def test_a_picture_is_made_only_while_somebody_watches(role: str, instance: str, shown: bool) -> None:
    rig = Rig(make_body("kinematic", {}))
    rig.act(0, {"turn": 0.0})
    assert rig.pictures.take() is None
    watcher = MemoryBus(rig.fabric, BRAIN)
    watcher.token(role, instance)
    rig.act(1, {"turn": 0.0})
    picture = rig.pictures.take()
    assert (picture is not None) == shown
    if picture is not None:
        assert (picture.iteration, picture.image) == (2, None)
        assert picture.drawing.front_rad == rig.scenes.take().now["heading_rad"]
    watcher.close()
    rig.act(2, {"turn": 0.0})
    assert rig.pictures.take() is None


def test_a_body_that_cannot_draw_shows_its_image_or_nothing() -> None:
    class Camera(Rail):
        def image(self) -> np.ndarray:
            return np.full((2, 3, 3), 7, np.uint8)

    for body, has_image in ((Camera(), True), (Rail(), False)):
        rig = Rig(body)
        rig.brain.token("viewer", "eve")
        rig.act(0)
        picture = rig.pictures.take()
        assert (picture.iteration, picture.drawing) == (1, None)
        assert (picture.image is not None) == has_image


# ---- changes ----


class Loaded(Rail):
    """A body on rails whose load can be changed."""

    load = 1.0

    def change(self, **settings: Any) -> None:
        if settings.keys() != {"load"}:
            raise BodyError(f"{settings}; expected load")
        self.load = settings["load"]

    def scene(self) -> Numbers:
        return super().scene() | {"load": self.load}


def test_what_somebody_asks_to_be_changed_is_changed_and_shown(tmp_path: Path) -> None:
    file = StateFile(tmp_path / "robot.state")
    rig = Rig(Loaded(), file=file)
    asks = rig.brain.publisher(keys.CHANGE)
    rig.act(0)
    rig.scenes.take()
    asks.put(messages.Change(settings={"load": 3.0}))
    assert rig.service.step() is True
    assert rig.scenes.take().now == {"x_m": 1.0, "load": 3.0}
    assert rig.perceptions.take().iteration == 1
    state = file.read()
    assert state is not None
    assert state.scene.now["load"] == 3.0
    asks.put(messages.Change(settings={"wind": 3.0}))
    rig.service.step()
    assert (rig.body.load, rig.scenes.take()) == (3.0, None)
    assert rig.service.bus.refusals.counts[keys.CHANGE.path] == 1


def test_changes_of_the_experiment_come_when_they_are_due() -> None:
    rig = Rig(Loaded(), changes={2: {"load": 5.0}})
    loads = []
    for i in range(3):
        rig.act(i)
        scene = rig.scenes.take()
        loads.append((scene.reached["load"], scene.now["load"]))
    assert loads == [(1.0, 1.0), (1.0, 5.0), (5.0, 5.0)]


def test_while_it_is_paused_it_takes_no_action_shows_itself_again_and_is_halted_once() -> None:
    rig = Rig()
    control = rig.brain.publisher(keys.CONTROL)
    rig.act(0)
    halts = rig.body.halts
    control.put(messages.Control(iteration=1, paused=True))
    for _ in range(5):
        rig.actions.put(order(1, 1.0, rig.now))
        rig.service.step()
        rig.now += SHOWN_AGAIN_S
    assert rig.body.done == [1.0]
    assert rig.perceptions.take().stamp > rig.now - 2 * SHOWN_AGAIN_S, "the brain sees that it is there"
    assert rig.body.halts == halts + 1
    assert rig.service.values()["paused"] == 1.0
    control.put(messages.Control(iteration=1))
    rig.service.step()
    perception = rig.act(1, 0.5)
    assert perception is not None
    assert (perception.iteration, rig.body.done) == (2, [1.0, 0.5])
    assert rig.service.values()["paused"] == 0.0


def test_in_a_pause_the_robot_can_be_changed() -> None:
    rig = Rig(Loaded())
    rig.act(0)
    rig.brain.publisher(keys.CONTROL).put(messages.Control(iteration=1, paused=True))
    rig.brain.publisher(keys.CHANGE).put(messages.Change(settings={"load": 3.0}))
    rig.service.step()
    assert rig.body.load == 3.0


def test_a_robot_that_is_started_in_a_pause_is_paused() -> None:
    fabric = Fabric()
    operator = MemoryBus(fabric, BRAIN)
    operator.publisher(keys.CONTROL).put(messages.Control(iteration=0, paused=True))
    body = Rail()
    service = RobotService(MemoryBus(fabric, BRAIN), body, Rules(), SEED, clock=lambda: 100.0)
    operator.publisher(keys.ACTION).put(order(0, 1.0, 100.0))
    service.step()
    assert body.done == []


def test_an_operator_sets_the_least_time_of_an_action_unless_the_pace_is_fixed() -> None:
    for options, expected in (({}, [0.3, 0.01]), ({"fixed_pace": True}, [0.01, 0.01]), ({"period_s": 1.0}, None)):
        rig = Rig(action_s=0.01, **options)
        least = []
        for asked in (0.3, None):
            rig.brain.publisher(keys.CONTROL).put(messages.Control(iteration=0, action_s=asked))
            rig.service.step()
            least.append(rig.service.values()["least_s"])
        assert least == (expected or [0.01, 0.01])


def test_an_action_takes_as_long_as_the_operator_wants() -> None:
    rig = Rig()
    rig.brain.publisher(keys.CONTROL).put(messages.Control(iteration=0, action_s=0.1))
    rig.service.step()
    begun_s = time.perf_counter()
    rig.act(0)
    assert time.perf_counter() - begun_s >= 0.1


# ---- a clocked robot ----


def test_a_clocked_robot_holds_an_action_until_another_comes_or_nobody_commands() -> None:
    rig = Rig(period_s=0.125, hold_s=0.25)

    def period() -> float:
        rig.now += 0.125
        rig.service.step()
        return float(rig.service.values()["iteration"])

    rig.service.step()
    assert (period(), rig.body.done) == (0.0, []), "nobody has commanded it yet"
    rig.actions.put(order(0, 2, rig.now))
    assert rig.service.step() is True
    assert rig.body.done == [], "the period is not over"
    assert (period(), rig.body.done) == (1.0, [2.0])
    assert (period(), rig.body.done) == (1.0, [2.0, 2.0]), "held: no iteration more"
    assert period() == 1.0
    assert rig.body.done == [2.0, 2.0]
    assert rig.body.halts == 1, "nobody commands it any more"
    assert (period(), rig.body.halts) == (1.0, 1)
    rig.actions.put(order(1, 1, rig.now))
    assert (period(), rig.body.done) == (2.0, [2.0, 2.0, 1.0])


def test_what_a_held_action_leads_to_is_shown_as_of_the_same_iteration() -> None:
    rig = Rig(period_s=0.1)
    shown = []
    rig.actions.put(order(0, 2, rig.now))
    for _ in range(3):
        rig.now += 0.1
        rig.service.step()
        shown.append(rig.perceptions.take())
    assert [perception.iteration for perception in shown] == [1, 1, 1]
    assert [perception.reading["distance"] for perception in shown] == [3.0, 5.0, 7.0]
    assert {perception.done.iteration for perception in shown} == {0}


def test_a_clocked_robot_says_when_it_is_due_and_what_it_missed() -> None:
    rig = Rig(period_s=0.1)
    rig.service.step()
    assert rig.service.due_in_s() == pytest.approx(0.1)
    rig.now += 0.06
    assert rig.service.due_in_s() == pytest.approx(0.04)
    rig.now += 0.3
    rig.service.step()
    values = rig.service.values()
    assert (values["periods"], values["missed_share"]) == (4.0, 0.5)
    assert Rig().service.due_in_s() == SHOWN_AGAIN_S
    assert "periods" not in Rig().service.values()


# ---- a body that takes its time, in a thread ----


class Slow(Rail):
    """An action is over when the test says so, or when the body is halted."""

    def __init__(self) -> None:
        super().__init__()
        self.over, self.begun = threading.Event(), threading.Event()

    def act(self, values: Mapping[str, float]) -> Outcome:
        self.begun.set()
        assert self.over.wait(BOUND_S)
        self.over.clear()
        return super().act(values)

    def halt(self) -> None:
        super().halt()
        self.over.set()


class ThreadedRig(Rig):
    def begin(self, iteration: int) -> Slow:
        self.actions.put(order(iteration, 1, self.now))
        self.service.step()
        body: Slow = self.body
        assert body.begun.wait(BOUND_S)
        body.begun.clear()
        return body

    def conclude(self) -> messages.Perception:
        """Wait until an action is over, as the service does."""
        deadline = time.monotonic() + BOUND_S
        while (perception := self.perceptions.take()) is None:
            assert time.monotonic() < deadline
            self.service.bus.wait(0.05)
            self.service.step()
        return perception


def test_while_an_action_is_carried_out_the_service_answers_and_does_no_other() -> None:
    rig = ThreadedRig(Slow(), threaded=True)
    rig.perceptions.take()
    body = rig.begin(0)
    for values in (1, 2):
        rig.actions.put(order(0, values, rig.now))
        assert rig.service.step() is True
    assert rig.service.values()["iteration"] == 0
    rig.actions.put(order(1, 1, rig.now))
    rig.service.step()
    assert rig.service.bus.refusals.counts[keys.ACTION.path] == 1, "that one is not due"
    body.over.set()
    assert rig.conclude().iteration == 1
    assert body.done == [1.0]
    body = rig.begin(1)
    body.over.set()
    assert rig.conclude().iteration == 2
    rig.service.close()


def test_an_action_whose_commander_falls_silent_is_interrupted_once() -> None:
    rig = ThreadedRig(Slow(), threaded=True, hold_s=1.0)
    rig.perceptions.take()
    body = rig.begin(0)
    rig.now += 0.9
    rig.service.step()
    assert (rig.perceptions.take().iteration, body.halts) == (0, 0), "it is shown that it lives"
    rig.now += 0.9
    rig.service.step()
    assert body.halts == 1
    rig.perceptions.take()
    assert rig.conclude().iteration == 1, "what it led to is told"
    for _ in range(3):
        rig.now += 0.9
        rig.service.step()
    assert body.halts == 1
    rig.service.close()


def test_closing_interrupts_the_action_that_is_being_carried_out() -> None:
    rig = ThreadedRig(Slow(), threaded=True)
    body = rig.begin(0)
    rig.service.close()
    assert (body.done, body.closed) == ([1.0], True), "it was over before the body was freed"
