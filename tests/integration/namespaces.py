"""Two network namespaces with a cable between them that can be cut: what is sent is then lost without a word."""

from __future__ import annotations

import os
import shutil
import subprocess
from types import TracebackType
from typing import Self

HERE, THERE = "10.213.77.1", "10.213.77.2"
NOWHERE = "02:00:00:00:00:99"
"""A hardware address that nobody has."""


def why_not() -> str | None:
    """Return why there can be no namespaces here, or None."""
    if os.geteuid() != 0 or shutil.which("ip") is None:
        return "network namespaces need root and iproute2's `ip`"
    probe = f"mdb-probe-{os.getpid()}"
    made = _ip("netns", "add", probe, check=False)
    if made.returncode:
        return f"no network namespaces here: {made.stderr.strip()}"
    pair = _ip("-n", probe, "link", "add", "mdb0", "type", "veth", "peer", "name", "mdb1", check=False)
    _ip("netns", "del", probe, check=False)
    return f"no veth here: {pair.stderr.strip()}" if pair.returncode else None


def _ip(*words: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["ip", *words], capture_output=True, text=True, check=check)


class Namespaces:
    """`here` has the address HERE, `there` the address THERE; nothing leads out of either."""

    def __init__(self) -> None:
        self.here, self.there = f"mdb-here-{os.getpid()}", f"mdb-there-{os.getpid()}"

    def __enter__(self) -> Self:
        for name in (self.here, self.there):
            _ip("netns", "add", name)
        _ip("-n", self.here, "link", "add", "cable", "type", "veth", "peer", "name", "cable", "netns", self.there)
        for name, address in ((self.here, HERE), (self.there, THERE)):
            _ip("-n", name, "addr", "add", f"{address}/30", "dev", "cable")
            _ip("-n", name, "link", "set", "lo", "up")
            _ip("-n", name, "link", "set", "cable", "up")
        return self

    def cut(self) -> None:
        """From now on all that one sends to the other is lost; neither is told."""
        for name, other in ((self.here, THERE), (self.there, HERE)):
            _ip("-n", name, "neigh", "replace", other, "lladdr", NOWHERE, "dev", "cable", "nud", "permanent")

    def mend(self) -> None:
        """Undo `cut`."""
        for name, other in ((self.here, THERE), (self.there, HERE)):
            _ip("-n", name, "neigh", "del", other, "dev", "cable")

    @staticmethod
    def inside(name: str) -> list[str]:
        """Return the words before a command that runs it in a namespace."""
        return ["ip", "netns", "exec", name]

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        for name in (self.here, self.there):
            _ip("netns", "del", name, check=False)
