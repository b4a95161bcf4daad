"""`mdb up --web` as people use it: the page's address, the bridge's death, the router's, the run's end, Ctrl-C."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.exceptions import ConnectionClosed

from mdb_deploy.web.live.hub import ROUTER_GONE
from mdb_deploy.web.opening import Place, WebOptions
from mdb_protocol import keys
from tests.integration.brain import Brain, until
from tests.web.rig import BOUND_S, Console, Page

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]

LASTING = ("experiment.iterations=5000", "robot.action_s=0.05")


class Served:
    """A brain with its page; `at` is where."""

    def __init__(self, brain: Brain) -> None:
        self.brain = brain

        def address() -> str:
            assert brain.process.poll() is None, brain.output()
            found = re.search(r"^page: (http://\S+)$", brain.output(), re.MULTILINE)
            return found[1] if found else ""

        self.at = str(until(address))

    @property
    def live(self) -> str:
        return self.at.replace("http", "ws", 1) + "live"

    def page(self, bound_s: float = BOUND_S) -> Page:
        """Open the page; while the bridge begins again it is tried again, as a browser does."""
        deadline = time.monotonic() + bound_s
        while True:
            try:
                return Page(self)  # type: ignore[arg-type]
            except OSError:
                assert time.monotonic() < deadline, self.brain.output()
                time.sleep(0.02)


def iteration(state: dict[str, Any]) -> int:
    return int((state.get("scene") or {}).get("iteration", -1))


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    with Brain(tmp_path, *LASTING, options=("--web",)) as brain:
        yield Served(brain)


def test_the_page_is_there_before_the_brain_and_shows_it(served: Served) -> None:
    assert "ready: optimizer" not in served.brain.output(), "the page is there first"
    assert httpx.get(served.at).status_code == 200
    with served.page() as page:
        page.until(lambda state: iteration(state) > 20, 60.0)
        page.until(lambda state: state.get("picture") and state.get("thought") and state.get("rows"))
        page.until(lambda state: set(state.get("models", ())) == {"communication", "object", "induced"})
        assert page.state["hello"]["run"] == served.brain.run.name
        bus = served.brain.bus()
        status = served.brain.status(bus, "web", "console")
        assert status is not None
        assert status.values["browsers"] == 1
        bus.close()


def test_the_operator_changes_the_robot_and_pauses_it(served: Served) -> None:
    with served.page() as page:
        page.until(lambda state: iteration(state) > 5, 60.0)
        assert page.ask(do="change", settings={"swapped": True})["ok"]
        refused = page.ask(do="change", settings={"swappd": True})
        assert not refused["ok"]
        assert "did you mean 'swapped'" in refused["words"]
        refused = page.ask(do="change", settings={"swapped": "perhaps"})
        assert not refused["ok"]
        assert "refused swapped = perhaps" in refused["words"]
        assert page.ask(do="control", paused=True)["ok"]
        page.until(lambda state: (state.get("control") or {}).get("paused"))
        bus = served.brain.bus()
        scenes = bus.subscriber(keys.SCENE)
        at = until(scenes.take)
        assert page.ask(do="control", paused=False)["ok"]
        page.until(lambda state: iteration(state) > at.iteration + 5)  # type: ignore[attr-defined]
        bus.close()


@pytest.mark.slow
def test_a_bridge_that_is_killed_is_back_at_the_same_place(served: Served) -> None:
    page = served.page()
    before = iteration(page.until(lambda state: iteration(state) > 20 and "rows" in state, 60.0))
    child = served.brain.child("web")
    assert child is not None
    child.kill()
    with pytest.raises((ConnectionClosed, EOFError)):
        page.until(lambda _: False)
    with served.page() as again:
        state = again.until(lambda state: iteration(state) > before and "rows" in state, 60.0)
        assert state["rows"]["iteration"][0] == 0, "what was before is read from the run's log"
    assert served.brain.process.poll() is None


def test_a_pause_outlives_the_bridge_and_then_the_robot(served: Served) -> None:
    with served.page() as page:
        page.until(lambda state: iteration(state) > 5, 60.0)
        assert page.ask(do="control", paused=True)["ok"]
        page.until(lambda state: (state.get("control") or {}).get("paused"))
    bus = served.brain.bus()
    heard = bus.subscriber(keys.CONTROL)
    until(heard.take)

    def is_paused() -> bool:
        status = served.brain.status(bus, "robot", "body")
        return status is not None and status.values["paused"] == 1

    until(is_paused)
    for word in ("web", "robot"):
        child = served.brain.child(word)
        assert child is not None
        child.kill()
        child.wait(BOUND_S)
        if word == "web":
            until(heard.take)  # the new bridge has said it again
    until(lambda: served.brain.child("robot"))
    until(is_paused)
    bus.close()
    with served.page(60.0) as page:
        page.until(lambda state: (state.get("control") or {}).get("paused"))
        before = iteration(page.until(lambda state: iteration(state) > 0))
        assert page.ask(do="control", paused=False)["ok"]
        page.until(lambda state: iteration(state) > before + 5, 60.0)


@pytest.mark.slow
def test_a_router_that_is_killed_is_told_of_and_the_page_goes_on(served: Served) -> None:
    with served.page() as page:
        before = iteration(page.until(lambda state: iteration(state) > 5, 60.0))
        router = served.brain.child("router")
        assert router is not None
        router.kill()
        page.until(lambda state: state.get("trouble") == ROUTER_GONE)
        page.until(lambda state: iteration(state) > before + 5 and state.get("trouble") is None, 60.0)


def test_mdb_web_finds_the_brain_and_what_was_before(served: Served, tmp_path: Path) -> None:
    with served.page() as page:
        page.until(lambda state: iteration(state) > 40, 60.0)
    endpoint = (served.brain.run / "router.endpoint").read_text()
    found = WebOptions(Place(endpoint), port=0, instance="page-1", runs=tmp_path)
    elsewhere = Place(endpoint, experiment=served.brain.run / "experiment.toml")
    with Console(found) as console, Page(console) as page:
        state = page.until(lambda state: "rows" in state and "memory" in state)
        assert state["hello"]["run"] == served.brain.run.name
        assert state["rows"]["iteration"][0] == 0, "from the run's log"
    with Console(WebOptions(elsewhere, port=0, instance="page-2")) as console, Page(console) as page:
        state = page.until(lambda state: len(state.get("memory") or ()) and len(state.get("models") or ()))
        assert state["memory"]["communication"]["used"] > 20, "asked of the memory store"


def test_ten_browsers_and_one_that_is_stopped(served: Served) -> None:
    from tests.web.test_server import stopped_browser

    pages = [served.page() for _ in range(10)]
    site = httpx.URL(served.at)
    with stopped_browser(site.host, site.port or 80):
        for least in range(31):  # in turns: who reads nothing for long answers no ping, and is given up
            for page in pages:
                page.until(lambda state, least=least: iteration(state) > least, 60.0)  # type: ignore[misc]
        for page in pages:
            page.close()


def test_the_page_goes_on_when_the_run_is_over(tmp_path: Path) -> None:
    with Brain(tmp_path, "experiment.iterations=30", options=("--web",)) as brain:
        served = Served(brain)
        with served.page() as page:
            page.until(lambda state: state.get("finished"), 90.0)
            until(lambda: "the page goes on" in brain.output())
            assert brain.child("optimizer") is None
            (found,) = httpx.get(served.at + "runs").json()
            assert found["name"] == brain.run.name
            rows = httpx.get(f"{served.at}runs/{found['name']}/rows", timeout=BOUND_S).json()
            assert rows["iteration"] == list(range(30))
            child = brain.child("web")
            assert child is not None
            child.kill()
        with served.page() as page:
            page.until(lambda state: state.get("finished"))
        brain.interrupt()
        assert brain.wait(20.0) == 0
        assert brain.output().count("results:") == 1


def test_a_page_that_cannot_be_kept_up_is_refused_and_the_run_goes_on(served: Served) -> None:
    with served.page() as page:
        page.until(lambda state: iteration(state) > 5, 60.0)
    deadline = time.monotonic() + 120.0
    while "the run goes on without it" not in served.brain.output():
        assert time.monotonic() < deadline
        if (child := served.brain.child("web")) is not None:
            child.kill()
        time.sleep(0.05)

    def is_refused() -> bool:
        try:
            httpx.get(served.at, timeout=2.0)
        except httpx.ConnectError:
            return True
        return False

    until(is_refused)
    bus = served.brain.bus()
    scenes = bus.subscriber(keys.SCENE)
    first = until(scenes.take)
    until(lambda: (scene := scenes.take()) is not None and scene.iteration > first.iteration + 5)  # type: ignore[attr-defined]
    bus.close()


def test_a_bridge_that_is_frozen_for_a_while_holds_nobody_up(served: Served) -> None:
    with served.page() as page:
        page.until(lambda state: iteration(state) > 5, 60.0)
        assert page.ask(do="join", name="ann")["ok"]
        bus = served.brain.bus()
        until(lambda: "teacher/ann" in bus.alive())
        assert page.ask(do="wait", on=True)["ok"]
        child = served.brain.child("web")
        assert child is not None
        scenes = bus.subscriber(keys.SCENE)
        child.suspend()
        first = until(scenes.take)
        until(lambda: (scene := scenes.take()) is not None and scene.iteration > first.iteration + 50)  # type: ignore[attr-defined]
        if child.is_running():
            child.resume()
        bus.close()
    with served.page(60.0) as page:
        before = iteration(page.until(lambda state: iteration(state) > 0, 60.0))
        page.until(lambda state: iteration(state) > before + 5, 60.0)


def test_ctrl_c_in_the_middle_ends_the_page_too(served: Served) -> None:
    with served.page() as page:
        page.until(lambda state: iteration(state) > 2, 60.0)
        served.brain.interrupt()
        assert served.brain.wait(30.0) == 130
        with pytest.raises((ConnectionClosed, EOFError)):
            page.until(lambda _: False)


def test_a_port_that_is_taken_is_said_before_anything_is_started(tmp_path: Path) -> None:
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        options = ("--web", "--web-port", str(taken.getsockname()[1]))
        with Brain(tmp_path, *LASTING, options=options) as brain:
            assert brain.wait(30.0) == 2
            assert "cannot be served" in brain.output()
