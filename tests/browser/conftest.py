"""A real browser before a real brain: Debian's chromium, driven by Playwright, and `mdb up --web` over its router."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, Playwright, sync_playwright

from tests.browser.visitor import Visitor
from tests.integration.brain import Brain, until

CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)
"""Playwright brings no browser of its own: that would be another of what the system updates."""
ADDRESS = re.compile(r"page: (http://\S+)")
FLAGS = ("--no-sandbox", "--autoplay-policy=no-user-gesture-required")
EXPECTED = ("WebSocket connection", "net::ERR_CONNECTION_REFUSED", "Failed to load resource")
"""What the browser itself writes when the bridge is gone."""

Open = Callable[..., Visitor]


@pytest.fixture(scope="module")
def playwright() -> Iterator[Playwright]:
    """Of a module, for its loop runs in this thread: tests of others have loops of their own."""
    if CHROMIUM is None:
        pytest.skip("no chromium here (Debian: apt-get install chromium)")
    with sync_playwright() as playwright:
        yield playwright


@pytest.fixture(scope="module")
def browser(playwright: Playwright) -> Browser:
    return playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))


@contextmanager
def watched(page: Page) -> Iterator[list[str]]:
    """What went wrong in a page while it was open."""
    wrong: list[str] = []

    def hear(said: ConsoleMessage) -> None:
        if said.type == "error" and not said.text.startswith(EXPECTED) and not any(e in said.text for e in EXPECTED):
            wrong.append(said.text)

    page.on("console", hear)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    yield wrong


@pytest.fixture
def visit(browser: Browser, request: pytest.FixtureRequest) -> Iterator[Open]:
    """Open pages; a mistake in any of them fails the test. Each is a visitor of his own, with his own cookies."""
    contexts, mistakes = [], []

    def open_(address: str, **options: Any) -> Visitor:
        settings = {"viewport": {"width": 1280, "height": 800}, "reduced_motion": "reduce", **options}
        context = browser.new_context(**settings)
        context.add_init_script("localStorage.setItem('mdb.guided', 'yes')")
        contexts.append(context)
        page = context.new_page()
        with watched(page) as wrong:
            mistakes.append(wrong)
        return Visitor(page, address)

    yield open_
    for context in contexts:
        for page in context.pages:
            if hasattr(request.node, "rep_call") and request.node.rep_call.failed:
                print(page.inner_text("body")[:4000])  # noqa: T201 - what was on the page, when a test has failed
        context.close()
    assert not any(mistakes), mistakes


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Any:
    report = yield
    setattr(item, f"rep_{report.when}", report)
    return report


def address_of(brain: Brain) -> str:
    """Where a brain's page is."""

    def said() -> str:
        assert brain.process.poll() is None, brain.output()
        found = ADDRESS.search(brain.output())
        return found.group(1) if found else ""

    return str(until(said))


@contextmanager
def console(
    folder: Path, *settings: str, experiment: str = "paper", options: tuple[str, ...] = ()
) -> Iterator[tuple[Brain, str]]:
    """A brain with a page: the Pioneer's kinematic twin unless the experiment says otherwise; small populations."""
    folder.mkdir(exist_ok=True)
    brain = Brain(folder, *settings, experiment=(experiment, ()), options=("--web", *options))
    with brain:
        yield brain, address_of(brain)
