"""`mdb status`: who is alive, by the liveliness tokens, and how each does, by its status queryable."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from mdb_protocol import keys
from mdb_protocol.bus import Bus
from mdb_protocol.errors import QueryError
from mdb_protocol.messages import Status
from mdb_protocol.zenoh_bus import ZenohBus

QUERY_S = 2.0


def show_status(brain: str, connect: str, credentials: Path | None = None) -> int:
    """Print a row for each living service; return 1 when nobody lives."""
    console = Console()
    with ZenohBus(brain, connect, credentials=credentials, connect_timeout_s=1.0) as bus:
        alive = sorted(bus.alive())
        table = Table(title=f"mdb/{brain} at {connect}")
        for column in ("service", "pid", "up", "figures", "refused"):
            table.add_column(column, overflow="fold")
        for name in alive:
            table.add_row(*_row(bus, name))
    console.print(table if alive else f"nobody is alive in mdb/{brain} at {connect}")
    return 0 if alive else 1


def _row(bus: Bus, name: str) -> tuple[str, str, str, str, str]:
    role, _, instance = name.partition("/")
    try:
        answers: list[Status] = bus.query(keys.STATUS, QUERY_S, role=role, instance=instance)
    except QueryError as error:
        return name, "?", "?", str(error), ""
    if not answers:
        return name, "?", "?", "alive, but does not answer", ""
    status = answers[0]
    figures = ", ".join(f"{key} {value:.4g}" for key, value in status.values.items())
    refused = ", ".join(f"{key}: {count}" for key, count in status.refused.items())
    return name, str(status.pid), f"{status.uptime_s:.0f} s", figures, refused
