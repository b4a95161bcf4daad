"""Do browsers hold up acting? Perception to action with no page, with ten, and with one of them stopped, in one run.

Ten real pages of chromium, drawn by the same cores. Run by name:
`mdb test -m slow tests/benchmarks/test_console_load.py -s`
"""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import psutil
import pytest
from playwright.sync_api import Browser

from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus
from tests.browser.conftest import browser, console, playwright
from tests.integration.brain import until

__all__ = ["browser", "playwright"]
PAGES, ROUNDS, ACTIONS = 10, 3, 150
SETTINGS = ("robot.body=kinematic", "robot.action_s=0.1", "experiment.iterations=100000")


@contextmanager
def pages(browser: Browser, address: str, count: int, *, stop_one: bool) -> Iterator[None]:
    """So many pages, each in a process of its own; one of them is stopped, as a laptop that is closed."""
    contexts = [browser.new_context(viewport={"width": 1280, "height": 800}) for _ in range(count)]
    before = set(drawing())
    for context in contexts:
        context.add_init_script("localStorage.setItem('mdb.guided', 'yes')")
        page = context.new_page()
        page.goto(address)
        page.wait_for_selector("#bars li")
    ours = sorted(set(drawing()) - before)
    if stop_one:
        os.kill(ours[-1], signal.SIGSTOP)
    yield
    if stop_one:
        os.kill(ours[-1], signal.SIGCONT)
    for context in contexts:
        context.close()


def drawing() -> Iterator[int]:
    """The processes of chromium that draw pages."""
    for process in psutil.Process().children(recursive=True):
        with suppress(psutil.Error):  # it ends at this moment
            if "--type=renderer" in process.cmdline():
                yield process.pid


def measured(bus: Bus) -> np.ndarray:
    """Milliseconds from perception to action of the next actions."""
    timings = bus.subscriber(keys.TIMING)
    times: list[float] = []

    def enough() -> bool:
        bus.wait(0.05)
        while (timing := timings.take()) is not None:
            assert isinstance(timing, messages.Timing)
            times.append(1e3 * timing.perception_to_action_s)
        return len(times) >= ACTIONS

    until(enough, 120.0)
    return np.array(times[5:])


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_browsers_do_not_hold_up_acting(tmp_path: Path, browser: Browser, capsys: pytest.CaptureFixture[str]) -> None:
    found: dict[str, list[np.ndarray]] = {"none": [], "ten": [], "ten, one of them stopped": []}
    with console(tmp_path, *SETTINGS) as (brain, address), brain.bus() as bus:
        until(lambda: "ready: optimizer" in brain.output())
        measured(bus)
        for _ in range(ROUNDS):
            found["none"].append(measured(bus))
            for name in ("ten", "ten, one of them stopped"):
                with pages(browser, address, PAGES, stop_one="stopped" in name):
                    found[name].append(measured(bus))
    none = np.median(np.concatenate(found["none"]))
    lines = [
        "\nperception to action, ms, ten actions a second",
        "| pages | p50 | p99 | p50 by none |",
        "|---|--:|--:|--:|",
    ]
    for name, times in found.items():
        p50, p99 = np.percentile(np.concatenate(times), [50, 99])
        lines.append(f"| {name} | {p50:.2f} | {p99:.1f} | {p50 / none:.2f} |")
    with capsys.disabled():
        os.write(1, ("\n".join(lines) + "\n").encode())
    assert all(len(times) == ROUNDS for times in found.values()), "it acted all the while"
