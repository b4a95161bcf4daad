"""Guests who say as much as they can starve nobody: acting goes on, memory stays as it is, all is soon over."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mdb_deploy.keys.credentials import KeyFolder
from mdb_deploy.trials.under_test import words_of
from mdb_protocol import keys
from mdb_protocol.roles import Role, User
from mdb_protocol.zenoh_bus import ZenohBus
from tests.integration.brain import BRAIN, Brain, select_nothing, until
from tests.integration.test_survival import LONG

GROWN_MB = 64
TEACHER, VIEWER = User(BRAIN, Role.TEACHER, "anna"), User(BRAIN, Role.VIEWER, "tom")
OPERATOR = User(BRAIN, Role.OPERATOR, "olga")
FLOODS = [
    *((TEACHER, kind) for kind in ("notes", "sound", "large", "gaps", "heartbeats", "tokens", "questions")),
    *((VIEWER, kind) for kind in ("notes", "large", "gaps", "questions")),
    *((OPERATOR, kind) for kind in ("notes", "large", "gaps")),
]
BUSY = TEACHER, "nothing"
"""What a flood takes of the processor by itself, which no limit gives back."""
AFTER_S, MEASURED_S = 5.0, 3.0
"""By then all is as before; the pace is measured in the last part of it."""
AS_BEFORE = 0.5
"""What of the pace before is as before, on a machine that has other work, too."""


class Flooded:
    """A brain with keys, and what of it must stay as it is."""

    def __init__(self, folder: Path) -> None:
        self._keys = KeyFolder.create(folder / "keys", BRAIN)
        for user in (TEACHER, VIEWER, OPERATOR):
            self._keys.add(user.role, user.name)
        runs = folder / "runs"
        runs.mkdir()
        options = ("--keys", str(self._keys.path))
        self._brain = Brain(runs, *LONG, listen="tls/127.0.0.1:0", options=options)
        self._newest = -1

    @contextmanager
    def running(self) -> Iterator[None]:
        with self._brain:
            place = self._brain.run / "router.endpoint"
            until(place.exists)
            self._endpoint = place.read_text()
            with ZenohBus(BRAIN, self._endpoint, credentials=self._keys.path) as bus:
                self._bus, self._reports = bus, bus.subscriber(keys.ITERATION)
                self.goes_on(20)
                self._processes = {child.pid: child.memory_info().rss for child in self._brain.children()}
                yield

    def _iteration(self) -> int:
        while (report := self._reports.take()) is not None:
            self._newest = max(self._newest, report.iteration)
        return self._newest

    def goes_on(self, more: int) -> None:
        first = self._iteration()
        until(lambda: self._iteration() >= first + more)

    def pace_hz(self, seconds: float) -> float:
        """Iterations a second while nothing else is done here."""
        first, began = self._iteration(), time.monotonic()
        select_nothing(seconds)
        return (self._iteration() - first) / (time.monotonic() - began)

    def pace_in_flood_hz(self, flood: tuple[User, str], seconds: float) -> float:
        user, kind = flood
        words = [self._endpoint, str(self._keys.bundle(user)), kind, str(seconds)]
        command = [sys.executable, "-m", "tests.integration.floods", *words]
        first, began = self._iteration(), time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
        pace = (self._iteration() - first) / (time.monotonic() - began)
        assert int(done.stdout) > 0, "nothing was said"
        return pace

    def check(self) -> str:
        """Nobody has died, none has grown by much, acting goes on; return who has grown most."""
        self.goes_on(5)
        children = {child.pid: child for child in self._brain.children()}
        assert set(children) == set(self._processes)
        grown = {
            " ".join(words_of(c)[:4]): (c.memory_info().rss - self._processes[p]) / 1e6 for p, c in children.items()
        }
        assert not {name: mb for name, mb in grown.items() if mb > GROWN_MB}
        most = max(grown, key=lambda name: grown[name])
        return f"{most} has grown by {grown[most]:.0f} MB"


@pytest.mark.long
@pytest.mark.timeout(600)
def test_floods_of_every_kind_leave_the_brain_as_it_was(tmp_path: Path) -> None:
    flooded = Flooded(tmp_path)
    with flooded.running():
        for flood in FLOODS:
            assert flooded.pace_in_flood_hz(flood, 1.5) > 0, flood
            flooded.check()


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_in_ten_sequences_of_floods_acting_keeps_half_its_pace_and_is_soon_as_before(tmp_path: Path) -> None:
    flooded = Flooded(tmp_path)
    with flooded.running():
        for turn in range(10):
            before, busy = flooded.pace_hz(4.0), flooded.pace_in_flood_hz(BUSY, 4.0)
            sys.stderr.write(f"\n{turn + 1}: {before:.1f} a second, {busy:.1f} beside a busy process\n")
            for flood in FLOODS:
                during = flooded.pace_in_flood_hz(flood, 8.0)
                select_nothing(AFTER_S - MEASURED_S)
                after = flooded.pace_hz(MEASURED_S)
                kind = f"{flood[0].role.value}: {flood[1]}"
                sys.stderr.write(f"{turn + 1} {kind}: {during:.1f} in it, {after:.1f} after; {flooded.check()}\n")
                assert during > 0.5 * min(before, busy), kind
                assert after > AS_BEFORE * before, kind
