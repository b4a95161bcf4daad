"""`mdb status` on a running brain: once, for scripts, again and again, and with somebody who does not answer."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from mdb_protocol import keys, messages
from tests.integration.brain import Brain, mdb, until
from tests.integration.ears import frozen
from tests.integration.test_survival import LONG, iteration_after

WHO = {
    "recorder/log", "memory/store", "evolver/communication", "evolver/object", "evolver/induced", "robot/body",
    "teacher/script", "optimizer/action", "runner/up",
}  # fmt: skip


def told(*words: str) -> dict[str, dict[str, Any]]:
    result = mdb("status", "--json", *words)
    assert result.returncode == 0, result.stderr
    return {row["service"]: row for row in json.loads(result.stdout)["services"]}


def test_status_tells_how_each_service_does(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus:
        iteration_after(bus, bus.subscriber(keys.ITERATION), 60)
        where = ("--connect", (brain.run / "router.endpoint").read_text())
        rows = told(*where)
        assert set(rows) == WHO
        pids = {child.pid for child in brain.children()} | {brain.process.pid}
        for name, row in rows.items():
            assert row["pid"] in pids
            assert row["rate_hz"] > 1.0, name
            assert row["queued"] < 1000
            assert 10 * 2**20 < row["memory_bytes"] < 2**30
            assert (row["refused"], row["dropped"]) == ({}, {})
        assert rows["memory/store"]["values"]["disk_refuses"] == 0.0
        table = mdb("status", *where)
        assert all(name in table.stdout for name in WHO)
        robot = brain.status(bus, "robot", "body")
        assert isinstance(robot, messages.Status)
        with frozen(brain.process.pid, robot.pid):  # so that it is not ended
            rows = told(*where)
        silent = rows.get("robot/body")
        assert silent is None or not silent["answers"], "frozen: no answer, and after two seconds no token either"
        assert rows["optimizer/action"]["answers"]


@pytest.mark.long
def test_status_is_told_again_and_again_until_interrupted(tmp_path: Path) -> None:
    with Brain(tmp_path, *LONG) as brain, brain.bus():
        words = ["status", "--json", "--watch", "0.2", "--connect", (brain.run / "router.endpoint").read_text()]
        out = tmp_path / "status"
        with out.open("wb") as file:
            heeds = ["env", "--default-signal=INT"]  # which who was started in the background does not
            watching = subprocess.Popen([*heeds, sys.executable, "-m", "mdb_deploy.cli", *words], stdout=file)
        until(lambda: len(out.read_text().splitlines()) >= 4)
        os.kill(watching.pid, signal.SIGINT)
        assert watching.wait(10.0) == 130
        for line in out.read_text().splitlines():
            assert json.loads(line)["brain"] == "pioneer"
