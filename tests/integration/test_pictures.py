"""Pictures of the scene are made while somebody watches, and only then: a robot's process, and its service alone."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import pytest

from mdb_deploy.supervision.processes import ROUTER_CONFIG
from mdb_protocol import keys, messages
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_protocol.zenoh_sessions import Router
from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.robot.course import Rules
from mdb_sim.robot.service import RobotService
from tests.integration.brain import BRAIN, mdb, until

IN_A_ROW = 4
"""Perceptions without a picture between them, after which none is on its way."""


class Robot:
    """A robot service whose time goes on by itself with each look at the clock, so that it shows in each step."""

    def __init__(self) -> None:
        self.fabric, ticks = Fabric(), count()
        self.world = MemoryBus(self.fabric, BRAIN)
        self.pictures = self.world.subscriber(keys.PICTURE)
        self.service = RobotService(
            MemoryBus(self.fabric, BRAIN), KinematicRobot(), Rules(), 1, clock=lambda: float(next(ticks)),
            deadlines=False,
        )  # fmt: skip

    def shows(self) -> list[messages.Picture]:
        """What pictures come while the robot shows itself a few times."""
        found = list(self.pictures.some())
        for _ in range(IN_A_ROW):
            self.service.step()
            found += self.pictures.some()
        return found


@pytest.mark.parametrize(
    ("role", "name", "watches"),
    [
        ("teacher", "ann", True), ("viewer", "tom", True), ("teacher", "script", False), ("recorder", "log", False),
        ("optimizer", "action", False),
    ],
)  # fmt: skip
def test_who_is_there_to_see_it_gets_pictures(role: str, name: str, *, watches: bool) -> None:
    robot = Robot()
    assert robot.shows() == []
    other = MemoryBus(robot.fabric, BRAIN)
    other.token(role, name)
    pictures = robot.shows()
    assert bool(pictures) is watches
    assert all(picture.iteration == 0 and picture.drawing is not None for picture in pictures)
    other.close()
    robot.shows()
    assert robot.shows() == []


def test_the_picture_is_of_the_newest_scene() -> None:
    robot = Robot()
    robot.world.token("teacher", "ann")
    scenes, actions = robot.world.subscriber(keys.SCENE), robot.world.publisher(keys.ACTION)
    for i in range(3):
        actions.put(messages.Action(iteration=i, action={"turn": 45.0}, valid_for_s=1.0))
        picture = robot.shows()[-1]
        (*_, scene) = scenes.some()
        assert picture.iteration == scene.iteration == i + 1
        assert picture.drawing is not None
        assert picture.drawing.front_rad == scene.now["heading_rad"]
        (front,) = [s for s in picture.drawing.shapes if s.what == "robot" and s.kind == "line"]
        assert front.points[0] == (scene.now["x_m"], scene.now["y_m"])


@contextmanager
def robot_process(folder: Path, endpoint: str) -> Iterator[None]:
    """`mdb run robot`: nobody commands it, so that it shows again and again where it stands."""
    run = folder / "run"
    assert mdb("prepare", "paper", "--run", str(run), "--set", "robot.body=kinematic").returncode == 0
    words = ["run", "robot", "--run", str(run), "--connect", endpoint, f"--with-parent={os.getpid()}"]
    with subprocess.Popen([sys.executable, "-m", "mdb_deploy.cli", *words], stderr=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            process.terminate()


def test_a_robots_process_sends_pictures_only_while_somebody_watches(tmp_path: Path) -> None:
    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    with ZenohBus(BRAIN, router.endpoint()) as bus, ZenohBus(BRAIN, router.endpoint()) as script:
        script.token("teacher", "script")
        perceptions, pictures = bus.subscriber(keys.PERCEPTION), bus.subscriber(keys.PICTURE)
        seen: list[messages.Picture] = []
        since = 0
        """Perceptions since the last picture."""

        def look() -> bool:
            nonlocal since
            bus.wait(0.05)
            for picture in pictures.some():
                seen.append(picture)
                since = 0
            since += len(list(perceptions.some()))
            return True

        with robot_process(tmp_path, router.endpoint()):
            until(lambda: look() and since >= IN_A_ROW)
            assert seen == [], "the scripted teacher needs no pictures"
            with ZenohBus(BRAIN, router.endpoint()) as viewer:
                viewer.token("viewer", "tom")
                until(lambda: look() and len(seen) >= IN_A_ROW)
                assert all(picture.drawing is not None for picture in seen)
            until(lambda: look() and since >= IN_A_ROW)
            with ZenohBus(BRAIN, router.endpoint()) as teacher:
                teacher.token("teacher", "ann")
                before = len(seen)
                until(lambda: look() and len(seen) >= before + IN_A_ROW)
            until(lambda: look() and since >= IN_A_ROW)
    router.close()
