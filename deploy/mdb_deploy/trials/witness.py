"""The witness: a process outside the brain that writes down what is acknowledged; `evidence` holds it against the
memory.

Owns its own file, and nothing of the run's. Never speaks. What a router's death kept from it, its subscriptions
fetch from the publishers afterwards; what it has not heard it does not claim.

    python -m mdb_deploy.trials.witness --connect tcp/127.0.0.1:7447 --brain pioneer --out witness.jsonl
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
from pathlib import Path

from mdb_protocol import codec, keys, messages
from mdb_protocol.bus import Bus
from mdb_protocol.errors import MdbError
from mdb_protocol.keys import Key
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.shell.service import Stopper

WAIT_S = 0.05
HEARD: tuple[Key, ...] = (keys.PAIR_STORED, keys.PAIR, keys.MEMORY_CHANGE, keys.CONTEXT, keys.CURRENT_MODEL)
"""The memory store says what it says after it is on disk; a pair is what the optimizer wants stored, and a model what
an evolver does."""


def digest_of(message: messages.Message) -> str:
    """Return what tells a message from any other."""
    return hashlib.sha256(codec.encode(message)).hexdigest()[:16]


def line_of(row: Key, message: messages.Message) -> str:
    """Return what is written of a message: all that the memory must have of it."""
    match message:
        case messages.MemoryChange():
            slots = [*zip(message.slots.tolist(), message.pairs.tolist(), strict=True)]
            slots += [(slot, None) for slot in message.freed.tolist()]
            says: object = {
                "model": message.model, "version": message.version, "slots": slots, "seeds": len(message.seeds),
            }  # fmt: skip
        case messages.CurrentModel():
            says = {"model": message.model, "version": message.version, "digest": digest_of(message)}
        case _:
            says = codec.to_plain(message)
    return json.dumps({"key": row.path, "says": says})


def write_down(bus: Bus, out: Path, stop: Stopper) -> None:
    """Write what comes of `HEARD`, a line of JSON each, on disk before the next is waited for."""
    inboxes = {row: bus.subscriber(row) for row in HEARD}
    with out.open("a", encoding="utf-8") as file:
        while True:
            over = stop()  # what has come before is still written
            came = False
            for row, inbox in inboxes.items():
                while (message := inbox.take()) is not None:
                    file.write(line_of(row, message) + "\n")
                    came = True
            if came:
                file.flush()
                os.fsync(file.fileno())
            if over:
                return
            bus.wait(WAIT_S)


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
