"""The key folder of `mdb keys`: an authority, certificates signed by it, and who of their holders is admitted.

    ca.pem, ca-key.pem     the authority: its key never leaves the folder
    router.pem, page.pem   what the router shows, and the page of `mdb up --web`
    brains/NAME.pem        what the processes of a brain show; teachers/, viewers/: bundles to carry away
    access.json5           who is admitted, and to what; a certificate that is not in it is worth nothing

Files are written whole or not at all, readable by their owner only. No network, no Zenoh.
"""

from __future__ import annotations

import fcntl
import ipaddress
import os
import re
import secrets
import shutil
import socket
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from mdb_deploy.keys import access
from mdb_protocol import bundle, endpoints
from mdb_protocol.errors import ConfigError
from mdb_protocol.keys import NAME
from mdb_protocol.roles import Role, User
from mdb_protocol.zenoh_sessions import RouterKeys
from mdb_services.shell.whole_file import write_whole

AUTHORITY_DAYS = 3650
CERTIFICATE_DAYS = 365
EARLIER = timedelta(days=1)
"""Certificates are valid from so long before they were made: a laptop's clock may be behind."""
COMMON_NAME_LIMIT = 64
"""Longest common name of a certificate (RFC 5280, appendix A.1)."""
ALWAYS = ("localhost", "127.0.0.1", "::1")
"""Hosts that the router's certificate is always for, besides this machine's name."""
PUBLIC_PEM, PRIVATE_PEM = "ca.pem", "ca-key.pem"
ROUTER, PAGE = "router", "page"
RENEWED_EARLIER = timedelta(days=7)
"""So long before its end the page's certificate is made anew."""


class KeyFolder:
    """A key folder that is there; `create` makes one."""

    def __init__(self, path: Path) -> None:
        """Open a folder; ConfigError when it is none."""
        self.path = path
        if not (path / access.ACCESS_FILE).is_file():
            raise ConfigError(f"{path} is not a key folder; 'mdb keys init {path}' makes one")

    @classmethod
    def create(cls, path: Path, brain: str, hosts: Sequence[str] = ()) -> KeyFolder:
        """Make a folder with an authority, a router's and a brain's certificate; ConfigError when it is there."""
        path = path.resolve()
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise ConfigError(f"{path} is there already; nothing was changed. Choose another folder, or remove it")
        path.parent.mkdir(parents=True, exist_ok=True)
        made = path.parent / f"{path.name}.{secrets.token_hex(4)}.part"
        made.mkdir(mode=0o700)
        try:
            write_whole(made / ".gitignore", b"*\n", power_safe=True, private=True)
            key, authority = _authority()
            write_whole(made / PRIVATE_PEM, _private(key), power_safe=True, private=True)
            write_whole(made / PUBLIC_PEM, _public(authority), power_safe=True, private=True)
            write_whole(made / access.ACCESS_FILE, access.text({}).encode(), power_safe=True, private=True)
            folder = cls(made)
            folder.renew(hosts)
            folder.add(Role.BRAIN, brain, brain)
            made.replace(path)
        except BaseException:
            shutil.rmtree(made)
            raise
        return cls(path)

    def users(self) -> dict[str, User]:
        """Return who is admitted, by the common names of their certificates."""
        return access.users(access.read(self.path / access.ACCESS_FILE))

    def bundle(self, user: User) -> Path:
        """Return the path of a user's bundle."""
        return self.path / f"{user.role.value}s" / f"{user.name}.pem"

    def add(self, role: Role, name: str, brain: str | None = None, days: int = CERTIFICATE_DAYS) -> Path:
        """Make a certificate for a new user and admit him; return the path of his bundle.

        `brain` may be left out when the folder has only one. Raises ConfigError when the name is taken or cannot be
        used.
        """
        with self._locked():
            users = self.users()
            user = User(brain or _only_brain(users.values()), role, name)
            _check(user, days, users.values())
            common_name = _common_name(user)
            self._sign(user, common_name, days)
            self._admit(users | {common_name: user})
        return self.bundle(user)

    def remove(self, name: str) -> User:
        """Take a user off the access control, whoever has his bundle; ConfigError when there is none to remove."""
        with self._locked():
            users = self.users()
            found = [common_name for common_name, user in users.items() if user.name == name]
            if not found:
                names = ", ".join(user.name for user in users.values() if user.role is not Role.BRAIN) or "nobody yet"
                raise ConfigError(f"no user {name!r} in {self.path}; there are: {names}")
            user = users.pop(found[0])
            if user.role is Role.BRAIN:
                raise ConfigError(f"{name} is the brain itself; without it the keys in {self.path} serve nobody")
            self._admit(users)
            self.bundle(user).unlink(missing_ok=True)
        return user

    def renew(self, hosts: Sequence[str] = ()) -> None:
        """Make the router's and the brains' certificates anew, for further hosts too, and the access-control file."""
        with self._locked():
            router = self.path / f"{ROUTER}.pem"
            all_hosts = dict.fromkeys(
                (*ALWAYS, socket.gethostname(), *(_hosts(router) if router.exists() else ()), *hosts)
            )
            names = x509.SubjectAlternativeName([_host(host) for host in all_hosts])
            self._issue(router, "the router", ROUTER, {"role": ROUTER}, names=names)
            users = self.users()
            for common_name, user in users.items():
                if user.role is Role.BRAIN:
                    self._sign(user, common_name, CERTIFICATE_DAYS)
            self._admit(users)

    def router_keys(self, listen: str) -> RouterKeys:
        """Return what a router needs that listens there; ConfigError when its certificate is not for that."""
        shown = bundle.Bundle.read(self.path / f"{ROUTER}.pem")
        if shown.until is not None and shown.until < datetime.now(UTC):
            raise ConfigError(
                f"the router's certificate ended on {shown.until:%Y-%m-%d}; {self._renew()} makes a new one"
            )
        endpoint = endpoints.parse(listen).for_this_machine()
        if endpoint.host not in (hosts := _hosts(shown.path)):
            raise ConfigError(
                f"the router's certificate is for {', '.join(hosts)}, not for {endpoint.host}; "
                f"'{self._renew()} --host {endpoint.host}' makes a new one"
            )
        section = access.read(self.path / access.ACCESS_FILE)
        return RouterKeys(shown, section, list(access.users(section).values()))

    def hosts(self) -> list[str]:
        """Return the names and addresses by which others reach this machine, as the router's certificate says."""
        return _hosts(self.path / f"{ROUTER}.pem")

    def page_certificate(self, host: str) -> Path:
        """Return what the page shows to browsers: a certificate for all hosts of the router's, and for `host`.

        It is made when it is not there, ends soon, or is not for these hosts; ConfigError when `host` is none.
        """
        path = self.path / f"{PAGE}.pem"
        hosts = list(dict.fromkeys((*self.hosts(), *([host] if host and not _is_any(host) else []))))
        with self._locked():
            if path.exists():
                until = bundle.Bundle.read(path).until
                lasts = until is not None and until - RENEWED_EARLIER > datetime.now(UTC)
                if lasts and set(hosts) <= set(_hosts(path)):
                    return path
            names = x509.SubjectAlternativeName([_host(each) for each in hosts])
            self._issue(path, "the page", PAGE, {"role": PAGE}, names=names)
        return path

    def _renew(self) -> str:
        return f"mdb keys renew --keys {self.path}"

    def _sign(self, user: User, common_name: str, days: int) -> None:
        says = {"brain": user.brain, "role": user.role.value, "name": user.name}
        self._issue(self.bundle(user), str(user), common_name, says, days=days)

    def _issue(
        self,
        path: Path,
        holder: str,
        common_name: str,
        says: dict[str, str],
        *,
        days: int = CERTIFICATE_DAYS,
        names: x509.SubjectAlternativeName | None = None,
    ) -> None:
        """Write a bundle; with `names` for a router, else for a client."""
        authority = x509.load_pem_x509_certificate((self.path / PUBLIC_PEM).read_bytes())
        authority_key = load_pem_private_key((self.path / PRIVATE_PEM).read_bytes(), None)
        assert isinstance(authority_key, ec.EllipticCurvePrivateKey)
        key = ec.generate_private_key(ec.SECP256R1())
        until = min(datetime.now(UTC) + timedelta(days=days), authority.not_valid_after_utc)
        purpose = ExtendedKeyUsageOID.CLIENT_AUTH if names is None else ExtendedKeyUsageOID.SERVER_AUTH
        builder = (
            _builder(common_name, authority.subject, key, until)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage([purpose]), critical=False)
            .add_extension(
                x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key()), critical=False
            )
        )
        if names is not None:
            builder = builder.add_extension(names, critical=False)
        certificate = builder.sign(authority_key, hashes.SHA256())
        path.parent.mkdir(mode=0o700, exist_ok=True)
        plain = says | {"until": until.isoformat(timespec="seconds")}
        write_whole(
            path,
            bundle.write(holder, plain, _private(key), _public(certificate), _public(authority)),
            power_safe=True,
            private=True,
        )

    def _admit(self, users: dict[str, User]) -> None:
        write_whole(self.path / access.ACCESS_FILE, access.text(users).encode(), power_safe=True, private=True)

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Keep two commands from undoing each other's changes."""
        lock = os.open(self.path, os.O_RDONLY)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
        finally:
            os.close(lock)


def _only_brain(users: Iterable[User]) -> str:
    brains = [user.brain for user in users if user.role is Role.BRAIN]
    if len(brains) != 1:
        raise ConfigError(f"of which brain? There are {', '.join(brains)}: give --brain NAME")
    return brains[0]


def _check(user: User, days: int, users: Iterable[User]) -> None:
    for name in (user.name, user.brain):
        if not NAME.fullmatch(name):
            raise ConfigError(f"{name!r} is not a name; expected 1 to 64 letters, digits, '_', '.' or '-'")
    if days < 1:
        raise ConfigError(f"a certificate for {days} days; expected at least 1")
    others = list(users)
    for other in others:
        if other.name == user.name:
            raise ConfigError(f"there is a {other} already; 'mdb keys remove {user.name}' makes the name free")
    if user.role is not Role.BRAIN and not any(other.brain == user.brain for other in others):
        raise ConfigError(f"no brain {user.brain!r} in this key folder; 'mdb keys list' shows who is there")


def _common_name(user: User) -> str:
    """Return a name that no certificate has had: a removed user's stays worthless when the name is given again."""
    name = f"{user.brain}/{user.role.value}/{user.name}/{secrets.token_hex(4)}"
    if len(name) > COMMON_NAME_LIMIT:
        over = len(name) - COMMON_NAME_LIMIT
        raise ConfigError(f"the names {user.name!r} and {user.brain!r} are together {over} letters too long")
    return name


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    if not re.fullmatch(r"[A-Za-z0-9_.-]{1,253}", host):
        raise ConfigError(
            f"{host!r} is neither a host name nor an address; expected one as in brain.lan or 192.168.1.5"
        )
    return x509.DNSName(host)


def _is_any(host: str) -> bool:
    """Whether a host to listen at stands for all of this machine's."""
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return False


def _hosts(path: Path) -> list[str]:
    """Return the hosts that the certificate in a bundle is for."""
    certificate = x509.load_pem_x509_certificate(bundle.Bundle.read(path).certificate)
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return [str(name.value) for name in names]


def _authority() -> tuple[ec.EllipticCurvePrivateKey, x509.Certificate]:
    key = ec.generate_private_key(ec.SECP256R1())
    common_name = f"mdb authority {secrets.token_hex(4)}"
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])
    builder = (
        _builder(common_name, subject, key, datetime.now(UTC) + timedelta(days=AUTHORITY_DAYS))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs_certificates=True), critical=True)
    )
    return key, builder.sign(key, hashes.SHA256())


def _builder(
    common_name: str, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, until: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)]))
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime.now(UTC) - EARLIER)
        .not_valid_after(until)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _private(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def _public(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(Encoding.PEM)
