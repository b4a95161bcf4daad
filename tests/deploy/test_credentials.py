"""The key folder: what is in it, for how long, for whose eyes, and that no accident leaves half of it."""

import json
import re
import subprocess
import threading
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import structlog
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from mdb_deploy.cli.keys import ROLES
from mdb_deploy.cli.main import main
from mdb_deploy.keys import access
from mdb_deploy.keys.credentials import KeyFolder
from mdb_protocol.bundle import Bundle
from mdb_protocol.errors import BusError, ConfigError
from mdb_protocol.keys import KEYS
from mdb_protocol.roles import Role, User, table

README = (Path(__file__).parents[2] / "deploy" / "README.md").read_text()


@pytest.fixture
def folder(tmp_path: Path) -> KeyFolder:
    return KeyFolder.create(tmp_path / "keys", "pioneer", ["brain.lan", "192.168.1.5", "fe80::1"])


@pytest.fixture(autouse=True)
def as_before() -> Iterator[None]:
    """The command line sets up the log for a process of its own."""
    yield
    structlog.reset_defaults()


def certificate(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(Bundle.read(path).certificate)


def common_name(path: Path) -> object:
    return certificate(path).subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value


def days(found: x509.Certificate) -> int:
    return round((found.not_valid_after_utc - datetime.now(UTC)) / timedelta(days=1))


def test_the_command_line_knows_each_role() -> None:
    assert list(ROLES) == [role.value for role in Role]


def test_only_the_owner_can_read_anything(folder: KeyFolder) -> None:
    folder.add(Role.TEACHER, "anna")
    for path in (folder.path, *folder.path.rglob("*")):
        assert path.stat().st_mode & 0o077 == 0, path


def test_git_takes_nothing_of_it(folder: KeyFolder) -> None:
    git = ["git", "-C", str(folder.path.parent)]
    subprocess.run([*git, "init", "--quiet"], check=True)
    status = subprocess.run([*git, "status", "--porcelain", "--untracked-files=all"], capture_output=True, check=True)
    assert status.stdout == b""


def test_certificates_are_signed_by_the_authority_for_their_purpose_and_time(folder: KeyFolder) -> None:
    authority = x509.load_pem_x509_certificate((folder.path / "ca.pem").read_bytes())
    assert days(authority) == 3650
    teacher = folder.add(Role.TEACHER, "anna")
    purposes = {
        folder.path / "router.pem": ExtendedKeyUsageOID.SERVER_AUTH,
        folder.path / "brains" / "pioneer.pem": ExtendedKeyUsageOID.CLIENT_AUTH,
        teacher: ExtendedKeyUsageOID.CLIENT_AUTH,
    }
    for path, purpose in purposes.items():
        found = certificate(path)
        found.verify_directly_issued_by(authority)
        assert days(found) == 365
        assert list(found.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value) == [purpose]
        key = load_pem_private_key(Bundle.read(path).key, None)
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        assert key.public_key() == found.public_key()
    assert days(certificate(folder.add(Role.TEACHER, "bert", days=7))) == 7
    assert days(certificate(folder.add(Role.TEACHER, "long", days=99999))) == 3650, "no longer than the authority"


def test_the_router_is_known_by_this_machines_names_and_the_given_ones(folder: KeyFolder) -> None:
    names = certificate(folder.path / "router.pem").extensions.get_extension_for_class(x509.SubjectAlternativeName)
    found = {str(name.value) for name in names.value}
    assert {"localhost", "127.0.0.1", "::1", "brain.lan", "192.168.1.5", "fe80::1"} <= found
    for listen in ("tls/0.0.0.0:7447", "quic/[::]:7447", "tls/brain.lan:7447", "tls/[fe80::1]:0"):
        assert folder.router_keys(listen).access_control["default_permission"] == "deny"
    with pytest.raises(ConfigError, match=r"not for elsewhere; .*mdb keys renew --keys .* --host elsewhere"):
        folder.router_keys("tls/elsewhere:7447")


def test_a_bundle_says_in_plain_words_whose_it_is(folder: KeyFolder) -> None:
    path = folder.add(Role.TEACHER, "anna")
    bundle = Bundle.read(path)
    assert bundle.user == User("pioneer", Role.TEACHER, "anna")
    assert bundle.until == certificate(path).not_valid_after_utc
    assert path.read_text().startswith("The secret key of teacher anna of brain pioneer: whoever has this file is")


def test_a_folder_that_is_there_is_never_touched(folder: KeyFolder) -> None:
    before = {path: path.read_bytes() for path in folder.path.rglob("*") if path.is_file()}
    with pytest.raises(ConfigError, match="there already; nothing was changed"):
        KeyFolder.create(folder.path, "pioneer")
    assert {path: path.read_bytes() for path in folder.path.rglob("*") if path.is_file()} == before


def test_a_folder_is_made_whole_or_not_at_all(tmp_path: Path) -> None:
    for brain, hosts in (("no/brain", []), ("pioneer", ["not a host"]), ("b" * 60, [])):
        with pytest.raises(ConfigError):
            KeyFolder.create(tmp_path / "keys", brain, hosts)
        assert list(tmp_path.iterdir()) == []
    (tmp_path / "keys").mkdir()
    assert KeyFolder.create(tmp_path / "keys", "pioneer").users(), "an empty folder is as good as none"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("", "not a name"), ("a/b", "not a name"), ("../x", "not a name"), ("*", "not a name"), ("ä", "not a name"),
        ("a" * 64, "letters too long"), ("anna", "there is a teacher anna of brain pioneer already"),
        ("pioneer", "there is a brain pioneer already"),
    ],
)  # fmt: skip
def test_names_that_cannot_be_used_are_said_and_change_nothing(name: str, said: str, folder: KeyFolder) -> None:
    folder.add(Role.TEACHER, "anna")
    before = sorted(folder.path.rglob("*")), folder.users()
    for role in (Role.TEACHER, Role.VIEWER):
        with pytest.raises(ConfigError, match=said):
            folder.add(role, name)
    assert (sorted(folder.path.rglob("*")), folder.users()) == before


def test_lifetimes_and_brains_that_cannot_be_are_said(folder: KeyFolder) -> None:
    with pytest.raises(ConfigError, match="for 0 days; expected at least 1"):
        folder.add(Role.TEACHER, "anna", days=0)
    with pytest.raises(ConfigError, match="no brain 'nobody'"):
        folder.add(Role.TEACHER, "anna", "nobody")
    folder.add(Role.BRAIN, "second", "second")
    with pytest.raises(ConfigError, match=r"of which brain\? There are pioneer, second: give --brain NAME"):
        folder.add(Role.TEACHER, "anna")
    assert folder.add(Role.TEACHER, "anna", "second").exists()


def test_a_name_given_again_is_another_user(folder: KeyFolder) -> None:
    first = folder.add(Role.TEACHER, "anna")
    old = common_name(first)
    folder.remove("anna")
    assert not first.exists()
    assert old not in folder.users()
    new = common_name(folder.add(Role.TEACHER, "anna"))
    assert new != old
    assert [name for name, user in folder.users().items() if user.name == "anna"] == [new]


def test_removing_says_whom_there_is_to_remove(folder: KeyFolder) -> None:
    with pytest.raises(ConfigError, match=r"no user 'anna' .*there are: nobody yet"):
        folder.remove("anna")
    folder.add(Role.VIEWER, "tom")
    with pytest.raises(ConfigError, match="there are: tom"):
        folder.remove("anna")
    with pytest.raises(ConfigError, match="pioneer is the brain itself"):
        folder.remove("pioneer")


def test_a_bundle_left_by_an_interrupted_command_is_in_nobodys_way(folder: KeyFolder) -> None:
    left = folder.path / "teachers" / "anna.pem"
    left.parent.mkdir()
    left.write_text("half of a bundle")
    assert common_name(folder.add(Role.TEACHER, "anna")) in folder.users()


def test_commands_at_the_same_time_lose_nobody(folder: KeyFolder) -> None:
    names = [f"teacher-{i}" for i in range(8)]
    threads = [threading.Thread(target=KeyFolder(folder.path).add, args=(Role.TEACHER, name)) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {user.name for user in folder.users().values()} == {"pioneer", *names}


def test_renewing_keeps_users_and_hosts_and_adds_hosts(folder: KeyFolder) -> None:
    folder.add(Role.TEACHER, "anna")
    users, teacher = folder.users(), (folder.path / "teachers" / "anna.pem").read_bytes()
    router, brain = certificate(folder.path / "router.pem"), certificate(folder.path / "brains" / "pioneer.pem")
    folder.renew(["10.0.0.7"])
    assert folder.users() == users
    assert (folder.path / "teachers" / "anna.pem").read_bytes() == teacher
    assert certificate(folder.path / "router.pem").serial_number != router.serial_number
    assert certificate(folder.path / "brains" / "pioneer.pem").serial_number != brain.serial_number
    for host in ("10.0.0.7", "brain.lan"):
        folder.router_keys(f"tls/{host}:7447")


def granted(section: dict[str, object], who: str, flow: str, message: str) -> set[str]:
    rules: list[dict[str, list[str]]] = section["rules"]  # type: ignore[assignment]
    own = [rule for rule in rules if str(rule["id"]).startswith(f"{who} ")]
    return {key for rule in own if flow in rule["flows"] and message in rule["messages"] for key in rule["key_exprs"]}


def test_the_access_control_gives_each_role_its_own_keys(folder: KeyFolder) -> None:
    folder.add(Role.TEACHER, "anna")
    folder.add(Role.VIEWER, "tom")
    folder.add(Role.OPERATOR, "eve")
    section = access.read(folder.path / access.ACCESS_FILE)
    assert section["enabled"] is True
    assert section["default_permission"] == "deny"
    taught = ["teacher/anna/command", "teacher/anna/feedback", "teacher/anna/lesson", "teacher/anna/audio"]
    for who, said in (("teacher/anna", taught), ("viewer/tom", []), ("operator/eve", ["change", "control"])):
        samples = {f"mdb/pioneer/{key}" for key in said}
        past, status = {f"{key}/@adv/**" for key in samples}, {f"mdb/pioneer/status/{who}"}
        for message, expected in (
            ("put", samples | past),
            ("reply", samples | past | status),
            ("declare_queryable", past | status),
            ("liveliness_token", {f"mdb/pioneer/alive/{who}"}),
        ):
            assert granted(section, f"pioneer/{who}", "ingress", message) == expected
    assert not any("delete" in rule["messages"] for rule in section["rules"])
    reads = granted(section, "pioneer/teacher/anna", "ingress", "declare_subscriber")
    assert "mdb/pioneer/scene" in reads
    assert not [key for key in reads if "model/" in key or "pair" in key or "bert" in key]


def test_every_key_of_the_table_has_its_readers_and_writers() -> None:
    teacher, viewer = User("b", Role.TEACHER, "anna"), User("b", Role.VIEWER, "tom")
    assert viewer.reads() == ["mdb/b/**"] == User("b", Role.BRAIN, "b").writes()
    own = {row.at("b", teacher="anna") for row in KEYS if row.writer == "that teacher"}
    assert own == set(teacher.writes()[:-2])
    assert own <= set(teacher.reads())
    assert "mdb/b/heard/anna" in teacher.reads()


def test_files_that_cannot_be_used_are_said(folder: KeyFolder, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"not a key folder; 'mdb keys init .*none' makes one"):
        KeyFolder(tmp_path / "none")
    file = folder.path / access.ACCESS_FILE
    for broken in ("", "// nothing", "{}", json.dumps({"access_control": {"subjects": [{"id": "anna"}]}})):
        file.write_text(broken)
        with pytest.raises(ConfigError, match=r"access\.json5 is not a usable access-control file"):
            folder.users()
    with pytest.raises(BusError, match=r"cannot read the keys .*no\.pem: No such file"):
        Bundle.read(tmp_path / "no.pem")
    with pytest.raises(BusError, match="holds 0 private keys and 1 certificates; expected a bundle"):
        Bundle.read(folder.path / "ca.pem")
    with pytest.raises(BusError, match=r"keys of brain pioneer; for brain other"):
        Bundle.find(folder.path / "brains" / "pioneer.pem", "other")


def test_the_commands_say_what_they_did(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(tmp_path / "keys")
    assert main(["keys", "init", folder, "--host", "brain.lan"]) == 0
    assert main(["keys", "add-teacher", "anna", "--keys", folder]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"{folder}/teachers/anna.pem"
    assert main(["keys", "add-viewer", "tom", "--keys", folder, "--days", "3"]) == 0
    capsys.readouterr()
    assert main(["keys", "list", "--keys", folder]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [re.sub(r"\d{4}-\d\d-\d\d", "DATE", line) for line in listed] == [
        f"brain pioneer, until DATE: {folder}/brains/pioneer.pem",
        f"teacher anna of brain pioneer, until DATE: {folder}/teachers/anna.pem",
        f"viewer tom of brain pioneer, until DATE: {folder}/viewers/tom.pem",
    ]
    assert main(["keys", "remove", "anna", "--keys", folder]) == 0
    assert main(["keys", "remove", "anna", "--keys", folder]) == 2
    assert "no user 'anna'" in capsys.readouterr().err
    assert main(["keys", "renew", "--keys", folder]) == 0
    assert main(["keys", "init", folder]) == 2


def test_the_readme_says_who_may_do_what_as_the_code_does(capsys: pytest.CaptureFixture[str]) -> None:
    assert table() in README, "print it with `mdb keys roles` between the marks"
    assert main(["keys", "roles"]) == 0
    assert capsys.readouterr().out.strip() == table()
