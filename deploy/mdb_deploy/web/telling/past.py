"""A run of before, read from its folder: the same parts as of one that goes on, at any of its moments.

Reads only: the run log, its experiment file, and for pictures another body that does the episode again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from mdb_deploy.web.runs import SUFFIXES
from mdb_deploy.web.telling.hello import hello
from mdb_deploy.web.telling.kept.film import Film
from mdb_deploy.web.telling.kept.heard import MOST_CONTEXTS, TIMINGS
from mdb_deploy.web.telling.kept.log import LogIndex, Place
from mdb_deploy.web.telling.kept.models import Memory, Models
from mdb_deploy.web.telling.kept.rows import MOST_ROWS, Rows
from mdb_deploy.web.telling.kept.speech import MOST_PHASES, Speech
from mdb_deploy.web.telling.plan import Plan
from mdb_deploy.web.telling.story import Story
from mdb_protocol import messages as m
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_services.mechanism.actions.foresight import Known
from mdb_sim.body import Reading
from mdb_sim.runs.experiment import Experiment

SHOTS, SPACING = 128, 64
"""Memories are kept whole at so many moments at the most, at first after so many changes."""
MOST_CONTROLS = 1000
MOST_FILES, DEPTH = 200, 3
"""Files for downloads, and how deep in the folder."""


class _Memories:
    """The memory of one model at any version: kept whole now and then, and its changes between."""

    def __init__(self, memory: Memory) -> None:
        self._now = memory
        self._every = SPACING
        self._shots: dict[int, Memory] = {0: memory.copy()}
        self._changes: list[Place] = []

    def take(self, change: m.MemoryChange, place: Place | None) -> None:
        if place is None or not self._now.take(change):
            return
        self._changes.append(place)
        if len(self._changes) % self._every == 0:
            self._shots[len(self._changes)] = self._now.copy()
        if len(self._shots) > SHOTS:
            self._every *= 2
            self._shots = {place: shot for place, shot in self._shots.items() if place % self._every == 0}

    def at(self, version: int, log: LogIndex) -> Memory:
        """Return the memory of a version, or the last before it."""
        place = max(place for place, shot in self._shots.items() if shot.version <= version or not place)
        memory = self._shots[place].copy()
        for kept in self._changes[place:]:
            change = log.read(kept)
            if not isinstance(change, m.MemoryChange) or change.version > version:
                break
            memory.take(change)
        return memory


class PastRun:
    """A run folder that is looked at. Reads only. Used by one thread at a time."""

    def __init__(self, folder: Path) -> None:
        """Read the log's index; MdbError says what is missing or damaged."""
        self.folder = folder
        self.experiment = Experiment.read(folder / EXPERIMENT_FILE)
        self.plan = Plan(self.experiment)
        self._memories = {s.name: _Memories(Memory(self.plan, s)) for s in self.plan.brain.model}
        self._speech = Speech(self.plan)
        self._announced: list[m.Phase | m.Lesson] = []
        self._contexts: deque[m.ContextEvent] = deque(maxlen=MOST_CONTEXTS)
        self._controls: deque[tuple[int, m.Control]] = deque(maxlen=MOST_CONTROLS)
        self._changes: deque[tuple[int, m.Change]] = deque(maxlen=MOST_CONTROLS)
        self._finished = False
        self._learnt_from: dict[str, int] = {}
        """Of each teacher the first iteration whose feedback was learnt."""
        self._log = LogIndex(folder, self.plan.brain.experiment.brain, self._take)
        self._rows = self._all_rows()
        self._film: Film | None = None

    def _take(self, message: m.Message, place: Place | None, newest: int) -> None:
        """Keep what is wanted whole."""
        match message:
            case m.MemoryChange() if message.model in self._memories:
                self._memories[message.model].take(message, place)
            case m.Phase() | m.Lesson():
                if self._speech.take(message) and len(self._announced) < MOST_PHASES:
                    self._announced.append(message)
            case m.ContextEvent():
                self._contexts.append(message)
            case m.Control():
                self._controls.append((newest, message))
            case m.Change():
                self._changes.append((newest, message))
            case m.Finished():
                self._finished = True

    def _all_rows(self) -> Rows:
        rows = Rows(self.plan)
        for iteration in self._log.iterations(m.IterationReport):
            report = self._report(iteration)
            if report is None:
                continue
            scene = None if report.note is None else self._scene(iteration + 1)
            rows.add(report, self._speech.obeyed(report, scene))
            if report.feedback is None and (pair := self._log.pair(iteration)) is not None:
                rows.judge(pair, self._known)
            if report.teacher is not None and (report.feedback is not None or iteration in self._log.judged):
                self._learnt_from.setdefault(report.teacher, iteration)
        return rows

    def _report(self, iteration: int) -> m.IterationReport | None:
        found = self._log.get(m.IterationReport, iteration)
        return found if isinstance(found, m.IterationReport) else None

    def _scene(self, iteration: int) -> m.Scene | None:
        found = self._log.get(m.Scene, iteration)
        return found if isinstance(found, m.Scene) else None

    def _sensed(self, iteration: int) -> Reading | None:
        found = self._log.get(m.Perception, iteration)
        return found.reading if isinstance(found, m.Perception) else None

    def _known(self, name: str, version: int) -> Known | None:
        """Return a current model, ready to use."""
        model, models = self._log.model(name, version), Models(self.plan, name)
        return models.known(version) if model is not None and models.take(model) else None

    def close(self) -> None:
        """Free the log's files and the body of the pictures."""
        self._log.close()
        if self._film is not None:
            self._film.close()

    def hello(self) -> dict[str, Any]:
        """Return the frame `hello`; `live` is false."""
        return hello(self.experiment, self.folder.resolve().name)

    @property
    def iterations(self) -> int:
        """The iterations of which the log has an action or a report."""
        return max([-1, self._rows.last, *self._log.iterations(m.Action)[-1:]]) + 1

    def rows(self) -> dict[str, Any]:
        """Return all rows (at most 100 000)."""
        return self._rows.since(0, MOST_ROWS)

    def at(self, iteration: int, *, picture: bool = False) -> dict[str, Any]:
        """Return all parts at the moment when the action of an iteration was chosen, with what came of it.

        A part that is not known of that moment is None. `at` is the iteration; one beyond the log's end is its last
        one. picture: with the picture, for which the episode is done again in another body (see `picture`).
        """
        iteration = max(min(iteration, self.iterations - 1), 0)
        story = Story(self.plan, clock=None)
        heard = story.heard
        for announced in self._announced:
            if announced.iteration <= iteration:
                heard.take(announced)
        for event in self._contexts:
            if event.iteration <= iteration:
                heard.take(event)
        control = next((said for newest, said in reversed(self._controls) if newest <= iteration), None)
        action, report = self._log.get(m.Action, iteration), self._report(iteration)
        for name, version in self._versions_at(action, report).items():
            if (model := self._log.model(name, version)) is not None:
                heard.take(model)
            heard.memories[name] = self._memories[name].at(version, self._log)
            heard.remembered(name)
        perception, scene = self._log.get(m.Perception, iteration), self._scene(iteration)
        pair = None if report is None or report.feedback is not None else self._log.pair(iteration)
        timings = [self._log.get(m.Timing, at) for at in range(max(0, iteration - TIMINGS + 1), iteration + 1)]
        for message in (control, perception, scene, action, report, pair, *timings):
            if message is not None:
                heard.take(message)
        heard.learnt_from = dict.fromkeys(n for n, first in self._learnt_from.items() if first <= iteration)
        heard.finished = self._finished and iteration == self.iterations - 1
        for part in ("thought", "finished"):
            heard.renew(part)
        story.trouble(self.trouble)
        found = {name: story.part(name) for name in story.names}
        found["models"] = {name: story.part(f"models/{name}") for name in self._memories}
        found["memory"] = {name: story.part(f"memory/{name}") for name in self._memories}
        if picture:
            found["picture"] = self.picture(iteration)
        return {"at": iteration, **found}

    @property
    def trouble(self) -> str | None:
        """What is missing of the log, in words."""
        if self._log.damage:
            return f"The log ends early: {self._log.damage}."
        return self._log.shortened or None

    def _versions_at(self, action: m.Message | None, report: m.IterationReport | None) -> dict[str, int]:
        """Return the versions of the models that were acted upon; where that was not told, of the newest ones."""
        meant = action.intention if isinstance(action, m.Action) else None
        told = meant.versions if meant is not None else report.versions if report is not None else None
        if told is None:
            told = {name: self._log.newest_model(name) for name in self._memories}
        return {name: version for name, version in told.items() if name in self._memories}

    def picture(self, iteration: int) -> dict[str, Any]:
        """Return {iteration, drawing, image, missing}: the episode is done again; why there is none, or null."""
        if self._film is None:
            changes = [(at, dict(settings)) for at, settings in self.experiment.robot.changes.items()]
            changes += [(newest, dict(change.settings)) for newest, change in self._changes]
            self._film = Film(self.experiment, self._scene, self._sensed, changes)
        return self._film.picture(iteration)

    def files(self) -> list[dict[str, Any]]:
        """Return what may be downloaded: [{path (relative, with /), bytes}]; nothing hidden, no databases."""
        return [{"path": name, "bytes": path.stat().st_size} for name, path in self._files().items()]

    def _files(self) -> dict[str, Path]:
        root = self.folder.resolve()
        return dict(islice(_below(root, root, DEPTH), MOST_FILES))


def _below(folder: Path, root: Path, depth: int) -> Iterator[tuple[str, Path]]:
    """Yield the files to download in a folder and below, by their names from `root`. No link is followed."""
    try:
        entries = sorted(folder.iterdir())
    except OSError:
        return
    for entry in entries:
        if entry.name.startswith(".") or entry.is_symlink():
            continue
        if entry.is_file() and entry.suffix in SUFFIXES:
            yield entry.relative_to(root).as_posix(), entry
        elif depth > 1 and entry.is_dir():
            yield from _below(entry, root, depth - 1)
