"""The witness: a process outside the brain that writes down what is acknowledged, to compare it with the memory.

Owns its own file, and nothing of the run's. Never speaks. What a router's death kept from it, its subscriptions
fetch from the publishers afterwards; what it has not heard it does not claim.

    python -m mdb_deploy.trials.witness --connect tcp/127.0.0.1:7447 --brain pioneer --out witness.jsonl
"""

from __future__ import annotations

import argparse
import json
import os
import sqlite3
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mdb_protocol import codec, keys, messages
from mdb_protocol.bus import Bus
from mdb_protocol.errors import MdbError
from mdb_protocol.keys import Key
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.shell.service import Stopper

Plain = dict[str, Any]

WAIT_S = 0.05
HEARD: tuple[Key, ...] = (keys.PAIR_STORED, keys.PAIR)


def write_down(bus: Bus, out: Path, stop: Stopper) -> None:
    """Write every pair and acknowledgement that comes, a line of JSON each, on disk before the next is waited for."""
    inboxes = {row.path: bus.subscriber(row) for row in HEARD}
    with out.open("a", encoding="utf-8") as file:
        while True:
            over = stop()  # what has come before is still written
            came = False
            for path, inbox in inboxes.items():
                while (message := inbox.take()) is not None:
                    file.write(json.dumps({"key": path, "says": codec.to_plain(message)}) + "\n")
                    came = True
            if came:
                file.flush()
                os.fsync(file.fileno())
            if over:
                return
            bus.wait(WAIT_S)


@dataclass(frozen=True)
class Findings:
    """What the witness's file and the memory say of each other; every list holds iterations."""

    acknowledged: int
    """Iterations whose acknowledgement the witness has heard."""
    stored: int
    """Pairs in the memory."""
    lost: list[int]
    """Acknowledged, but not in the memory."""
    altered: list[int]
    """Acknowledged and heard, but in the memory with another content, or without the feedback it was stored with."""
    doubled: list[int]
    """Twice in a model's short-term memory's history, or the same as the pair before: one action counted twice."""
    missing: list[int]
    """Never stored, though a later one is."""

    @property
    def holds(self) -> bool:
        """Whether everything acknowledged is there, once, as it was."""
        return not (self.lost or self.altered or self.doubled)


def compare(witness: Path, memory: Path) -> Findings:
    """Compare a witness's file with a memory store's; MdbError when one of them cannot be read."""
    heard, judged = _heard(witness)
    try:
        with sqlite3.connect(f"file:{memory}?mode=ro", uri=True) as db:
            pairs = _pairs(db)
            entered_twice = {row[0] for row in db.execute(ENTERED_TWICE)}
    except sqlite3.Error as error:
        raise MdbError(f"cannot compare with {memory}: {error}") from error
    lost = [iteration for iteration in judged if iteration not in pairs]
    altered = [
        iteration
        for iteration, was_judged in judged.items()
        if (pair := pairs.get(iteration)) is not None
        and ((heard[iteration] and pair not in heard[iteration]) or (was_judged and pair["feedback"] is None))
    ]
    repeated = {i for i, pair in pairs.items() if i - 1 in pairs and _same_act(pairs[i - 1], pair)}
    return Findings(
        acknowledged=len(judged),
        stored=len(pairs),
        lost=sorted(lost),
        altered=sorted(altered),
        doubled=sorted(entered_twice | repeated),
        missing=[iteration for iteration in range(max(pairs, default=-1)) if iteration not in pairs],
    )


ENTERED_TWICE = "SELECT pair FROM change WHERE pair >= 0 GROUP BY model, pair HAVING count(*) > 1"


def _heard(witness: Path) -> tuple[dict[int, list[Plain]], dict[int, bool]]:
    """Return the pairs heard for each iteration, and for each that was acknowledged whether with its feedback."""
    pairs: dict[int, list[Plain]] = defaultdict(list)
    judged: dict[int, bool] = {}
    for line in _lines(witness):
        says = line["says"]
        iteration = says["iteration"]
        if line["key"] == keys.PAIR.path:
            pairs[iteration].append(says)
        else:
            judged[iteration] = judged.get(iteration, False) or says["judged"]
    return pairs, judged


def _lines(witness: Path) -> Iterator[Plain]:
    try:
        text = witness.read_text(encoding="utf-8")
    except OSError as error:
        raise MdbError(f"the witness has left nothing: {error}") from error
    whole = text.rpartition("\n")[0]  # a witness that was killed may have left half a line
    yield from map(json.loads, whole.splitlines())


def _pairs(db: sqlite3.Connection) -> dict[int, Plain]:
    encoding = codec.encoding_of(messages.Pair)
    rows = db.execute("SELECT iteration, payload FROM pair ORDER BY iteration")
    return {i: codec.to_plain(codec.decode(messages.Pair, payload, encoding)) for i, payload in rows}


def _same_act(a: Plain, b: Plain) -> bool:
    """Whether two pairs tell of one act: sensors are noisy, so two acts read the same only where nothing is seen."""
    return bool(a["before"]) and all(a[name] == b[name] for name in ("before", "action", "after"))


def main(argv: list[str] | None = None) -> int:
    """Listen until told to stop, or until the parent process is gone."""
    parser = argparse.ArgumentParser(prog="python -m mdb_deploy.trials.witness", description=__doc__)
    parser.add_argument("--connect", required=True)
    parser.add_argument("--brain", default="pioneer")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--with-parent", type=int, metavar="PID")
    arguments = parser.parse_args(argv)
    stop = Stopper(arguments.with_parent)
    stop.install()
    try:
        with ZenohBus(arguments.brain, arguments.connect, connect_timeout_s=10.0) as bus:
            write_down(bus, arguments.out, stop)
    except MdbError as error:
        sys.stderr.write(f"witness: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
