"""`mdb status`: a row for each living service, in words for people and in JSON for scripts."""

import io
import json
import math
from typing import Any

import pytest
from rich.console import Console

from mdb_deploy.running import status
from mdb_deploy.running.status import Row, rows_of
from mdb_protocol import keys
from mdb_protocol.memory_bus import Fabric, MemoryBus
from mdb_protocol.messages import Status

BRAIN = "test"


def said(**fields: Any) -> Status:
    plain = {
        "role": "evolver", "instance": "object", "pid": 7, "uptime_s": 61.2, "values": {"behind": 3.0, "error": 0.5},
        "refused": {"pair": 2, "action": 1}, "dropped": {"pair": 4}, "rate_hz": 12.34, "queued": 5,
        "memory_bytes": 64 * 2**20,
    }  # fmt: skip
    return Status(**(plain | fields))


@pytest.fixture
def fabric() -> Fabric:
    return Fabric()


def service(fabric: Fabric, answer: Status | None, name: str = "evolver/object") -> None:
    bus = MemoryBus(fabric, BRAIN)
    role, _, instance = name.partition("/")
    bus.queryable(keys.STATUS, lambda: answer, role=role, instance=instance)
    bus.token(role, instance)


def printed(rows: list[Row], width: int = 80) -> str:
    console = Console(file=io.StringIO(), width=width)
    console.print(status._table(rows, f"mdb/{BRAIN}"))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_who_lives_has_a_row_whether_he_answers_or_not(fabric: Fabric) -> None:
    service(fabric, said())
    service(fabric, None, "robot/body")
    rows = rows_of(MemoryBus(fabric, BRAIN))
    assert [(row.name, row.status is not None) for row in rows] == [("evolver/object", True), ("robot/body", False)]
    assert rows[1].plain() == {"service": "robot/body", "answers": False, "reason": "alive, but does not answer"}


def test_the_table_fits_a_terminal_and_names_the_keys_of_what_was_refused(fabric: Fabric) -> None:
    service(fabric, said())
    text = printed(rows_of(MemoryBus(fabric, BRAIN)))
    head, row = next(
        (text.splitlines()[i : i + 2] for i, line in enumerate(text.splitlines()) if "msg/s" in line), ""
    )
    assert head.split() == list(status.COLUMNS)
    assert row.split() == ["evolver/object", "7", "61", "s", "12.3", "5", "3", "3", "4", "64", "MB"]
    assert max(map(len, text.splitlines())) <= 80
    for words in ("evolver/object refused 2 of pair", "refused 1 of action", "dropped 4 of pair", "error 0.5"):
        assert words in text


def test_json_has_all_of_it_and_no_number_that_json_lacks(fabric: Fabric, capsys: pytest.CaptureFixture[str]) -> None:
    service(fabric, said(rate_hz=math.nan, values={"behind.a": 1.0, "behind.b": 4.0, "error": math.inf}))
    status._print_json(rows_of(MemoryBus(fabric, BRAIN)), BRAIN, "here")
    (row,) = json.loads(capsys.readouterr().out)["services"]
    assert (row["service"], row["pid"], row["behind"], row["queued"]) == ("evolver/object", 7, 4, 5)
    assert (row["rate_hz"], row["values"]["error"]) == (None, None)
    assert row["refused"] == {"pair": 2, "action": 1}
    assert row["memory_bytes"] == 64 * 2**20


def test_nobody_is_said() -> None:
    assert "nobody is alive in mdb/test" in printed([])
