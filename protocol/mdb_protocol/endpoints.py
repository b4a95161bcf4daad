"""Zenoh's endpoints, `protocol/host:port`: taking them apart, and who can reach them.

Owns the rule that a router is open to this machine only, unless it has keys or somebody said otherwise.
"""

from __future__ import annotations

import ipaddress
import socket
from typing import NamedTuple

from mdb_protocol.errors import BusError

ENCRYPTED = ("tls", "quic")
WITHIN = ("unixsock-stream", "unixpipe")
"""Protocols that never leave the machine."""
EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}
"""Addresses that stand for all of this machine's, and the loopback address among them."""


class Endpoint(NamedTuple):
    """A part of the network: protocol, host (IPv6 without brackets), port."""

    protocol: str
    host: str
    port: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.protocol}/{host}:{self.port}"

    @property
    def encrypted(self) -> bool:
        """Whether both ends show certificates."""
        return self.protocol in ENCRYPTED

    def is_loopback(self) -> bool:
        """Whether only this machine reaches it; a name that cannot be resolved counts as beyond."""
        try:
            found = [ipaddress.ip_address(self.host)]
        except ValueError:
            found = _resolve(self.host)
        return bool(found) and all(address.is_loopback for address in found)

    def for_this_machine(self) -> Endpoint:
        """Return where a client on this machine connects: a listener on all addresses is reached on loopback."""
        return self._replace(host=EVERYWHERE.get(self.host, self.host))


def _resolve(host: str) -> list[ipaddress.IPv4Address | ipaddress.IPv6Address]:
    try:
        infos = socket.getaddrinfo(host, None)
    except OSError:
        return []
    return [ipaddress.ip_address(str(address[0]).partition("%")[0]) for *_, address in infos]


def parse(text: str) -> Endpoint:
    """Take an endpoint apart; BusError when it is not `protocol/host:port`."""
    protocol, slash, rest = text.partition("/")
    address = rest.partition("?")[0].partition("#")[0]
    host, colon, port = address.rpartition(":")
    bare = host.removeprefix("[").removesuffix("]")
    if not (slash and colon and bare and port.isdigit()):
        raise BusError(f"{text!r} is not an endpoint; expected PROTOCOL/HOST:PORT, as in tcp/127.0.0.1:7447")
    return Endpoint(protocol, bare, int(port))


def with_port_of(listen: str, found: str) -> str:
    """Return where a router listens again, after it asked for any free port and got that of `found`."""
    return str(parse(listen)._replace(port=parse(found).port)) if listen.endswith(":0") else listen


def check_listen(text: str, *, has_keys: bool, open_to_everyone: bool) -> None:
    """Raise BusError when a router listening there would let in people whom nobody has asked for."""
    if text.partition("/")[0] in WITHIN:
        return
    endpoint = parse(text)
    if has_keys and not endpoint.encrypted:
        raise BusError(f"with keys a router listens on tls/ or quic/, not on {text}: --listen {_encrypted(endpoint)}")
    if not has_keys and endpoint.encrypted:
        raise BusError(f"{text} needs keys: 'mdb keys init', then --keys keys")
    if not has_keys and not open_to_everyone and not endpoint.is_loopback():
        raise BusError(
            f"{text} can be reached from beyond this machine, and without keys everyone there may command the robot. "
            f"Make keys ('mdb keys init') and give --listen {_encrypted(endpoint)} --keys keys; or, if that is what "
            "you want, --open-to-everyone"
        )


def _encrypted(endpoint: Endpoint) -> Endpoint:
    return endpoint._replace(protocol="tls")
