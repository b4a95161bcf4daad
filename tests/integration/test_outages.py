"""Outages of a whole brain: stopped readers, late joiners, clocks that are set, disks that fill up, damaged files."""

import json
import os
import shutil
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from itertools import count
from pathlib import Path

import numpy as np
import pytest
import zenoh

from mdb_deploy.supervision.processes import ROUTER_CONFIG
from mdb_protocol import codec, keys, messages
from mdb_protocol.messages import Message
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_protocol.zenoh_sessions import Router
from mdb_services.acting.outbox import UNSTORED
from mdb_services.experiment.run_folder import MEMORY_FILE
from mdb_services.memory.file import PAGE
from mdb_services.recorder import read_log
from tests.integration.brain import BRAIN, SHORT, Brain, mdb, until
from tests.integration.ears import Ears, frozen, longest_gap_s, of, stored_iterations
from tests.integration.test_deadman import goes_on
from tests.integration.test_survival import LONG

pytestmark = pytest.mark.long

HOUR_S = 3600
LISTENER = """
import sys
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_protocol.zenoh_sessions import Router
with ZenohBus("pioneer", sys.argv[1]) as bus:
    tap = bus.tap()
    bus.token("viewer", "listener")
    while True:
        bus.wait(1.0)
        while tap.take() is not None:
            pass
"""
A_TEACHERS_LAST = 20
"""Notes that who comes late gets at least: more than one, and no more than were played by then."""
HELD_UP_S = 0.9
"""What a stopped reader may cost the others, beyond their usual longest gap: the router waits up to four times."""
BUSY_S = 0.3
"""What other work on this machine may cost."""
TRIES = 4
"""A reader that holds others up does so each time; other work on this machine does not."""


def status(brain: Brain, bus: ZenohBus, role: str, instance: str) -> messages.Status:
    found = until(lambda: brain.status(bus, role, instance))
    assert isinstance(found, messages.Status)
    return found


# ---- readers ----


@contextmanager
def listener(brain: Brain, bus: ZenohBus) -> Iterator[subprocess.Popen[bytes]]:
    """A process that reads everything."""
    endpoint = (brain.run / "router.endpoint").read_text()
    with subprocess.Popen([sys.executable, "-c", LISTENER, endpoint]) as process:
        try:
            until(lambda: "viewer/listener" in bus.alive())
            yield process
        finally:
            process.kill()


@contextmanager
def loud_teacher(brain: Brain) -> Iterator[None]:
    """12 MB/s of sound, so that the buffers of a stopped reader are soon full."""
    over = threading.Event()
    frame = messages.AudioFrame(teacher="loud", iteration=0, rate_hz=48_000, samples=np.zeros(30_000, np.int16))

    def play() -> None:
        with brain.bus() as bus:
            sound = bus.publisher(keys.AUDIO, teacher="loud")
            while not over.wait(0.005):
                sound.put(frame)

    thread = threading.Thread(target=play)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def test_a_stopped_reader_holds_up_nobody_for_long(tmp_path: Path) -> None:
    kinds: tuple[type[Message], ...] = (messages.Perception, messages.IterationReport, messages.AudioFrame)
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        ears = Ears(bus)
        goes_on(ears)

        def gaps() -> dict[str, float]:
            ears.heard.clear()
            began_s = time.monotonic()
            ears.listen(2.5)
            return {k.__name__: longest_gap_s(ears.heard, k, began_s, time.monotonic()) for k in kinds}

        tries = []
        for _ in range(TRIES):
            with listener(brain, bus) as process, loud_teacher(brain):
                ears.listen(0.5)
                usual = gaps()
                with frozen(process.pid):
                    stopped = gaps()
            tries.append((usual, stopped))
            if held := all(stopped[kind] < max(usual[kind], BUSY_S) + HELD_UP_S for kind in usual):
                break
        assert held, tries
        goes_on(ears)


def test_who_comes_late_gets_at_once_what_everybody_knows(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        ears = Ears(bus)
        goes_on(ears)
        optimizer = status(brain, bus, "optimizer", "action").pid
        with frozen(brain.process.pid, optimizer), brain.bus() as late:  # so that nothing new is said
            rows = (keys.PERCEPTION, keys.SCENE, keys.COMMAND, keys.FEEDBACK, keys.PHASE, keys.CURRENT_MODEL)
            inboxes = {row.path: late.subscriber(row) for row in rows}
            known: dict[str, list[Message]] = {path: [] for path in inboxes}

            def all_came() -> bool:
                late.wait(0.05)
                for path, inbox in inboxes.items():
                    known[path] += list(inbox.some())
                models, notes = known[keys.CURRENT_MODEL.path], known[keys.COMMAND.path]
                return all(known.values()) and len(models) >= 3 and len(notes) >= A_TEACHERS_LAST

            until(all_came, 5.0)
            assert len(late.alive()) >= 8 - 1
            assert len(late.query(keys.MEMORY_SNAPSHOT, 2.0)) == 3
        goes_on(ears)


# ---- clocks ----


@pytest.fixture(scope="module")
def skew(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A library that sets the clock of processes that preload it."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("setting the clock of a process needs a C compiler (cc)")
    library = tmp_path_factory.mktemp("skew") / "skew.so"
    source = Path(__file__).with_name("skew.c")
    command = [compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(source), "-ldl"]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    if built.returncode:
        pytest.skip(f"skew.c cannot be built here: {built.stderr.strip()}")
    return library


@pytest.mark.slow
def test_a_clock_that_is_set_an_hour_forward_and_back_changes_nothing(
    tmp_path: Path, skew: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ahead = tmp_path / "ahead"
    ahead.write_bytes(struct.pack("l", 0))
    monkeypatch.setenv("LD_PRELOAD", str(skew))
    monkeypatch.setenv("SKEW_FILE", str(ahead))
    runs = tmp_path / "runs"
    runs.mkdir()
    with Brain(runs, *LONG) as brain, brain.bus() as bus:
        monkeypatch.delenv("LD_PRELOAD")
        ears = Ears(bus)
        goes_on(ears)
        pids = {child.pid for child in brain.children()}
        for seconds in (HOUR_S, -HOUR_S, 0):
            with ahead.open("r+b") as file:
                file.write(struct.pack("l", seconds))
            ears.heard.clear()
            began_s = time.monotonic()
            ears.listen(2.5)
            gap_s = longest_gap_s(ears.heard, messages.IterationReport, began_s, time.monotonic())
            assert gap_s < 1.0
        assert {child.pid for child in brain.children()} == pids
        assert status(brain, bus, "robot", "body").values["late"] == 0
        assert set(status(brain, bus, "optimizer", "action").refused) == set()
        on_disk = stored_iterations(brain.run)
        assert on_disk == list(range(len(on_disk)))
        times_s = [recorded.time_s for recorded in read_log(brain.run)]
        assert max(times_s) - min(times_s) > 1.9 * HOUR_S, "the clock was set, as the log's times show"


@pytest.mark.parametrize("hours", [-1, 1, 24])
def test_a_client_whose_clock_is_hours_away_is_heard_like_any_other(hours: int) -> None:
    """The router gives samples from the future its own time; what a client says is never told apart by its clock."""
    router = Router(ROUTER_CONFIG, "tcp/127.0.0.1:0")
    config = zenoh.Config.from_json5(json.dumps({"mode": "client", "connect": {"endpoints": [router.endpoint()]}}))
    with ZenohBus(BRAIN, router.endpoint()) as bus, zenoh.open(config) as session:
        commands = bus.subscriber(keys.COMMAND)
        now = session.new_timestamp()
        heard: list[int] = []

        def say(i: int) -> bool:
            session.put(
                keys.COMMAND.at(BRAIN, teacher="anna"),
                codec.encode(messages.Command(teacher="anna", iteration=i, note=1)),
                encoding=codec.encoding_of(messages.Command),
                congestion_control=zenoh.CongestionControl.BLOCK,
                timestamp=zenoh.Timestamp(now.get_time() + timedelta(hours=hours, seconds=i), now.get_id()),
            )
            bus.wait(0.05)
            heard.extend(command.iteration for command in commands.some())
            return bool(heard)

        numbers = count()
        until(lambda: say(next(numbers)))  # until the subscription has come to the router
        first = heard[0]
        until(lambda: say(next(numbers)) and len(heard) >= 5)
        assert heard == list(range(first, first + len(heard)))
    router.close()


# ---- disks ----


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own, of 24 MB: the memory file's log alone grows to 4."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(place)]
    done = subprocess.run(mount, capture_output=True, text=True, check=False) if shutil.which("mount") else None
    if done is None or done.returncode:
        pytest.skip(f"no small file system here: {done.stderr.strip() if done else 'there is no mount'}")
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=False)


def fill(place: Path) -> Path:
    filler = place / "filler"
    with filler.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(65_536))
        except OSError:
            return filler


@pytest.mark.parametrize("when_full", ["stop", pytest.param("act", marks=pytest.mark.slow)])
def test_a_full_disk_is_said_costs_nothing_acknowledged_and_is_over_when_there_is_room(
    small_disk: Path, when_full: str
) -> None:
    with Brain(small_disk, *LONG, f"store.when_full={when_full}", "robot.action_s=0") as brain, brain.bus() as bus:
        ears = Ears(bus)
        goes_on(ears)
        pids = {child.pid for child in brain.children()}
        filler = fill(small_disk)
        until(lambda: status(brain, bus, "memory", "store").values["disk_refuses"] == 1.0)

        def optimizer() -> dict[str, float]:
            return status(brain, bus, "optimizer", "action").values

        if when_full == "stop":
            until(lambda: optimizer()["waits_for_store"] == 1.0)
            ears.listen(0.5)
            ears.heard.clear()
            ears.listen(1.0)
            assert of(ears.heard, messages.IterationReport) == []
            assert optimizer()["unacknowledged"] == UNSTORED + 1
        else:
            until(lambda: optimizer()["unacknowledged"] > 2 * UNSTORED)
            assert optimizer()["waits_for_store"] == 0.0
        assert status(brain, bus, "recorder", "log").values["disk_refuses"] == 1.0
        assert status(brain, bus, "robot", "body").values["disk_refuses"] == 1.0
        filler.unlink()
        until(lambda: optimizer()["unacknowledged"] < 10)
        goes_on(ears)
        assert {child.pid for child in brain.children()} == pids, "nobody died of it"
        for role, instance in (("memory", "store"), ("recorder", "log"), ("robot", "body")):
            until(lambda who=(role, instance): status(brain, bus, *who).values["disk_refuses"] == 0.0)
        on_disk = stored_iterations(brain.run)
        assert {stored.iteration for stored in of(ears.heard, messages.PairStored)} <= set(
            stored_iterations(brain.run)
        )
        assert on_disk == list(range(len(on_disk)))
        assert optimizer()["lost"] == 0.0
        said = "".join(path.read_text() for path in (brain.run / "logs").iterdir())
        assert len(said.splitlines()) < 50
        assert "cannot write to disk" in said


# ---- files ----


@pytest.fixture(scope="module")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run to its end, of 80 iterations."""
    folder = tmp_path_factory.mktemp("runs")
    words = [word for setting in (*SHORT, "experiment.pace=lockstep") for word in ("--set", setting)]
    done = mdb("up", "paper", "--runs", str(folder), "--listen", "tcp/127.0.0.1:0", "--no-plot", *words)
    assert done.returncode == 0, done.stdout + done.stderr
    (run,) = [path for path in folder.iterdir() if path.is_dir()]
    return run


def garbage_in_the_middle(content: bytearray) -> bytes:
    half = len(content) // PAGE // 2 * PAGE
    content[half : half + 2 * PAGE] = os.urandom(2 * PAGE)
    return bytes(content)


@pytest.mark.parametrize(
    "spoil",
    [
        pytest.param(lambda content: bytes(content[: len(content) // 2]), id="truncated", marks=pytest.mark.slow),
        pytest.param(garbage_in_the_middle, id="garbage in the middle"),
        pytest.param(
            lambda content: os.urandom(100) + bytes(content[100:]), id="garbage header", marks=pytest.mark.slow
        ),
    ],
)
def test_a_damaged_memory_is_said_at_the_start_and_what_is_left_goes_on_in_another_run(
    finished_run: Path, tmp_path: Path, spoil: object
) -> None:
    run, new = tmp_path / "run", tmp_path / "new"
    shutil.copytree(finished_run, run)
    file = run / MEMORY_FILE
    file.write_bytes(spoil(bytearray(file.read_bytes())))  # type: ignore[operator]
    up = ("--listen", "tcp/127.0.0.1:0", "--no-plot", "--iterations", "100")
    refused = mdb("up", "--resume", str(run), *up)
    assert refused.returncode == 2
    assert "memory.sqlite cannot be used" in refused.stderr
    assert "What can be read:" in refused.stderr
    assert "mdb rescue" in refused.stderr
    assert "Traceback" not in refused.stderr
    models = mdb("ltm", "export", str(run), "--out", str(tmp_path / "models"))
    assert models.returncode == 0 or "empty" in models.stderr or "damaged" in models.stderr
    rescued = mdb("rescue", str(run), "--out", str(new))
    assert rescued.returncode == 0, rescued.stderr
    saved = stored_iterations(new)
    assert f"{len(saved)} pairs" in rescued.stdout
    resumed = mdb("up", "--resume", str(new), *up)
    assert resumed.returncode == 0, resumed.stdout + resumed.stderr
    assert set(stored_iterations(new)) == {*saved, *range(80, 100)}


@pytest.mark.slow
def test_a_memory_that_is_damaged_while_its_store_is_dead_ends_the_run_with_the_reason(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        ears = Ears(bus)
        goes_on(ears, 50)
        store = status(brain, bus, "memory", "store").pid
        with frozen(brain.process.pid):
            os.kill(store, 9)
            path = brain.run / MEMORY_FILE
            path.with_name(f"{MEMORY_FILE}-wal").unlink()
            content = path.read_bytes() or bytes(PAGE)
            path.write_bytes(b"\xa5" * 200 + content[200:])
        assert brain.wait(40.0) == 2
        said = " ".join(brain.output().split())
        assert "cannot be used as the memory's database" in said
        assert "mdb rescue" in said
        assert "Traceback" not in said
