"""The robot service: each action is done once, and whatever else comes is answered or refused."""

import errno
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from structlog.testing import capture_logs

from mdb_protocol import keys, messages
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_services.shell.elsewhere import BELIEVED_AFTER_S
from mdb_sim.body import Placement, Pose, RobotConfig, RobotError, Step, make_robot
from mdb_sim.robot.service import SHOWN_AGAIN_S, RobotService
from mdb_sim.robot.state_file import StateFile

BRAIN, SEED = "test", 7
START = Placement(Pose(0.0, 0.0, 0.0), 1.0, 0.0)


@dataclass
class Body:
    """A body on rails: an action moves it by its own number."""

    actions: int = 3
    done: list[int] = field(default_factory=list)
    restored: list[tuple[int, int]] = field(default_factory=list)
    broken: bool = False
    closed: bool = False
    last: Step | None = None

    @property
    def placement(self) -> Placement:
        assert self.last is not None
        return self.last.now

    def reset(self, seed: int) -> Step:  # noqa: ARG002
        reading = {"distance": 1.0}
        self.last = Step(0, "none", START, reading, START, reading, captures=0, episode=0)
        return self.last

    def sense(self) -> dict[str, float]:
        return {"distance": 1.0}

    def act(self, action: int) -> Step:
        if self.broken:
            raise RobotError("the motors are off")
        assert self.last is not None
        self.done.append(action)
        at = self.last.now.robot
        now = replace(self.last.now, robot=replace(at, x_m=at.x_m + action))
        reading = {"distance": 1.0 + now.robot.x_m}
        self.last = replace(
            self.last, iteration=self.last.iteration + 1, reached=now, now=now, reading=reading, next_reading=reading
        )
        return self.last

    def restore(self, placement: Placement, iteration: int, *, seed: int, **_: int) -> None:  # noqa: ARG002
        assert self.last is not None
        self.restored.append((iteration, seed))
        self.last = replace(self.last, iteration=iteration)

    def close(self) -> None:
        self.closed = True


def order(iteration: int, action: int, stamp: float) -> messages.Action:
    return messages.Action(iteration=iteration, action=action, valid_for_s=1.0, stamp=stamp)


class Rig:
    def __init__(self, body: Any = None, **options: Any) -> None:
        self.body = body or Body()
        fabric = Fabric()
        self.brain = MemoryBus(fabric, BRAIN)
        self.perceptions = self.brain.subscriber(keys.PERCEPTION)
        self.scenes = self.brain.subscriber(keys.SCENE)
        self.actions = self.brain.publisher(keys.ACTION)
        self.now = 100.0
        self.service = RobotService(
            MemoryBus(fabric, BRAIN), self.body, SEED, clock=lambda: self.now, **({"sleep": lambda _: None} | options)
        )

    def act(self, iteration: int, action: int = 1, *, age_s: float = 0.0) -> messages.Perception | None:
        """Say an action that answers what was shown so long ago; return what is shown then."""
        self.actions.put(order(iteration, action, self.now - age_s))
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
    assert (scene.iteration, scene.action, scene.before.x_m, scene.now.x_m) == (1, 2, 0.0, 2.0)


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


def test_actions_that_the_body_lacks_are_refused_and_counted() -> None:
    rig = Rig()
    rig.perceptions.take()
    for action in (3, 1023):
        assert rig.act(0, action) is None
        assert rig.act(5, action) is None, "nor does it catch up for them"
    assert rig.body.done == rig.body.restored == []
    assert rig.service.bus.refusals.counts[keys.ACTION.path] == 4
    assert rig.act(0, 2) is not None


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
    assert (perception.iteration, rig.body.restored) == (58, [(57, SEED)])
    rig.act(58)
    assert rig.body.restored == [(57, SEED)]


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
    assert rig.body.restored == []
    assert rig.service.bus.refusals.counts[keys.ACTION.path] == 42
    perception = None
    for _ in range(round(BELIEVED_AFTER_S / 0.5) + 2):
        perception = perception or rig.act(57)
        rig.now += 0.5
    assert perception is not None
    assert (perception.iteration, rig.body.restored) == (58, [(57, SEED)])


def test_an_action_with_a_stamp_that_this_robot_never_gave_is_not_done() -> None:
    rig = Rig()
    rig.perceptions.take()
    for stamp in (rig.now + 0.1, 1e300, -1e300):
        rig.actions.put(order(0, 2, stamp))
        rig.service.step()
    assert (rig.body.done, rig.service.values()["late"]) == ([], 3.0)


def test_an_action_takes_its_time_on_the_wall() -> None:
    slept: list[float] = []
    rig = Rig(action_s=2.0, sleep=slept.append)
    rig.act(0)
    rig.act(0)
    assert len(slept) == 1
    assert 1.5 < slept[0] <= 2.0
    unhurried = Rig(action_s=0.0, sleep=slept.append)
    unhurried.act(0)
    assert len(slept) == 1


def test_the_same_actions_give_the_same_perceptions() -> None:
    def run() -> list[messages.Perception | None]:
        rig = Rig(make_robot("kinematic", RobotConfig()))
        return [rig.act(i, i % 7) for i in range(20)]

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
    actions = [(3 * i) % 7 for i in range(60)]
    straight = Rig(make_robot(body, RobotConfig()))
    expected = [straight.act(i, action) for i, action in enumerate(actions)]
    file = StateFile(tmp_path / "robot.state")
    rig = Rig(make_robot(body, RobotConfig()), file=file)
    got = []
    for i, action in enumerate(actions):
        if i % 7 == 3:
            rig = Rig(make_robot(body, RobotConfig()), file=file)
            shown = rig.perceptions.take()
            assert shown == got[-1], "what it showed last, the optimizer's intention with it"
        got.append(rig.act(i, action))
    assert got == expected
    captures = [rig.service.values()["captures"], straight.service.values()["captures"]]
    assert captures[0] == captures[1]
    assert {step.event for step in expected if step is not None} > {"none"}, "new placements are drawn as before"


def test_a_damaged_state_is_set_aside_and_the_robot_begins_anew(tmp_path: Path) -> None:
    path = tmp_path / "robot.state"
    rig = Rig(file=StateFile(path))
    rig.act(0)
    path.write_bytes(path.read_bytes()[:-3])
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


def test_a_state_that_the_body_cannot_take_is_left(tmp_path: Path) -> None:
    file = StateFile(tmp_path / "robot.state", power_safe=True)
    rig = Rig(file=file)
    rig.act(0)
    state = file.read()
    assert state is not None
    far = msgspec.structs.replace(state.scene.now, x_m=1e5)
    file.write(msgspec.structs.replace(state, scene=msgspec.structs.replace(state.scene, now=far)))
    rig = Rig(make_robot("kinematic", RobotConfig()), file=file)
    assert rig.perceptions.take().iteration == 0
