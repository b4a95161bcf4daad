"""One run as arrays by iteration, read from its run log and its experiment file alone.

Owns `RunRecord` and its reading; what is made of it is in `measures` and `figures`. It must not write, and
must not use anything of a run but `run*.mcap` and `experiment.toml`. Of messages that came twice (a service
sends again what was not acknowledged) the first counts. Feedback may come after the report of its iteration, with the
pair that is then sent again; the errors foreseen are then those of the models of that iteration, as if it had been in
time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from mdb_protocol.errors import DamageError
from mdb_protocol.messages import Control, CurrentModel, IterationReport, Lesson, Message, Pair, Phase, Scene, Timing
from mdb_services.acting.models import prequential
from mdb_services.experiment.brain import BrainConfig
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_services.mechanism.actions.foresight import Known
from mdb_services.mechanism.networks.encoding import Codebook
from mdb_services.mechanism.networks.network import Network
from mdb_services.recorder import Recorded, read_log
from mdb_sim.body import Numbers
from mdb_sim.runs.experiment import Experiment
from mdb_sim.teaching.languages import Language

GAP, SHORT = 30, 10_000
"""A log that speaks of more iterations than `GAP` times its messages and `SHORT` is not made a record of: what is by
iteration would be far larger than the log."""
ABSENT = -1
"""Stands in `note` for silence, and in `choice` where there is none, or no report in the log."""

Doubles = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Span:
    """A phase as it lies in the run: iterations `start` to `stop`, `stop` not included."""

    name: str
    start: int
    stop: int
    teacher: str | None = None
    language: Language | None = None
    """What its notes mean; None when nobody teaches, or when the teacher is not the experiment's own."""


@dataclass(frozen=True)
class Episode:
    """The actions of an episode. `places` are the scenes' numbers, one entry more than actions."""

    start: int
    event: str
    success: bool
    places: tuple[Numbers, ...]

    @property
    def steps(self) -> int:
        """Number of actions."""
        return len(self.places) - 1

    @property
    def stop(self) -> int:
        """The iterations after which it had ended."""
        return self.start + self.steps


@dataclass(frozen=True, eq=False)
class RunRecord:
    """A run by iteration: arrays have shape (iterations,) and nan, `ABSENT` or "" where the log has nothing.

    `successes` has shape (iterations + 1,): successes after so many actions, so `successes[b] - successes[a]` are
    those of iterations a to b. Times are in seconds, `feedback` in [-1, 1], `prequential` in scaled units
    squared.
    """

    run: Path
    experiment: Experiment
    spans: tuple[Span, ...]
    reported: Flags
    choice: Ints
    note: Ints
    feedback: Doubles
    explored: Flags
    mode: NDArray[np.str_]
    event: NDArray[np.str_]
    successes: Ints
    prequential: dict[str, Doubles]
    versions: dict[str, Ints]
    perception_to_action_s: Doubles
    cycle_s: Doubles
    models: dict[tuple[str, int], CurrentModel]
    """Current models by name and memory version."""
    scenes: dict[int, Scene]
    """What a bystander saw, by the number of actions done."""
    reports: dict[int, IterationReport]
    """What the optimizer said of each iteration, with feedback that came late."""
    timings: dict[int, Timing]
    lessons: tuple[Lesson, ...] = ()
    """What teachers who are none of the experiment's own said of themselves, in the order in which it came."""
    controls: tuple[Control, ...] = ()
    """What operators said, in that order."""

    @property
    def iterations(self) -> int:
        """Iterations in the log, up to the last one that it knows of."""
        return len(self.reported)

    @property
    def seed(self) -> int:
        """The experiment's seed."""
        return self.experiment.brain.experiment.seed

    @property
    def random_iterations(self) -> int:
        """Iterations of forced exploration at the beginning."""
        return self.experiment.brain.optimizer.random_iterations

    @cached_property
    def communication(self) -> str | None:
        """Name of the model that foresees the feedback to a note (paper, figure 3 top), if there is one."""
        for model in self.experiment.brain.model:
            if model.role == "world" and "note" in model.inputs and "feedback" in model.outputs:
                return model.name
        return None

    @property
    def commanded(self) -> Flags:
        """Iterations in which the brain heard a note."""
        heard: Flags = self.note != ABSENT
        return heard

    @property
    def taught(self) -> tuple[Span, ...]:
        """The phases in which somebody teaches."""
        return tuple(span for span in self.spans if span.teacher is not None)

    def span_at(self, iteration: int) -> Span | None:
        """Return the phase of an iteration."""
        return next((span for span in self.spans if span.start <= iteration < span.stop), None)

    def episodes(self) -> Iterator[Episode]:
        """Yield the episodes that the log holds without a gap, the last and perhaps unended one left out."""
        start, places = 0, list[Numbers]()
        for count in sorted(self.scenes):
            scene = self.scenes[count]
            if scene.before is None or scene.action is None:
                places = []
                continue
            if not places or start + len(places) != count:
                start, places = count - 1, [scene.before]
            places.append(scene.reached)
            if scene.ended:
                if self._is_whole(start):
                    yield Episode(start, scene.event, scene.success, tuple(places))
                places = []

    def _is_whole(self, start: int) -> bool:
        """Whether an episode is there from its beginning: from the first scene, or after the end of another."""
        scene = self.scenes.get(start)
        return scene is not None and (scene.action is None or scene.ended)


@dataclass
class _Found:
    """Messages of a log by iteration; the first of each counts. One that is beyond the experiment's end is none."""

    brain: BrainConfig
    messages: int = 0
    reports: dict[int, IterationReport] = field(default_factory=dict)
    scenes: dict[int, Scene] = field(default_factory=dict)
    phases: dict[int, Phase] = field(default_factory=dict)
    lessons: list[Lesson] = field(default_factory=list)
    controls: list[Control] = field(default_factory=list)
    timings: dict[int, Timing] = field(default_factory=dict)
    models: dict[tuple[str, int], CurrentModel] = field(default_factory=dict)
    judged: dict[int, Pair] = field(default_factory=dict)
    """The pairs that have feedback."""
    iterations: int = 0
    """Up to the last one that it knows of."""

    def take(self, message: Message) -> None:
        self.messages += 1
        if getattr(message, "iteration", 0) > self.brain.experiment.iterations:
            return
        match message:
            case IterationReport():
                self.reports.setdefault(message.iteration, message)
                self.iterations = max(self.iterations, message.iteration + 1)
            case Scene():
                self.scenes.setdefault(message.iteration, message)
                self.iterations = max(self.iterations, message.iteration)
            case Phase():
                self.phases.setdefault(message.iteration, message)
            case Lesson():
                self.lessons.append(message)
            case Control():
                self.controls.append(message)
            case Timing():
                self.timings.setdefault(message.iteration, message)
            case CurrentModel() if self._is_one(message):
                self.models.setdefault((message.model, message.version), message)
            case Pair() if message.feedback is not None:
                self.judged.setdefault(message.iteration, message)

    @cached_property
    def _books(self) -> dict[str, Codebook]:
        variables = self.brain.variables()
        return {model.name: Codebook(variables, model.inputs, model.outputs) for model in self.brain.model}

    def _is_one(self, model: CurrentModel) -> bool:
        """Whether a model is one of this brain's: what is drawn of a run lets its networks predict."""
        book = self._books.get(model.model)
        return book is not None and len(model.layers) > 2 and book.misfit(model.layers) is None

    def with_late_feedback(self) -> dict[int, IterationReport]:
        """Return the reports with the feedback that came after them, and the errors that it shows."""
        return {i: self._judged(report) for i, report in self.reports.items()}

    def _judged(self, report: IterationReport) -> IterationReport:
        pair = self.judged.get(report.iteration)
        if pair is None or report.feedback is not None:
            return report
        acted_upon = {name: self.models.get((name, version)) for name, version in report.versions.items()}
        networks = {
            name: Known(self._books[name], Network.from_arrays(model.layers, model.weights))
            for name, model in acted_upon.items()
            if model is not None
        }
        errors = report.prequential | prequential(networks, pair)
        return structs.replace(report, feedback=pair.feedback, judges=pair.judges, prequential=errors)


def read_record(run: Path) -> RunRecord:
    """Return the record of a run folder, finished or not; MdbError when log or experiment file is missing."""
    experiment = Experiment.read(run / EXPERIMENT_FILE)
    return record_of(run, experiment, read_log(run, experiment.brain.experiment.brain))


def record_of(run: Path, experiment: Experiment, log: Iterable[Recorded]) -> RunRecord:
    """Return the record of messages in the order in which they were recorded."""
    found = _Found(experiment.brain)
    for recorded in log:
        found.take(recorded.message)
    if found.iterations > GAP * found.messages + SHORT:
        raise DamageError(
            f"the run log in {run} has {found.messages} messages and speaks of iteration {found.iterations}: it is "
            "damaged, or nearly all of it is lost"
        )
    reports, n = found.with_late_feedback(), found.iterations
    return RunRecord(
        run=run,
        experiment=experiment,
        spans=_spans(experiment, found, n, heard=any(r.note is not None for r in reports.values())),
        reported=_column(n, dict.fromkeys(reports, True), False, np.bool_),
        choice=_column(n, {i: r.choice for i, r in reports.items()}, ABSENT, np.int64),
        note=_column(n, {i: r.note for i, r in reports.items()}, ABSENT, np.int64),
        feedback=_column(n, {i: r.feedback for i, r in reports.items()}, np.nan, np.float64),
        explored=_column(n, {i: r.explored for i, r in reports.items()}, False, np.bool_),
        mode=_words(n, {i: r.mode for i, r in reports.items()}),
        event=_words(n, {i: r.event for i, r in reports.items()}),
        successes=_successes(found, frozenset(experiment.robot.successes), n),
        prequential=_by_model(
            n, experiment.brain, {i: r.prequential for i, r in reports.items()}, np.nan, np.float64
        ),
        versions=_by_model(n, experiment.brain, {i: r.versions for i, r in reports.items()}, 0, np.int64),
        perception_to_action_s=_column(
            n, {i: t.perception_to_action_s for i, t in found.timings.items()}, np.nan, np.float64
        ),
        cycle_s=_column(n, {i: t.cycle_s for i, t in found.timings.items()}, np.nan, np.float64),
        models=found.models,
        scenes=found.scenes,
        reports=reports,
        timings=found.timings,
        lessons=tuple(found.lessons),
        controls=tuple(found.controls),
    )


def _column(n: int, values: Mapping[int, Any], absent: Any, dtype: Any) -> NDArray[Any]:
    """Return values by iteration (n,); what is None or missing is `absent`."""
    column = np.full(n, absent, dtype)
    for i, value in values.items():
        if value is not None and i < n:
            column[i] = value
    return column


def _words(n: int, values: Mapping[int, str]) -> NDArray[np.str_]:
    longest = max(map(len, values.values()), default=1)
    words: NDArray[np.str_] = _column(n, values, "", np.dtype(f"U{longest}"))
    return words


def _by_model(
    n: int, brain: BrainConfig, values: Mapping[int, Mapping[str, float]], absent: Any, dtype: Any
) -> dict[str, NDArray[Any]]:
    there = {name for by_name in values.values() for name in by_name}
    names = sorted(model.name for model in brain.model if model.name in there)
    return {name: _column(n, {i: v.get(name) for i, v in values.items()}, absent, dtype) for name in names}


def _successes(found: _Found, events: frozenset[str], n: int) -> Ints:
    """Return the successes after 0 to n actions.

    Counted from the events, for a robot that was restarted counts from its own beginning. What happened while
    nobody recorded comes from the robot's own count, at the first scene after the gap.
    """
    gained = np.zeros(n + 1, np.int64)
    last = 0
    for i in range(n):
        report, scene = found.reports.get(i), found.scenes.get(i + 1)
        gained[i + 1] = scene.success if scene else report is not None and report.event in events
        if scene is not None:
            before = found.scenes.get(last)
            missed = scene.successes - (before.successes if before else 0) - int(gained[last + 1 : i + 2].sum())
            gained[i + 1] += max(0, missed)
            last = i + 1
    return np.cumsum(gained)


def _spans(experiment: Experiment, found: _Found, n: int, *, heard: bool) -> tuple[Span, ...]:
    """Return the phases: those that were announced, and of the experiment's schedule those still to come.

    What an operator has ended early is in both.
    """
    schedule = experiment.schedule() if experiment.teacher is not None else None
    if schedule is not None and found.controls:
        schedule = schedule.with_ended(found.controls[-1].ended)
    end = max(n, experiment.brain.experiment.iterations)
    begun = max(found.phases, default=-1)
    starts = {
        p.start: Span(p.name, p.start, p.start, p.teacher, p.language)
        for p in (schedule.phases if schedule is not None else ())
        if p.start > begun
    }
    for i, phase in found.phases.items():
        plan = schedule.at(i) if schedule is not None else None
        own = plan is not None and (plan.name, plan.teacher) == (phase.name, phase.teacher)
        starts[i] = Span(phase.name, i, i, phase.teacher, plan.language if plan is not None and own else None)
    if not starts:
        starts = _lessons(found.lessons) or {0: Span("whole run", 0, 0, "somebody" if heard else None)}
    edges = [*sorted(i for i in starts if i < end), end]
    return tuple(replace(starts[a], stop=b) for a, b in pairwise(edges))


def _lessons(lessons: Iterable[Lesson]) -> dict[int, Span]:
    """Return the phases that outside teachers have announced, by their beginnings; between them nobody teaches."""
    starts: dict[int, Span] = {}
    teaching: dict[str, Span] = {}
    for lesson in lessons:
        at, who = lesson.iteration, lesson.teacher
        if lesson.over:
            teaching.pop(who, None)
        else:
            teaching[who] = Span(who, at, at, who, Language(f"of {who}", tuple(lesson.notes)))
        now = next(reversed(teaching.values()), None)
        starts[at] = Span("alone", at, at) if now is None else replace(now, start=at)
    if starts and min(starts) > 0:
        starts[0] = Span("nobody yet", 0, 0)
    return starts
