"""The teacher's terminal against a real brain over Zenoh: keys pressed, reports and screens looked at."""

import asyncio
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from itertools import count
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("textual")

from textual.pilot import Pilot
from textual.strip import Strip
from textual.widgets import Static

from mdb_deploy.experiments import experiment_path
from mdb_deploy.keys.credentials import KeyFolder
from mdb_deploy.teach.keyboard import NOTE_KEYS, graded
from mdb_deploy.teach.run import patience_of
from mdb_deploy.teach.screen.app import ScenePicture, SessionThread, TeachApp
from mdb_deploy.teach.screen.language import LanguageScreen
from mdb_deploy.teach.screen.picture import HALF_BLOCK
from mdb_deploy.teach.session import TeachingSession
from mdb_protocol import keys, messages
from mdb_protocol.bus import Inbox
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_protocol.roles import Role
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_protocol.zenoh_sessions import Router
from mdb_services.experiment.reading import read_file
from mdb_sim.bodies.pioneer.twin import KinematicRobot
from mdb_sim.body import NOTHING, Actuator, Body, Numbers, Outcome, Reading, Resting, Sensor, Spec, Unrestorable
from mdb_sim.robot.course import Rules
from mdb_sim.robot.service import RobotService
from mdb_sim.teaching.languages import make_language
from mdb_sim.teaching.policies.pioneer import Reach
from tests.integration.brain import BRAIN, Brain, mdb, until

ROUTER_CONFIG = Path(__file__).parents[2] / "deploy" / "router.json5"
BOUND_S = 30.0
SILENCES = 3
REACH = Reach()
REVERSED = make_language("reversed", REACH.order)
LEFT_90, LEFT_45 = REACH.commands.index("left 90"), REACH.commands.index("left 45")
PLACE = {"x_m": 0.0, "y_m": 0.0, "heading_rad": 1.0, "object_x_m": 1.0, "object_y_m": 1.0}
SCENE = messages.Scene(
    iteration=4, episode=0, successes=0, event="none", action=None, before=None, reached=PLACE, now=PLACE
)
DRAWING = messages.Drawing(
    shapes=[messages.Shape(kind="disc", points=[(1.0, 1.0)], radius=0.2)], box=(-1.0, -1.0, 2.0, 2.0), front_rad=1.0
)
PICTURES = (
    messages.Picture(iteration=4),
    messages.Picture(iteration=4, drawing=DRAWING),
    messages.Picture(iteration=4, image=np.full((5, 9, 3), 200, np.uint8)),
)
PATIENT = (
    "experiment.iterations=100000",
    "optimizer.command_patience_s=60",
    "optimizer.feedback_patience_s=60",
)


@pytest.fixture(autouse=True)
def _never_idle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Textual's pilot waits up to a second after each key until the process idles: one with a bus never does."""

    async def moment(*_: float) -> None:
        await asyncio.sleep(0.0)

    for module in ("textual.app", "textual.pilot"):
        monkeypatch.setattr(f"{module}.wait_for_idle", moment)


@pytest.fixture(scope="module")
def brain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Brain]:
    """`mdb up --no-teacher`: it begins when a teacher has come, and waits for each of his words."""
    with Brain(tmp_path_factory.mktemp("runs"), *PATIENT, options=("--no-teacher",)) as running:
        with running.bus() as bus:
            models = ("communication", "object", "induced")
            others = {"recorder/log", "memory/store", "robot/body", *(f"evolver/{model}" for model in models)}
            until(lambda: others <= bus.alive())
            assert running.child("optimizer") is None, "nobody has come yet"
        yield running


def session_of(bus: ZenohBus, name: str, *, auto: bool = False) -> TeachingSession:
    return TeachingSession(bus, name, REVERSED, auto=auto, patience_s=(60.0, 60.0))


class Desk:
    """A teacher's screen and keys, and what a bystander hears of the brain."""

    def __init__(self, app: TeachApp, pilot: Pilot[int], witness: ZenohBus) -> None:
        self.app, self.pilot, self.witness = app, pilot, witness
        self._reports: Inbox = witness.subscriber(keys.ITERATION)
        self._seen: list[messages.IterationReport] = []

    def text(self, where: str) -> str:
        return str(self.app.screen_stack[0].query_one(where, Static).render())

    async def until(self, condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + BOUND_S
        while not condition():
            assert time.monotonic() < deadline, f"not within {BOUND_S} s; the screen says {self.text('#says')!r}"
            await self.pilot.pause(0.02)

    async def shows_scene_after(self, iteration: int) -> int:
        """Wait until a later scene is on the screen; return its iteration."""

        def shown() -> bool:
            scene = self.app._shown.scene
            return scene is not None and scene.iteration > iteration

        await self.until(shown)
        assert self.app._shown.scene is not None
        return self.app._shown.scene.iteration

    async def settle(self) -> None:
        """Be silent a few times: a brain that was alone may have begun an iteration before it saw this teacher."""
        for _ in range(SILENCES):
            await self.until(lambda: self.app.session.view.scene is not None)
            before = self.newest()
            await self.pilot.press("space")
            await self.until(lambda before=before: self.newest() > before)
        await self.until(lambda: self.app._shown.scene == self.app.session.view.scene)

    def newest(self) -> int:
        scene = self.app.session.view.scene
        return -1 if scene is None else scene.iteration

    async def is_awaited(self) -> int:
        """Wait until the scene on the screen has no command of this teacher yet; return its iteration."""

        def awaited() -> bool:
            view = self.app._shown
            spoken = {exchange.iteration for exchange in view.exchanges if exchange.spoke}
            return view.scene is not None and view.scene.iteration not in spoken

        await self.until(awaited)
        return await self.shows_scene_after(-1)

    async def report(self, wanted: Callable[[messages.IterationReport], bool]) -> messages.IterationReport:
        """Wait for a report; those that came before stay to be looked at again."""

        def come() -> bool:
            while (report := self._reports.take()) is not None:
                self._seen.append(report)
            return any(map(wanted, self._seen))

        await self.until(come)
        return next(filter(wanted, self._seen))


@asynccontextmanager
async def desk(brain: Brain, name: str, size: tuple[int, int] = (80, 24)) -> AsyncIterator[Desk]:
    with brain.bus() as bus, brain.bus() as witness:
        app = TeachApp(session_of(bus, name), "here", suggest=True)
        async with app.run_test(size=size) as pilot:
            one = Desk(app, pilot, witness)
            await one.until(lambda: f"teacher/{name}" in witness.alive() and "optimizer/action" in witness.alive())
            await one.settle()
            yield one
            if app.is_running:
                await pilot.press("q")


def test_notes_and_feedback_arrive_with_the_teachers_name(brain: Brain) -> None:
    async def lesson() -> None:
        async with desk(brain, "ann") as ann:
            iteration = await ann.shows_scene_after(-1)
            await ann.pilot.press("c")
            after = await ann.shows_scene_after(iteration)
            assert after == iteration + 1, "the robot did one action, for which it had waited"
            await ann.pilot.press("7")
            report = await ann.report(lambda r: r.iteration == iteration)
            assert (report.teacher, report.note, report.holder) == ("ann", NOTE_KEYS.index("c"), "ann")
            assert (report.feedback, report.judges) == (pytest.approx(graded(7)), ["ann"])
            await ann.until(lambda: re.search(rf" {iteration} c left 20 .*\+0\.56", ann.text("#panel")))
            assert "teacher   you" in ann.text("#panel")
            await ann.until(lambda: is_dotted(ann.app))
            assert "connected" in ann.text("#top")
            await ann.pilot.press("z")
            after = await ann.shows_scene_after(after)
            await ann.pilot.press("minus")
            report = await ann.report(lambda r: r.iteration == after - 1)
            assert (report.note, report.feedback) == (0, -1.0)

    asyncio.run(lesson())


def test_without_feedback_the_next_note_is_obeyed_at_once(brain: Brain) -> None:
    async def lesson() -> None:
        async with desk(brain, "ann") as ann:
            iteration = await ann.shows_scene_after(-1)
            for key in "mb":
                await ann.pilot.press(key)
                iteration = await ann.shows_scene_after(iteration)
            report = await ann.report(lambda r: r.iteration == iteration - 2)
            assert (report.note, report.feedback) == (NOTE_KEYS.index("m"), None)

    asyncio.run(lesson())


def test_whose_turn_it_is_is_said_with_the_time_that_is_left_and_w_makes_the_brain_wait(brain: Brain) -> None:
    async def lesson() -> None:
        async with desk(brain, "ann") as ann:
            first = await ann.is_awaited()
            await ann.until(lambda: re.search(r"your turn: play a note.* \d+ s left, w: wait", ann.text("#turn")))
            waits = ann.witness.subscriber(keys.COMMAND, teacher="ann")
            await ann.pilot.press("w")
            await ann.until(lambda: "it waits for you" in ann.text("#turn"))
            await ann.until(lambda: (said := waits.take()) is not None and said.later)
            assert ann.newest() == first, "the robot did nothing meanwhile"
            await ann.pilot.press("w")
            await ann.until(lambda: "s left" in ann.text("#turn"))
            await ann.pilot.press("h")
            await ann.until(lambda: "hint:" not in ann.text("#says"))
            await ann.pilot.press("v")
            await ann.shows_scene_after(first)
            await ann.until(lambda: "your turn: judge what it did" in ann.text("#turn"))
            await ann.pilot.press("9")
            await ann.until(lambda: re.search(r"your turn: play a note · \d+ s left", ann.text("#turn")))

    asyncio.run(lesson())


def test_in_a_pause_the_brain_goes_on_alone_and_the_teacher_stays(brain: Brain) -> None:
    async def lesson() -> None:
        async with desk(brain, "ann") as ann:
            iteration = await ann.shows_scene_after(-1)
            await ann.pilot.press("p")
            report = await ann.report(lambda r: r.iteration == iteration + 5)
            assert (report.note, report.teacher) == (None, None)
            assert "teacher/ann" in ann.witness.alive()
            await ann.until(lambda: "pause" in ann.text("#top"))
            await ann.until(lambda: "pause: you are silent" in ann.text("#turn"))
            await ann.pilot.press("p")
            await ann.until(lambda: not ann.app.session.view.paused)
            iteration = await ann.is_awaited()
            await ann.pilot.press("x")
            await ann.shows_scene_after(iteration)
            await ann.pilot.press("0")
            report = await ann.report(lambda r: r.iteration == iteration)
            assert (report.note, report.feedback) == (NOTE_KEYS.index("x"), -1.0)

    asyncio.run(lesson())


def test_a_note_gets_another_meaning_and_the_brain_is_not_told(brain: Brain) -> None:
    async def lesson() -> None:
        async with desk(brain, "ann") as ann:
            iteration = await ann.shows_scene_after(-1)
            tap = ann.witness.subscriber(keys.COMMAND, teacher="ann")
            await ann.pilot.press("l")
            assert isinstance(ann.app.screen, LanguageScreen)
            await ann.pilot.press("down", "m", "5", "space", "escape")
            await ann.until(lambda: ann.app.session.view.language.command(NOTE_KEYS.index("m")) == LEFT_45)
            assert ann.app.session.view.language.command(NOTE_KEYS.index("z")) == LEFT_90
            await ann.until(lambda: "m left 45" in ann.text("#notes"))
            while (last := tap.take()) is not None:
                assert last.iteration < iteration, "keys of the language's screen are no notes"
            await ann.pilot.press("m")
            await ann.shows_scene_after(iteration)
            await ann.pilot.press("9")
            report = await ann.report(lambda r: r.iteration == iteration)
            assert report.note == NOTE_KEYS.index("m")
            (exchange,) = [e for e in ann.app.session.view.exchanges if e.iteration == iteration]
            assert exchange.command == LEFT_45

    asyncio.run(lesson())


def test_who_leaves_is_gone_and_the_brain_goes_on(brain: Brain) -> None:
    async def lesson() -> int:
        async with desk(brain, "ann") as ann:
            iteration = await ann.shows_scene_after(-1)
            await ann.pilot.press("q")
            until(lambda: "teacher/ann" not in ann.witness.alive())
            until(lambda: not ann.app.thread.running)
            return iteration

    iteration = asyncio.run(lesson())
    with brain.bus() as bus:
        reports = bus.subscriber(keys.ITERATION)

        def moved() -> bool:
            bus.wait(0.05)
            return (report := reports.take()) is not None and report.iteration > iteration

        until(moved)


def test_who_is_not_heard_reads_who_is_being_obeyed(brain: Brain) -> None:
    async def lesson() -> None:
        with brain.bus() as first_bus:
            bob = SessionThread(session_of(first_bus, "bob", auto=True))
            bob.start()
            try:
                async with desk(brain, "ann") as ann:
                    await ann.report(lambda r: r.holder == "bob")
                    deadline = time.monotonic() + BOUND_S
                    while "bob is being obeyed" not in ann.text("#says"):
                        assert time.monotonic() < deadline
                        await ann.pilot.press("x")
                        await ann.shows_scene_after(ann.newest())
                    await ann.until(lambda: "bob (also here: bob)" in ann.text("#panel"))
                    await ann.until(lambda: "watch: bob is being obeyed" in ann.text("#turn"))
            finally:
                bob.stop()

    asyncio.run(lesson())


@pytest.mark.parametrize("size", [(80, 24), (140, 40), (50, 20), (30, 10), (10, 5)])
def test_every_size_of_terminal_has_room(size: tuple[int, int]) -> None:
    async def look() -> None:
        fabric = Fabric()
        world = MemoryBus(fabric, BRAIN)
        world.publisher(keys.SCENE).put(SCENE)
        app = TeachApp(TeachingSession(MemoryBus(fabric, BRAIN), "ann", REVERSED), "here", suggest=True)
        async with app.run_test(size=size) as pilot:
            one = Desk(app, pilot, world)  # type: ignore[arg-type]
            await one.shows_scene_after(-1)
            for picture in PICTURES:
                world.publisher(keys.PICTURE).put(picture)
                await one.until(lambda picture=picture: is_of(app._shown.picture, picture))
                await pilot.press("l", "escape", "u", "h")
                assert len(drawn(app)) == app.query_one(ScenePicture).size.height
            await pilot.press("q")
        assert app.return_code == 0

    asyncio.run(look())


def is_of(shown: messages.Picture | None, sent: messages.Picture) -> bool:
    """Whether what is shown came as the picture that was sent."""
    if shown is None or (shown.iteration, shown.drawing) != (sent.iteration, sent.drawing):
        return False
    return shown.image is sent.image is None or np.array_equal(shown.image, sent.image)  # type: ignore[arg-type]


def drawn(app: TeachApp) -> list[Strip]:
    """The lines of the scene as they are on the screen."""
    scene = app.screen_stack[0].query_one(ScenePicture)
    return [scene.render_line(y) for y in range(scene.size.height)]


def is_dotted(app: TeachApp) -> bool:
    """Whether a drawing is on the screen."""
    return any(character > "\u2800" for line in drawn(app) for character in line.text)


def words_of(app: TeachApp) -> list[list[str]]:
    return [line.text.split() for line in drawn(app) if line.text.strip()]


def colours_of(app: TeachApp) -> set[tuple[int, int, int]]:
    """The colours of an image's pixels."""
    styles = [segment.style for line in drawn(app) for segment in line if HALF_BLOCK in segment.text]
    pairs = [(style.color, style.bgcolor) for style in styles if style is not None]
    return {tuple(colour.get_truecolor()) for pair in pairs for colour in pair if colour is not None}


class Pushed(Resting, Unrestorable):
    """A body of another kind: it is pushed, and there is nothing to see of it but a number."""

    spec = Spec(
        sensors=(Sensor(name="light", low=0.0, high=1.0), Sensor(name="speeds", low=-1.0, high=1.0, numbers=2)),
        actuators=(Actuator(name="push", low=-1.0, high=1.0),),
        scene=("pole_rad",),
    )

    def reset(self, seed: int, episode: int) -> Reading:
        del seed, episode
        self.pole_rad = 0.25
        return self.perceived()

    def perceived(self) -> Reading:
        return {"light": 0.5, "speeds": [0.0, self.pole_rad]}

    def act(self, values: Mapping[str, float]) -> Outcome:
        self.pole_rad += values["push"]
        return Outcome(NOTHING, self.perceived())

    def scene(self) -> Numbers:
        return {"pole_rad": self.pole_rad}

    def close(self) -> None:
        """Nothing to free."""


class Filmed(Pushed):
    """A body of which there is an image: the lower half is red, and green once it was pushed."""

    def image(self) -> np.ndarray:
        image = np.zeros((8, 8, 3), np.uint8)
        image[4:] = (255, 0, 0) if self.pole_rad == 0.25 else (0, 255, 0)
        return image


@asynccontextmanager
async def watched(body: Body) -> AsyncIterator[tuple[Desk, Callable[[Mapping[str, float]], None]]]:
    """A teacher's screen and a robot service with a body, and how the robot is told what to do."""
    fabric, ticks = Fabric(), count()
    world = MemoryBus(fabric, BRAIN)
    robot = RobotService(
        MemoryBus(fabric, BRAIN), body, Rules(), 1, clock=lambda: float(next(ticks)), deadlines=False
    )
    app = TeachApp(TeachingSession(MemoryBus(fabric, BRAIN), "ann", REVERSED), "here")

    def tell(action: Mapping[str, float]) -> None:
        iteration = int(robot.values()["iteration"])
        world.publisher(keys.ACTION).put(messages.Action(iteration=iteration, action=dict(action), valid_for_s=1.0))

    class Awake(Desk):
        """Somebody who waits with the robot at work."""

        async def until(self, condition: Callable[[], object]) -> None:
            await super().until(lambda: (robot.step(), condition())[1])

    async with app.run_test(size=(100, 30)) as pilot:
        one = Awake(app, pilot, world)  # type: ignore[arg-type]
        yield one, tell
        await pilot.press("q")
    robot.close()


def test_a_robot_that_sends_no_picture_is_shown_by_its_numbers() -> None:
    async def look() -> None:
        async with watched(Pushed()) as (ann, tell):
            numbers = [
                ["the", "scene"],
                ["pole_rad", "0.25"],
                ["perceived"],
                ["light", "0.5"],
                ["speeds", "0", "0.25"],
            ]
            await ann.until(lambda: words_of(ann.app) == numbers)
            tell({"push": 0.5})
            await ann.until(lambda: ["pole_rad", "0.75"] in words_of(ann.app))
            assert ["speeds", "0", "0.75"] in words_of(ann.app)

    asyncio.run(look())


def test_numbers_are_shown_of_what_is_no_robot_of_ours_and_knows_no_pictures() -> None:
    async def look() -> None:
        fabric = Fabric()
        world = MemoryBus(fabric, BRAIN)
        world.publisher(keys.SCENE).put(SCENE)
        app = TeachApp(TeachingSession(MemoryBus(fabric, BRAIN), "ann", REVERSED), "here")
        async with app.run_test() as pilot:
            one = Desk(app, pilot, world)  # type: ignore[arg-type]
            await one.until(lambda: ["object_y_m", "1"] in words_of(app))
            assert app.session.view.picture is None
            await pilot.press("q")

    asyncio.run(look())


def test_an_image_that_the_robot_sends_is_shown_and_follows_what_it_does() -> None:
    async def look() -> None:
        async with watched(Filmed()) as (ann, tell):
            await ann.until(lambda: colours_of(ann.app) == {(0, 0, 0), (255, 0, 0)})
            lines = [line for line in drawn(ann.app) if HALF_BLOCK in line.text]
            assert len(lines) == ann.app.query_one(ScenePicture).size.height, "as large as there is room for"
            assert len({line.text.count(HALF_BLOCK) for line in lines}) == 1
            assert lines[0].text.count(HALF_BLOCK) == 2 * len(lines), "a square, two pixels a character"
            tell({"push": 0.5})
            await ann.until(lambda: colours_of(ann.app) == {(0, 0, 0), (0, 255, 0)})

    asyncio.run(look())


def test_a_drawing_that_the_robot_sends_is_shown_and_can_be_turned() -> None:
    async def look() -> None:
        async with watched(KinematicRobot()) as (ann, tell):
            await ann.until(lambda: is_dotted(ann.app))
            before = [line.text for line in drawn(ann.app)]
            tell({"turn": 45.0})
            await ann.until(lambda: [line.text for line in drawn(ann.app)] != before)
            before = [line.text for line in drawn(ann.app)]
            await ann.pilot.press("u")
            await ann.until(lambda: [line.text for line in drawn(ann.app)] != before)
            await ann.pilot.press("u")
            await ann.until(lambda: [line.text for line in drawn(ann.app)] == before)

    asyncio.run(look())


def test_a_removed_teacher_is_told_that_the_router_does_not_let_him_in(tmp_path: Path) -> None:
    listen = "tls/127.0.0.1:0"
    folder = KeyFolder.create(tmp_path / "keys", BRAIN)
    bundle = tmp_path / "ann.pem"
    bundle.write_bytes(folder.add(Role.TEACHER, "ann", BRAIN).read_bytes())
    folder.remove("ann")
    router = Router(ROUTER_CONFIG, listen, keys=folder.router_keys(listen))

    async def look() -> None:
        with ZenohBus(BRAIN, router.endpoint(), credentials=bundle) as bus:
            app = TeachApp(session_of(bus, "ann"), "here")
            async with app.run_test() as pilot:
                await Desk(app, pilot, bus).until(lambda: "does not let you in as ann" in str(app._shown.trouble))
                await pilot.press("q")

    try:
        asyncio.run(look())
    finally:
        router.close()


def test_a_router_that_comes_back_is_used_again() -> None:
    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    endpoint = router.endpoint()
    session = session_of(ZenohBus(BRAIN, endpoint), "ann")
    teaching = SessionThread(session)
    teaching.start()
    try:
        until(lambda: "no brain" in str(session.view.trouble), BOUND_S)
        router.close()
        until(lambda: "the router is gone" in str(session.view.trouble), BOUND_S)
        router = Router(ROUTER_CONFIG, endpoint)
        until(lambda: "no brain" in str(session.view.trouble), BOUND_S)
        with ZenohBus(BRAIN, endpoint) as robot:
            commands = robot.subscriber(keys.COMMAND)
            robot.publisher(keys.SCENE).put(SCENE)
            until(lambda: session.view.scene == SCENE, BOUND_S)
            session.command(3)
            until(lambda: commands.take() == messages.Command(teacher="ann", iteration=4, note=3), BOUND_S)
    finally:
        teaching.stop()
        router.close()
    assert not teaching.running


def test_graded_feedback_is_exact() -> None:
    assert [graded(digit) for digit in (0, 9)] == [-1.0, 1.0]
    assert [round(graded(digit) * 9) for digit in range(10)] == [-9, -7, -5, -3, -1, 1, 3, 5, 7, 9]


BLOCKED = (
    "numba",
    "pybullet",
    "mcap",
    "tomli_w",
    "psutil",
    "yaml",
    "cryptography",
    "zstandard",
    "matplotlib",
    "cmaes",
    "sounddevice",
)
WITHOUT = f"""
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {BLOCKED!r}:
            raise ModuleNotFoundError(f"blocked: {{name}}", name=name)
sys.meta_path.insert(0, Blocked())
from mdb_deploy.cli.main import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.long
def test_a_laptop_needs_only_the_extra_teach() -> None:
    """All that `mdb teach` imports is imported before it finds that nobody answers."""
    words = ["teach", "--connect", "tcp/127.0.0.1:1", "--name", "ann", "--language", "random:3"]
    command = [sys.executable, "-c", WITHOUT, *words]
    result = subprocess.run(command, capture_output=True, text=True, timeout=BOUND_S, check=False)
    assert result.returncode == 2
    assert "no router answers at tcp/127.0.0.1:1" in result.stderr, result.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--language", "notes:1,1"), "no language 'notes:1,1' for 7 commands"),
        (("--name", "a b"), "expected 1 to 64 letters"),
        (("--keys", "nowhere.pem"), "with keys the router is at tls/"),
        (("--experiment", "nowhere.toml"), "cannot read the experiment file"),
    ],
)
def test_what_cannot_be_is_said_with_what_to_do(words: tuple[str, ...], said: str) -> None:
    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    try:
        result = mdb("teach", "--connect", router.endpoint(), *words)
    finally:
        router.close()
    assert result.returncode == 2
    assert said in result.stderr


def test_a_name_that_is_taken_is_refused() -> None:
    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    try:
        with ZenohBus(BRAIN, router.endpoint()) as other:
            other.token("teacher", "ann")
            result = mdb("teach", "--connect", router.endpoint(), "--name", "ann")
    finally:
        router.close()
    assert result.returncode == 2
    assert "somebody teaches pioneer as ann already" in result.stderr


@pytest.mark.edge("pipes and terminals", "mdb teach without a terminal")
def test_without_a_terminal_it_says_so_and_ends() -> None:
    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    try:
        result = mdb("teach", "--connect", router.endpoint())
    finally:
        router.close()
    assert result.returncode == 2
    assert "needs a terminal" in result.stderr
    assert "teacher.py teaches without one" in result.stderr


def test_help_says_keys_and_feedback() -> None:
    text = mdb("teach", "--help").stdout
    keys_said = ("z x c v b n m", "0 (punishment, -1) to 9 (reward, +1)", "p pause", "w wait")
    for said in (*keys_said, "--language", "--no-suggest", "--no-teacher"):
        assert said in text


@contextmanager
def terminal(*words: str) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """Run `mdb teach` on a terminal of its own, 80 by 24."""
    keyboard, screen = pty.openpty()
    environment = os.environ | {"TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"}
    process = subprocess.Popen(
        [sys.executable, "-m", "mdb_deploy.cli", "teach", *words],
        stdin=screen, stdout=screen, stderr=screen, env=environment, start_new_session=True,
    )  # fmt: skip
    os.close(screen)
    try:
        yield process, keyboard
    finally:
        process.kill()
        process.wait()
        os.close(keyboard)


def written(keyboard: int, process: subprocess.Popen[bytes], enough: Callable[[bytes], object]) -> bytes:
    """Return what the terminal got, until it is enough or the process has ended."""
    content, deadline = b"", time.monotonic() + BOUND_S
    while not enough(content) and time.monotonic() < deadline:
        if select.select([keyboard], [], [], 0.1)[0]:
            try:
                content += os.read(keyboard, 65536)
            except OSError:  # the other side is closed
                break
        elif process.poll() is not None:
            break
    return content


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 130), (signal.SIGINT, 130), (None, 0)])
def test_the_terminal_is_given_back(number: signal.Signals | None, status: int) -> None:
    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    try:
        with (
            ZenohBus(BRAIN, router.endpoint()) as witness,
            terminal("--connect", router.endpoint(), "--name", "ann") as (process, keyboard),
        ):
            witness.alive()
            drawn = written(keyboard, process, lambda content: b"no brain is at work" in content)
            assert b"\x1b[?1049h" in drawn, drawn
            until(lambda: "teacher/ann" in witness.alive())
            if number is None:
                os.write(keyboard, b"q")
            else:
                process.send_signal(number)
            last = written(keyboard, process, lambda _: False)
            assert process.wait(BOUND_S) == status
            assert b"\x1b[?1049l" in last, "the screen as it was before"
            assert b"\x1b[?25h" in last, "the cursor"
            assert b"ann has left pioneer. No note was played." in last
            until(lambda: "teacher/ann" not in witness.alive())
    finally:
        router.close()


def test_the_patience_of_the_brain_is_read_from_its_file() -> None:
    path = experiment_path("paper")
    assert patience_of(read_file(path, ["optimizer.feedback_patience_s=5"]), path) == (2.0, 5.0)
    assert patience_of({}, None) is None, "without the file it is not known"
