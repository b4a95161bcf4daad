"""What dies comes back, and the page with it; past runs; what can be tried."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import psutil
import pytest

from mdb_deploy.trials.under_test import words_of
from tests.browser.conftest import Open, console
from tests.integration.brain import Brain, until

pytestmark = [pytest.mark.long, pytest.mark.timeout(240)]

QUICK = (
    "robot.body=kinematic",
    "robot.action_s=0.02",
    "experiment.iterations=3000",
    "optimizer.random_iterations=20",
)


def process_of(brain: Brain, role: str) -> psutil.Process:
    """The process of a role."""
    found = until(lambda: [p for p in brain.children() if {"run", role} <= set(words_of(p))])
    assert isinstance(found, list)
    return psutil.Process(found[0].pid)


@pytest.mark.parametrize("role", ["web", "router"])
def test_who_was_killed_is_back_and_the_page_goes_on(tmp_path: Path, visit: Open, role: str) -> None:
    with console(tmp_path, *QUICK) as (brain, address):
        visitor = visit(address)
        visitor.sees("s.scene?.iteration > 10")
        os.kill(process_of(brain, role).pid, signal.SIGKILL)
        if role == "web":
            visitor.sees("s.connection === 'lost'")
        visitor.sees("s.connection === 'open' && !s.trouble", bound_ms=30_000)
        at = visitor.iteration
        visitor.sees("s.scene.iteration > a + 20", at)
        visitor.sees("s.rows.iteration.at(-1) > a", at)


def test_a_lesson_goes_on_when_the_bridge_was_killed(tmp_path: Path, visit: Open) -> None:
    with console(tmp_path, *QUICK, options=("--no-teacher",)) as (brain, address):
        visitor = visit(address)
        visitor.come()
        visitor.teach(3)
        os.kill(process_of(brain, "web").pid, signal.SIGKILL)
        visitor.sees("s.connection === 'lost'")
        visitor.sees("s.connection === 'open' && s.you?.name === 'ann'")
        visitor.teach(3)
        visitor.page.reload()
        visitor.look()
        visitor.sees("s.you?.name === 'ann'")
        visitor.teach(2)


def test_the_robot_can_be_paused_made_fast_and_changed(tmp_path: Path, visit: Open) -> None:
    slow = ("robot.action_s=0.2",)
    with console(tmp_path, *QUICK, *slow) as (_, address):
        visitor = visit(address)
        visitor.sees("s.scene?.iteration > 3")
        visitor.page.click("#pause")
        visitor.sees("s.control?.paused")
        visitor.page.wait_for_selector("#badge:has-text('Paused')")
        visitor.page.click("#pause")
        visitor.sees("s.control?.paused === false")
        visitor.page.click("#just-watch")
        visitor.sees("s.control?.action_s !== null && s.control.action_s <= 0.02")
        visitor.page.click("[data-change='swapped']")
        visitor.sees("s.said?.ok === true && s.said.to === 'change'")
        before = visitor.value("[s.scene.now.object_x_m, s.scene.now.object_y_m]")
        visitor.page.click("[data-put]")
        visitor.sees("s.scene.now.object_x_m !== a[0] || s.scene.now.object_y_m !== a[1]", before)
        phase = visitor.value("s.phase.name")
        visitor.page.click("#next-phase")
        visitor.sees("s.phase.name !== a", phase)


def test_a_moment_of_a_past_run_has_a_link(tmp_path: Path, visit: Open) -> None:
    phases = ("alone.start=30", "second teacher.start=40", "alone again.start=50")
    short = ("robot.action_s=0.01", "experiment.iterations=60", *(f"teacher.phase.{phase}" for phase in phases))
    with console(tmp_path, *QUICK, *short) as (brain, address):
        name = brain.run.name
        until(lambda: "results:" in brain.output())
        visitor = visit(f"{address}#run={name}&at=25")
        visitor.sees("s.mode === 'past' && s.moment === 25 && s.thought !== undefined")
        assert visitor.value("s.thought.iteration") == 25
        visitor.sees("s.picture?.iteration === 25 && s.picture.drawing?.shapes.length > 2")
        assert visitor.value("s.rows.iteration.length") == 60
        visitor.page.click("[aria-label='One iteration on']")
        visitor.sees("s.moment === 26")
        visitor.page.wait_for_url(f"**#run={name}&at=26")
        with visitor.page.expect_download() as download:
            visitor.page.click("#past a:has-text('run.mcap')")
        assert Path(download.value.path()).read_bytes().startswith(b"\x89MCAP0")
