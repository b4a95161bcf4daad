"""What browsers are given of a story, over the in-memory bus: the newest of what they lack, and never more."""

from __future__ import annotations

import json
import time
from typing import Any

import pytest
from structlog.testing import capture_logs

from mdb_deploy.experiments import experiment_path
from mdb_deploy.web.live import bridge as bridges
from mdb_deploy.web.live.fan import Fan, Waiting
from mdb_deploy.web.live.hub import NO_BRAIN, Hub
from mdb_deploy.web.opening import Place
from mdb_deploy.web.telling.hello import hello
from mdb_deploy.web.telling.story import Story
from mdb_protocol import keys, messages
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_sim.runs.experiment import Experiment
from tests.web.rig import scene

PAPER = Experiment.read(experiment_path("paper"))


class Browser:
    """Keeps what it is given; says that it has taken it only when the test wants it."""

    rights = {"teach": True, "operate": False}  # noqa: RUF012

    def __init__(self, fan: Fan) -> None:
        self._fan = fan
        self.given: list[dict[str, Any]] = []

    def give(self, frames: list[str]) -> None:
        self.given.extend(json.loads(frame) for frame in frames)

    def take(self) -> list[dict[str, Any]]:
        taken, self.given = self.given, []
        self._fan.has_taken(self)
        return taken


class Rig:
    """A hub, and a robot played by hand."""

    def __init__(self) -> None:
        self.fabric = Fabric()
        self.world = MemoryBus(self.fabric, "test")
        self.scenes, self.reports = self.world.publisher(keys.SCENE), self.world.publisher(keys.ITERATION)
        self.fan, self.story = Fan(), Story(PAPER, clock=None)
        self.hub = Hub(MemoryBus(self.fabric, "test"), "console", self.story, self.fan)
        self.fan.begin(hello(PAPER, "run", live=True), self.story)

    def step(self) -> None:
        """Take what has come, and make frames now."""
        self.hub._frame_s = self.hub._look_s = 0.0
        self.hub.step()

    def browser(self) -> Browser:
        found = Browser(self.fan)
        self.fan.add(found)
        return found


@pytest.fixture
def rig() -> Rig:
    return Rig()


def report(iteration: int) -> messages.IterationReport:
    return messages.IterationReport(
        iteration=iteration, mode="taught", action={"turn": 0.0}, choice=0, explored=False, predicted=0.5, note=1,
        feedback=None, event="none", prequential={}, versions={}, teacher="ann",
    )  # fmt: skip


def test_a_browser_is_greeted_and_gets_what_is_known(rig: Rig) -> None:
    rig.scenes.put(scene(3))
    browser = rig.browser()
    rig.step()
    greeting, now = browser.take()
    assert (greeting["is"], greeting["brain"], greeting["rights"]) == ("hello", "pioneer", browser.rights)
    assert now["is"] == "now"
    assert now["scene"]["iteration"] == 3


def test_only_what_is_new_is_sent_again(rig: Rig) -> None:
    browser = rig.browser()
    rig.scenes.put(scene(1))
    for _ in range(2):  # first that it is watched itself is new
        rig.step()
        browser.take()
    rig.step()
    assert browser.take() == []
    rig.scenes.put(scene(2))
    rig.step()
    (now,) = browser.take()
    assert now["scene"]["iteration"] == 2
    assert "trouble" not in now


def test_what_a_browser_does_not_take_is_merged(rig: Rig) -> None:
    slow, quick = rig.browser(), rig.browser()
    seen = []
    for iteration in range(1, 30):
        rig.scenes.put(scene(iteration))
        rig.reports.put(report(iteration - 1))
        rig.step()
        seen += [frame["scene"]["iteration"] for frame in quick.take() if "scene" in frame]
    assert seen == list(range(1, 30))
    assert [frame["scene"]["iteration"] for frame in slow.given if "scene" in frame] == [1]
    slow.take()
    rig.step()
    (now,) = slow.take()
    assert now["scene"]["iteration"] == 29
    assert now["rows"]["iteration"] == list(range(1, 29))


def test_browsers_that_lack_the_same_get_the_same_text(rig: Rig) -> None:
    first, second = rig.browser(), rig.browser()
    for iteration in range(1, 4):
        rig.scenes.put(scene(iteration))
        rig.reports.put(report(iteration - 1))
        rig.step()
        assert first.take() == second.take()


def test_another_run_is_told_from_its_beginning(rig: Rig) -> None:
    browser = rig.browser()
    rig.scenes.put(scene(7))
    rig.reports.put(report(6))
    rig.step()
    browser.take()
    rig.fan.begin(hello(PAPER, "another", live=True), Story(PAPER, clock=None))
    rig.fan.send()
    greeting = browser.take()[0]
    assert greeting["run"] == "another"


def test_what_is_waited_for_is_told_before_there_is_a_brain() -> None:
    fan, waiting = Fan(), Waiting()
    fan.begin({"live": False}, waiting)
    browser = Browser(fan)
    fan.add(browser)
    waiting.trouble("the brain starts")
    fan.send()
    greeting, now = browser.take()
    assert (greeting["is"], greeting["live"], now["trouble"]) == ("hello", False, "the brain starts")
    waiting.trouble("the brain starts")
    fan.send()
    assert browser.take() == []


def test_the_robot_knows_whether_somebody_watches(rig: Rig) -> None:
    rig.step()
    assert "viewer/console" not in rig.world.alive()
    browser = rig.browser()
    rig.step()
    assert "viewer/console" in rig.world.alive()
    rig.fan.remove(browser)
    rig.step()
    assert "viewer/console" not in rig.world.alive()


def test_nothing_is_made_while_nobody_watches(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig.story, "part", lambda name: pytest.fail(f"{name} was made for nobody"))
    for iteration in range(1, 10):
        rig.scenes.put(scene(iteration))
        rig.step()
    assert rig.hub.iteration == 9


def test_a_part_that_cannot_be_told_does_not_keep_the_others(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = rig.story.part

    def part(name: str) -> Any:
        if name == "teachers":
            raise ValueError("broken")
        return honest(name)

    monkeypatch.setattr(rig.story, "part", part)
    browser = rig.browser()
    rig.scenes.put(scene(1))
    rig.step()
    now = browser.take()[-1]
    assert now["scene"]["iteration"] == 1
    assert now.get("teachers") is None


def test_a_message_that_cannot_be_told_does_not_keep_the_others(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = rig.story.take

    def take(row: keys.Key, message: messages.Message) -> None:
        if row is keys.ITERATION:
            raise ValueError("broken")
        honest(row, message)

    monkeypatch.setattr(rig.story, "take", take)
    for iteration in range(3):
        rig.reports.put(report(iteration))
        rig.scenes.put(scene(iteration))
        rig.step()
    assert rig.hub.iteration == 2


def test_a_bridge_that_fails_again_and_again_says_so_once(monkeypatch: pytest.MonkeyPatch) -> None:
    tries = []

    def fails(_: Place) -> None:
        tries.append(1)
        raise RuntimeError("broken")

    monkeypatch.setattr(bridges, "find", fails)
    monkeypatch.setattr(bridges, "AGAIN_S", 0.01)
    with capture_logs() as logged:
        bridge = bridges.Bridge(Place(), "console", Fan())
        bridge.start()
        deadline = time.monotonic() + 20.0
        while len(tries) < 4:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        bridge.stop()
    assert [entry["event"] for entry in logged] == ["the bridge failed; it begins again"]


def test_that_there_is_no_brain_is_told(rig: Rig) -> None:
    browser = rig.browser()
    rig.step()
    assert browser.take()[-1]["trouble"] == NO_BRAIN
    withdraw = rig.world.token("optimizer", "action")
    rig.step()
    assert browser.take()[-1]["trouble"] is None
    withdraw()
    rig.step()
    assert browser.take()[-1]["trouble"] == NO_BRAIN


def test_frames_are_fewer_where_they_take_long(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    browser = rig.browser()
    monkeypatch.setattr(rig.fan, "send", lambda: time.sleep(0.05) or True)
    for _ in range(20):
        rig.step()
    assert rig.hub._frame_s - time.monotonic() > 0.1, "a quarter of the time at most is for frames"
    assert browser.given == []
