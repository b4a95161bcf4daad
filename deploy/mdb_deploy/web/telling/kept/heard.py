"""The newest of what was heard of a run, and of each part how often it was another. Bounded, and cheap to keep."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

from msgspec import structs

from mdb_deploy.web.telling.beliefs import believers, valued_alone
from mdb_deploy.web.telling.kept.models import Memory, Models
from mdb_deploy.web.telling.kept.rows import Rows
from mdb_deploy.web.telling.kept.speech import MOST_TEACHERS, Speech
from mdb_deploy.web.telling.plan import Plan
from mdb_protocol import messages as m
from mdb_services.mechanism.actions.foresight import Known

SCENES = 256
"""Scenes that are kept, by iteration: a report may come later than its scene."""
TIMINGS = 500
TIMED = 20
"""After so many timings they are told anew."""
MOST_CONTEXTS = 500
SPOKE = 20
"""Who said a note in the last so many iterations is there."""


class Heard:
    """See the module's docstring. Parts are those of `story.Story`."""

    def __init__(self, plan: Plan, clock: Callable[[], float] | None) -> None:
        """`clock`: seconds, for `moved_s`; None: it stays 0."""
        self.plan, self._clock = plan, clock
        self.versions: dict[str, int] = {}
        """Of each part how often it was another."""
        self.speech = Speech(plan)
        self.rows = Rows(plan)
        self.models = {name: Models(plan, name) for name in plan.books}
        self.memories = {model.name: Memory(plan, model) for model in plan.brain.model}
        self.valued = valued_alone(plan)
        """The model that tells the satisfaction where no note came, and its output."""
        self._believers, self._somewhere = believers(plan)
        self.scene: m.Scene | None = None
        self._scenes: dict[int, m.Scene] = {}
        self.perception: m.Perception | None = None
        self.picture: m.Picture | None = None
        self.action: m.Action | None = None
        self.report: m.IterationReport | None = None
        self.control: m.Control | None = None
        self.tokens: frozenset[str] | None = None
        """Who is alive; None: that was not said."""
        self.words: str | None = None
        """What is wrong with the run."""
        self.finished = False
        self._iterations = 0
        """How many iterations there were when it was finished."""
        self.contexts: deque[m.ContextEvent] = deque(maxlen=MOST_CONTEXTS)
        self.timings: deque[float] = deque(maxlen=TIMINGS)
        self._timed = 0
        self.spoke: dict[str, int] = {}
        """In which iteration each teacher said his last note."""
        self.learnt_from: dict[str, None] = {}
        """The teachers whose feedback was learnt, in the order in which they came."""
        self.obeyed: str | None = None
        """The teacher who is being obeyed."""
        self.moved_s = 0.0
        """When something of the operation cycle came last."""
        self._take: dict[type, Callable[[Any], None]] = {
            m.Scene: self._take_scene,
            m.Perception: self._take_perception,
            m.Picture: self._take_picture,
            m.Action: self._take_action,
            m.IterationReport: self._take_report,
            m.Pair: self._take_pair,
            m.CurrentModel: self._take_model,
            m.MemoryChange: self._take_memory,
            m.MemorySnapshot: self._take_memory,
            m.ContextEvent: self._take_context,
            m.Phase: self._take_phase,
            m.Lesson: self._take_lesson,
            m.Command: self._take_command,
            m.Control: self._take_control,
            m.Timing: self._take_timing,
            m.Finished: self._take_finished,
        }

    def take(self, message: m.Message) -> None:
        """Keep what a message says; what is not of this experiment is passed over."""
        taker = self._take.get(type(message))
        if taker is not None:
            taker(message)

    def alive(self, tokens: Iterable[str]) -> None:
        """Say who is alive: tokens as ROLE/INSTANCE."""
        now = frozenset(tokens)
        if now != self.tokens:
            self.tokens = now
            self._new("alive", "teachers")

    def trouble(self, words: str | None) -> None:
        """Say what is wrong with the run; None: nothing."""
        if words != self.words:
            self.words = words
            self._new("trouble")

    def known(self, name: str, version: int) -> Known | None:
        """Return a current model, if that version of it is kept."""
        return self.models[name].known(version) if name in self.models else None

    @property
    def iteration(self) -> int:
        """The iteration that goes on: that of the newest action."""
        return max(self.rows.last, 0 if self.action is None else self.action.iteration, 0)

    def remembered(self, name: str) -> None:
        """Say that the memory of a model is another."""
        self._new(f"memory/{name}")
        if self.valued is not None and name == self.valued[0]:
            self._new("induced")

    def renew(self, part: str) -> None:
        """Say that a part is another."""
        self._new(part)

    def _new(self, *parts: str) -> None:
        for part in parts:
            self.versions[part] = self.versions.get(part, 0) + 1

    def _moved(self) -> None:
        """Something of the operation cycle came, so nobody waits."""
        if self._clock is not None:
            self.moved_s = self._clock()

    def _take_scene(self, scene: m.Scene) -> None:
        if scene.iteration not in self._scenes:
            self._scenes[scene.iteration] = scene
            if len(self._scenes) > SCENES:
                del self._scenes[next(iter(self._scenes))]
            report = self.report
            if report is not None and report.iteration == scene.iteration - 1:
                self.rows.obey(report.iteration, self.speech.obeyed(report, scene))
        if scene != self.scene:
            self.scene = scene
            self._new("scene")

    def _take_perception(self, perception: m.Perception) -> None:
        last = self.perception
        if last is None or (last.iteration, last.event, last.reading) != (
            perception.iteration,
            perception.event,
            perception.reading,
        ):
            if last is None or last.iteration != perception.iteration:
                self._moved()
            self.perception = perception
            self._new("perception")

    def _take_picture(self, picture: m.Picture) -> None:
        self.picture = picture
        self._new("picture")

    def _take_action(self, action: m.Action) -> None:
        last, meant = self.action, action.intention
        if last is not None and (last.iteration, last.intention) == (action.iteration, meant):
            return
        self.action = action
        self._moved()
        self._new("thought")
        if self._somewhere:
            self._new("beliefs")
        if meant is not None:
            self._obey(meant.holder if self.plan.brain.optimizer.word == "first" else meant.teacher)

    def _take_report(self, report: m.IterationReport) -> None:
        scene = self._scenes.get(report.iteration + 1)
        if not self.rows.add(report, self.speech.obeyed(report, scene)):
            return
        self.report = report
        self._moved()
        if self.finished and report.iteration >= self._iterations:  # with more iterations than it had it goes on
            self.finished = False
            self._new("finished")
        if report.teacher is not None and report.feedback is not None:
            self._learn_from(report.teacher)
        if self.action is not None and self.action.iteration == report.iteration:
            self._new("thought")

    def _take_pair(self, pair: m.Pair) -> None:
        if not self.rows.judge(pair, self.known):
            return
        if pair.teacher is not None:
            self._learn_from(pair.teacher)
        if self.report is not None and self.report.iteration == pair.iteration:
            self.report = structs.replace(self.report, feedback=pair.feedback)
            self._new("thought")

    def _take_model(self, model: m.CurrentModel) -> None:
        of = self.models.get(model.model)
        if of is None or not of.take(model):
            return
        self._new(f"models/{model.model}")
        if model.model in self._believers:
            self._new("beliefs")
        if self.valued is not None and model.model == self.valued[0]:
            self._new("induced")

    def _take_memory(self, change: m.MemoryChange | m.MemorySnapshot) -> None:
        of = self.memories.get(change.model)
        if of is not None and of.take(change):
            self.remembered(change.model)

    def _take_context(self, event: m.ContextEvent) -> None:
        if event not in self.contexts:
            self.contexts.append(event)
            self._new("contexts", "shelf")

    def _take_phase(self, phase: m.Phase) -> None:
        if self.speech.take(phase):
            self._new("phase", "teachers")

    def _take_lesson(self, lesson: m.Lesson) -> None:
        if self.speech.take(lesson):
            self._new("lessons", "teachers")

    def _take_command(self, command: m.Command) -> None:
        if command.note is None:
            return
        last = self.spoke.pop(command.teacher, None)
        self.spoke[command.teacher] = command.iteration
        if last is None or command.iteration - last > SPOKE:
            self._new("teachers")
        if len(self.spoke) > MOST_TEACHERS:
            del self.spoke[next(iter(self.spoke))]

    def _take_control(self, control: m.Control) -> None:
        if control != self.control:
            self.control = control
            self._moved()
            self._new("control", "teachers")

    def _take_timing(self, timing: m.Timing) -> None:
        self.timings.append(timing.perception_to_action_s)
        self._timed += 1
        if self._timed % TIMED == 1:
            self._new("timing")

    def _take_finished(self, finished: m.Finished) -> None:
        self._iterations = finished.iterations
        if not self.finished:
            self.finished = True
            self._moved()
            self._new("finished")

    def _learn_from(self, teacher: str) -> None:
        self.learnt_from[teacher] = None
        if len(self.learnt_from) > MOST_TEACHERS:
            del self.learnt_from[next(iter(self.learnt_from))]

    def _obey(self, teacher: str | None) -> None:
        if teacher != self.obeyed:
            self.obeyed = teacher
            self._new("teachers")
