"""How soon the page is there, and the robot moves, after `mdb up --web`: on a warm machine, several times.

Run by name: `mdb test -m slow tests/benchmarks/test_console_start.py -s`
"""

import os
import time
from pathlib import Path

import httpx
import numpy as np
import pytest
from playwright.sync_api import Browser

from tests.browser.conftest import browser, console, playwright
from tests.integration.brain import until

__all__ = ["browser", "playwright"]
TIMES = 5
SHOWN = "() => Number(document.querySelector('#iteration strong')?.textContent) >= 1"


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_page_is_there_and_the_robot_moves(
    tmp_path: Path, browser: Browser, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = []
    for number in range(TIMES):
        began_s = time.perf_counter()
        with console(tmp_path / str(number), experiment="demo") as (_, address):
            until(lambda: _answers(address))
            page_s = time.perf_counter() - began_s
            page = browser.new_page()
            page.goto(address)
            loaded_s = time.perf_counter() - began_s
            page.wait_for_function(SHOWN)
            moves_s = time.perf_counter() - began_s
            page.close()
        rows.append((page_s, loaded_s, moves_s))
    found = np.array(rows)
    with capsys.disabled():
        lines = ["\nseconds after `mdb up demo --web`", "| | median | most |", "|---|--:|--:|"]
        for name, times in zip(("page answers", "page is shown", "robot moves on it"), found.T, strict=True):
            lines.append(f"| {name} | {np.median(times):.2f} | {times.max():.2f} |")
        os.write(1, ("\n".join(lines) + "\n").encode())
    assert (np.diff(found, axis=1) > 0).all()


def _answers(address: str) -> bool:
    try:
        return httpx.get(address, timeout=5.0).status_code == 200
    except httpx.HTTPError:
        return False
