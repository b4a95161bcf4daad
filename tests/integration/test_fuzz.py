"""Junk on every key of a running brain: counted, said a few times, dropped; nobody dies, nothing is learnt of it."""

import json
import os
import sqlite3
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil
import pytest
import zenoh

from mdb_deploy.trials.under_test import words_of
from mdb_protocol import codec, keys, messages
from mdb_protocol.bus import TAPPED
from mdb_protocol.waiting import Raw
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.experiment.run_folder import MEMORY_FILE
from tests.integration.brain import BRAIN, Brain, until
from tests.integration.junk import LATEST_READERS, READERS, Maker, Reads
from tests.integration.test_survival import LONG

pytestmark = pytest.mark.long

ROUNDS = 14
AT_ONCE = 250
"""Messages sent before their readers have to have counted them."""
SAID_AGAIN = 5
"""Times that they are sent, at most: a reader that was cut off on a busy machine did not hear the first ones."""
GROWN_MB = 150.0
LOGGED = 400
"""Lines in all logs together: a few for each key and reader."""


@contextmanager
def stranger(brain: Brain) -> Iterator[zenoh.Session]:
    """A client that asks nobody before it speaks."""
    endpoints = {"endpoints": [(brain.run / "router.endpoint").read_text()]}
    with zenoh.open(zenoh.Config.from_json5(json.dumps({"mode": "client", "connect": endpoints}))) as session:
        yield session


def put(session: zenoh.Session, raw: Raw, *, drop: bool = False) -> None:
    control = zenoh.CongestionControl.DROP if drop else zenoh.CongestionControl.BLOCK
    session.put(raw.key, raw.payload, encoding=raw.encoding, congestion_control=control)


def statuses(bus: ZenohBus) -> dict[str, messages.Status]:
    return {f"{s.role}/{s.instance}": s for s in bus.query(keys.STATUS, 10.0)}


class Watch:
    """What of a brain must not change, or not much, whatever is sent to it."""

    def __init__(self, brain: Brain, bus: ZenohBus) -> None:
        self._brain, self._bus = brain, bus
        self.goes_on(40)
        self._processes = {child.pid: child.memory_info().rss for child in brain.children()}
        self._pairs = self.pairs()
        self._errors = self.errors()

    def goes_on(self, more: int) -> None:
        """Return when so many iterations were done."""
        first = self.iteration()
        until(lambda: self.iteration() >= first + more)

    def iteration(self) -> int:
        """The robot's own word, for reports may be junk."""
        robot = until(lambda: self._brain.status(self._bus, "robot", "body"))
        assert isinstance(robot, messages.Status)
        return int(robot.values["iteration"])

    def pairs(self) -> dict[int, bytes]:
        path = self._brain.run / MEMORY_FILE
        with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as db:
            return dict(db.execute("SELECT iteration, payload FROM pair").fetchall())

    def errors(self) -> dict[str, float]:
        found = statuses(self._bus)
        return {name: found[name].values["error"] for name in found if name.startswith("evolver/")}

    def check(self) -> None:
        self.goes_on(40)
        processes = {child.pid: child.memory_info().rss for child in self._brain.children()}
        assert processes.keys() == self._processes.keys(), "nobody died"
        grown = {pid: (rss - self._processes[pid]) / 2**20 for pid, rss in processes.items()}
        assert max(grown.values()) < GROWN_MB, {
            " ".join(words_of(psutil.Process(pid))[:4]): mb for pid, mb in grown.items()
        }
        pairs = self.pairs()
        assert self._pairs.items() <= pairs.items(), "what was stored is as it was"
        assert sorted(pairs) == list(range(len(pairs))), "and what came since is the brain's own"
        for name, error in self.errors().items():
            assert error <= self._errors[name] + 0.1, f"{name} learnt of it"
        for model in self._bus.query(keys.KEPT_MODEL, 5.0):
            assert np.isfinite(model.weights).all()
            assert model.version < 10**6
        logs = [path.read_text().splitlines() for path in (self._brain.run / "logs").iterdir()]
        assert sum(map(len, logs)) < LOGGED
        assert max(len(line) for log in logs for line in log) < 1000


def test_junk_of_every_kind_on_every_key_is_counted_and_changes_nothing(tmp_path: Path) -> None:
    maker = Maker(BRAIN, seed=1, heavy_every=3)
    junk = maker.stream()
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus, stranger(brain) as session:
        watch = Watch(brain, bus)
        sent = Counter[str]()
        for _ in range(ROUNDS):
            some = [next(junk) for _ in range(AT_ONCE)]
            for raw in some:
                row = keys.find(BRAIN, raw.key)
                sent[row.path if row is not None else TAPPED] += 1
            send_until_counted(bus, session, some, maker.unreadable)
        for size in (keys.CHECKPOINT.most_bytes + 1, 3 * keys.CHECKPOINT.most_bytes):
            put(session, Raw(keys.CHECKPOINT.at(BRAIN, model="object"), bytes(size), ""))
        session.delete(keys.ACTION.at(BRAIN))
        session.delete(f"mdb/{BRAIN}/**")
        watch.check()
        found = statuses(bus)
    for role, instance, row in LATEST_READERS:
        assert found[f"{role}/{instance}"].refused.get(row.path, 0) > 0, "of latest values not all is read"
    assert sum(sent.values()) == ROUNDS * AT_ONCE
    assert set(sent) == {row.path for row in keys.KEYS} | {TAPPED}


ALL_READ = (*READERS, *(Reads("recorder", "log", row) for row in keys.KEYS if row.recorded))
"""Who reads every message of which key."""


def send_until_counted(bus: ZenohBus, session: zenoh.Session, some: list[Raw], unreadable: Counter[str]) -> None:
    """Send messages until all their readers have refused all that cannot be read."""

    def uncounted() -> list[str]:
        refused = {name: status.refused for name, status in statuses(bus).items()}
        return [
            f"{name}: {row.path}"
            for role, instance, row in ALL_READ
            if refused.get(name := f"{role}/{instance}", {}).get(row.path, 0) < unreadable[row.path]
        ]

    for _ in range(SAID_AGAIN):
        for raw in some:
            put(session, raw)
        deadline_s = time.monotonic() + 10.0
        while (missing := uncounted()) and time.monotonic() < deadline_s:
            time.sleep(0.05)
        if not missing:
            return
    raise AssertionError(f"not counted: {missing}")


def test_a_model_of_a_wrong_writer_acts_until_the_next_version_and_is_learnt_by_nobody(tmp_path: Path) -> None:
    """Without keys nobody can tell it from the evolver's; its numbers are bounded, and the next takes its place."""
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus, stranger(brain) as session:
        watch = Watch(brain, bus)
        (model,) = until(lambda: bus.query(keys.KEPT_MODEL, 5.0, model="object"))  # type: ignore[misc]
        for weight, taken in ((1e6, True), (1.1e6, False), (np.nan, False), (np.inf, False)):
            absurd = messages.CurrentModel(
                model="object", version=2**53, generation=2**53, layers=model.layers, error=0.0,
                weights=np.full(len(model.weights), 0.0, np.float32),
            )  # fmt: skip
            payload = codec.encode(absurd).replace(
                absurd.weights.tobytes(), np.full_like(absurd.weights, weight).tobytes()
            )
            before = refused_models(brain, bus)
            put(session, Raw(keys.CURRENT_MODEL.at(BRAIN, model="object"), payload, codec.encoding_of(type(absurd))))
            if not taken:
                until(lambda n=before: refused_models(brain, bus) > n, 5.0)
        watch.check()


def refused_models(brain: Brain, bus: ZenohBus) -> int:
    optimizer = until(lambda: brain.status(bus, "optimizer", "action"))
    assert isinstance(optimizer, messages.Status)
    return optimizer.refused.get(keys.CURRENT_MODEL.path, 0)


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_a_million_messages_of_junk_are_survived(tmp_path: Path) -> None:
    """As fast as they go; what readers cannot follow, the router drops."""
    maker = Maker(BRAIN, seed=2, heavy_every=100)
    junk = maker.stream()
    repeated = [next(junk) for _ in range(50_000)]
    with Brain(tmp_path, *LONG) as brain, brain.bus() as bus, stranger(brain) as session:
        watch = Watch(brain, bus)
        began_s, first = time.monotonic(), watch.iteration()
        for turn in range(20):
            for raw in repeated:
                put(session, raw, drop=turn % 2 == 0)
        took_s = time.monotonic() - began_s
        done = watch.iteration() - first
        sys.stderr.write(
            f"\n10^6 messages of junk in {took_s:.0f} s: {1e6 / took_s:.0f}/s; {done} iterations meanwhile\n"
        )
        watch.check()
        found = statuses(bus)
    for name in sorted(found):
        refused, dropped = sum(found[name].refused.values()), sum(found[name].dropped.values())
        memory = found[name].memory_bytes / 2**20
        sys.stderr.write(f"{name}: refused {refused}, dropped {dropped}, {memory:.0f} MB\n")
    assert sum(found["recorder/log"].refused.values()) > 1000
    assert os.path.getsize(brain.run / "run.mcap") < 2**30
