"""What `rmw_zenoh` calls things: keys of topics, liveliness tokens of the graph, attachments of samples. Pure.

Source: ros2/rmw_zenoh, docs/design.md, "Topic and Service name mapping" and "Graph Cache"; `liveliness_utils.cpp`,
`attachment_helpers.cpp` and `qos.cpp` of its versions for Jazzy (from 0.2.4 on), Kilted and Rolling.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

import xxhash

from mdb_sim.body import BodyError

PUBLISHER, SUBSCRIPTION, NODE = "MP", "MS", "NN"
"""Kinds of entities."""
RELIABLE = "::,10:,:,:,,"
"""A quality of service in a token: what differs from reliable, volatile, keep last 42. Here: keep last 10, ..."""
SENSOR_DATA = "2::,5:,:,:,,"
"""... and best effort (2), keep last 5: ROS 2's for sensors."""
NO_HASH = "TypeHashNotSupported"
"""In the place of a type's hash in Humble, which has none."""
GRAPH = "@ros2_lv"
_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
"""A fully qualified name (design.ros2.org, "Topic and Service name mapping to DDS")."""
_PARTS = 13
"""Of the token of a publisher or subscription."""


@dataclass(frozen=True, slots=True)
class Type:
    """A message type: `package/msg/Name` and its hash of REP 2016, `RIHS01_` and 64 digits."""

    name: str
    hash: str

    @property
    def dds(self) -> str:
        """Its name in keys."""
        package, _, name = self.name.split("/")
        return f"{package}::msg::dds_::{name}_"


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic by its fully qualified name, with its type."""

    name: str
    type: Type

    def key(self, domain: int) -> str:
        """Return the key of its data."""
        return f"{domain}/{self.name.strip('/')}/{self.type.dds}/{self.type.hash}"


@dataclass(frozen=True, slots=True)
class Node:
    """A node in the graph; `session`: the Zenoh session's identity in hexadecimal digits."""

    domain: int
    session: str
    namespace: str
    name: str
    number: int = 0

    def token(self) -> str:
        """Return the token that says that it is there."""
        return f"{self._begins(self.number, NODE)}/%/{mangled(self.namespace)}/{self.name}"

    def endpoint_token(self, number: int, kind: str, topic: Topic, qos: str) -> str:
        """Return the token of one of its publishers or subscriptions."""
        begins = f"{self._begins(number, kind)}/%/{mangled(self.namespace)}/{self.name}"
        return f"{begins}/{mangled(topic.name)}/{topic.type.dds}/{topic.type.hash}/{qos}"

    def _begins(self, number: int, kind: str) -> str:
        return f"{GRAPH}/{self.domain}/{self.session}/{self.number}/{number}/{kind}"


@dataclass(frozen=True, slots=True)
class Endpoint:
    """What a token of somebody else says."""

    kind: str
    node: str
    topic: str
    type: str
    hash: str


def endpoint_of(token: str) -> Endpoint | None:
    """Return what a token says of a publisher or subscription; None: it is none, or not understood."""
    parts = token.split("/")
    if len(parts) < _PARTS or parts[0] != GRAPH or parts[5] not in (PUBLISHER, SUBSCRIPTION):
        return None
    topic = parts[9].replace("%", "/")
    return Endpoint(parts[5], parts[8], topic if topic.startswith("/") else f"/{topic}", parts[10], parts[11])


def endpoints_key(domain: int) -> str:
    """Return the key under which all tokens of a domain are."""
    return f"{GRAPH}/{domain}/**"


def mangled(name: str) -> str:
    """Return a name as it is in a token; `%` is the empty namespace."""
    return name.replace("/", "%") or "%"


def resolved(name: str, namespace: str) -> str:
    """Return the fully qualified name of a topic; BodyError when it can be none."""
    whole = name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"
    if not _NAME.fullmatch(whole):
        raise BodyError(f"topic {name!r} in namespace {namespace!r} is {whole!r}; expected letters, digits, _ and /")
    return whole


def gid_of(token: str) -> bytes:
    """Return the 16 bytes by which an endpoint is known: XXH3 of its token, the lower half first."""
    return xxhash.xxh3_128_digest(token.encode())[::-1]


def attachment(sequence: int, stamp_ns: int, gid: bytes) -> bytes:
    """Return what goes with each sample: its number from 1 on, the time in ns since 1970, whose it is. 33 bytes."""
    return struct.pack("<qqB16s", sequence, stamp_ns, len(gid), gid)
