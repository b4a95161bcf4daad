"""The runner: what dies comes back at once; what dies quickly again and again ends the run with its last words."""

import asyncio
import os
import resource
import shutil
import signal
import sys
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from mdb_deploy.supervision import runner as module
from mdb_deploy.supervision.compose import ROUTER, ProcessSpec
from mdb_deploy.supervision.runner import BACKOFF_S, QUICK_DEATHS, Child, Runner, StartError
from mdb_protocol.errors import UNHEARD

BOUND_S = 20.0
READY = "import pathlib, time; pathlib.Path({flag!r}).touch(); "
LIVES = READY + "time.sleep(60)"
DIES = READY + "time.sleep(0.2); print('no disk'); print('giving in'); raise SystemExit(3)"


class Rig:
    """A runner of one process, which is ready as long as its flag file is there."""

    def __init__(self, folder: Path, code: str, *, restarts: bool = True) -> None:
        self.flag = folder / "ready"
        command = (sys.executable, "-u", "-c", code.format(flag=str(self.flag)))
        spec = ProcessSpec("one", command, (), "role/one", {}, restarts)
        self.runner = Runner({"one": spec}, {}, folder / "logs", self.alive)
        self.child = self.runner.children["one"]

    def alive(self) -> frozenset[str]:
        return frozenset({"role/one"}) if self.flag.exists() else frozenset()

    def kill(self) -> None:
        assert self.child.process is not None
        self.flag.unlink()
        os.kill(self.child.process.pid, signal.SIGKILL)


async def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + BOUND_S
    while not condition():
        assert time.monotonic() < deadline, "the condition did not come true within the bound"
        await asyncio.sleep(0.01)


def run(rig: Callable[[], Rig], check: Callable[[Rig], Awaitable[None]]) -> None:
    async def whole() -> None:
        one = rig()
        try:
            await check(one)
        finally:
            await one.runner.stop()

    asyncio.run(whole())


def test_a_killed_process_is_started_again_at_once_and_is_not_ready_until_its_token_is_back(tmp_path: Path) -> None:
    async def check(rig: Rig) -> None:
        await rig.runner.start()
        assert rig.child.ready
        first = rig.child.process
        rig.kill()
        await until(lambda: rig.child.process is not first)
        assert not rig.child.ready
        await until(lambda: rig.child.ready)
        assert (rig.child.restarts, rig.runner.failed.done()) == (1, False)

    run(lambda: Rig(tmp_path, LIVES), check)


def test_who_is_given_nothing_at_its_first_start_is_started_again(tmp_path: Path) -> None:
    async def check(rig: Rig) -> None:
        await rig.runner.start()
        assert (rig.child.restarts, rig.child.ready) == (1, True)

    first = (
        "import pathlib; been = pathlib.Path({flag!r} + '.been')\n"
        f"if not been.exists(): been.touch(); raise SystemExit({UNHEARD})\n"
    )
    run(lambda: Rig(tmp_path, first + LIVES), check)


def test_many_deaths_that_are_not_quick_end_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "QUICK_S", 0.0)

    async def check(rig: Rig) -> None:
        await rig.runner.start()
        for death in range(QUICK_DEATHS + 1):
            rig.kill()
            await until(lambda death=death: rig.child.restarts == death + 1 and rig.child.ready)  # type: ignore[misc]
        assert (rig.child.quick_deaths, rig.runner.failed.done()) == (0, False)

    run(lambda: Rig(tmp_path, LIVES), check)


def test_a_process_that_dies_quickly_again_and_again_ends_the_run_with_its_last_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "BACKOFF_S", 0.01)

    async def check(rig: Rig) -> None:
        await rig.runner.start()
        error = await asyncio.wait_for(rig.runner.failed, BOUND_S)
        said = str(error)
        assert f"one died {QUICK_DEATHS} times in a row" in said
        assert "last with status 3" in said
        assert str(tmp_path / "logs" / "one.log") in said
        assert said.endswith("no disk\n    giving in")
        assert rig.child.restarts == QUICK_DEATHS - 1

    run(lambda: Rig(tmp_path, DIES), check)


def test_a_process_that_does_not_come_back_to_being_ready_is_ended_and_counts_as_a_death(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    once = (
        "import os, pathlib, time; flag = pathlib.Path({flag!r}); first = not (flag.parent / 'again').exists(); "
        "(flag.parent / 'again').touch(); first and flag.touch(); time.sleep(60)"
    )

    async def check(rig: Rig) -> None:
        await rig.runner.start()
        monkeypatch.setattr(module, "READY_S", 0.3)
        monkeypatch.setattr(module, "BACKOFF_S", 0.01)
        rig.kill()
        assert "last with status -9" in str(await asyncio.wait_for(rig.runner.failed, BOUND_S))

    run(lambda: Rig(tmp_path, once), check)


def test_a_process_that_ends_while_starting_is_named_with_its_last_lines(tmp_path: Path) -> None:
    async def check(rig: Rig) -> None:
        with pytest.raises(StartError, match=r"one ended with status 1(.|\n)*ModuleNotFoundError"):
            await rig.runner.start()

    run(lambda: Rig(tmp_path, "import nothing_of_this_name"), check)


def test_what_is_not_to_be_started_again_ends_the_run(tmp_path: Path) -> None:
    async def check(rig: Rig) -> None:
        await rig.runner.start()
        error = await asyncio.wait_for(rig.runner.failed, BOUND_S)
        assert "not to be started again" in str(error)

    run(lambda: Rig(tmp_path, DIES, restarts=False), check)


def test_without_what_is_not_needed_the_run_goes_on_and_it_is_told(tmp_path: Path) -> None:
    async def check(rig: Rig) -> None:
        rig.child.spec = replace(rig.child.spec, needed=False)
        given_up = asyncio.Event()
        rig.runner.on_given_up = given_up.set
        await rig.runner.start()
        await asyncio.wait_for(given_up.wait(), BOUND_S)
        assert not rig.runner.failed.done()

    run(lambda: Rig(tmp_path, "raise SystemExit(2)"), check)


def test_the_first_restart_is_immediate_and_later_ones_wait_ever_longer() -> None:
    spec = ProcessSpec("one", ("true",), (), "role/one", {}, True)
    waits = [Child(spec, Path("log"), quick_deaths=n).backoff_s for n in range(QUICK_DEATHS)]
    assert waits == [0.0, 0.0, BACKOFF_S, 2 * BACKOFF_S, 4 * BACKOFF_S]


BEATS = (
    "import os, pathlib, time; from mdb_services.shell.heartbeat import Heart; flag = pathlib.Path({flag!r}); "
    "heart = Heart.inherited()\n"
)
HANGS_ONCE = BEATS + (
    "again = flag.parent / 'again'\nhangs = not again.exists()\nagain.touch()\nflag.touch()\n"
    "while True:\n    heart.beat(0.3)\n    time.sleep(60 if hangs else 0.01)"
)
NEVER_GETS_READY = BEATS + "heart.beat(0.3)\ntime.sleep(60)"


@pytest.mark.edge("a start that fails, a process that hangs", "a loop that hangs")
def test_a_process_whose_loop_hangs_is_ended_and_started_again(tmp_path: Path) -> None:
    async def check(rig: Rig) -> None:
        await rig.runner.start()
        await until(lambda: rig.child.restarts == 1 and rig.child.ready)
        assert not rig.runner.failed.done()

    with capture_logs() as said:
        run(lambda: Rig(tmp_path, HANGS_ONCE), check)
    (died,) = (line for line in said if line["event"] == "process died")
    assert died["reason"].startswith("it hung: no sign of life for ")


@pytest.mark.edge("a start that fails, a process that hangs", "the router gives one of its clients nothing any more")
def test_a_router_that_gives_a_process_nothing_is_replaced_with_it(tmp_path: Path) -> None:
    async def check(rig: Rig) -> None:
        spec = ProcessSpec(ROUTER, (sys.executable, "-c", "import time; time.sleep(60)"), (), "role/one", {}, True)
        rig.runner.children[ROUTER] = router = Child(spec, tmp_path / "logs" / "router.log")
        await rig.runner.start()
        (tmp_path / "unheard").touch()
        await until(lambda: router.restarts == 1 and router.ready and rig.child.restarts == 1 and rig.child.ready)

    leaves = READY + (
        "there = pathlib.Path({flag!r}).with_name('unheard')\n"
        "while not there.exists(): time.sleep(0.01)\n"
        f"there.unlink(); raise SystemExit({UNHEARD})"
    )
    with capture_logs() as said:
        run(lambda: Rig(tmp_path, leaves), check)
    assert "it gave one nothing any more" in [line.get("reason") for line in said]


@pytest.mark.edge("a start that fails, a process that hangs", "SIGSTOP for good")
def test_a_process_that_is_stopped_for_good_is_ended_and_started_again(tmp_path: Path) -> None:
    lives = BEATS + "flag.touch()\nwhile True:\n    heart.beat(0.3)\n    time.sleep(0.01)"

    async def check(rig: Rig) -> None:
        await rig.runner.start()
        assert rig.child.process is not None
        await until(lambda: rig.child.pulse is not None and rig.child.pulse._limit_s)
        os.kill(rig.child.process.pid, signal.SIGSTOP)
        rig.flag.unlink()
        await until(lambda: rig.child.restarts == 1 and rig.child.ready)

    run(lambda: Rig(tmp_path, lives), check)


@pytest.mark.edge("a start that fails, a process that hangs", "hangs at each start")
def test_one_that_hangs_at_each_start_ends_the_run_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "BACKOFF_S", 0.01)
    monkeypatch.setattr(Child, "patience", 1.0)

    async def check(rig: Rig) -> None:
        with pytest.raises(StartError, match=r"5 times in a row .* last with status -9: it hung: no sign"):
            await rig.runner.start()

    run(lambda: Rig(tmp_path, NEVER_GETS_READY), check)


def test_who_dies_quickly_again_and_again_is_given_more_time_to_show_a_sign_of_life() -> None:
    spec = ProcessSpec("one", ("true",), (), "role/one", {}, True)
    assert [Child(spec, Path("log"), quick_deaths=n).patience for n in range(4)] == [1.0, 2.0, 4.0, 8.0]


@pytest.mark.edge("a start that fails, a process that hangs", "the folder of the logs deleted")
def test_a_log_folder_that_was_deleted_is_made_again(tmp_path: Path) -> None:
    async def check(rig: Rig) -> None:
        await rig.runner.start()
        shutil.rmtree(tmp_path / "logs")
        rig.kill()
        await until(lambda: rig.child.restarts == 1 and rig.child.ready)
        assert rig.child.log_path.exists()

    run(lambda: Rig(tmp_path, LIVES), check)


@pytest.mark.edge("a start that fails, a process that hangs", "a log file that cannot be opened")
def test_a_start_that_fails_is_a_death_that_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "BACKOFF_S", 0.01)

    async def check(rig: Rig) -> None:
        await rig.runner.start()
        shutil.rmtree(tmp_path / "logs")
        (tmp_path / "logs").write_text("in the way")
        rig.kill()
        await until(lambda: rig.child.quick_deaths >= 2)
        (tmp_path / "logs").unlink()
        await until(lambda: rig.child.ready)
        assert not rig.runner.failed.done()

    run(lambda: Rig(tmp_path, LIVES), check)


@pytest.mark.edge("a start that fails, a process that hangs", "no start succeeds")
def test_a_start_that_fails_again_and_again_ends_the_run_saying_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "BACKOFF_S", 0.01)

    async def check(rig: Rig) -> None:
        await rig.runner.start()
        (tmp_path / "logs").rename(tmp_path / "elsewhere")
        (tmp_path / "logs").write_text("in the way")
        rig.kill()
        said = str(await asyncio.wait_for(rig.runner.failed, BOUND_S))
        assert f"one died {QUICK_DEATHS} times in a row" in said
        assert "last for it cannot be started: [Errno 17] File exists" in said

    run(lambda: Rig(tmp_path, LIVES), check)


@pytest.mark.edge("a start that fails, a process that hangs", "no descriptors left for a while")
def test_without_descriptors_for_a_while_the_process_comes_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "BACKOFF_S", 0.01)

    async def check(rig: Rig) -> None:
        await rig.runner.start()
        limits = resource.getrlimit(resource.RLIMIT_NOFILE)
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (3, limits[1]))  # what is open stays open
            rig.kill()
            await until(lambda: rig.child.quick_deaths >= 2)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        await until(lambda: rig.child.ready)

    run(lambda: Rig(tmp_path, LIVES), check)


@pytest.mark.edge("a start that fails, a process that hangs", "a mistake in the runner itself")
def test_a_mistake_in_the_runner_itself_ends_the_run(tmp_path: Path) -> None:
    async def check(rig: Rig) -> None:
        await rig.runner.start()
        rig.child.spec = replace(rig.child.spec, command=("${NOTHING}",))
        rig.kill()
        said = str(await asyncio.wait_for(rig.runner.failed, BOUND_S))
        assert "the runner itself failed: ConfigError: ${NOTHING}" in said

    run(lambda: Rig(tmp_path, LIVES), check)
