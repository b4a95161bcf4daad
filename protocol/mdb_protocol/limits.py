"""How much and how often may be said on a key: the router's limits, made of the key table.

Owns Zenoh's `low_pass_filter` and `downsampling` sections. What is too large or too soon is dropped without a word.
Measured with Zenoh 1.10: both count for each link by itself; of rates the first rule whose keys meet a sample's
counts, of sizes the smallest that includes it; a rate is the time that must have passed since the last sample, so of
two sent together one is dropped, which readers ask for again (see `following`).
"""

from __future__ import annotations

from collections.abc import Iterable

from mdb_protocol.codec import MAX_BYTES
from mdb_protocol.keys import KEYS, ROOT, SMALL
from mdb_protocol.roles import Role, User

KEPT_HZ = 50
"""How often a guest's publisher may say on one key how far it is; ours say it four times a second."""


def sizes() -> list[dict[str, object]]:
    """Return `low_pass_filter`: what a sample or an answer may have by its key, whoever sends it, and a question."""
    limits = {f"{ROOT}/{_any(row.path)}": row.most_bytes for row in KEYS if row.message is not None}
    rules = [_size(key, ["put", "reply"], [key, f"{key}/@adv/**"], most) for key, most in limits.items()]
    everything = [f"{ROOT}/**", f"{ROOT}/**/@adv/**"]
    return [
        *rules,
        _size("anything", ["put", "reply", "delete"], everything, MAX_BYTES),
        _size("questions", ["query"], everything, SMALL),
    ]


def _any(path: str) -> str:
    return "/".join("*" if part.startswith("{") else part for part in ("{brain}", *path.split("/")))


def _size(name: str, messages: list[str], keys: list[str], most: int) -> dict[str, object]:
    return {"id": name, "flows": ["ingress"], "messages": messages, "key_exprs": keys, "size_limit": most}


def rates(users: Iterable[User]) -> list[dict[str, object]]:
    """Return `downsampling`: how often each guest may write on his own keys; the brain's are not slowed down."""
    freq: dict[str, float] = {}
    for user in users:
        for row, key in user.writes_on().items() if user.role is not Role.BRAIN else ():
            if row.guests_write:
                freq |= {key: row.most_hz, f"{key}/@adv/**": KEPT_HZ}
    rules = [{"key_expr": key, "freq": hz} for key, hz in freq.items()]
    return [{"id": "guests", "flows": ["ingress"], "messages": ["put"], "rules": rules}] if rules else []
