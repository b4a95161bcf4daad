"""A service without `mdb up` around it: it ends with its own status, when it hangs, and once the run is finished."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from mdb_deploy.supervision.unattended import HUNG, or_finished
from mdb_protocol import keys
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_protocol.messages import Finished
from tests.integration.brain import until

ROUTER = ("run", "router", "--unattended", "--listen", "tcp/127.0.0.1:0", "--run")


@pytest.fixture
def router(tmp_path: Path) -> Iterator[psutil.Popen]:
    run, beats = tmp_path / "run", tmp_path / "beats"
    command = [sys.executable, "-m", "mdb_deploy.cli", *ROUTER, str(run)]
    process = psutil.Popen(command, stderr=subprocess.PIPE, env=os.environ | {"MDB_BEATS": str(beats)})
    try:
        until(lambda: beats.exists() or process.poll() is not None)
        yield process
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def service(router: psutil.Popen) -> psutil.Process:
    (one,) = router.children()
    assert isinstance(one, psutil.Process)
    return one


def experiment_in(run: Path) -> None:
    run.mkdir()
    words = ("prepare", "paper", "--run", str(run), "--set", "robot.body=kinematic")
    subprocess.run([sys.executable, "-m", "mdb_deploy.cli", *words], check=True)


@pytest.fixture(autouse=True)
def _prepared(tmp_path: Path) -> None:
    experiment_in(tmp_path / "run")


def test_one_that_is_stopped_for_good_is_ended_and_so_is_what_looks_after_it(router: psutil.Popen) -> None:
    hung = service(router)
    os.kill(hung.pid, signal.SIGSTOP)
    assert router.wait(30.0) == HUNG
    assert b"it hung and was ended" in router.stderr.read()
    assert not hung.is_running()


def test_its_death_is_told_by_the_status(router: psutil.Popen) -> None:
    service(router).kill()
    assert router.wait(30.0) == 128 + signal.SIGKILL


def test_told_to_stop_it_stops(router: psutil.Popen) -> None:
    inside = service(router)
    router.terminate()
    assert router.wait(30.0) == 0
    assert not inside.is_running()


def test_without_who_looks_after_it_it_stops(router: psutil.Popen) -> None:
    inside = service(router)
    router.kill()
    router.wait()
    until(lambda: not inside.is_running() or inside.status() == psutil.STATUS_ZOMBIE)


def test_a_service_is_told_to_stop_once_the_run_is_finished(tmp_path: Path) -> None:
    fabric = Fabric()
    told = or_finished(lambda: False, MemoryBus(fabric, "one"), tmp_path)
    assert not told()
    MemoryBus(fabric, "one").publisher(keys.FINISHED).put(Finished(iterations=3))
    assert told()
    assert told(), "and it stays so"
    assert or_finished(lambda: False, MemoryBus(fabric, "two"), tmp_path)(), "who was cut off finds it in the folder"
    assert or_finished(lambda: True, MemoryBus(fabric, "two"), tmp_path / "other")()
