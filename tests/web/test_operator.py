"""How the run goes on, as operators say it by the page: it is known after any death, and heard by who is late."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from mdb_deploy.web.live import hub as hubs
from mdb_deploy.web.live import operator as operators
from mdb_deploy.web.opening import Place, WebOptions
from mdb_protocol import keys, messages
from mdb_protocol.bus import Inbox
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_services.recorder import Recorder
from mdb_services.shell.service import run
from tests.web.rig import BRAIN, Console, Page, Played, options_of, router, run_folder

LATE_S = 0.6
"""So long who comes late listens."""


@contextmanager
def recorded(endpoint: str, folder: Path) -> Iterator[None]:
    """A recorder that writes the run's log."""
    ended = threading.Event()
    recorder = Recorder(ZenohBus(BRAIN, endpoint), folder)
    thread = threading.Thread(target=run, args=(recorder, ended.is_set))
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hubs, "SILENT_S", 0.2)
    monkeypatch.setattr(operators, "BEHIND_S", 0.1)


def heard_late(endpoint: str) -> list[messages.Control]:
    """Join as a robot does that begins anew; return all that it hears of how the run goes on."""
    with ZenohBus(BRAIN, endpoint) as bus:
        inbox: Inbox = bus.subscriber(keys.CONTROL)
        found: list[messages.Control] = []
        deadline = time.monotonic() + LATE_S
        while (left_s := deadline - time.monotonic()) > 0:
            bus.wait(left_s)
            found += inbox.some()
        return found


def joined(page: Page) -> None:
    page.until(lambda state: "scene" in state and state.get("hello", {}).get("live"))


@contextmanager
def shown(runs: Path, iteration: int, *settings: str) -> Iterator[tuple[Played, Page, str]]:
    """A brain at this iteration, a page that shows it, and the router's endpoint."""
    folder = run_folder(runs / "now", *settings)
    with router() as running, Played(running.endpoint()) as brain:
        endpoint = running.endpoint()
        with Console(options_of(endpoint, folder)) as console, Page(console) as page:
            brain.show(iteration)
            joined(page)
            yield brain, page, endpoint


def test_what_a_dead_bridge_said_is_read_in_the_log_and_said_again(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "runs" / "now")
    with router() as running, Played(running.endpoint()) as brain:
        endpoint = running.endpoint()
        with recorded(endpoint, folder):
            with Console(options_of(endpoint, folder)) as console, Page(console) as page:
                brain.show(7)
                joined(page)
                assert page.ask(do="control", paused=True, script=False)["ok"]
                assert page.ask(do="control", end_phase=True)["ok"]
            brain.wait_for(brain.controls, lambda said: said.ended == [7])
        assert heard_late(endpoint) == [], "nobody says it any more"
        with Console(options_of(endpoint, folder)) as console, Page(console) as page:
            again = brain.wait_for(brain.controls)
            assert (again.paused, again.script, again.ended) == (True, False, [7])
            page.until(lambda state: (state.get("control") or {}).get("paused"))
            assert heard_late(endpoint) == [again]
            joined(page)
            assert page.ask(do="control", paused=False)["ok"], "and it is gone on with from there"
            said = brain.wait_for(brain.controls, lambda said: not said.paused)
            assert (said.script, said.ended) == (False, [7])


def test_without_a_log_robot_and_teacher_are_asked(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "runs" / "now")
    states = {
        ("robot", "body"): {"paused": 1.0, "least_s": 0.5},
        ("teacher", "script"): {"silenced": 1.0},
    }
    with router() as running, Played(running.endpoint()) as brain:
        bus = brain.bus
        for (role, instance), values in states.items():
            status = messages.Status(role=role, instance=instance, pid=1, uptime_s=1.0, values=values, refused={})
            bus.queryable(keys.STATUS, lambda status=status: status, role=role, instance=instance)
            bus.token(role, instance)
        elsewhere = Place(running.endpoint(), experiment=folder / EXPERIMENT_FILE)
        with Console(WebOptions(elsewhere, port=0)):
            found = []
            for _ in range(200):
                bus.serve()
                bus.wait(0.05)
                if found := list(brain.controls.some()):
                    break
            assert [(said.paused, said.action_s, said.script) for said in found] == [(True, 0.5, False)]


def test_nothing_is_said_of_a_run_that_goes_on_as_usual(tmp_path: Path) -> None:
    with shown(tmp_path / "runs", 1) as (_, _, endpoint):
        assert heard_late(endpoint) == []


def test_of_two_operators_only_the_last_one_is_heard_by_who_comes_late(tmp_path: Path) -> None:
    with shown(tmp_path / "runs", 1) as (brain, page, endpoint):
        assert page.ask(do="control", paused=True)["ok"]
        other = brain.bus.publisher(keys.CONTROL)
        last = messages.Control(iteration=1, action_s=0.5)
        other.put(last)
        page.until(lambda state: (state.get("control") or {}).get("action_s") == 0.5)
        for _ in range(20):
            if heard_late(endpoint) == [last]:
                break
        assert heard_late(endpoint) == [last]
        assert page.ask(do="control", paused=True)["ok"], "its own turn comes again"
        said = brain.wait_for(brain.controls, lambda said: said.paused and said.action_s is not None)
        assert said.action_s == 0.5


def test_what_holds_is_known_after_the_router_was_away(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "runs" / "now")
    with Console(options_of(None, folder)) as console, Page(console) as page:
        with router() as running:
            endpoint = running.endpoint()
            (folder / "router.endpoint").write_text(endpoint)
            with Played(endpoint) as brain:
                brain.show(3)
                joined(page)
                assert page.ask(do="control", paused=True)["ok"]
        page.until(lambda state: state["trouble"] is not None)
        with router(endpoint), Played(endpoint) as brain:
            page.until(lambda state: state["trouble"] is None)
            brain.show(4)
            page.until(lambda state: state["scene"]["iteration"] == 4)
            assert page.ask(do="control", action_s=0.1)["ok"]
            said = brain.wait_for(brain.controls, lambda said: said.action_s == 0.1)
            assert said.paused, "what was said before holds"


def test_the_last_phase_cannot_be_ended(tmp_path: Path) -> None:
    with shown(tmp_path / "runs", 1999, "teacher.phase.alone.start=5") as (_, page, _):
        refused = page.ask(do="control", end_phase=True)
        assert not refused["ok"]
        assert "last phase" in refused["words"]


def test_what_a_robot_has_not_is_named(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "runs" / "now", "robot.body=kinematic")
    with router() as running, Played(running.endpoint()) as brain:
        brain.bus.token("robot", "body")
        with Console(options_of(running.endpoint(), folder)) as console, Page(console) as page:
            brain.show(1)
            joined(page)
            refused = page.ask(do="change", settings={"swappd": True})
            assert "did you mean 'swapped'" in refused["words"]
