"""The operator's part: changes of the robot, and how the run goes on, on a bus of its own.

One order after the other. How the run goes on is one state, of which the last word counts: each order changes a part
of what was said last, by whomever.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from mdb_deploy.running.changing import change_robot
from mdb_deploy.web.live.finding import Found
from mdb_deploy.web.live.orders import ControlRun
from mdb_protocol import keys, messages
from mdb_protocol.bus import Publisher
from mdb_protocol.errors import MdbError
from mdb_protocol.messages.world import MAX_ENDED
from mdb_protocol.zenoh_bus import ZenohBus

JOIN_S = 2.0
HEARD_S, LOOK_S = 2.0, 0.005
"""Bound on hearing ourselves what was said, and how often it is looked for."""


class Operator:
    """See the module's docstring. Its methods wait, with a bound: to be called in a thread."""

    def __init__(self, found: Found, credentials: Path | None) -> None:
        self._found, self._credentials = found, credentials
        self._lock = threading.Lock()
        self._bus: ZenohBus | None = None
        self._controls: Publisher

    def change(self, settings: Mapping[str, Any]) -> str:
        """Change something of the robot; return what was done. MdbError when it was not."""
        try:
            msgspec.convert({"settings": dict(settings)}, messages.Change)
        except (msgspec.ValidationError, ValueError, TypeError) as error:
            raise MdbError(f"this is no change of a robot: {error}") from error
        with self._lock:
            change_robot(self._joined(), settings)
        return f"changed: {', '.join(settings)}"

    def control(self, order: ControlRun, last: Callable[[], messages.Control], iteration: int) -> None:
        """Say how the run goes on: what was said last, with what the order changes. MdbError when that cannot be."""
        changes: dict[str, Any] = {
            name: value
            for name in ("paused", "action_s", "script")
            if (value := getattr(order, name)) is not msgspec.UNSET
        }
        if not (changes or order.end_phase):
            raise MdbError("nothing is to be changed; give paused, action_s, script or end_phase")
        with self._lock:
            self._joined()
            before = last()
            if order.end_phase:
                if len(before.ended) >= MAX_ENDED:
                    raise MdbError(f"{MAX_ENDED} phases of this run were ended already; no more can be")
                changes["ended"] = sorted({*before.ended, iteration})
            said = msgspec.structs.replace(before, iteration=iteration, **changes)
            self._controls.put(said)
            until_s = time.monotonic() + HEARD_S
            while last() != said:  # the next order begins with this one
                if time.monotonic() > until_s:
                    raise MdbError("it was said and is not heard: do these keys let you? ('mdb keys roles')")
                time.sleep(LOOK_S)

    def _joined(self) -> ZenohBus:
        if self._bus is not None and not self._bus.connected():
            raise MdbError("the router is gone; ask again when it is back")
        if self._bus is None:
            self._bus = ZenohBus(
                self._found.brain,
                self._found.endpoint,
                credentials=self._credentials,
                connect_timeout_s=JOIN_S,
            )
            self._controls = self._bus.publisher(keys.CONTROL)
        return self._bus

    def close(self) -> None:
        """Leave the router."""
        with self._lock:
            if self._bus is not None:
                self._bus.close()
            self._bus = None
