"""How much and how often may be said on a key: the router's limits, made of the key table.

Owns Zenoh's `low_pass_filter`, `downsampling` and `qos` sections. What is too large or too soon is dropped without a
word. Measured with Zenoh 1.10: both count for each link by itself; of rates the first rule whose keys meet a sample's
counts, of sizes the smallest that includes it; a rate is the time that must have passed since the last sample, so of
two sent together one is dropped, which readers ask for again (see `following`).
"""

from __future__ import annotations

from collections.abc import Iterable

from mdb_protocol.codec import MAX_BYTES
from mdb_protocol.keys import KEYS, ROOT, SMALL, Key
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
    rules: list[dict[str, object]] = []
    for key, row in _guests(users).items():
        rules += [{"key_expr": key, "freq": row.most_hz}, {"key_expr": f"{key}/@adv/**", "freq": KEPT_HZ}]
    return [{"id": "guests", "flows": ["ingress"], "messages": ["put"], "rules": rules}] if rules else []


def priorities(users: Iterable[User]) -> list[dict[str, object]]:
    """Return `qos/network`: what guests write comes after what the brain says, and no reader is waited for with it.

    Whatever they ask for: who is to be waited for, and is too slow, is disconnected by Zenoh.
    """
    guests = [expression for key in _guests(users) for expression in (key, f"{key}/@adv/**")]
    after = {"priority": "data", "congestion_control": "drop"}
    rule: dict[str, object] = {
        "id": "guests",
        "flows": ["ingress"],
        "messages": ["put"],
        "key_exprs": guests,
        "overwrite": after,
    }
    return [rule] if guests else []


def _guests(users: Iterable[User]) -> dict[str, Key]:
    """Return the keys that guests may write, with their rows."""
    guests = (user for user in users if user.role is not Role.BRAIN)
    return {key: row for user in guests for row, key in user.writes_on().items() if row.guests_write}
