"""One of a name: a service becomes what no other of its brain's name is.

Owns the rule. Who starts claims the place, and has it as soon as there is no other claim and nobody alive in it. Of
two that claim at the same time the one whose name sorts later steps back, so that one of them gets it. A predecessor
that died leaves its tokens behind for a moment, after a cut cable for Zenoh's lease: that is waited for. Whoever
answers, or is there after that, lives, and the newcomer is refused.
"""

from __future__ import annotations

import os
import re
import secrets
import socket
import time
from collections.abc import Callable

from mdb_protocol import keys
from mdb_protocol.bus import Bus
from mdb_protocol.errors import QueryError, TakenError
from mdb_protocol.messages import Status

GONE_S = 3.0
"""By then the tokens of who is dead are gone: Zenoh's lease is 2 s."""
ANSWER_S = 0.5
PAUSE_S = 0.01
UNNAMED = re.compile(r"[^A-Za-z0-9_-]")


def hold(bus: Bus, role: str, instance: str, stop: Callable[[], bool] = lambda: False) -> bool:
    """Become this service of the bus's brain; False when told to stop meanwhile.

    Raises TakenError, which says who it is, when another lives. Waits `GONE_S` at most, and for an answer.
    """
    me = _holder()
    withdraw: Callable[[], None] | None = None
    deadline = time.monotonic() + GONE_S
    while not stop():
        others, lives = bus.holders(role, instance) - {me}, f"{role}/{instance}" in bus.alive()
        if not others and not lives:
            if withdraw is not None:
                return True
            withdraw = bus.claim(role, instance, me)
            continue  # and look again: another may have claimed it at the same time
        said = _ask(bus, role, instance) if lives else None
        if said is not None or time.monotonic() >= deadline:
            raise TakenError(_words(bus.brain, role, instance, said, others))
        if withdraw is not None and others and min(others) < me:
            withdraw()
            withdraw = None
        time.sleep(PAUSE_S)
    return False


def _holder() -> str:
    """Return a name that no other process has, and from which is seen where it runs."""
    host = UNNAMED.sub("-", socket.gethostname())[:40]
    return f"{host}.{os.getpid()}.{secrets.token_hex(4)}"


def _process(holder: str) -> str:
    """Tell who a holder is, by the name that `_holder` gave it; a robot of somebody else's has a name of its own."""
    host, _, process = holder.rpartition(".")[0].rpartition(".")
    return f"process {process} on {host}" if host else f"somebody who calls himself {holder}"


def _ask(bus: Bus, role: str, instance: str) -> Status | None:
    try:
        answers: list[Status] = bus.query(keys.STATUS, ANSWER_S, role=role, instance=instance)
    except QueryError:
        return None
    return answers[0] if answers else None


def _words(brain: str, role: str, instance: str, said: Status | None, others: frozenset[str]) -> str:
    """Say who it is, as far as it is known."""
    who = "somebody who does not say who it is"
    if said is not None:
        since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(time.time() - said.uptime_s))
        who = f"process {said.pid} on {said.host or 'an unnamed host'}, since {since}"
        who += f", in {said.run}" if said.run else ""
    elif others:
        who = f"{_process(min(others))}, which is starting or does not answer"
    return (
        f"brain {brain} has its {role}/{instance} already: {who}. Stop that one first, or give this brain another "
        "name: --set experiment.brain=NAME"
    )
