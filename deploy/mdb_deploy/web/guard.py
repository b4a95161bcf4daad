"""Who may see the page and do what: hosts, origins, the tokens in links, and what a page of ours may load.

Without keys the page is for this machine alone, and whoever is at it may do everything. With keys each role has a
link of its own, with a secret in it that the browser keeps as a cookie. Pure but for the file of the secrets.
"""

from __future__ import annotations

import base64
import hmac
import json
import re
import secrets
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from pathlib import Path
from typing import NamedTuple

from mdb_protocol import files
from mdb_protocol.endpoints import EVERYWHERE
from mdb_protocol.errors import ConfigError, DamageError
from mdb_protocol.words import shown
from mdb_services.shell.whole_file import write_whole

LOOPBACK = ("localhost", "127.0.0.1", "::1")
"""Names of this machine for itself, which are always ours."""
HOST = re.compile(r"(?:\[(?P<six>[0-9A-Fa-f:.]+)\]|(?P<name>[A-Za-z0-9._-]+))(?::\d{1,5})?")
"""A host as a browser says it, perhaps with its port."""
TOKENS_FILE = "web.tokens"
ROLES = ("viewer", "teacher", "operator")
TOKEN_BYTES = 24
MOST_BYTES = 4096
"""Of the file with the tokens."""


class Rights(NamedTuple):
    """What a visitor may do besides watching."""

    teach: bool
    operate: bool


EVERYTHING = Rights(teach=True, operate=True)
OF_ROLE = {"viewer": Rights(False, False), "teacher": Rights(True, False), "operator": EVERYTHING}
TO = {
    OF_ROLE["viewer"]: "to watch",
    OF_ROLE["teacher"]: "to watch and teach",
    Rights(teach=False, operate=True): "to watch and operate",
    EVERYTHING: "to do everything",
}
"""What a link is for."""


class RefusedError(Exception):
    """A request that is not answered; the text says why, and what would be."""


class Site(NamedTuple):
    """Where the page is served."""

    host: str
    port: int
    encrypted: bool = False

    @property
    def scheme(self) -> str:
        """The scheme of its address."""
        return "https" if self.encrypted else "http"

    def address(self, host: str | None = None) -> str:
        """Return the page's address, as others reach this machine by `host`."""
        named = host or ("127.0.0.1" if self.host in (*EVERYWHERE, "") else self.host)
        return f"{self.scheme}://{f'[{named}]' if ':' in named else named}:{self.port}/"


@dataclass(frozen=True)
class Guard:
    """See the module's docstring."""

    site: Site
    hosts: frozenset[str]
    """By which names the page may be asked for."""
    tokens: dict[str, str] | None = None
    """The secret in each role's link; None: everyone who can open the page may do everything."""
    known_as: str | None = None
    """The host in the links, where it is another than the one that is listened at."""
    of_role: Mapping[str, Rights] = field(default_factory=lambda: OF_ROLE)
    """What the holder of each role's link may do."""

    @property
    def cookie(self) -> str:
        """The cookie's name; cookies do not tell ports apart, so it does."""
        return f"mdb-{self.site.port}"

    def check_host(self, host: str | None) -> str:
        """Return the host and port that were asked for; RefusedError when a page of another name leads here."""
        found = HOST.fullmatch(host or "")
        if host is None or found is None or (found["six"] or found["name"]).lower() not in self.hosts:
            asked = shown(host, 100) if host else "a host without a name"
            raise RefusedError(f"this page is not served as {asked}; open {self.site.address()}")
        return host

    def check_origin(self, origin: str | None, host: str) -> None:
        """Raise RefusedError when a page of another site asks; programs say no origin."""
        if origin is not None and origin.lower() not in (f"http://{host.lower()}", f"https://{host.lower()}"):
            raise RefusedError(f"a page of {shown(origin, 100)} may not use this console; open {self.site.address()}")

    def rights(self, token: str | None, cookie: str | None) -> Rights:
        """Return what the holder of a link's token, or of the cookie, may do; RefusedError when it is none."""
        if self.tokens is None:
            return EVERYTHING
        for said in (token, self._in_cookie(cookie)):
            if said is not None and (role := self.role_of(said)) is not None:
                return self.of_role[role]
        raise RefusedError(
            "this console is for those who have a link to it: ask who started it for a link, "
            "which ends with ?token= and letters; links of an earlier key folder are not valid any more"
        )

    def role_of(self, token: str) -> str | None:
        """Return whose token it is, in a time that does not depend on how much of it is right."""
        found = None
        for role, right in (self.tokens or {}).items():
            if hmac.compare_digest(right.encode(), token.encode(errors="replace")):
                found = role
        return found

    def _in_cookie(self, header: str | None) -> str | None:
        try:
            found = SimpleCookie(header or "").get(self.cookie)
        except CookieError:
            found = None
        return None if found is None else found.value

    def links(self) -> dict[str, str]:
        """Return the link of each role; without tokens the operator's is for everyone."""
        address = self.site.address(self.known_as)
        if self.tokens is None:
            return {"operator": address}
        return {role: f"{address}?token={token}" for role, token in self.tokens.items()}

    def lines(self) -> list[str]:
        """Return what is said of the page to who has started it."""
        if self.tokens is None:
            return [f"page: {link}" for link in self.links().values()]
        return [f"page {TO[self.of_role[role]]}: {link}" for role, link in self.links().items()]

    def headers(self, host: str) -> dict[str, str]:
        """Return what each answer says of what a page of ours may load: from here, and from nowhere else."""
        policy = (
            "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'none'; "
            f"frame-ancestors 'none'; connect-src 'self' ws://{host} wss://{host}"
        )
        return {
            "Content-Security-Policy": policy,
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Permissions-Policy": "microphone=(self), camera=(), geolocation=()",
        }


def tokens_in(folder: Path) -> dict[str, str]:
    """Return the tokens that a folder keeps, for its owner's eyes only; they are made if there are none.

    Raises ConfigError when the file is there and is not ours.
    """
    path = folder / TOKENS_FILE
    if not path.exists():
        made = {role: secrets.token_urlsafe(TOKEN_BYTES) for role in ROLES}
        write_whole(path, json.dumps(made, indent=1).encode() + b"\n", private=True)
        return made
    try:
        found = json.loads(files.content(path, MOST_BYTES))
    except (ValueError, DamageError) as error:
        found = error
    if not (isinstance(found, dict) and set(found) == set(ROLES) and all(_is_token(t) for t in found.values())):
        raise ConfigError(f"{path} does not hold the links' tokens; remove it, and new ones are made")
    return found


def tokens_of(secret: bytes, roles: Iterable[str]) -> dict[str, str]:
    """Return the tokens that follow from a secret: the same ones in each process that has it."""
    found = {role: hmac.digest(secret, f"mdb page {role}".encode(), "sha256") for role in roles}
    return {role: base64.urlsafe_b64encode(digest[:TOKEN_BYTES]).decode() for role, digest in found.items()}


def _is_token(found: object) -> bool:
    return isinstance(found, str) and len(found) >= TOKEN_BYTES
