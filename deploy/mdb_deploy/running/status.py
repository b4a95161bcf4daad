"""`mdb status`: who is alive, by the liveliness tokens, and how each does, by its status queryable.

Owns the table and the JSON; asks, and never changes anything.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table

from mdb_deploy.running.console import console_of, plain
from mdb_protocol import codec, keys
from mdb_protocol.bundle import brains_of
from mdb_protocol.bus import Bus
from mdb_protocol.errors import QueryError
from mdb_protocol.messages import Status
from mdb_protocol.words import shown
from mdb_protocol.zenoh_bus import ZenohBus

QUERY_S = 2.0
MOST_CELL = 140
"""Characters of a cell: the longest name of a service."""
NOBODY = "nobody"
"""The brain of a bus that only asks which brains there are."""
COLUMNS = ("service", "pid", "up", "msg/s", "queue", "behind", "refused", "dropped", "memory")
BEHIND = "behind"
"""A figure of this name, or that begins with it and a dot, is a number of versions."""


@dataclass(frozen=True)
class Row:
    """A service that is alive: what it says of itself, or why it says nothing."""

    name: str
    status: Status | None
    silent: str = ""

    @property
    def behind(self) -> int:
        """Versions of a memory or model that it lags, of all that it follows the most."""
        values = self.status.values.items() if self.status is not None else ()
        return int(max((v for k, v in values if k.partition(".")[0] == BEHIND and math.isfinite(v)), default=0))

    def plain(self) -> dict[str, Any]:
        """Return what is known as plain values; a number that is not finite is None, for JSON has none such."""
        if self.status is None:
            return {"service": self.name, "answers": False, "reason": self.silent}
        said = _finite(codec.to_plain(self.status))
        return {"service": self.name, "answers": True, "behind": self.behind, **said}

    def cells(self) -> tuple[str, ...]:
        """Return the row of the table."""
        said = self.status
        if said is None:
            return (self.name, *"?" * 8)
        return (
            self.name, str(said.pid), f"{said.uptime_s:.0f} s", f"{said.rate_hz:.1f}", str(said.queued),
            str(self.behind), str(sum(said.refused.values())), str(sum(said.dropped.values())),
            f"{said.memory_bytes / 2**20:.0f} MB" if said.memory_bytes else "?",
        )  # fmt: skip

    def figures(self) -> str:
        """Return a line of its own figures, or why it says nothing."""
        if self.status is None:
            return f"{self.name}: {self.silent}"
        own = [f"{k} {v:.4g}" for k, v in self.status.values.items() if k.partition(".")[0] != BEHIND]
        return f"{self.name}: {', '.join(own)}"

    def counts(self) -> list[str]:
        """Return a line for each key of which something was refused or dropped."""
        if self.status is None:
            return []
        found = (("refused", self.status.refused), ("dropped", self.status.dropped))
        return [f"{self.name} {what} {n} of {key}" for what, by_key in found for key, n in sorted(by_key.items())]


def _finite(plain: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in plain.items():
        bad = isinstance(value, float) and not math.isfinite(value)
        found[name] = _finite(value) if isinstance(value, dict) else None if bad else value
    return found


def rows_of(bus: Bus) -> list[Row]:
    """Ask everyone who is alive; each that is frozen takes `QUERY_S`."""
    return [_ask(bus, name) for name in sorted(bus.alive())]


def _ask(bus: Bus, name: str) -> Row:
    role, _, instance = name.partition("/")
    try:
        answers: list[Status] = bus.query(keys.STATUS, QUERY_S, role=role, instance=instance)
    except QueryError as error:
        return Row(name, None, f"does not answer: {error}")
    return Row(name, answers[0]) if answers else Row(name, None, "alive, but does not answer")


def show_status(
    brain: str | None,
    connect: str,
    credentials: Path | None = None,
    *,
    as_json: bool = False,
    every_s: float | None = None,
) -> int:
    """Print a row for each living service, or a line of JSON a brain; with `every_s` again and again, until
    interrupted.

    Without a brain's name all brains of the router are shown. Return 1 when nobody lives.
    """
    console = console_of(sys.stdout)
    with ExitStack() as opened:
        asked = Asked(connect, credentials, opened)
        if as_json:
            found = _repeat(asked, brain, lambda found: _print_all(found, connect), every_s)
        elif every_s is None:
            found = _repeat(asked, brain, lambda found: console.print(_tables(found, connect)), None)
        else:
            live = opened.enter_context(Live(console=console, auto_refresh=False))
            found = _repeat(asked, brain, lambda found: live.update(_tables(found, connect), refresh=True), every_s)
    return 0 if any(found.values()) else 1


class Asked:
    """Buses to the brains of one router, kept open as long as somebody watches."""

    def __init__(self, connect: str, credentials: Path | None, opened: ExitStack) -> None:
        self._connect, self._credentials, self._opened = connect, credentials, opened
        self._buses: dict[str, ZenohBus] = {}

    def brains(self) -> list[str]:
        """Return the names of all brains that can be seen."""
        if self._credentials is not None:
            return brains_of(self._credentials)
        return self.bus(NOBODY).brains()

    def bus(self, brain: str) -> ZenohBus:
        """Return the bus to a brain."""
        if brain not in self._buses:
            bus = ZenohBus(brain, self._connect, credentials=self._credentials, connect_timeout_s=1.0)
            self._buses[brain] = bus
            self._opened.callback(bus.close)
        return self._buses[brain]


Found = dict[str, list[Row]]
"""The rows of each brain."""


def _repeat(asked: Asked, brain: str | None, show: Callable[[Found], None], every_s: float | None) -> Found:
    while True:
        names = [brain] if brain is not None else asked.brains()
        found = {name: rows_of(asked.bus(name)) for name in names}
        show(found)
        if every_s is None:
            return found
        time.sleep(every_s)


def _print_all(found: Found, connect: str) -> None:
    for brain, rows in found.items():
        _print_json(rows, brain, connect)


def _tables(found: Found, connect: str) -> RenderableType:
    if not found:
        return plain(f"nobody is alive at {connect}")
    return Group(*(_table(rows, f"mdb/{brain} at {connect}") for brain, rows in found.items()))


def _print_json(rows: list[Row], brain: str, connect: str) -> None:
    said = {"brain": brain, "connect": connect, "time_s": time.time(), "services": [row.plain() for row in rows]}
    sys.stdout.write(json.dumps(said, allow_nan=False) + "\n")
    sys.stdout.flush()


def _table(rows: list[Row], where: str) -> RenderableType:
    if not rows:
        return plain(f"nobody is alive in {where}")
    table = Table(title=plain(where), box=None, padding=(0, 1, 0, 0), pad_edge=False)  # fits a terminal of 80 columns
    for column in COLUMNS:
        table.add_column(column, justify="left" if column == "service" else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(plain(shown(cell, MOST_CELL)) for cell in row.cells()))
    below = [row.figures() for row in rows] + [line for row in rows for line in row.counts()]
    return Group(table, *(plain(shown(line)) for line in below))
