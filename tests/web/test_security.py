"""Who may open the page, and do what: hosts, origins, links with tokens, HTTPS, and the runs that can be read."""

from __future__ import annotations

import json
import socket
import ssl
import stat
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import httpx
import pytest
from websockets.exceptions import InvalidStatus

from mdb_deploy.keys.credentials import KeyFolder
from mdb_deploy.web import serve
from mdb_deploy.web.guard import TOKENS_FILE, Guard, RefusedError, Site, tokens_in
from mdb_deploy.web.opening import PORT, Place, WebOptions, bind, check, guard_of, is_loopback
from mdb_protocol import keys
from mdb_protocol.errors import ConfigError
from mdb_protocol.roles import Role
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_protocol.zenoh_sessions import Router
from tests.web.rig import BOUND_S, BRAIN, ROUTER_CONFIG, Console, Page, run_folder, scene

RECORDED = "run-20260101-000000-seed1"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of runs, and what lies beside and leads out of it."""
    base = tmp_path_factory.mktemp("security") / "runs"
    folder = run_folder(base / RECORDED)
    (folder / "run.mcap").write_bytes(b"this is no log")
    (folder / "figures").mkdir()
    (folder / "figures" / "a.png").write_bytes(b"\x89PNG")
    (folder / ".hidden").write_text("hidden")
    (folder / "memory.sqlite").write_text("a database")
    (folder / "key.pem").write_text("secret")
    secret = base.parent / "secret.txt"
    secret.write_text("secret")
    (folder / "out.txt").symlink_to(secret)
    (folder / "outside").symlink_to(base.parent)
    (base / "linked").symlink_to(folder)
    outside = base.parent / "elsewhere"
    outside.mkdir()
    (outside / "run.mcap").write_bytes(b"x")
    (base / "no-run").mkdir()
    return base


@pytest.fixture(scope="module")
def console(runs: Path) -> Iterator[Console]:
    with Console(WebOptions(Place("tcp/127.0.0.1:1"), port=0, runs=runs)) as found:
        yield found


# ---- hosts and origins


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1.evil.example", "", "127.0.0.1; script-src *", "a@127.0.0.1"]
)
def test_a_page_of_another_name_does_not_lead_here(console: Console, host: str) -> None:
    with socket.create_connection((console.guard.site.host, console.guard.site.port), BOUND_S) as link:
        link.sendall(f"GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())
        said = b""
        while part := link.recv(65536):
            said += part
    assert said.startswith((b"HTTP/1.1 403", b"HTTP/1.1 400"))


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "[::1]", "LOCALHOST:1234"])
def test_this_machines_own_names_do(console: Console, host: str) -> None:
    assert console.get("/", headers={"Host": host}).status_code == 200


def test_another_sites_page_may_not_use_the_socket(console: Console) -> None:
    for origin in ("http://evil.example", "null", "http://127.0.0.1:1", "http://localhost.evil.example"):
        with pytest.raises(InvalidStatus, match="403"):
            Page(console, origin=origin)
        assert console.get("/runs", headers={"Origin": origin}).status_code == 403
    with Page(console, origin=console.at.rstrip("/")) as page:
        page.until(lambda state: "hello" in state)


def test_a_page_of_ours_loads_from_here_alone(console: Console) -> None:
    for path in ("/", "/page/main.js", "/runs", "/none"):
        headers = console.get(path).headers
        policy = headers["content-security-policy"]
        assert policy.startswith("default-src 'self'; img-src 'self' data:;")
        assert "unsafe" not in policy
        assert "frame-ancestors 'none'" in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert "access-control-allow-origin" not in headers
        assert "server" not in headers


def test_nothing_is_posted(console: Console) -> None:
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "PATCH"):
        assert httpx.request(method, f"{console.at}runs").status_code == 403


# ---- past runs


def test_runs_are_listed(console: Console) -> None:
    (found,) = console.get("/runs").json()
    assert (found["name"], found["experiment"], found["iterations"]) == (RECORDED, "paper", 2000)


@pytest.mark.parametrize(
    "path",
    [
        "..", "../elsewhere", "%2e%2e%2felsewhere", "linked", "no-run", "none", "..%2f..", "%00", ".", "a" * 300,
        f"{RECORDED}%2f..%2f{RECORDED}",
    ],
)  # fmt: skip
def test_no_other_folder_is_read(console: Console, path: str) -> None:
    for what in ("hello", "rows", "at/1", "files", "files/run.mcap"):
        assert console.get(f"/runs/{path}/{what}").status_code == 404, what


@pytest.mark.parametrize(
    "path",
    [
        "out.txt", "outside/secret.txt", "../../secret.txt", "%2e%2e/%2e%2e/secret.txt", ".hidden", "figures", "",
        "figures/../../../secret.txt", "/etc/passwd", "%2fetc%2fpasswd", "run.mcap%00", "none",
        "memory.sqlite", "key.pem",
    ],
)  # fmt: skip
def test_no_other_file_is_downloaded(console: Console, path: str) -> None:
    assert console.get(f"/runs/{RECORDED}/files/{path}").status_code == 404


def test_a_runs_own_files_are(console: Console) -> None:
    found = console.get(f"/runs/{RECORDED}/files/run.mcap")
    assert (found.status_code, found.content) == (200, b"this is no log")
    assert found.headers["content-disposition"].startswith("attachment")
    assert console.get(f"/runs/{RECORDED}/files/figures/a.png").headers["content-type"] == "image/png"


def test_a_damaged_run_is_told_in_words(console: Console) -> None:
    answer = console.get(f"/runs/{RECORDED}/rows")
    assert answer.status_code == 422
    assert answer.text


# ---- where the page may be


def test_beyond_this_machine_only_with_keys(tmp_path: Path) -> None:
    for host in ("0.0.0.0", "::", "192.168.1.5", "example.org"):
        with pytest.raises(ConfigError, match="--keys"):
            check(WebOptions(Place(), host))
    check(WebOptions(Place(), "127.0.0.1"))
    check(WebOptions(Place(), "0.0.0.0", open_to_everyone=True))
    folder = KeyFolder.create(tmp_path / "keys", BRAIN)
    check(WebOptions(Place(keys=folder.path), "0.0.0.0"))
    with pytest.raises(ConfigError, match="teacher"):
        check(WebOptions(Place(keys=folder.add(Role.TEACHER, "anna"))))
    viewer = folder.add(Role.VIEWER, "tom")
    check(WebOptions(Place(keys=viewer)))
    with pytest.raises(ConfigError, match="this machine alone"):
        check(WebOptions(Place(keys=viewer), "0.0.0.0"))


def test_a_port_that_is_taken() -> None:
    with bind("127.0.0.1", 0) as taken, pytest.raises(ConfigError, match="port"):
        bind("127.0.0.1", taken.getsockname()[1])
    with bind("127.0.0.1", None) as first, bind("127.0.0.1", None) as second:
        assert PORT <= first.getsockname()[1] < second.getsockname()[1]


# ---- with keys


class Locked(NamedTuple):
    """A console with keys, its folder, and a client that trusts its authority."""

    console: Console
    folder: KeyFolder
    trust: ssl.SSLContext

    def client(self, role: str) -> httpx.Client:
        """Open a role's link, as a browser does."""
        client = httpx.Client(verify=self.trust, follow_redirects=True)
        assert client.get(self.console.guard.links()[role]).status_code == 200
        return client

    def page(self, role: str) -> Page:
        cookies = "; ".join(f"{name}={value}" for name, value in self.client(role).cookies.items())
        return Page(self.console, ssl=self.trust, additional_headers={"Cookie": cookies})


@pytest.fixture(scope="module")
def locked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Locked]:
    base = tmp_path_factory.mktemp("locked")
    folder = KeyFolder.create(base / "keys", BRAIN)
    listen = "tls/127.0.0.1:0"
    router = Router(ROUTER_CONFIG, listen, keys=folder.router_keys(listen))
    run = run_folder(base / "runs" / "now")
    options = WebOptions(Place(router.endpoint(), run, keys=folder.path), port=0)
    with Console(options) as console:
        yield Locked(console, folder, ssl.create_default_context(cafile=str(folder.path / "ca.pem")))
    router.close()


def test_tokens_are_their_owners_and_stay(locked: Locked) -> None:
    path = locked.folder.path / TOKENS_FILE
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE((locked.folder.path / "page.pem").stat().st_mode) == 0o600
    assert tokens_in(locked.folder.path) == locked.console.guard.tokens
    assert len(set(tokens_in(locked.folder.path).values())) == 3


def test_without_a_link_nothing_is_shown(locked: Locked) -> None:
    with httpx.Client(verify=locked.trust) as client:
        for path in ("", "page/main.js", "runs", "?token=", "?token=wrong", "?token=%00%ff"):
            answer = client.get(locked.console.at + path)
            assert answer.status_code == 403, path
            assert "link" in answer.text
    with pytest.raises(InvalidStatus, match="403"):
        Page(locked.console, ssl=locked.trust)
    with pytest.raises(InvalidStatus, match="403"):
        Page(locked.console, ssl=locked.trust, additional_headers={"Cookie": f"{locked.console.guard.cookie}=wrong"})


def test_a_link_becomes_a_cookie_and_leaves_the_address(locked: Locked) -> None:
    with httpx.Client(verify=locked.trust) as client:
        answer = client.get(locked.console.guard.links()["viewer"])
        assert (answer.status_code, answer.headers["location"]) == (303, "/")
        (kept,) = [c for c in answer.headers.get_list("set-cookie") if "Max-Age" in c]
        assert "HttpOnly" in kept
        assert "Secure" in kept
        assert "SameSite=Lax" in kept
        assert client.get(locked.console.at).status_code == 200


def test_a_link_leads_to_no_other_site(locked: Locked) -> None:
    client = locked.client("viewer")
    for path in ("//evil.example/", "///evil.example/a", "/%2fevil.example/", "/\\evil.example"):
        at = f"{locked.console.at.rstrip('/')}{path}?token=wrong"
        answer = client.get(at, follow_redirects=False)
        assert answer.status_code == 303
        assert not answer.headers["location"].startswith(("//", "/\\", "http")), path


def test_each_link_lets_do_what_its_role_may(locked: Locked) -> None:
    def rights(page: Page) -> tuple[bool, bool]:
        found = page.until(lambda state: state.get("hello", {}).get("live"))["hello"]["rights"]
        return found["teach"], found["operate"]

    with locked.page("viewer") as page:
        assert rights(page) == (False, False)
        assert "teacher's link" in page.ask(do="join", name="eve")["words"]
        assert "operator's link" in page.ask(do="control", paused=True)["words"]
        assert not page.say(b"\0\0")["ok"]
    with locked.page("teacher") as page:
        assert rights(page) == (True, False)
        assert page.ask(do="join", name="eve")["ok"]
        assert "operator's link" in page.ask(do="change", settings={"swapped": True})["words"]
        assert page.ask(do="leave")["ok"]
    with locked.page("operator") as page:
        assert rights(page) == (True, True)
        assert page.ask(do="control", paused=False)["ok"]


def test_plain_http_is_not_answered(locked: Locked) -> None:
    site = locked.console.guard.site
    with pytest.raises(httpx.HTTPError):
        httpx.get(f"http://{site.host}:{site.port}/")


def test_the_pages_certificate_is_for_where_it_listens(tmp_path: Path) -> None:
    folder = KeyFolder.create(tmp_path / "keys", BRAIN, ["brain.lan"])
    first = folder.page_certificate("0.0.0.0").read_bytes()
    assert folder.page_certificate("127.0.0.1").read_bytes() == first, "it is kept"
    assert folder.page_certificate("192.168.7.7").read_bytes() != first, "it is for another host as well"
    assert folder.page_certificate("").read_bytes() != first


def test_tokens_that_are_not_ours_are_said(tmp_path: Path) -> None:
    (tmp_path / TOKENS_FILE).write_text(json.dumps({"viewer": "short"}))
    with pytest.raises(ConfigError, match="remove it"):
        tokens_in(tmp_path)


def test_a_token_is_compared_whole() -> None:
    guard = Guard(Site("127.0.0.1", 1), frozenset({"127.0.0.1"}), {"viewer": "abc", "teacher": "abd"})
    assert guard.role_of("abd") == "teacher"
    for wrong in ("", "ab", "abcd", "äbc", "\ud800"):
        assert guard.role_of(wrong) is None
    with pytest.raises(RefusedError):
        guard.rights(None, "mdb-1=abe; x")
    assert not guard.rights(None, "mdb-1=abc").teach


def test_a_viewers_bundle_shows_the_brain_and_no_more(tmp_path: Path) -> None:
    folder = KeyFolder.create(tmp_path / "keys", BRAIN)
    bundle = folder.add(Role.VIEWER, "tom")
    listen = "tls/127.0.0.1:0"
    router = Router(ROUTER_CONFIG, listen, keys=folder.router_keys(listen))
    run = run_folder(tmp_path / "runs" / "now")
    options = WebOptions(Place(router.endpoint(), run, keys=bundle), port=0)
    with Console(options) as console, ZenohBus(BRAIN, router.endpoint(), credentials=folder.path) as brain:
        ((role, link),) = console.guard.links().items()
        assert role == "viewer"
        cookies = httpx.get(link).cookies
        header = "; ".join(f"{name}={value}" for name, value in cookies.items())
        with Page(console, additional_headers={"Cookie": header}) as page:
            page.until(lambda state: state.get("hello", {}).get("live"))
            brain.publisher(keys.SCENE).put(scene(7))
            page.until(lambda state: state.get("scene", {}).get("iteration") == 7)
            assert not page.ask(do="join", name="tom")["ok"]
        assert "viewer/tom" in brain.alive()
    router.close()


def test_a_bundle_is_shown_by_the_same_links_in_each_process_and_lets_do_no_more(tmp_path: Path) -> None:
    folder = KeyFolder.create(tmp_path / "keys", BRAIN)
    bundles = {
        Role.VIEWER: folder.add(Role.VIEWER, "tom"),
        Role.OPERATOR: folder.add(Role.OPERATOR, "olga"),
        Role.BRAIN: folder.path / "brains" / f"{BRAIN}.pem",
    }
    links = {role: guard_of(WebOptions(Place(keys=path)), 1).links() for role, path in bundles.items()}
    assert links == {role: guard_of(WebOptions(Place(keys=path)), 1).links() for role, path in bundles.items()}
    assert {role: set(found) for role, found in links.items()} == {
        Role.VIEWER: {"viewer"},
        Role.OPERATOR: {"viewer", "operator"},
        Role.BRAIN: {"viewer", "teacher", "operator"},
    }
    assert len({link for found in links.values() for link in found.values()}) == 6
    guard = guard_of(WebOptions(Place(keys=bundles[Role.OPERATOR])), 1)
    assert guard.tokens is not None
    assert guard.rights(guard.tokens["operator"], None) == (False, True), "an operator's bundle cannot teach"
    assert any("to watch and operate" in line for line in guard.lines())


def test_a_connection_without_a_request_is_closed(console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serve, "REQUEST_S", 0.2)
    site = console.guard.site
    for beginning in (b"", b"GET / HT", b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\nGET / HT"):
        with socket.create_connection((site.host, site.port), BOUND_S) as link:
            link.sendall(beginning)
            with suppress(ConnectionError):
                while link.recv(65536):
                    pass
    with Page(console) as page:
        page.until(lambda state: "hello" in state)
        time.sleep(0.5)
        assert not page.ask(do="leave")["ok"], "a socket stays"


@pytest.mark.parametrize(
    ("host", "only_here"),
    [("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("localhost", True), ("127.elsewhere.invalid", False),
     ("0.0.0.0", False), ("::", False), ("", False)],
)  # fmt: skip
def test_only_this_machine_reaches_a_loopback_address(host: str, only_here: bool) -> None:
    assert is_loopback(host) is only_here
