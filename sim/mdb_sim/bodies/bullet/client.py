"""A physics client of PyBullet's without a window, which has 35 MB; 20 of them are zeros that it may never use.

Those go back to the system, but only while the process has one thread. So who is to have threads gets a client ready
before.
"""

from __future__ import annotations

import sys

import pybullet

from mdb_services.shell.pages import let_go_of_zeros

_ready: list[int] = []


def get_ready() -> None:
    """Make the client that the next `connect` gives, now."""
    if not _ready:
        _ready.append(_connected())


def connect() -> int:
    """Return a client, below 0 when there is none to be had."""
    return _ready.pop() if _ready else _connected()


def _connected() -> int:
    client: int = pybullet.connect(pybullet.DIRECT)
    if sys.platform == "linux":
        let_go_of_zeros()
    return client
