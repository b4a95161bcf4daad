"""The tutorial `deploy/examples/TEACHING.md`, step by step, with the commands that stand there."""

import os
import re
import shlex
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mdb_protocol import codec, keys, messages
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.experiment.run_folder import MEMORY_FILE
from mdb_services.recorder import read_log
from tests.integration.brain import until

pytestmark = pytest.mark.long

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"
TUTORIAL = (EXAMPLES / "TEACHING.md").read_text()
ENDPOINT = "tcp/127.0.0.1:7447"
FAST = ["--set", "robot.action_s=0.002"]
"""The tutorial's robot takes longer for an action, so that people can watch."""
COMMANDS = [shlex.split(line) for line in re.findall(r"```sh\n(.*?)\n```", TUTORIAL, re.DOTALL)]
BRAIN, TEACHER, STATUS, FARAWAY = COMMANDS
BOUND_S = 90.0


def words(command: list[str], endpoint: str = ENDPOINT) -> list[str]:
    """A command of the tutorial with the executables, the examples and the router of this test."""
    replaced = {
        "mdb": [sys.executable, "-m", "mdb_deploy.cli"],
        "python": [sys.executable],
        ENDPOINT: [endpoint],
    }
    return [part for word in command for part in replaced.get(word, [word])]


class Up:
    """The brain of step 1, in a folder of its own."""

    def __init__(self, folder: Path, *more: str) -> None:
        folder.mkdir()
        self.folder, self.log = folder, folder / "up.log"
        command = [*words(BRAIN), *FAST, "--listen", "tcp/127.0.0.1:0", *more]
        with self.log.open("wb") as out:
            self.process = subprocess.Popen(command, cwd=folder, stdout=out, stderr=subprocess.STDOUT)
        self.endpoint = str(until(self._endpoint))

    @property
    def run(self) -> Path:
        (run,) = (self.folder / "runs").iterdir()
        return run

    def _endpoint(self) -> str:
        assert self.process.poll() is None, self.log.read_text()
        found = list(self.folder.glob("runs/*/router.endpoint"))
        return found[0].read_text() if found else ""

    def command(self, change: Callable[[str], str]) -> list[str]:
        """The tutorial's words for a teacher, whose script is changed as the tutorial says."""
        script = self.folder / "teacher.py"
        script.write_text(change((EXAMPLES / "teacher.py").read_text()))
        return words(TEACHER, self.endpoint)

    def teach(self, change: Callable[[str], str] = lambda script: script) -> None:
        """Run `teacher.py` to its end."""
        command = self.command(change)
        done = subprocess.run(command, cwd=self.folder, capture_output=True, text=True, timeout=BOUND_S, check=False)
        assert done.returncode == 0, done.stderr

    @contextmanager
    def teacher(self, change: Callable[[str], str]) -> Iterator[None]:
        """`teacher.py` for as long as it is needed."""
        *command, _lessons = self.command(change)
        with subprocess.Popen([*command, str(10**9)], cwd=self.folder) as process:
            try:
                yield
            finally:
                process.terminate()

    def finish(self) -> list[messages.IterationReport]:
        """Wait for the end of the experiment; return what was done in each iteration."""
        assert self.process.wait(BOUND_S) == 0, self.log.read_text()
        return self.done()

    def interrupt(self) -> list[messages.IterationReport]:
        """Press Ctrl-C; return what was done in each iteration."""
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(BOUND_S) == 130, self.log.read_text()
        return self.done()

    def done(self) -> list[messages.IterationReport]:
        found = {r.message.iteration: r.message for r in read_log(self.run) if r.row is keys.ITERATION}  # type: ignore[attr-defined]
        return [found[i] for i in sorted(found)]  # type: ignore[misc]

    def __enter__(self) -> "Up":
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(10.0)


def events(reports: list[messages.IterationReport]) -> Counter[str]:
    return Counter(report.event for report in reports)


def rewards(reports: list[messages.IterationReport]) -> float:
    values = [report.feedback for report in reports if report.feedback is not None]
    return sum(values) / len(values)


def another_language(script: str) -> str:
    changed = re.sub(r"NOTES = \[.*?\]", "NOTES = [0, 1, 2, 3, 4, 5, 6]", script)
    assert changed != script
    return changed


def test_steps_1_to_4_a_language_then_alone_then_another_language(tmp_path: Path) -> None:
    with Up(tmp_path / "brain", "--iterations", "100000") as brain:
        with ZenohBus("pioneer", brain.endpoint) as bus:
            reports = bus.subscriber(keys.ITERATION)
            bus.wait(0.2)
            assert reports.take() is None, "it waits for somebody to teach"
        brain.teach()
        shown = subprocess.run(
            [*words(STATUS), "--connect", brain.endpoint],
            capture_output=True,
            text=True,
            timeout=BOUND_S,
            check=False,
        )
        assert "optimizer" in shown.stdout
        heard: list[messages.IterationReport] = []
        with ZenohBus("pioneer", brain.endpoint) as bus:
            reports = bus.subscriber(keys.ITERATION)

            def by(teacher: str | None) -> int:
                bus.wait(0.05)
                heard.extend(reports.some())
                return sum(report.teacher == teacher for report in heard)

            until(lambda: by(None) >= 200)
            newest = heard[-1].iteration
            heard.clear()
            with brain.teacher(another_language):
                until(lambda: by("ann") >= 300)
        done = brain.interrupt()
    assert {r.teacher for r in done[5:500]} == {"ann"}
    assert rewards(done[300:500]) > 0.8, "it obeys"
    left = [r for r in done[520 : newest + 1] if r.teacher is None]
    assert {r.mode for r in left} >= {"induced"}
    assert events(left)["capture"] >= len(left) * 0.08, "at random it is 1.5 in 100, at best 23"
    again = [r for r in done if r.iteration > newest and r.teacher == "ann"]
    assert rewards(again[150:300]) > 0.7, "it obeys the other language"


@pytest.mark.slow
def test_step_5_another_behaviour_by_one_line_of_the_teacher(tmp_path: Path) -> None:
    assert "`AIM = 180`" in TUTORIAL
    with Up(tmp_path / "brain") as brain:
        brain.teach(lambda script: script.replace("AIM = 0 ", "AIM = 180 "))
        done = brain.finish()
    assert rewards(done[300:500]) > 0.8
    left = events(done[520:])
    assert left["capture"] <= 0.02 * len(done[520:])
    assert left["lost"] >= 0.06 * len(done[520:]), "it flees until it sees the object no more"


@pytest.mark.slow
def test_step_6_a_teacher_in_another_network_through_a_link_that_loses_packets(tmp_path: Path) -> None:
    if os.geteuid() != 0 or not (shutil.which("ip") and shutil.which("nft")):
        pytest.skip("needs root, ip and nft")
    if subprocess.run(["ip", "netns", "add", f"probe{os.getpid()}"], capture_output=True, check=False).returncode:
        pytest.skip("the kernel denies network namespaces here")
    subprocess.run(["ip", "netns", "delete", f"probe{os.getpid()}"], check=True)
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "TMPDIR": str(tmp_path),
    }
    done = subprocess.run(
        FARAWAY, cwd=EXAMPLES, env=environment, capture_output=True, text=True, timeout=110.0, check=False
    )
    if "nft" in done.stderr and done.returncode:
        pytest.skip(f"nft cannot drop packets here: {done.stderr}")
    assert done.returncode == 0, done.stdout + done.stderr
    lost = [int(count) for count in re.findall(r"packets (\d+)", done.stdout)]
    assert len(lost) == 2
    assert min(lost) > 0, "packets were lost in both directions"
    (file,) = tmp_path.glob(f"*/runs/*/{MEMORY_FILE}")
    with sqlite3.connect(file) as db:
        rows = db.execute("SELECT payload FROM pair WHERE iteration < 60 ORDER BY iteration").fetchall()
    encoding = codec.encoding_of(messages.Pair)
    pairs = [codec.decode(messages.Pair, payload, encoding) for (payload,) in rows]
    taught = [pair for pair in pairs if pair.teacher == "ann" and pair.judges == ["ann"]]
    assert len(taught) > 50, "nearly every lesson came through"
