"""The console over the wire: a real router, a real server, real sockets; robot and optimizer played by hand."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed

from mdb_deploy.web.live import bridge, guests, visitor
from mdb_deploy.web.live.hub import ROUTER_GONE, Hub
from mdb_protocol import messages
from tests.web.rig import BOUND_S, BRAIN, Console, Page, Played, options_of, router, run_folder

WATCHED = "viewer/console"


class Place:
    """A router, a brain that is played, a console."""

    def __init__(self, brain: Played, console: Console, run: Path) -> None:
        self.brain, self.console, self.run = brain, console, run


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    run = run_folder(tmp_path_factory.mktemp("server") / "runs" / "now", "ear.detector=template")
    with router() as running:
        (run / "router.endpoint").write_text(running.endpoint())
        with Played(running.endpoint()) as brain, Console(options_of(None, run, runs=run.parent)) as console:
            brain.show(0)
            yield Place(brain, console, run)


@pytest.fixture
def page(place: Place) -> Iterator[Page]:
    with Page(place.console) as found:
        found.until(lambda state: "scene" in state and state.get("hello", {}).get("live"))
        yield found


@pytest.fixture
def ann(place: Place, page: Page) -> Iterator[Page]:
    """A page on which ann teaches."""
    assert page.ask(do="join", name="ann", language="reversed")["ok"]
    try:
        page.until(lambda state: state["you"].get("name") == "ann", 8.0)
    except TimeoutError as error:
        raise AssertionError(page.state["you"]) from error
    yield page
    page.ask(do="leave")
    place.brain.wait_until(lambda alive: "teacher/ann" not in alive)


def test_a_page_sees_the_brain(place: Place, page: Page) -> None:
    assert (page.state["hello"]["brain"], page.state["hello"]["run"]) == (BRAIN, "now")
    assert page.state["hello"]["rights"] == {"teach": True, "operate": True}
    place.brain.show(5)
    page.until(lambda state: state["scene"]["iteration"] == 5)


def test_who_is_told_of_a_brain_can_teach_it(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """However long the router takes for what the console wants to hear."""

    class Slow(Hub):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            time.sleep(0.5)

    monkeypatch.setattr(bridge, "Hub", Slow)
    with Console(options_of(None, place.run, runs=place.run.parent)) as console, Page(console) as page:
        page.until(lambda state: state.get("hello", {}).get("live"))
        said = page.ask(do="join", name="eve", language="ordered")
        assert said["ok"], said
    place.brain.wait_until(lambda alive: "teacher/eve" not in alive)


def test_the_robot_is_told_that_somebody_watches(place: Place) -> None:
    place.brain.wait_until(lambda alive: WATCHED not in alive)
    with Page(place.console):
        place.brain.wait_until(lambda alive: WATCHED in alive)
    place.brain.wait_until(lambda alive: WATCHED not in alive)


def test_browsers_share_what_is_heard(place: Place) -> None:
    pages = [Page(place.console) for _ in range(5)]
    place.brain.show(11)
    for each in pages:
        each.until(lambda state: state.get("scene", {}).get("iteration") == 11)
        each.close()


def test_a_note_and_its_judgement_reach_the_brain(place: Place, ann: Page) -> None:
    place.brain.wait_until(lambda alive: "teacher/ann" in alive)
    place.brain.show(20)
    ann.until(lambda state: state["you"]["turn"]["iteration"] == 20)
    assert ann.ask(do="note", note=3)["ok"]
    said = place.brain.wait_for(place.brain.commands, lambda command: command.note == 3)
    assert (said.teacher, said.iteration) == ("ann", 20)
    place.brain.show(21)
    ann.until(lambda state: state["you"]["turn"]["kind"] == "both")
    assert ann.ask(do="judge", iteration=20, value=0.5)["ok"]
    judged = place.brain.wait_for(place.brain.feedback, lambda feedback: feedback.value is not None)
    assert (judged.teacher, judged.iteration, judged.value) == ("ann", 20, 0.5)


def test_silence_waiting_language_and_auto_are_told_back(ann: Page) -> None:
    for order, changed in (
        ({"do": "silent", "on": True}, lambda you: you["paused"]),
        ({"do": "silent", "on": False}, lambda you: not you["paused"]),
        ({"do": "wait", "on": True}, lambda you: you["waits"]),
        ({"do": "wait", "on": False}, lambda you: not you["waits"]),
        ({"do": "auto", "on": True}, lambda you: you["auto"]),
        ({"do": "auto", "on": False}, lambda you: not you["auto"]),
        ({"do": "speak", "language": [6, 5, 4, 3, 2, 1, 0]}, lambda you: you["language"] == [6, 5, 4, 3, 2, 1, 0]),
        ({"do": "speak", "language": "random"}, lambda you: sorted(you["language"]) == list(range(7))),
    ):
        assert ann.ask(**order)["ok"]
        ann.until(lambda state, changed=changed: changed(state["you"]))


def test_sound_reaches_the_ear(place: Place, ann: Page) -> None:
    assert not ann.say(b"\0\0")["ok"], "the rate was not said"
    assert ann.ask(do="microphone", rate_hz=16_000)["ok"]
    samples = np.arange(-400, 400, dtype="<i2")
    ann.send(samples.tobytes())
    heard = place.brain.wait_for(place.brain.audio)
    assert (heard.teacher, heard.rate_hz) == ("ann", 16_000)
    np.testing.assert_array_equal(heard.samples, samples)
    assert not ann.say(b"\0\0\0")["ok"], "half a sample"
    assert ann.ask(do="microphone", rate_hz=None)["ok"]


def test_a_name_is_one_persons(place: Place, ann: Page) -> None:
    with Page(place.console) as other:
        refused = other.ask(do="join", name="ann", language="reversed")
        assert not refused["ok"]
        assert "ann" in refused["words"]
        for name in ("a b", "", "../x", "a" * 65, "one", "script"):
            assert not other.ask(do="join", name=name)["ok"], name
        assert not other.ask(do="join", name="bert", language=[0, 0, 1, 2, 3, 4, 5])["ok"]
        assert not other.ask(do="join", name="bert", language="klingon")["ok"]
        assert not other.ask(do="note", note=1)["ok"], "who has not joined teaches nothing"
    assert ann.ask(do="note", note=99)["words"].startswith("there is no note 99")
    assert not ann.ask(do="judge", iteration=10**9, value=1)["ok"]


def test_a_lesson_ends_with_its_sum(place: Place, page: Page) -> None:
    assert page.ask(do="join", name="eve", language="ordered")["ok"]
    place.brain.wait_until(lambda alive: "teacher/eve" in alive)
    assert page.ask(do="leave")["ok"]
    page.until(lambda state: state["you"].get("name") is None and "summary" in state["you"])
    assert page.state["you"]["summary"]["commands"] == 0
    place.brain.wait_until(lambda alive: "teacher/eve" not in alive)


def test_a_page_that_is_loaded_again_goes_on_with_its_lesson(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    cookies = place.console.get("/").headers["set-cookie"].partition(";")[0]
    options = {"additional_headers": {"Cookie": cookies}}
    with Page(place.console, **options) as first:
        first.until(lambda state: "scene" in state)
        assert first.ask(do="join", name="fay", language="ordered")["ok"]
    with Page(place.console, **options) as again:
        again.until(lambda state: state.get("you", {}).get("name") == "fay")
        assert again.ask(do="silent", on=False)["ok"]
        with Page(place.console) as stranger:
            stranger.until(lambda state: "name" in state.get("you", {}))
            assert stranger.state["you"]["name"] is None
    monkeypatch.setattr(guests, "BACK_S", 0.1)
    place.brain.wait_until(lambda alive: "teacher/fay" not in alive)


def test_the_operator_pauses_and_sets_the_pace(place: Place, page: Page) -> None:
    place.brain.show(33)
    page.until(lambda state: state["scene"]["iteration"] == 33)
    assert page.ask(do="control", paused=True)["ok"]
    assert page.ask(do="control", action_s=0.5, script=False)["ok"]
    assert page.ask(do="control", end_phase=True)["ok"]
    assert page.ask(do="control", paused=False)["ok"]
    expected = messages.Control(iteration=33, paused=False, action_s=0.5, script=False, ended=[33])
    assert place.brain.wait_for(place.brain.controls, lambda said: not said.paused) == expected
    assert not page.ask(do="control")["ok"], "nothing is to be changed"
    page.until(lambda state: (state.get("control") or {}).get("action_s") == 0.5)


def test_without_a_robot_nothing_is_changed(page: Page) -> None:
    refused = page.ask(do="change", settings={"swapped": True})
    assert not refused["ok"]
    assert "no robot" in refused["words"]
    assert not page.ask(do="change", settings={"a b": True})["ok"]
    assert not page.ask(do="change", settings={"swapped": {"deep": 1}})["ok"]


HOSTILE = (
    "", "{", "null", "[]", "1", '"x"', "{}", '{"do": 1}', '{"do": null}', '{"do": "dance"}', '{"do": "note"}',
    '{"do": "note", "note": "a"}', '{"do": "note", "note": -1}', '{"do": "note", "note": 1e999}',
    '{"do": "note", "note": 1, "more": 2}', '{"do": "judge", "iteration": 0, "value": 2}',
    '{"do": "judge", "iteration": -1, "value": 0}', '{"do": "judge", "iteration": 1, "value": NaN}',
    '{"do": "join"}', '{"do": "join", "name": {"a": 1}}', '{"do": "join", "name": "x", "language": [1e9]}',
    '{"do": "microphone", "rate_hz": 1}', '{"do": "microphone", "rate_hz": 1e12}',
    '{"do": "control", "action_s": -1}',
    '{"do": "control", "paused": "yes"}', '{"do": "change", "settings": {}}', '{"do": "change", "settings": 1}',
    "[" * 20_000, '{"do": ' + "[" * 20_000, '{"do": "\\ud800"}', "x" * 70_000, '{"do": "leave"}',
)  # fmt: skip


def test_what_is_not_understood_is_answered_in_words(page: Page) -> None:
    for text in HOSTILE:
        answer = page.say(text)
        assert not answer["ok"], text[:80]
        assert answer["words"], text[:80]
    assert page.say(b"\0" * 100)["ok"] is False, "sound of nobody"
    assert page.ask(do="control", paused=False)["ok"], "and the page goes on"


def test_a_message_that_is_too_large_ends_its_connection_only(place: Place, page: Page) -> None:
    with Page(place.console) as large:
        large.send("x" * 2**20)
        with pytest.raises(ConnectionClosed):
            large.until(lambda _: False)
    place.brain.show(40)
    page.until(lambda state: state["scene"]["iteration"] == 40)


def test_who_asks_too_much_is_read_more_slowly(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(visitor, "ORDERS_HZ", 100.0)
    began_s, count = time.monotonic(), visitor.ORDERS_AT_ONCE + 60
    for _ in range(count):
        page.send('{"do": "dance"}')
    answers = 0
    while answers < count:
        answers += page.take()["is"] == "said"
    assert time.monotonic() - began_s > 0.4, "sixty more than at once, at a hundred a second"


def stopped_browser(host: str, port: int) -> socket.socket:
    """Open a socket as a browser does, and read nothing from it any more."""
    link = socket.socket()
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    link.connect((host, port))
    key = "dGhlIHNhbXBsZSBub25jZQ=="
    link.sendall(
        f"GET /live HTTP/1.1\r\nHost: {host}:{port}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
        f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {key}\r\n\r\n".encode()
    )
    assert link.recv(1024).startswith(b"HTTP/1.1 101")
    return link


def test_a_stopped_browser_loses_frames_and_nobody_else_does(
    place: Place, page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(visitor, "TAKES_S", 1.0)
    image = np.random.default_rng(1).integers(0, 256, (256, 256, 3), np.uint8)  # 200 kB, which do not shrink
    site = place.console.guard.site
    with stopped_browser(site.host, site.port) as stopped:
        deadline, iteration = time.monotonic() + BOUND_S, 1000
        while True:
            iteration += 1
            place.brain.pictures.put(messages.Picture(iteration=iteration, image=image))
            place.brain.show(iteration)
            page.until(lambda state: state["scene"]["iteration"] == iteration)  # noqa: B023
            if is_cut_off(stopped):
                break
            assert time.monotonic() < deadline, "the stopped browser was not cut off"


def is_cut_off(link: socket.socket) -> bool:
    """Whether the other end has dropped a connection, of which nothing is read."""
    found = link.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 1)[0]
    return found != 1  # ESTABLISHED


def test_no_more_than_so_many_browsers(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    from websockets.exceptions import InvalidStatus

    from mdb_deploy.web import server

    monkeypatch.setattr(server, "MOST_VISITORS", 2)
    with Page(place.console), Page(place.console), pytest.raises(InvalidStatus, match="503"):
        Page(place.console)


def test_no_more_than_so_many_teachers(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guests, "MOST_TEACHERS", 1)
    monkeypatch.setattr(guests, "BACK_S", 0.1)
    with Page(place.console) as first, Page(place.console) as second:
        first.until(lambda state: "scene" in state)
        assert first.ask(do="join", name="gil")["ok"]
        assert "no more" in second.ask(do="join", name="hal")["words"]
    place.brain.wait_until(lambda alive: "teacher/gil" not in alive)


# ---- files


def test_the_page_is_served_as_browsers_want_it(place: Place) -> None:
    index = place.console.get("/")
    assert index.status_code == 200
    assert index.headers["content-type"] == "text/html; charset=utf-8"
    script = place.console.get("/page/main.js")
    assert script.headers["content-type"] == "text/javascript; charset=utf-8"
    assert script.headers["cache-control"] == "no-cache"
    again = place.console.get("/page/main.js", headers={"If-None-Match": script.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")


@pytest.mark.parametrize(
    "path",
    ["/page/../server.py", "/page/%2e%2e/server.py", "/page/..%2fserver.py", "/page//etc/passwd", "/page/none.js",
     "/page/", "/page/teach", "/page/%00.js", "/server.py", "/page/../../cli/main.py"],
)  # fmt: skip
def test_nothing_else_is_served(place: Place, path: str) -> None:
    site = place.console.guard.site
    with socket.create_connection((site.host, site.port), BOUND_S) as link:  # as it is: a client would mend the path
        link.sendall(f"GET {path} HTTP/1.1\r\nHost: {site.host}\r\nConnection: close\r\n\r\n".encode())
        said = b""
        while part := link.recv(65536):
            said += part
    assert said.startswith(b"HTTP/1.1 404"), said[:200]


# ---- the router


def test_a_router_that_dies_and_comes_back(tmp_path: Path) -> None:
    run = run_folder(tmp_path / "runs" / "now")
    with Console(options_of(None, run)) as console, Page(console) as page:
        page.until(lambda state: state.get("trouble") == "the brain starts")
        assert page.state["hello"]["live"] is False
        with router() as running:
            endpoint = running.endpoint()
            (run / "router.endpoint").write_text(endpoint)
            with Played(endpoint) as brain:
                brain.show(3)
                page.until(lambda state: state.get("scene", {}).get("iteration") == 3)
                page.until(lambda state: state["trouble"] is None)
        page.until(lambda state: state["trouble"] == ROUTER_GONE)
        with router(endpoint), Played(endpoint) as brain:
            page.until(lambda state: state["trouble"] is None)
            brain.show(4)
            page.until(lambda state: state["scene"]["iteration"] == 4)


def test_a_console_without_a_brain_says_what_it_waits_for(tmp_path: Path) -> None:
    with router() as running, Console(options_of(running.endpoint(), None, runs=tmp_path)) as console:
        with Page(console) as page:
            page.until(lambda state: "mdb up" in (state.get("trouble") or ""))
            refused = page.ask(do="join", name="ann")
            assert not refused["ok"]
            assert "no brain" in refused["words"]
        assert json.loads(console.get("/runs").content) == []
