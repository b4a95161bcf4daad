"""For whom the page is: keyboard, screen reader, light and dark, a phone; the guided minute."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from axe_playwright_python.sync_playwright import Axe

from tests.browser.conftest import Open, console
from tests.browser.visitor import Visitor

pytestmark = [pytest.mark.long, pytest.mark.timeout(240)]

QUICK = (
    "robot.body=kinematic",
    "robot.action_s=0.05",
    "experiment.iterations=3000",
    "optimizer.random_iterations=20",
)
STEPS = 6
"""Presses of Tab at most between two places of the form."""
SERIOUS = ("serious", "critical")
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True}


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with console(tmp_path_factory.mktemp("fit"), *QUICK) as (_, address):
        yield address


def check(visitor: Visitor) -> None:
    """Nothing serious is found, and nothing is wider than the window."""
    found = Axe().run(visitor.page).response["violations"]
    serious = [(one["id"], one["help"], one["nodes"][0]["html"]) for one in found if one["impact"] in SERIOUS]
    assert not serious, serious
    assert visitor.page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [{}, PHONE], ids=["screen", "phone"])
def test_axe_finds_nothing_serious(address: str, visit: Open, scheme: str, size: dict[str, object]) -> None:
    visitor = visit(address, color_scheme=scheme, **size)
    visitor.sees("s.rows.iteration.length > 25 && s.beliefs && s.memory")
    check(visitor)
    visitor.come(f"eve-{scheme}-{len(size)}", take_over=False)
    check(visitor)
    visitor.leave()
    check(visitor)


def test_all_that_is_needed_at_once_is_on_one_screen(address: str, visit: Open) -> None:
    visitor = visit(address)
    visitor.sees("s.thought")
    for panel in ("#scene", "#choosing", "#teach-join", "#badge"):
        box = visitor.page.locator(panel).bounding_box()
        assert box is not None
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 1280
        assert box["y"] + (0 if panel.startswith("#scene") else min(box["height"], 600)) <= 800


def test_the_guided_minute_is_shown_once_and_left_at_will(address: str, visit: Open) -> None:
    visitor = visit(address)
    visitor.page.click("#open-guide")
    visitor.page.wait_for_selector("#guide-words")
    steps = 0
    while visitor.page.is_visible("#guide-next") and steps < 20:
        check(visitor) if steps == 0 else None
        visitor.page.click("#guide-next")
        steps += 1
    assert 3 <= steps < 20
    visitor.page.keyboard.press("Escape")
    visitor.page.wait_for_selector("dialog[open]", state="hidden")
    visitor.page.evaluate("localStorage.removeItem('mdb.guided')")


def go_to(visitor: Visitor, place: str, key: str = "Tab") -> None:
    """Press a key until a place has the focus."""
    for _ in range(STEPS):
        if visitor.value("document.activeElement.id") == place:
            return
        visitor.page.keyboard.press(key)
    raise AssertionError(f"{key} does not lead to {place}")


def fill_in(visitor: Visitor, name: str) -> None:
    """Type a name, and go on to the button; the scripted teacher is to go on."""
    visitor.page.keyboard.press("Control+A")
    visitor.page.keyboard.type(name)
    if visitor.page.is_visible("#teach-takes"):
        go_to(visitor, "teach-takes")
        if visitor.page.is_checked("#teach-takes"):
            visitor.page.keyboard.press("Space")
    go_to(visitor, "teach-join")


def test_the_page_is_worked_with_the_keyboard_alone(address: str, visit: Open) -> None:
    visitor = visit(address)
    visitor.sees("s.hello?.live")
    visitor.page.focus("#teach-name")
    fill_in(visitor, "one")
    visitor.page.keyboard.press("Enter")
    visitor.sees("s.said?.to === 'join' && !s.said.ok")  # the scripted teacher has this name
    assert visitor.value("document.activeElement.id") == "teach-join"
    go_to(visitor, "teach-name", "Shift+Tab")
    fill_in(visitor, "kim")
    visitor.joins("kim", lambda: visitor.page.keyboard.press("Enter"))
    visitor.page.keyboard.press("q")
    visitor.sees("!s.you?.name")
