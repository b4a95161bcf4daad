"""A network that is cut in two: what is acknowledged stays, each side waits or goes on by itself, and both recover.

The parts of a brain run in two network namespaces; the test reads what they have written, for it is in neither.
"""

import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from mdb_protocol import codec, keys, messages
from mdb_services.experiment.run_folder import MEMORY_FILE
from mdb_services.recorder import Recorded, read_log
from mdb_sim.robot.state_file import StateFile
from mdb_sim.runs.experiment import ROBOT_FILE
from tests.integration.brain import SHORT, Brain, mdb, until
from tests.integration.ears import stored_iterations
from tests.integration.namespaces import HERE, Namespaces, why_not
from tests.integration.test_survival import LONG

WHY_NOT = why_not()
pytestmark = [pytest.mark.long, pytest.mark.skipif(WHY_NOT is not None, reason=WHY_NOT or "")]

cut_s = pytest.mark.parametrize("cut_s", [3.0, pytest.param(10.0, marks=pytest.mark.slow)])
MDB = (sys.executable, "-m", "mdb_deploy.cli")
PATIENCE_S = 2.0
"""How long a note is waited for; a lost teacher's token is gone as soon (lease)."""
SLACK_S = 1.5


@contextmanager
def process(*command: str, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    with log.open("wb") as out, subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT) as started:
        try:
            yield started
        finally:
            started.kill()


def settings() -> list[str]:
    return [word for setting in (*SHORT, *LONG) for word in ("--set", setting)]


def endpoint_of(run: Path) -> str:
    path = run / "router.endpoint"
    until(path.exists)
    return path.read_text()


def counts(run: Path) -> tuple[int, int]:
    """Pairs on disk, and those of them with a note."""
    try:
        with sqlite3.connect(f"file:{run / MEMORY_FILE}?mode=ro", uri=True) as db:
            pairs, noted = db.execute("SELECT count(*), count(note) FROM pair").fetchone()
            return pairs, noted
    except sqlite3.OperationalError:  # it is not there yet
        return 0, 0


def check_nothing_is_lost(run: Path, log: list[Recorded]) -> None:
    on_disk = stored_iterations(run)
    acknowledged = {r.message.iteration for r in log if isinstance(r.message, messages.PairStored)}
    assert acknowledged
    assert acknowledged <= set(on_disk), "what was acknowledged is on disk"
    assert on_disk == list(range(len(on_disk))), "and nothing is missing, or there twice"
    assert [r.row for r in log if r.row is keys.FINISHED] == []


@cut_s
def test_a_brain_cut_off_from_its_teacher_goes_on_by_itself_until_he_is_back(tmp_path: Path, cut_s: float) -> None:
    teachers = tmp_path / "teacher"
    assert mdb("prepare", "paper", "--run", str(teachers), *settings()).returncode == 0
    options, runs = ("--no-teacher", "--open-to-everyone"), tmp_path / "runs"
    runs.mkdir()
    with (
        Namespaces() as net,
        Brain(runs, *LONG, options=options, listen=f"tcp/{HERE}:0", inside=net.inside(net.here)) as brain,
    ):
        teach = ("run", "teacher", "--run", str(teachers), "--connect", endpoint_of(brain.run))
        with process(*net.inside(net.there), *MDB, *teach, log=tmp_path / "teacher.log") as teacher:
            until(lambda: counts(brain.run)[1] > 50)
            net.cut()
            cut_at_s, (before, _) = time.time(), counts(brain.run)
            until(lambda: time.time() - cut_at_s > cut_s, cut_s + 1.0)
            pairs, noted = counts(brain.run)
            net.mend()
            assert pairs > before + 5, "the brain goes on by itself"
            until(lambda: counts(brain.run)[1] > noted + 10, 15.0)
            assert teacher.poll() is None
        brain.interrupt()
        assert brain.wait(10.0) == 130
        log = list(read_log(brain.run))
    check_nothing_is_lost(brain.run, log)
    reports = [r for r in log if isinstance(r.message, messages.IterationReport) and r.time_s >= cut_at_s - 1.0]
    gap_s = max(b.time_s - a.time_s for a, b in pairwise(reports))
    assert gap_s < PATIENCE_S + SLACK_S, "a teacher who is gone is waited for once"
    alone = [r for r in reports if cut_at_s + PATIENCE_S + 1.0 < r.time_s < cut_at_s + cut_s]
    assert {r.message.note for r in alone if isinstance(r.message, messages.IterationReport)} <= {None}


@cut_s
def test_a_robot_cut_off_from_its_brain_stands_still_and_does_nothing_twice(tmp_path: Path, cut_s: float) -> None:
    run = tmp_path / "run"
    assert mdb("prepare", "paper", "--run", str(run), *settings()).returncode == 0
    with Namespaces() as net, ExitStack() as stack:

        def start(where: str, *words: str) -> None:
            command = (*net.inside(where), *MDB, "run", *words, "--run", str(run))
            stack.enter_context(process(*command, log=tmp_path / f"{words[0]}.log"))

        start(net.here, "router", "--listen", f"tcp/{HERE}:0", "--open-to-everyone")
        endpoint = endpoint_of(run)
        for name in ("recorder", "memory", "teacher", "optimizer"):
            start(net.here, name, "--connect", endpoint)
        start(net.there, "robot", "--connect", endpoint)
        until(lambda: counts(run)[0] > 30)
        net.cut()
        cut_at_s = time.time()
        until(lambda: time.time() - cut_at_s > 0.5, 2.0)
        state = StateFile(run / ROBOT_FILE)
        stood = state.read()
        until(lambda: time.time() - cut_at_s > cut_s, cut_s + 1.0)
        still, (pairs, _) = state.read(), counts(run)
        net.mend()
        assert stood is not None
        assert still is not None
        assert codec.encode(stood) == codec.encode(still)
        until(lambda: counts(run)[0] > pairs + 30, 15.0)
    log = list(read_log(run))
    check_nothing_is_lost(run, log)
    shown = [r.message for r in log if isinstance(r.message, messages.Perception)]
    first = {p.iteration: p for p in reversed(shown) if p.done is not None}
    first.pop(stood.perception.iteration, None)  # it was done before the cut, and shown when nobody could see it
    ages_s = [p.stamp - p.done.stamp for p in first.values() if p.done is not None]
    assert len(ages_s) > 50
    assert max(ages_s) < 1.5, "nothing was done that was too late"
