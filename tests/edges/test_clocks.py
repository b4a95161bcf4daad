"""TLS with one clock wrong: the true cause is said, on whichever side it is."""

from __future__ import annotations

import datetime as time
import re
from pathlib import Path

import pytest

from mdb_deploy.keys import credentials
from mdb_deploy.keys.credentials import KeyFolder
from mdb_deploy.supervision.processes import ROUTER_CONFIG
from mdb_protocol.errors import BusError
from mdb_protocol.roles import Role
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_protocol.zenoh_sessions import Router

LISTEN = "tls/127.0.0.1:0"
BRAIN = "pioneer"


def clock(days: int) -> type[time.datetime]:
    """Return a clock of the machine on which certificates are made, which is wrong by so many days."""

    class Wrong(time.datetime):
        @classmethod
        def now(cls, tz: time.tzinfo | None = None) -> Wrong:
            return cls.fromtimestamp((time.datetime.now(time.UTC) + time.timedelta(days=days)).timestamp(), tz)

    return Wrong


@pytest.fixture
def folder(tmp_path: Path) -> KeyFolder:
    return KeyFolder.create(tmp_path / "keys", BRAIN, ["127.0.0.1"])


def refusal(folder: KeyFolder, bundle: Path) -> str:
    """Return what somebody is told who cannot join."""
    router = Router(ROUTER_CONFIG, LISTEN, keys=folder.router_keys(LISTEN))
    try:
        with pytest.raises(BusError) as told:
            ZenohBus(BRAIN, router.endpoint(), credentials=bundle, connect_timeout_s=2.0)
    finally:
        router.close()
    return str(told.value)


@pytest.fixture
def bundle(folder: KeyFolder) -> Path:
    return folder.add(Role.TEACHER, "anna", BRAIN)


@pytest.mark.edge("the true cause", "TLS: the router's certificate begins later, by this machine's clock")
def test_this_machine_s_clock_is_behind(folder: KeyFolder, bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(credentials, "datetime", clock(30))
    folder.renew([])
    said = refusal(folder, bundle)
    assert "the router's certificate is not valid yet: this machine's clock says 20" in said
    assert "keys were made anew" not in said


@pytest.mark.edge("the true cause", "TLS: the router's certificate has ended, by this machine's clock")
def test_this_machine_s_clock_is_ahead(folder: KeyFolder, bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(credentials, "datetime", clock(-credentials.CERTIFICATE_DAYS - 2))
    folder.renew([])
    said = refusal(folder, bundle)
    assert re.search(r"has expired: this machine's clock says .* UTC, and if that is right 'mdb keys renew'", said)


@pytest.mark.edge("the true cause", "TLS: a teacher's valid certificate begins later, by the router's clock")
def test_the_router_s_clock_is_behind(folder: KeyFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(credentials, "datetime", clock(30))
    said = refusal(folder, folder.add(Role.TEACHER, "bert", BRAIN))
    assert "by the router's clock the certificate is not valid now; this machine's clock says 20" in said
    assert "has expired" not in said
