"""What the user sees of a run: one display with iteration, phase, successes, errors and obedience.

On a terminal it is drawn in place; elsewhere a line is written at every tenth of the run.
"""

from __future__ import annotations

from collections import deque

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.text import Text

from mdb_protocol.messages import Control, CurrentModel, IterationReport, Phase, Scene
from mdb_protocol.words import shown
from mdb_sim.runs.experiment import Experiment
from mdb_sim.teaching.policy import obeyed

RECENT = 40
MOST_NAME = 64
"""Characters of a name."""
LINES = 10


class Progress:
    """A context manager that shows reports as they come."""

    def __init__(self, console: Console, experiment: Experiment) -> None:
        self._console, self._iterations = console, experiment.brain.experiment.iterations
        self._planned = self._schedule = experiment.schedule() if experiment.teacher is not None else None
        self._paused = False
        self._scenes: dict[int, Scene] = {}
        self._obeyed: deque[bool] = deque(maxlen=RECENT)
        self._errors: dict[str, float] = {}
        self._prequential: dict[str, deque[float]] = {}
        self._successes = self._done = self._lines = 0
        self._mode = self._phase = ""
        self._ready: list[str] = []
        self._bar = Bar(
            TextColumn("iteration"),
            BarColumn(bar_width=None),
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
        )
        self._task = self._bar.add_task("run", total=self._iterations)
        self._live = Live(get_renderable=self._render, console=console, refresh_per_second=8, transient=False)

    def __enter__(self) -> Progress:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._console.is_terminal:
            self._live.refresh()
            self._live.stop()

    def ready(self, name: str) -> None:
        """A process is ready."""
        self._ready.append(name)
        if not self._console.is_terminal:
            self._console.print(f"ready: {shown(name)}")

    def phase(self, phase: Phase) -> None:
        """A phase has begun."""
        self._phase = shown(phase.name, MOST_NAME)

    def control(self, control: Control) -> None:
        """An operator has said how the run is to go on."""
        self._paused = control.paused
        if self._planned is not None:
            self._schedule = self._planned.with_ended(control.ended)

    def model(self, model: CurrentModel) -> None:
        """A model has learnt."""
        self._errors[model.model] = model.error

    def report(self, report: IterationReport) -> None:
        """An iteration is done."""
        self._done = report.iteration + 1
        self._mode = shown(report.mode, MOST_NAME)
        if (obeyed := self._is_obeyed(report)) is not None:
            self._obeyed.append(obeyed)
        for name, error in report.prequential.items():
            self._prequential.setdefault(name, deque(maxlen=RECENT)).append(error)
        if (lines := self._done * LINES // self._iterations) > self._lines:
            self._lines = lines
            if not self._console.is_terminal:
                self._console.print(f"iteration {self._done}/{self._iterations}  {self._words()}", soft_wrap=True)

    def scene(self, scene: Scene) -> None:
        """A scene is seen; not each is, where they follow fast."""
        self._successes = scene.successes
        self._scenes[scene.iteration] = scene
        if len(self._scenes) > RECENT:
            del self._scenes[min(self._scenes)]

    def _is_obeyed(self, report: IterationReport) -> bool | None:
        """Whether what a scripted teacher's note meant was done, if that was seen."""
        scene = self._scenes.get(report.iteration + 1)
        if scene is None or self._schedule is None or report.note is None:
            return None
        phase = self._schedule.at(report.iteration)
        if phase.language is None or report.teacher not in (None, phase.teacher):
            return None
        return obeyed(self._schedule.policy, phase.language, report.note, scene)

    def _words(self) -> str:
        phase = f"{self._phase}: " if self._phase else ""
        seen = f"successes {self._successes}  obedience {self._obedience()}"
        return f"{phase}{self._mode}  {seen}  error before learning: {self._before_learning()}"

    def _obedience(self) -> str:
        return f"{sum(self._obeyed) / len(self._obeyed):.0%}" if self._obeyed else "-"

    def _before_learning(self) -> str:
        means = {name: sum(recent) / len(recent) for name, recent in sorted(self._prequential.items())}
        return "  ".join(f"{name} {mean:.3f}" for name, mean in means.items())

    def _render(self) -> Group:
        if not self._done:
            return Group(Text(f"starting: {', '.join(self._ready) or '...'}"))
        self._bar.update(self._task, completed=self._done)
        paused = "   paused by an operator" if self._paused else ""
        memory = "  ".join(f"{name} {error:.3f}" for name, error in sorted(self._errors.items()))
        return Group(
            self._bar,
            Text.assemble(("phase      ", "bold"), f"{self._phase or '-'}   acting on: {self._mode}{paused}"),
            Text.assemble(
                ("successes  ", "bold"), f"{self._successes}   obedience (last {RECENT}): {self._obedience()}"
            ),
            Text.assemble(("error      ", "bold"), f"before learning: {self._before_learning()}"),
            Text.assemble(("           ", "bold"), f"over the memory: {memory or '-'}"),
        )
