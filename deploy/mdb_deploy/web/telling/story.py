"""A run as it goes on, in parts: each reader is told those that are new for it.

Taking a message keeps it and counts (`kept.heard`); what it means is computed when a part is asked for, and only when
what it depends on has changed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

from mdb_deploy.web.telling.beliefs import Pairs, beliefs, induced
from mdb_deploy.web.telling.kept.heard import SPOKE, Heard
from mdb_deploy.web.telling.kept.rows import AT_ONCE
from mdb_deploy.web.telling.parts import model_part, percentile_ms, perception_part, picture_part, plain
from mdb_deploy.web.telling.plan import Plan
from mdb_deploy.web.telling.thoughts import Around, thought, waiting
from mdb_protocol.keys import Key
from mdb_protocol.messages import Message
from mdb_services.mechanism.actions.foresight import Known
from mdb_sim.runs.experiment import Experiment

WAITS_S = 1.0
"""After so long without a perception, an action or a report the brain is said to wait."""
LARGE_S = 0.5
"""Large parts are renewed no more often."""
LARGE = ("memory", "models", "induced")
MOST_ALIVE, MOST_TOLD = 500, 200
"""Tokens and lessons that are told."""
TEACHER = "teacher/"
"""Begins the tokens of teachers."""


class Story:
    """Takes every message of a run and tells its parts as plain JSON values. Used by one thread.

    Parts: scene, perception, picture, phase, control, alive, finished, trouble, thought, beliefs, induced, contexts,
    shelf, teachers, lessons, timing; and, one for each model, `models/NAME` and `memory/NAME`.
    """

    def __init__(self, experiment: Experiment | Plan, clock: Callable[[], float] | None = time.monotonic) -> None:
        """`clock`: seconds, to tell that the brain waits, and to renew large parts not too often; None: neither."""
        self.plan = experiment if isinstance(experiment, Plan) else Plan(experiment)
        self.heard = Heard(self.plan, clock)
        self._clock = clock
        self._told: dict[str, int] = {}
        self._told_s: dict[str, float] = {}
        self._made: dict[str, tuple[int, Any]] = {}
        self._waits: str | None = None
        """What the brain waits for, in words."""
        heard = self.heard
        self._make: dict[str, Callable[[], Any]] = {
            "scene": lambda: None if heard.scene is None else plain(heard.scene),
            "perception": lambda: None if heard.perception is None else perception_part(heard.perception),
            "picture": lambda: None if heard.picture is None else picture_part(heard.picture),
            "phase": lambda: plain(heard.speech.phases[-1]) if heard.speech.phases else None,
            "control": lambda: None if heard.control is None else plain(heard.control),
            "alive": lambda: sorted(heard.tokens or ())[:MOST_ALIVE],
            "finished": lambda: heard.finished,
            "trouble": lambda: heard.words,
            "thought": self._thought_part,
            "beliefs": self._beliefs_part,
            "induced": self._induced_part,
            "contexts": lambda: [plain(event) for event in heard.contexts],
            "shelf": self._shelf_part,
            "teachers": self._teachers_part,
            "lessons": self._lessons_part,
            "timing": lambda: {f"p{n}_ms": percentile_ms([*heard.timings], n / 100) for n in (50, 99)},
        }

    # ---- what came ----

    def take(self, key: Key | str, message: Message) -> None:
        """Keep what a message says. What is not of this experiment is passed over.

        Also taken: PICTURE, MEMORY_SNAPSHOT and KEPT_MODEL (answers to the server's questions, when it comes late).
        What a key says beside its message is not needed.
        """
        del key
        self.heard.take(message)

    def alive(self, tokens: Iterable[str]) -> None:
        """Say who is alive: tokens as ROLE/INSTANCE."""
        self.heard.alive(tokens)

    def trouble(self, words: str | None) -> None:
        """Say what is wrong with the run, as the server knows it (the router is gone); None: nothing."""
        self.heard.trouble(words)

    @property
    def names(self) -> tuple[str, ...]:
        """The parts that are not of one model, `picture` aside."""
        return tuple(name for name in self._make if name != "picture")

    @property
    def missing_memories(self) -> tuple[str, ...]:
        """The models of whose memories changes were missed: who asks for their snapshots may `take` them."""
        return tuple(name for name, memory in self.heard.memories.items() if not memory.whole)

    # ---- what there is to tell ----

    @property
    def versions(self) -> dict[str, int]:
        """Of each part the number of times that it was another; parts that are not known yet are left out."""
        if self._clock is None:
            return dict(self.heard.versions)
        now, heard = self._clock(), self.heard
        waits = self._waits_for() if now - heard.moved_s >= WAITS_S else None
        if waits != self._waits:
            self._waits = waits
            heard.renew("thought")
        for part, version in heard.versions.items():
            if version == self._told.get(part):
                continue
            if part.startswith(LARGE):
                if now - self._told_s.get(part, -LARGE_S) < LARGE_S:
                    continue
                self._told_s[part] = now
            self._told[part] = version
        return dict(self._told)

    def part(self, name: str) -> Any:
        """Return one part, as in the frame `now`; computed when asked for, and only when it has changed.

        None for one that is not known yet; KeyError for one that there is not.
        """
        version = self.heard.versions.get(name, 0)
        made = self._made.get(name)
        if made is None or made[0] != version:
            made = self._made[name] = version, self._maker(name)()
        return made[1]

    def _maker(self, name: str) -> Callable[[], Any]:
        kind, _, model = name.partition("/")
        if kind == "models" and model in self.heard.models:
            newest = self.heard.models[model].newest
            return lambda: None if newest is None else model_part(self.plan, newest)
        if kind == "memory" and model in self.heard.memories:
            return lambda: self.heard.memories[model].told(self.heard.iteration)
        return self._make[name]

    @property
    def rows_count(self) -> int:
        """Rows so far, those that are no longer kept too: the place of the next row."""
        return self.heard.rows.count

    def rows(self, since: int, most: int = AT_ONCE) -> dict[str, Any]:
        """Return at most `most` rows from place `since` on, as in the frame; `from` is higher where old ones left."""
        return self.heard.rows.since(since, most)

    def parts(self, seen: dict[str, int]) -> dict[str, Any]:
        """Return the frame `now` without `is`: all parts that are new for a reader, and its rows; {} when none is.

        `seen` is what this reader has (begin with {}); it is brought up to date here. Rows that have changed (by
        feedback that came late) come again: a page puts what it gets in the place of what it has from `rows.from` on.
        A frame has a bounded number of rows; the next call gives the next ones.
        """
        found: dict[str, Any] = {}
        for name, version in self.versions.items():
            if seen.get(name, 0) >= version:
                continue
            seen[name] = version
            kind, slash, model = name.partition("/")
            if slash:
                found.setdefault(kind, {})[model] = self.part(name)
            else:
                found[kind] = self.part(name)
        if (rows := self.new_rows(seen)) is not None:
            found["rows"] = rows
        return found

    def new_rows(self, seen: dict[str, int]) -> dict[str, Any] | None:
        """Return the rows that are new for a reader, as `parts` does; None when none is."""
        rows, start = self.heard.rows, seen.get("rows", 0)
        changed = rows.changed(seen.get("rows changed", 0)) if start else None
        seen["rows changed"] = rows.revision
        start = start if changed is None else min(start, changed)
        if start >= rows.count:
            return None
        found = rows.since(start)
        seen["rows"] = found["from"] + len(found["iteration"])
        return found

    # ---- the parts that are computed ----

    def _thought_part(self) -> Any:
        heard, action = self.heard, self.heard.action
        if action is None:
            return None if self._waits is None else waiting(self._waits)
        versions = {} if action.intention is None else action.intention.versions
        found = {name: heard.known(name, version) for name, version in versions.items()}
        report = heard.report if heard.report is not None and heard.report.iteration == action.iteration else None
        around = Around(tuple(heard.learnt_from), self._teacher_now())
        told = thought(self.plan, action, {n: k for n, k in found.items() if k is not None}, report, around)
        return told if self._waits is None else told | {"badge": "waits", "badge_words": self._waits}

    def _waits_for(self) -> str | None:
        """Return in words what the brain waits for, when nothing came for a while; None: for nothing."""
        heard = self.heard
        if heard.finished or heard.perception is None:
            return None
        if heard.control is not None and heard.control.paused:
            return "is paused"
        who = heard.obeyed or self._teacher_now()
        perceived = heard.perception.iteration
        if heard.action is not None and heard.action.iteration >= perceived:
            return "waits for the robot"
        if who is None or not self.plan.notes:
            return "waits"
        judged = heard.report is not None and heard.report.iteration >= perceived - 1
        return f"waits for {who} to {'play' if judged or perceived == 0 else 'judge'}"

    def _teacher_now(self) -> str | None:
        """Return who teaches: a person, or else the scripted teacher of the phase."""
        return next((str(teacher["name"]) for teacher in reversed(self._teachers_part())), None)

    def _beliefs_part(self) -> Any:
        models = {name: known for name in self.heard.models if (known := self._newest(name)) is not None}
        meant = None if self.heard.action is None else self.heard.action.intention
        return beliefs(self.plan, models, None if meant is None else meant.before)

    def _newest(self, name: str) -> Known | None:
        newest = self.heard.models[name].newest
        return None if newest is None else self.heard.known(name, newest.version)

    def _induced_part(self) -> Any:
        if self.heard.valued is None:
            return None
        name, output = self.heard.valued
        known = self._newest(name)
        if known is None:
            return None
        pairs = self.heard.memories[name].rows()
        if not len(pairs.inputs) and known.support is not None:
            pairs = Pairs(known.support, None)
        return induced(self.plan, name, output, known, pairs)

    def _shelf_part(self) -> list[dict[str, Any]]:
        shelf: dict[tuple[str, int], dict[str, Any]] = {}
        for event in self.heard.contexts:
            if event.stored is None:
                continue
            entry: dict[str, Any] = {
                "model": event.model,
                "stored": event.stored,
                "iteration": event.iteration,
                "uses": 0,
            }
            entry = shelf.setdefault((event.model, event.stored), entry)
            entry["uses"] += event.kind == "recalled"
        return list(shelf.values())

    def _lessons_part(self) -> list[Any]:
        lessons = (lesson for of in self.heard.speech.lessons.values() for lesson in of)
        return [plain(lesson) for lesson in sorted(lessons, key=lambda lesson: lesson.iteration)[-MOST_TOLD:]]

    def _teachers_part(self) -> list[dict[str, Any]]:
        """Return who is there to teach: the scripted teacher of the phase first, then the others."""
        heard, now, names = self.heard, self.heard.iteration, dict[str, bool]()
        phase = heard.speech.phases[-1] if heard.speech.phases else None
        scripted = heard.control is None or heard.control.script
        if phase is not None and phase.teacher is not None and scripted:
            names[phase.teacher] = False
        for teacher, lessons in heard.speech.lessons.items():
            if not lessons[-1].over and self._is_there(teacher):
                names[teacher] = True
        for teacher, iteration in heard.spoke.items():
            person = teacher not in self.plan.languages
            if person and now - iteration <= SPOKE and self._is_there(teacher):
                names.setdefault(teacher, True)
        return [
            {"name": name, "obeyed": name == heard.obeyed, "notes": self._notes(name, now), "person": person}
            for name, person in names.items()
        ]

    def _is_there(self, teacher: str) -> bool:
        return self.heard.tokens is None or f"{TEACHER}{teacher}" in self.heard.tokens

    def _notes(self, teacher: str, now: int) -> list[int] | None:
        lessons = self.heard.speech.lessons.get(teacher)
        if lessons and not lessons[-1].over:
            return list(lessons[-1].notes)
        language = self.heard.speech.language(teacher, now)
        return None if language is None else list(language.notes)
