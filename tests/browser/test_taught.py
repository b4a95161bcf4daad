"""A person teaches a real brain from the page, until it obeys; leaves; and the robot goes on."""

from __future__ import annotations

import subprocess
import sys
import wave
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Playwright

from tests.browser.conftest import CHROMIUM, FLAGS, Open, console
from tests.browser.visitor import Visitor
from tests.integration.brain import until

pytestmark = [pytest.mark.long, pytest.mark.timeout(240)]

QUICK = (
    "robot.body=kinematic",
    "robot.action_s=0.01",
    "experiment.iterations=1500",
    "optimizer.random_iterations=20",
)
OBEDIENT = 0.65
"""Of the last 20 notes; by chance it is one in seven."""
ENOUGH = 5
"""Captures while it is alone that are waited for."""


@pytest.mark.parametrize("by_keys", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["clicks", "keys"])
def test_taught_until_it_obeys_then_it_goes_on_alone(tmp_path: Path, visit: Open, by_keys: bool) -> None:
    with console(tmp_path, *QUICK, options=("--no-teacher",)) as (_, address):
        visitor = visit(address)
        visitor.come()
        while visitor.iteration < 60:
            visitor.teach(10, by_keys=by_keys)
        while (visitor.value("s.you.obedience") or 0) < OBEDIENT:
            assert visitor.iteration < 300, visitor.value("s.you.obedience")
            visitor.teach(10, by_keys=by_keys)
        captured = visitor.successes
        visitor.page.keyboard.press("q") if by_keys else visitor.page.click("#leave")
        visitor.sees("!s.you?.name")
        assert "Now watch: it goes on alone" in visitor.page.inner_text("#teach")
        assert "Obedience, your last notes" in visitor.page.inner_text("#teach")
        visitor.page.wait_for_selector("#badge:has-text('what it learnt from you')")
        visitor.sees(f"s.scene.successes >= a + {ENOUGH}", captured)


def test_a_lesson_is_taken_over_from_the_script_and_given_back(tmp_path: Path, visit: Open) -> None:
    with console(tmp_path, *QUICK, "teacher.phase.alone.start=1400", "teacher.phase.second teacher.start=1410",
                 "teacher.phase.alone again.start=1420") as (_, address):  # fmt: skip
        ann, bob = visit(address), visit(address)
        ann.sees("s.scene?.iteration > 5")
        ann.come("ann", take_over=False)
        ann.page.wait_for_selector("text=“one” is being obeyed")
        ann.page.click("#take-over")
        ann.sees("s.control?.script === false")
        # The one that was obeyed last says no more: nobody is told to watch while the robot waits for his note.
        ann.page.wait_for_selector("#turn-words:has-text('Your turn')")
        ann.page.wait_for_selector(".phases [aria-current]:has-text('first teacher · nobody')")
        ann.teach(3)
        ann.page.wait_for_selector(".phases [aria-current]:has-text('first teacher · you')")
        ann.sees("s.you.obeyed === 'ann'")
        ann.page.wait_for_selector("text=/You are being obeyed|Your notes count/")
        bob.come("bob", take_over=False)
        bob.page.wait_for_selector(
            "text=“ann” is being obeyed. Your notes do not count until “ann” is silent or leaves"
        )
        bob.leave()
        ann.page.click("#give-back")
        ann.sees("s.control?.script === true && s.you.paused")
        ann.page.wait_for_selector("text=“one” is being obeyed. Your notes do not count")
        ann.page.click("#take-over")
        ann.sees("s.control?.script === false && !s.you.paused")
        ann.teach(2)
        ann.sees("s.you.obeyed === 'ann'")
        ann.page.click("#give-back")
        ann.sees("s.control?.script === true")
        ann.leave()
        at = ann.iteration
        ann.sees("s.scene.iteration > a + 20", at)
        ann.sees("s.thought?.teacher === 'one' && s.thought.badge !== 'alone'")


def test_after_a_lesson_the_script_stays_silent_until_it_is_asked(tmp_path: Path, visit: Open) -> None:
    with console(tmp_path, *QUICK, "experiment.iterations=400", experiment="demo") as (_, address):
        visitor = visit(address)
        visitor.sees("s.scene?.iteration > 3")
        visitor.come()
        visitor.teach(2)
        visitor.leave()
        visitor.page.wait_for_selector("text=The scripted teacher stays silent until you give the robot back to it")
        visitor.page.click("#pause")
        visitor.sees("s.control?.paused")
        visitor.page.click("#next-phase")
        visitor.sees("s.control.ended.length === 1")
        visitor.page.click("#pause")
        visitor.sees("s.phase.name === 'alone'")
        # What is over is short now, and who does not teach is not named.
        widths = visitor.value(
            "[...document.querySelectorAll('.phases li')].map((one) => parseFloat(one.style.flexGrow))"
        )
        assert widths[0] < 170
        visitor.page.wait_for_selector(".phases li:has-text('second teacher · nobody')")
        visitor.sees("s.finished")
        assert visitor.value("s.rows.teacher.includes('teacher-2')") is False
        visitor.page.click("#teach-run")
        visitor.sees("s.mode === 'past' && s.moment === 399")


def test_the_run_ends_while_somebody_teaches(tmp_path: Path, visit: Open) -> None:
    with console(tmp_path, *QUICK, "experiment.iterations=25", options=("--no-teacher",)) as (_, address):
        visitor = visit(address)
        visitor.come()
        visitor.teach(40, by_keys=True)  # a key that comes too late does nothing
        visitor.sees("s.finished && !s.you?.name")
        visitor.page.wait_for_selector("text=This is what came of your lesson")
        assert "Notes you played" in visitor.page.inner_text("#teach")


def test_who_comes_after_the_end_is_told_why_there_is_no_picture(tmp_path: Path, visit: Open) -> None:
    with console(tmp_path, *QUICK, "experiment.iterations=25") as (brain, address):
        until(lambda: "the page goes on" in brain.output())
        visitor = visit(address)
        visitor.page.wait_for_selector("text=Nobody watched, so no picture was made")
        visitor.page.click("#teach-run")
        visitor.sees("s.mode === 'past' && s.picture?.drawing")
        visitor.page.wait_for_selector("text=Nobody watched", state="hidden")


def test_actions_of_ranges_have_room_for_their_bars(tmp_path: Path, visit: Open) -> None:
    with console(tmp_path, "optimizer.random_iterations=10", experiment="arm") as (_, address):
        visitor = visit(address)
        visitor.sees("s.thought?.actions?.length > 9")
        assert visitor.page.inner_text("#bars-of") == "base, shoulder, elbow (rad)"
        parts = ["#bars .track", ".axis", "#choosing > .key"]  # all at one moment: the page goes on
        track, axis, key = visitor.page.evaluate(
            "parts => parts.map((part) => document.querySelector(part).getBoundingClientRect().toJSON())", parts
        )
        assert track["width"] > 100
        assert axis["bottom"] <= key["top"]


def test_who_comes_back_as_somebody_else_speaks_another_language(tmp_path: Path, visit: Open) -> None:
    with console(tmp_path, *QUICK, options=("--no-teacher",)) as (_, address):
        visitor = visit(address)
        visitor.come()
        visitor.teach(4)
        first = visitor.value("s.you.language")
        visitor.page.click("#open-language")
        visitor.page.click("#language-reversed")
        visitor.page.click("#language-done")
        visitor.sees("JSON.stringify(s.you.language) !== a", str(first).replace(" ", ""))
        assert visitor.value("s.you.language") == [6 - note for note in first]
        visitor.teach(2)
        visitor.leave()
        visitor.page.click("#come-back")
        visitor.page.click("#teach-join")
        visitor.sees("s.you?.name === 'ann-2'")
        visitor.teach(2)
        visitor.sees("s.teachers.some((t) => t.name === 'ann-2' && t.person)")


def tone(path: Path, hertz: float) -> None:
    """A sound file of one second: a note of half a second with its octave, then silence."""
    rate = 48_000
    at = np.arange(rate) / rate
    sound = np.where(at < 0.5, 0.5 * np.sin(2 * np.pi * hertz * at) + 0.2 * np.sin(4 * np.pi * hertz * at), 0.0)
    with wave.open(str(path), "wb") as file:
        file.setparams((1, 2, rate, 0, "NONE", ""))
        file.writeframes((sound * 20_000).astype("<i2").tobytes())


def test_the_microphone_is_heard(tmp_path: Path, playwright: Playwright) -> None:
    sound = tmp_path / "note.wav"
    tone(sound, 440.0)
    flags = ("--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream")
    fake = [*FLAGS, *flags, f"--use-file-for-fake-audio-capture={sound}"]
    settings = (*QUICK, "ear.detector=template")
    with console(tmp_path / "runs", *settings, options=("--no-teacher",)) as (_, address):
        browser: Browser = playwright.chromium.launch(executable_path=CHROMIUM, args=fake)
        page = browser.new_context(permissions=["microphone"]).new_page()
        page.add_init_script("localStorage.setItem('mdb.guided', 'yes')")
        visitor = Visitor(page, address)
        visitor.come()
        page.click("#microphone")
        scale = visitor.value("s.hello.scale_hz")
        nearest = int(np.argmin(np.abs(np.log(np.array(scale) / 440.0))))
        visitor.sees("s.you.heard?.note === a", nearest)
        visitor.sees("s.you.exchanges.some((e) => e.note === a)", nearest)
        assert abs(visitor.value("s.you.heard.hz") - scale[nearest]) < 20
        browser.close()


def test_a_machine_of_gymnasium_is_taught_in_the_same_page(tmp_path: Path, visit: Open) -> None:
    pytest.importorskip("gymnasium")
    settings = ("robot.action_s=0.01", "optimizer.random_iterations=10", "experiment.iterations=400")
    with console(tmp_path, *settings, experiment="cartpole", options=("--no-teacher",)) as (_, address):
        visitor = visit(address)
        visitor.come()
        visitor.teach(12)
        visitor.sees("s.picture?.image?.startsWith('data:image/png;base64,') || s.picture?.drawing")
        assert visitor.page.locator("#bars li").count() == 2
        visitor.sees("s.rows.iteration.length >= 12")
        visitor.leave()


def test_the_terminal_is_not_needed() -> None:
    """What the page is made with is no part of what a brain needs."""
    told = "import sys, mdb_deploy.cli.main; print(sorted(set(sys.modules) & {'starlette', 'uvicorn', 'websockets'}))"
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
