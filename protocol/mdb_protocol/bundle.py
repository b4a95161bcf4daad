"""A bundle: the one file a user carries, with his private key, his certificate and the authority that he trusts.

Owns its format (PEM, after a few lines in plain words that say whose it is) and why a router refuses it. Makes no
keys: `mdb keys` does. What the plain lines say only serves early, clear errors; what counts is the certificate.
"""

from __future__ import annotations

import base64
import codecs
import re
import socket
import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mdb_protocol import files
from mdb_protocol.endpoints import ENCRYPTED, Endpoint
from mdb_protocol.errors import BusError, DamageError
from mdb_protocol.roles import Role, User

BLOCK = re.compile(rb"-----BEGIN ([A-Z ]+)-----\n.*?-----END \1-----\n?", re.DOTALL)
SAYS = re.compile(r"^(\w+): (.+)$", re.MULTILINE)
NOT_YET_VALID, EXPIRED = 9, 10
"""OpenSSL's X509_V_ERR_CERT_NOT_YET_VALID and X509_V_ERR_CERT_HAS_EXPIRED."""
MOST_BYTES = 32 * 2**10
"""Of a bundle; those of `mdb keys` have 2 kB."""
PROBE_S = 1.0
"""Bound on each step of asking a router why."""
MAKE_NEW = "ask for a new one: 'mdb keys remove NAME', then 'mdb keys add-teacher NAME' or 'add-viewer NAME'"


@dataclass(frozen=True)
class Bundle:
    """Parts of a bundle, PEM bytes; `user` and `until` as its plain lines say (None: they do not)."""

    path: Path
    key: bytes
    certificate: bytes
    authority: bytes
    user: User | None = None
    until: datetime | None = None

    @classmethod
    def read(cls, path: Path) -> Bundle:
        """Read a bundle file; BusError when it is not one."""
        try:
            content = files.content(path, MOST_BYTES).removeprefix(codecs.BOM_UTF8).replace(b"\r\n", b"\n")
        except OSError as error:
            raise BusError(f"cannot read the keys {path}: {error.strerror}; 'mdb keys init' makes some") from error
        except DamageError as error:
            raise BusError(f"{error}: a bundle of 'mdb keys'") from error
        blocks = [(found.group(1), found.group(0)) for found in BLOCK.finditer(content)]
        keys = [pem for kind, pem in blocks if kind.endswith(b"PRIVATE KEY")]
        certificates = [pem for kind, pem in blocks if kind == b"CERTIFICATE"]
        if len(keys) != 1 or len(certificates) != 2:
            raise BusError(
                f"{path} holds {len(keys)} private keys and {len(certificates)} certificates; expected a bundle of "
                "'mdb keys': a private key, its certificate, the authority's certificate"
            )
        said = dict(SAYS.findall(content.partition(b"-----BEGIN")[0].decode(errors="replace")))
        return cls(path, keys[0], certificates[0], certificates[1], _user(said), _until(said))

    @classmethod
    def find(cls, path: Path, brain: str) -> Bundle:
        """Read a bundle, or from a key folder the brain's own; BusError when there is none that is still valid."""
        bundle = cls.read(path / "brains" / f"{brain}.pem" if path.is_dir() else path)
        if bundle.user is not None:
            bundle.user.check_brain(brain)
        if bundle.until is not None and bundle.until < datetime.now(UTC):
            raise BusError(
                f"the certificate in {bundle.path} ended on {bundle.until:%Y-%m-%d}; {_clock()}, and if that is "
                f"right {MAKE_NEW}"
            )
        return bundle

    @classmethod
    def shown_to(cls, connect: str, path: Path | None, brain: str) -> Bundle | None:
        """Return what is shown to a router, None without keys; BusError when it wants some, or takes none."""
        encrypted = connect.partition("/")[0] in ENCRYPTED
        if path is None and encrypted:
            raise BusError(f"the router at {connect} lets in only who has keys: give your bundle with --keys FILE")
        if path is not None and not encrypted:
            raise BusError(f"with keys the router is at tls/HOST:PORT or quic/HOST:PORT, not at {connect}")
        return None if path is None else cls.find(path, brain)

    def client_tls(self) -> dict[str, object]:
        """Return Zenoh's `transport/link/tls` for a client that shows this bundle."""
        return self._tls("connect") | {"verify_name_on_connect": True}

    def router_tls(self) -> dict[str, object]:
        """Return Zenoh's `transport/link/tls` for a router that shows this bundle, and wants clients to show one."""
        return self._tls("listen")

    def _tls(self, side: str) -> dict[str, object]:
        parts = {
            "root_ca_certificate_base64": self.authority,
            f"{side}_private_key_base64": self.key,
            f"{side}_certificate_base64": self.certificate,
        }
        texts = {name: base64.b64encode(pem).decode() for name, pem in parts.items()}
        return {**texts, "enable_mtls": True, "close_link_on_expiration": True}


def brains_of(path: Path) -> list[str]:
    """Return the brains that a bundle is for, or all that a key folder has keys of; BusError when it does not say."""
    if path.is_dir():
        return sorted(found.stem for found in (path / "brains").glob("*.pem"))
    user = Bundle.read(path).user
    if user is None:
        raise BusError(f"{path} does not say of which brain it is; give the brain's name")
    return [user.brain]


def write(user: str, says: Mapping[str, str], *blocks: bytes) -> bytes:
    """Return the bytes of a bundle file: plain lines, then the PEM blocks (private key, certificate, authority)."""
    lines = [f"The secret key of {user}: whoever has this file is {user}.", *(f"{k}: {v}" for k, v in says.items())]
    return "\n".join(lines).encode() + b"\n" + b"".join(blocks)


def _user(said: Mapping[str, str]) -> User | None:
    try:
        return User(said["brain"], Role(said["role"]), said["name"])
    except (KeyError, ValueError):
        return None


def _until(said: Mapping[str, str]) -> datetime | None:
    try:
        return datetime.fromisoformat(said["until"])
    except (KeyError, ValueError):
        return None


def why_refused(endpoint: Endpoint, bundle: Bundle | None) -> str | None:
    """Return why a router there takes no client with this bundle, or None when nothing there says.

    Zenoh only says that it could not connect; one TLS handshake of our own tells the reasons apart.
    """
    if endpoint.protocol not in ("tcp", "tls"):
        return None
    try:
        with socket.create_connection((endpoint.host, endpoint.port), PROBE_S) as link:
            if endpoint.protocol == "tcp":
                return (
                    "something answers there, but not as an open router; if the router has keys, connect to "
                    f"{endpoint._replace(protocol='tls')} with --keys"
                )
            return None if bundle is None else _handshake(link, endpoint, bundle)
    except (socket.gaierror, ValueError):  # not known; no name that can be (IDNA)
        return f"the host name {endpoint.host} is not known"
    except OSError:
        return None


def _handshake(link: socket.socket, endpoint: Endpoint, bundle: Bundle) -> str | None:
    try:
        context = _context(bundle)
    except ssl.SSLError as error:
        return f"{bundle.path} is not usable: {error}"
    try:
        with context.wrap_socket(link, server_hostname=endpoint.host) as tls:
            tls.recv(1)  # with TLS 1.3 the router's refusal comes after the handshake
    except ssl.SSLCertVerificationError as error:
        return _of_router(error, endpoint, bundle)
    except ssl.SSLError as error:
        return _of_client(error.reason or "", bundle)
    except OSError:
        return None
    return "it closes the connection"


def _context(bundle: Bundle) -> ssl.SSLContext:
    context = ssl.create_default_context(cadata=bundle.authority.decode())
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.load_cert_chain(bundle.path)
    return context


def _of_router(error: ssl.SSLCertVerificationError, endpoint: Endpoint, bundle: Bundle) -> str:
    """Say what is wrong with the router's certificate."""
    if "mismatch" in error.verify_message:
        names = _names(endpoint, bundle)
        return (
            f"the router's certificate is not for {endpoint.host} but for {names}: connect by one of these names, or "
            f"make it a new one there: 'mdb keys renew --host {endpoint.host}'"
        )
    if error.verify_code == NOT_YET_VALID:
        return f"the router's certificate is not valid yet: {_clock()}; set the clock that is wrong, here or there"
    if error.verify_code == EXPIRED:
        return (
            f"the router's certificate has expired: {_clock()}, and if that is right 'mdb keys renew' there makes a "
            "new one"
        )
    return (
        f"its certificate is not from the authority in {bundle.path} ({error.verify_message}): it is another router, "
        "or its keys were made anew"
    )


def _clock() -> str:
    return f"this machine's clock says {datetime.now(UTC):%Y-%m-%d %H:%M} UTC"


def _names(endpoint: Endpoint, bundle: Bundle) -> str:
    context = _context(bundle)
    context.check_hostname = False
    with (
        socket.create_connection((endpoint.host, endpoint.port), PROBE_S) as link,
        context.wrap_socket(link) as tls,
    ):
        shown: dict[str, Any] = dict(tls.getpeercert() or {})
    return ", ".join(name for _, name in shown.get("subjectAltName", ()))


def _of_client(reason: str, bundle: Bundle) -> str:
    """Say what the router found wrong with the client's certificate."""
    words = reason.lower().replace("_", " ")
    if "EXPIRED" in reason and bundle.until is not None:  # `find` has looked: by our clock it has not ended
        return (
            f"it refuses {bundle.path}: by the router's clock the certificate is not valid now; {_clock()}, and it "
            f"ends on {bundle.until:%Y-%m-%d}: set the clock that is wrong, here or there"
        )
    if "EXPIRED" in reason:
        return f"it refuses {bundle.path}: the certificate has expired; {_clock()}, and if that is right {MAKE_NEW}"
    if "UNKNOWN_CA" in reason or "DECRYPT_ERROR" in reason:
        return f"it refuses {bundle.path}: not signed by its authority ({words}); {MAKE_NEW}"
    if "ALERT" in reason:
        return f"it refuses {bundle.path} ({words}); {MAKE_NEW}"
    return f"it does not speak TLS ({words}); a router without keys is at tcp/, without --keys"
