"""The brain's side of a link to a robot on trial: all that it says, as it came, and the actions that it is told.

Owns the bus of the trial. Judges nothing: `robot_check` does.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import msgpack

from mdb_protocol import codec, keys, messages
from mdb_protocol.bus import read
from mdb_protocol.errors import DecodeError
from mdb_protocol.waiting import Raw
from mdb_protocol.zenoh_bus import ZenohBus

ROBOTS = (keys.PERCEPTION, keys.SCENE, keys.PICTURE)
"""The keys on which a robot writes."""
RESEND_S = 0.5
VALID_S = 1.0


class Shown(NamedTuple):
    """A perception, and when it came."""

    at_s: float
    perception: messages.Perception


class Link:
    """See the module's docstring."""

    def __init__(self, bus: ZenohBus) -> None:
        self.bus = bus
        self._tap = bus.tap()
        self._actions = bus.publisher(keys.ACTION)
        self.shown: list[Shown] = []
        self.scenes: list[messages.Scene] = []
        self.unreadable: list[str] = []
        """Why what it wrote cannot be read."""
        self.sent: dict[int, list[messages.Action]] = {}
        """What it was told, by iteration."""
        self._made = 0

    @property
    def now(self) -> messages.Perception:
        """The newest perception."""
        return self.shown[-1].perception

    @property
    def place(self) -> Mapping[str, float]:
        """What was true last; nothing without a scene."""
        return self.scenes[-1].now if self.scenes else {}

    def robots(self) -> list[str]:
        """Return the instances of all robots that hold a token."""
        return sorted(name.partition("/")[2] for name in self.bus.alive() if name.startswith("robot/"))

    def claims(self) -> list[str]:
        """Return the names of all that hold the robot's place."""
        return sorted(self.bus.holders("robot", "body"))

    def listen(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Take what it says until something is so, and return True, or for so long."""
        deadline = time.monotonic() + seconds
        while True:
            for raw in self._tap.some():
                self._take(raw)
            left_s = deadline - time.monotonic()
            if until():
                return True
            if left_s <= 0:
                return False
            self.bus.wait(min(left_s, 0.05))

    def _take(self, raw: Raw) -> None:
        row = keys.find(self.bus.brain, raw.key)
        if row not in ROBOTS:
            return
        try:
            message = read(row, self.bus.brain, raw)
        except DecodeError as error:
            self.unreadable.append(f"{row.path}: {error}")
            return
        if isinstance(message, messages.Perception):
            self.shown.append(Shown(time.monotonic(), message))
        elif isinstance(message, messages.Scene):
            self.scenes.append(message)

    def action(
        self,
        iteration: int,
        values: Mapping[str, float],
        *,
        choice: int | None = None,
        stamp: float | None = None,
        valid_for_s: float = VALID_S,
    ) -> messages.Action:
        """Make an action that answers the newest perception, or one of another `stamp`; what is meant is its own."""
        self._made += 1
        meant = messages.Intention(
            before=self.now.reading,
            note=self._made % 7,
            teacher="check",
            holder=None,
            mode="check",
            explored=False,
            predicted=self._made / 1000,
            versions={"check": self._made},
        )
        return messages.Action(
            iteration=iteration,
            action=dict(values),
            choice=choice,
            valid_for_s=valid_for_s,
            stamp=self.now.stamp if stamp is None else stamp,
            intention=meant,
        )

    def tell(self, action: messages.Action) -> None:
        """Send an action."""
        self.sent.setdefault(action.iteration, []).append(action)
        self._actions.put(action)

    def tell_until(
        self,
        iteration: int,
        values: Mapping[str, float],
        choice: int | None,
        bound_s: float,
        every_s: float = RESEND_S,
    ) -> bool:
        """Send an action again and again, as the brain does, until the count moves; return whether it did."""
        stands, deadline = self.now.iteration, time.monotonic() + bound_s
        while (left_s := deadline - time.monotonic()) > 0:
            self.tell(self.action(iteration, values, choice=choice))
            if self.listen(min(every_s, left_s), lambda: self.now.iteration != stands):
                return True
        return False

    def put_junk(self, action: messages.Action) -> None:
        """Put on the action's key what is no action, made from one that would be due."""
        payload, right = codec.encode(action), codec.encoding_of(messages.Action)
        other = right.replace(f"mdb={codec.VERSION};", f"mdb={codec.VERSION + 1};")
        nans = codec.to_plain(action) | {"action": dict.fromkeys(action.action, math.nan)}
        for content, encoding in (
            (b"\xc1 no message", right),
            (payload[: len(payload) // 2], right),
            (msgpack.packb(nans), right),
            (payload, other),
            (payload, "text/plain"),
        ):
            self.bus.put(Raw(keys.ACTION.at(self.bus.brain), content, encoding))
