"""What is told of a run while it goes on: successes by the scenes, obedience by what was seen to happen."""

import io
import math
from typing import Any

from rich.console import Console

from mdb_deploy.experiments import experiment_path
from mdb_deploy.running.progress import Progress
from mdb_protocol import messages
from mdb_sim.runs.experiment import Experiment


def told(experiment: Experiment, turned_deg: list[float], *, seen: bool = True) -> str:
    """What is printed of a run in which a robot that should turn to its left each time turned so far."""
    out = io.StringIO()
    progress = Progress(Console(file=out, width=200), experiment)
    phases = experiment.schedule() if experiment.teacher is not None else None
    at = {"x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0, "object_x_m": 0.0, "object_y_m": 1.0}
    with progress:
        progress.ready("robot")
        progress.phase(messages.Phase(iteration=0, name="first teacher", teacher="one"))
        for i, turn in enumerate(turned_deg):
            scene = messages.Scene(
                iteration=i + 1, episode=0, successes=i // 2, event="none", action={"turn": turn}, before=at,
                reached=at | {"heading_rad": math.radians(turn)}, now=at,
            )  # fmt: skip
            if seen:
                progress.scene(scene)
            plain: dict[str, Any] = {"explored": False, "predicted": None, "feedback": None, "event": "none"}
            progress.report(messages.IterationReport(
                iteration=i, mode="taught", action={"turn": turn}, note=phases.note(i, at) if phases else 0,
                prequential={"object": 0.5}, versions={}, **plain,
            ))  # fmt: skip
    return out.getvalue()


def test_successes_and_obedience_are_told_ten_times_a_run() -> None:
    experiment = Experiment.read(experiment_path("paper"), ["experiment.iterations=20"])
    lines = told(experiment, [90.0, -90.0] * 10).splitlines()
    assert lines[0] == "ready: robot"
    assert len(lines) == 11
    assert lines[1].startswith("iteration 2/20  first teacher: taught  successes 0  obedience 50%")
    assert lines[-1].startswith("iteration 20/20  first teacher: taught  successes 9  obedience 50%")
    assert lines[-1].endswith("error before learning: object 0.500")


def test_obedience_is_not_told_where_nobody_knows_it() -> None:
    """Without scenes, when nobody teaches, and without a scripted teacher, of whom it is known what he means."""
    short = ["experiment.iterations=10"]
    experiment = Experiment.read(experiment_path("paper"), short)
    assert "obedience -" in told(experiment, [90.0] * 10, seen=False).splitlines()[-1]
    alone = Experiment.read(experiment_path("paper"), [*short, 'teacher.phase=[{start=0, name="alone"}]'])
    assert "obedience -" in told(alone, [90.0] * 10).splitlines()[-1]
    content = dict(experiment.content)
    del content["teacher"]
    assert "obedience -" in told(Experiment(content, "test"), [90.0] * 10).splitlines()[-1]


def test_obedience_is_told_of_the_phase_that_goes_on_and_of_its_own_teacher() -> None:
    experiment = Experiment.read(experiment_path("paper"), ["experiment.iterations=20"])
    out = io.StringIO()
    at = {"x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0, "object_x_m": 0.0, "object_y_m": 1.0}
    schedule = experiment.schedule()
    second = schedule.phases[2]
    assert second.language is not None
    note = second.language.note(6)  # left 90
    with Progress(Console(file=out, width=200), experiment) as progress:
        progress.control(messages.Control(iteration=0, ended=[3, 4]))
        for i in range(10):
            reached = at | {"heading_rad": math.radians(90.0)}
            progress.scene(messages.Scene(
                iteration=i + 1, episode=0, successes=0, event="none", action={}, before=at, reached=reached, now=at
            ))  # fmt: skip
            progress.report(messages.IterationReport(
                iteration=i, mode="taught", action={}, note=note, prequential={}, versions={}, explored=False,
                predicted=None, feedback=None, event="none", teacher=second.teacher if i != 7 else "bob",
            ))  # fmt: skip
    assert "obedience 100%" in out.getvalue().splitlines()[-1]
