"""The brain in real containers, as compose.yaml says: it runs, survives a hang, and ends with its run and figures.

Needs an engine that runs and Docker Compose. Where the image's base cannot be had, make one of Debian's packages:
`debootstrap --variant=minbase --include=python3.11,python3-pip,ca-certificates bookworm ROOT`, in it
`rm usr/lib/python3.11/EXTERNALLY-MANAGED; ln -s python3.11 usr/bin/python`, then
`tar -C ROOT -c . | docker import - python:3.11-slim`.
"""

import json
import os
import shutil
import sqlite3
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from mdb_deploy.supervision.compose import COMPOSE_FILE
from mdb_services.experiment.run_folder import MEMORY_FILE
from tests.integration.brain import SHORT

ROOT = COMPOSE_FILE.parents[1]
BASE, IMAGE = "python:3.11-slim", "multilevel-darwinist-brain"
OWNER = "4321:4321"
ITERATIONS = 600
BOUND_S = 240.0
FREEZE = (
    "import os, psutil, signal; "
    "(service,) = [p.pid for p in psutil.process_iter() if '--until-finished' in p.cmdline()]; "
    "os.kill(service, signal.SIGSTOP)"
)


def docker(*words: str, bound_s: float = BOUND_S) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(["docker", *words], capture_output=True, text=True, check=False, timeout=bound_s)
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(words, 1, "", f"not within {bound_s:g} s")


def compose_command() -> list[str] | None:
    """Docker Compose as a part of Docker, or as a program of its own."""
    for command in (["docker", "compose"], ["docker-compose"]):
        if shutil.which(command[0]):
            asked = subprocess.run([*command, "version"], capture_output=True, check=False)
            if asked.returncode == 0:
                return command
    return None


def why_not() -> str:
    """Why there can be no containers here; empty when there can."""
    if shutil.which("docker") is None:
        return "Docker is not installed"
    if (asked := docker("info", "--format", "{{.ServerVersion}}", bound_s=20.0)).returncode:
        return f"no engine runs: {asked.stderr.strip() or asked.stdout.strip()}"
    if compose_command() is None:
        return "Docker Compose is not installed"
    if docker("image", "inspect", BASE).returncode and docker("pull", BASE, bound_s=60.0).returncode:
        return f"the image {BASE} cannot be had; this file says how to make it"
    return ""


class Containers:
    """The containers of one brain; nothing is left of them."""

    def __init__(self, run: Path) -> None:
        self.run, self.project = run, f"mdb-test-{os.getpid()}"
        settings = [s for s in SHORT if not s.startswith("experiment.iterations")]
        self.environment = os.environ | {
            "MDB_RUN": str(run),
            "MDB_ITERATIONS": str(ITERATIONS),
            "MDB_SET": ";".join([*settings, "experiment.brain=ann", "robot.action_s=0.03"]),
            "MDB_USER": OWNER,
        }

    def compose(self, *words: str) -> str:
        command = compose_command()
        assert command is not None
        said = subprocess.run(
            [*command, "-p", self.project, "-f", str(COMPOSE_FILE), *words],
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=BOUND_S,
        )
        assert said.returncode == 0, said.stderr
        return said.stdout

    def states(self) -> dict[str, dict[str, object]]:
        """What the engine says of each container: its state, and how often it was started again."""
        names = self.compose("ps", "-a", "-q").split()
        found = json.loads(docker("inspect", *names).stdout)
        label = "com.docker.compose.service"
        return {
            each["Config"]["Labels"][label]: each["State"] | {"restarts": each["RestartCount"], "id": each["Id"]}
            for each in found
        }

    def wait_for(self, condition: Callable[[], bool]) -> None:
        """Look now and then, for each look costs a second of a core; the end tells how all are."""
        deadline = time.monotonic() + BOUND_S
        while not condition():
            assert time.monotonic() < deadline, self.compose("logs", "--tail", "5")
            time.sleep(2.0)

    def log(self, service: str) -> list[str]:
        said = docker("logs", str(self.states()[service]["id"]))
        return (said.stdout + said.stderr).strip().splitlines()


@pytest.fixture
def containers(tmp_path: Path) -> Iterator[Containers]:
    if reason := why_not():
        pytest.skip(reason)
    built = docker("build", "--network", "host", "-t", IMAGE, "-f", "deploy/Dockerfile", str(ROOT), bound_s=1200.0)
    assert built.returncode == 0, built.stderr[-2000:]
    one = Containers(tmp_path / "run")
    try:
        yield one
    finally:
        one.compose("down", "-t", "2", "-v")


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_run_in_containers_survives_a_hang_and_ends_with_figures_and_a_last_line(containers: Containers) -> None:
    containers.compose("up", "-d")
    containers.wait_for(lambda: any("iteration" in line for line in containers.log("follow")))
    state = containers.states()
    healthy = {name for name, one in state.items() if (one.get("Health") or {}).get("Status") == "healthy"}  # type: ignore[attr-defined]
    assert {"router", "memory", "robot", "teacher", "recorder", "evolver-object"} <= healthy
    frozen = docker("exec", str(state["memory"]["id"]), "python", "-c", FREEZE)
    assert frozen.returncode == 0, frozen.stderr

    containers.wait_for(lambda: not any(one["Running"] for one in containers.states().values()))

    state = containers.states()
    assert {name: one["ExitCode"] for name, one in state.items()} == dict.fromkeys(state, 0)
    assert state["memory"]["restarts"]
    assert any("it hung and was ended" in line for line in containers.log("memory"))
    seen = containers.log("follow")
    assert any(f"iteration {ITERATIONS}/{ITERATIONS}" in line for line in seen)
    assert seen[-1] == f"results: {containers.run}"
    assert (containers.run / "figure5.png").exists()
    with sqlite3.connect(containers.run / MEMORY_FILE) as db:
        assert db.execute("SELECT count(*) FROM pair").fetchone() == (ITERATIONS,)
    owners = {f"{path.stat().st_uid}:{path.stat().st_gid}" for path in containers.run.rglob("*")}
    assert owners == {OWNER}
