"""Zenoh's endpoints, `protocol/host:port`: taking them apart, and who can reach them.

Owns the rule that a router is open to this machine only, unless it has keys or somebody said otherwise.
"""

from __future__ import annotations

import difflib
import ipaddress
import re
import socket
from typing import NamedTuple

from mdb_protocol.errors import BusError

PROTOCOLS = ("tcp", "tls", "udp", "quic", "ws")
"""Those of an address with a port."""
PORT, PORTS = 7447, 65536
"""The usual port; how many there are."""
USUAL = f"tcp/127.0.0.1:{PORT}"
UNUSABLE = re.compile(r"[\s/\[\]@]")
"""What no host has."""
HOST = re.compile(r"[0-9]+(\.[0-9]+){3}|[0-9a-fA-F]*:[0-9a-fA-F:.%]*:[^:]*|(?!\d+$)\w[^:\\]*")
"""What a host that is guessed looks like: IPv4, IPv6, a name."""
SEPARATOR = re.compile(r"^([a-zA-Z]+)(?::/*|\\)(?!\d*$)")
"""What others write between protocol and host."""
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
    except (OSError, ValueError):  # not known; no name that can be (IDNA)
        return []
    return [ipaddress.ip_address(str(address[0]).partition("%")[0]) for *_, address in infos]


def parse(text: str) -> Endpoint:
    """Take an endpoint apart; BusError when it is not `protocol/host:port`, with what may have been meant."""
    found = _parsed(text)
    if found is None:
        meant = _meant(text)
        guess = f"; did you mean {meant}?" if meant else ""
        raise BusError(f"{text!r} is not an endpoint; expected PROTOCOL/HOST:PORT, as in {USUAL}{guess}")
    return found


def within(text: str) -> bool:
    """Whether an endpoint is a file of this machine, without host and port."""
    protocol, _, path = text.partition("/")
    return protocol in WITHIN and bool(path)


def check(text: str, *, listens: bool = False) -> None:
    """Raise BusError when a text is no endpoint to connect to, or to listen on: nothing waits for what cannot be."""
    if not within(text) and parse(text).port == 0 and not listens:
        raise BusError(f"{text}: port 0, any free one, is for --listen; a run's router.endpoint says which it got")


def _parsed(text: str) -> Endpoint | None:
    protocol, _, rest = text.partition("/")
    address = rest.partition("?")[0].partition("#")[0]
    host, _, port = address.rpartition(":")
    bare = host.removeprefix("[").removesuffix("]")
    bracketed = host == f"[{bare}]" or ":" not in bare
    if protocol not in PROTOCOLS or not bare or not bracketed or UNUSABLE.search(bare):
        return None
    number = int(port) if port.isascii() and port.isdigit() and len(port) <= 5 else PORTS
    return Endpoint(protocol, bare, number) if number < PORTS else None


def _meant(text: str) -> Endpoint | None:
    """Return the endpoint that somebody may have meant who wrote an URL, no protocol, or no port."""
    protocol, separator, address = SEPARATOR.sub(r"\1/", text.strip().rstrip("/"), count=1).partition("/")
    if not separator:
        protocol, address = "tcp", protocol
    protocol = next(iter(difflib.get_close_matches(protocol.lower(), PROTOCOLS, 1)), "tcp")
    host, colon, port = address.rpartition(":")
    address = host if colon and "]" not in port and ":" not in host and not port.isdigit() else address
    for whole in (address, f"{address}:{PORT}", f"[{address}]:{PORT}", f"127.0.0.1:{address.removeprefix(':')}"):
        found = _parsed(f"{protocol}/{whole}")
        if found is not None and HOST.fullmatch(found.host):
            return found
    return None


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
