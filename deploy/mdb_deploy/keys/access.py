"""The router's access-control file: who is admitted, and by the key table what each may write and read.

Owns the translation of roles into Zenoh's rules. Everything that is not allowed is denied, without a word to the one
who is denied. Measured with Zenoh 1.10: `**` does not reach into `@adv`, where publishers keep what late joiners get;
a writer needs to hear of the subscriptions that include its key, or it sends nothing.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from mdb_protocol.errors import ConfigError
from mdb_protocol.keys import Delivery
from mdb_protocol.roles import Role, User

ACCESS_FILE = "access.json5"
SAY = ("put", "reply", "declare_queryable", "liveliness_token")
"""Messages of one who gives: into the router from a writer, out of it to a reader."""
ANSWER = ("reply", "declare_queryable")
KEEP = ("put", *ANSWER)
"""What a guest says where his publisher keeps what was said: its heartbeats, and answers to who missed something."""
GUEST_SAYS = {Delivery.QUERY: ANSWER, Delivery.TOKEN: ("liveliness_token",)}
"""What a guest says on keys that are not for samples."""
SAMPLES = ("put", "reply")
"""What he says on the others: an answer to who missed something lies on the sample's own key."""
ASK = ("declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query")
"""Messages of one who wants: into the router from a reader, out of it to a writer."""
COMMENT = """\
// Who may join this router and what each may do; made by `mdb keys`, which writes it anew at every change.
// A subject is a user, its common name that of the certificate in his bundle.
"""


def access_control(users: Mapping[str, User]) -> dict[str, object]:
    """Return Zenoh's `access_control` section for users by the common names of their certificates."""
    rules: list[object] = []
    subjects, policies = [], []
    for common_name, user in users.items():
        own = _rules(user)
        rules += own
        subjects.append({"id": _id(user), "cert_common_names": [common_name]})
        policies.append({"rules": [rule["id"] for rule in own], "subjects": [_id(user)]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _id(user: User) -> str:
    return f"{user.brain}/{user.role.value}/{user.name}"


def _rules(user: User) -> list[dict[str, Any]]:
    everything = _with_past([user.everything()])
    reads = _with_past(user.reads())
    return [
        *_writes(user),
        _rule(user, "is asked", "egress", ASK, everything),
        _rule(user, "reads", "ingress", ASK, reads),
        _rule(user, "is told", "egress", SAY, reads),
    ]


def _writes(user: User) -> list[dict[str, Any]]:
    """Let the brain say all, a guest on each of his keys what belongs there."""
    if user.role is Role.BRAIN:
        return [_rule(user, "writes", "ingress", SAY, _with_past(user.writes()))]
    rules = []
    for row, key in user.writes_on().items():
        says = GUEST_SAYS.get(row.delivery)
        rules.append(_rule(user, f"writes {row.path}", "ingress", says or SAMPLES, [key]))
        if says is None:
            rules.append(_rule(user, f"keeps {row.path}", "ingress", KEEP, [f"{key}/@adv/**"]))
    return rules


def _with_past(keys: Iterable[str]) -> list[str]:
    return [expression for key in keys for expression in (key, f"{key}/@adv/**")]


def _rule(user: User, what: str, flow: str, messages: Iterable[str], keys: list[str]) -> dict[str, Any]:
    return {
        "id": f"{_id(user)} {what}",
        "permission": "allow",
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": keys,
    }


def text(users: Mapping[str, User]) -> str:
    """Return the whole file."""
    return COMMENT + json.dumps({"access_control": access_control(users)}, indent=1) + "\n"


def read(path: Path) -> dict[str, Any]:
    """Return the `access_control` section of a file; ConfigError when it cannot be used."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
        section = json.loads("\n".join(line for line in lines if not line.lstrip().startswith("//")))[
            "access_control"
        ]
        users(section)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{path} is not a usable access-control file ({error}); 'mdb keys init' makes one"
        ) from error
    return dict(section)


def users(section: Mapping[str, Any]) -> dict[str, User]:
    """Return who is admitted by an `access_control` section, by the common names of the certificates."""
    found = {}
    for subject in section["subjects"]:
        brain, role, name = subject["id"].split("/")
        found[subject["cert_common_names"][0]] = User(brain, Role(role), name)
    return found
