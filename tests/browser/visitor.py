"""Somebody before the page, who sees what is on it and clicks or types. He waits for events, with a bound."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from playwright.sync_api import Page

BOUND_MS = 60_000
TRIES = 3
STATE = "import('/page/state.js').then(({ state }) => { window.seen = state; })"
"""The page's own module, so that a test waits for what the page knows, and not for a time."""


class Visitor:
    """See the module's docstring."""

    def __init__(self, page: Page, address: str) -> None:
        self.page = page
        page.set_default_timeout(BOUND_MS)
        page.goto(address)
        self.look()

    def look(self) -> None:
        """Take hold of the page's state, after it was loaded."""
        self.page.evaluate(STATE)

    def sees(self, condition: str, argument: Any = None, bound_ms: float = BOUND_MS) -> None:
        """Wait until a condition on the page's state `s`, and `a`, the argument, is true."""
        try:
            self.page.wait_for_function(
                f"a => {{ const s = window.seen; return {condition}; }}", arg=argument, timeout=bound_ms
            )
        except Exception as error:
            error.add_note(f"on the page: {self.page.inner_text('body')[:3000]}")
            raise

    def value(self, what: str) -> Any:
        """What the page knows."""
        return self.page.evaluate(f"() => {{ const s = window.seen; return {what}; }}")

    @property
    def iteration(self) -> int:
        return int(self.value("s.scene?.iteration ?? -1"))

    @property
    def successes(self) -> int:
        return int(self.value("s.scene?.successes ?? 0"))

    def come(self, name: str = "ann", language: str = "ordered", *, take_over: bool = True) -> None:
        """Begin to teach."""
        self.page.fill("#teach-name", name)
        self.page.select_option("#teach-language", language)
        if self.page.is_visible("#teach-takes"):
            self.page.set_checked("#teach-takes", take_over)
        self.joins(name, lambda: self.page.click("#teach-join"))
        self.sees("s.you.waits")

    def joins(self, name: str, asks: Callable[[], None]) -> None:
        """Ask to teach; who is told that no router answers (a machine may be that busy) asks again, as people do."""
        for _ in range(TRIES):
            self.page.evaluate("window.before = window.seen.said")
            asks()
            self.sees("s.you?.name === a || (s.said !== window.before && s.said?.to === 'join' && !s.said.ok)", name)
            if self.value("s.you?.name") == name:
                return
            words = self.value("s.said.words")
            assert words.startswith("no router answers"), words
        raise AssertionError(f"{name} was told {TRIES} times: {words}")

    def leave(self) -> None:
        """End the lesson."""
        self.page.click("#leave")
        self.sees("s.you?.name === null || s.you?.name === undefined")

    def teach(self, count: int, *, by_keys: bool = False) -> None:
        """Play the note that the hint names, then judge what came of it; so many times."""
        for _ in range(count):
            self.sees("['play', 'both'].includes(s.you?.turn?.kind) || s.finished")
            if (you := self.value("s.finished ? null : s.you")) is None:
                return
            at = you["turn"]["iteration"]
            self._judge(at - 1, by_keys)
            self._press(None if you["wanted"] is None else you["language"][you["wanted"]], by_keys)
            self.sees("s.you?.turn?.iteration > a || s.finished", at)
        if (you := self.value("s.finished ? null : s.you")) is not None:
            self._judge(you["turn"]["iteration"] - 1, by_keys)

    def _press(self, note: int | None, by_keys: bool) -> None:
        if by_keys:
            self.page.keyboard.press(" " if note is None else "zxcvbnmasdfg"[note])
        else:
            self.page.click(f"[data-note='{'none' if note is None else note}']")

    def _judge(self, iteration: int, by_keys: bool) -> None:
        """Praise what was meant, punish the rest, less when it was near; as a person does who sees what it did."""
        said = self.value(f"s.you?.exchanges?.find((e) => e.iteration === {iteration}) ?? null")
        if said is None or said["command"] is None or said["did"] is None or said["feedback"] is not None:
            return
        order = self.value("s.hello.order")
        away = abs(order[said["command"]] - order[said["did"]])
        value = (1, 0, -0.5, -1)[min(away, 3)]
        if by_keys:
            key = {1: "+", 0: "5", -0.5: "2", -1: "-"}[value]
            self.page.keyboard.press(key)
        else:
            self.page.click(f".face-key[data-value='{value}']")
        # While he is not obeyed yet, the robot may go on before he has judged.
        given = "s.you?.exchanges?.find((e) => e.iteration === a)?.feedback != null"
        self.sees(f"{given} || s.finished || s.you?.turn?.iteration > a + 1", iteration)
