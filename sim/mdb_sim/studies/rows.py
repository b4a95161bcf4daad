"""What a study keeps of a run: one row a phase, with its numbers and its curves. Pure, without files.

Owns which measures there are of a phase; how each is measured is in `measures`, how they are stored in
`results`. A number is nan where the log does not hold it and inf where what is measured never happened.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdb_sim.runs import measures
from mdb_sim.runs.films import Film, films_of
from mdb_sim.runs.record import Doubles, Episode, RunRecord, Span
from mdb_sim.runs.trajectories import typical
from mdb_sim.studies import machines
from mdb_sim.studies.ideal import ideal_successes

Curve = NDArray[np.float32]
Marks = NDArray[np.int8]
Counts = NDArray[np.int32]

POSES = ("object_x_m", "object_y_m", "x_m", "y_m", "heading_rad")
"""The numbers of a scene that a path consists of."""
ABSENT = -1
"""Stands in `obeyed` where no command came."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PhaseRow:
    """One phase of one run. Curves have shape (iterations of the phase that the log holds,)."""

    seed: int
    body: str
    phase: int
    """Its place in the run, from 0."""
    name: str
    teacher: str | None
    start: int
    stop: int
    counted_from: int
    """Captures count from here: after the forced exploration."""
    captures: float
    ideal_captures: float
    """Of a policy that sees the truth, on the same placements; see `ideal`."""
    random_iterations: int
    """Iterations of forced exploration at the beginning of the run."""
    commands: int
    obedience: float
    """In the last part of the phase, `measures.obedience_window`."""
    iterations_to_obedience: float
    disobeyed_at_first: float
    iterations_to_error: float
    """Until the prequential error is below 10 %."""
    prequential: float
    """Mean prequential error of the phase's last `measures.AVERAGED` commands."""
    pair_error: float
    """Over all command-action pairs, at the phase's end."""
    bumps: int
    lost: int
    timeouts: int

    captured: Marks
    obeyed: Marks
    """1 obeyed, 0 not, -1 no command."""
    prequential_curve: Curve
    memory_error_curve: Curve
    pair_error_curve: Curve
    """Every `measures.EVERY` iterations, elsewhere nan."""
    capture_steps: Counts
    """Steps of each episode of the phase that ended in a capture."""
    paths: tuple[Curve, ...]
    """Typical episodes: object x, y, then x, y and heading of each place, in m and rad; empty without these."""
    scores: Curve = field(default_factory=lambda: np.zeros(0, np.float32))
    """Of each episode that began and ended in the phase, where episodes have a score; see `machines.measured`."""
    ended_after: Counts = field(default_factory=lambda: np.zeros(0, np.int32))
    """The iterations after which an episode ended in the phase, wherever it began, ..."""
    ended_scores: Curve = field(default_factory=lambda: np.zeros(0, np.float32))
    """... and its score."""
    errors: Mapping[str, Curve] = field(default_factory=dict)
    """Of every model, by its name: the error on each pair before it was learnt, nan where there was none."""
    films: tuple[Film, ...] = ()
    """Typical episodes of the last phase in which nobody taught, or else of the last, in pictures."""
    judgements: float = math.nan
    """How often somebody said how good an action was; nan in results of before this was counted."""
    repeat: int = 1
    """Steps of the environment that an action lasts."""

    @property
    def share(self) -> float:
        """Captures as a share of the ideal's; nan where there is none to compare with."""
        return self.captures / self.ideal_captures if self.ideal_captures > 0 else math.nan

    @property
    def alone(self) -> bool:
        """Whether nobody taught."""
        return self.teacher is None


def rows_of(record: RunRecord) -> list[PhaseRow]:
    """Return what a study keeps of a run."""
    curves = {
        "prequential": measures.prequential_error(record),
        "memory": measures.memory_error(record),
        "pairs": measures.pair_error(record),
    }
    episodes = list(record.episodes())
    begun = [place for place, span in enumerate(record.spans) if span.start < record.iterations]
    filmed = max(begun, key=lambda place: (record.spans[place].teacher is None, place), default=0)
    return [
        _row(record, place, span, curves, episodes, filmed=place == filmed) for place, span in enumerate(record.spans)
    ]


def _row(
    record: RunRecord,
    place: int,
    span: Span,
    curves: Mapping[str, Doubles],
    episodes: list[Episode],
    *,
    filmed: bool,
) -> PhaseRow:
    phase = slice(span.start, min(span.stop, record.iterations))
    window = measures.success_window(record, span)
    events = record.event[phase].tolist()
    inside = [e for e in episodes if window[0] <= e.start and e.start + e.steps <= span.stop]
    done = [episode for episode in inside if episode.success]
    return PhaseRow(
        seed=record.seed,
        body=record.experiment.robot.body,
        phase=place,
        name=span.name,
        teacher=span.teacher,
        start=span.start,
        stop=span.stop,
        counted_from=window[0],
        captures=measures.successes(record, window),
        ideal_captures=ideal_successes(record, window),
        random_iterations=record.random_iterations,
        bumps=events.count("bump"),
        lost=events.count("lost"),
        timeouts=events.count("timeout"),
        captured=np.diff(record.successes[phase.start : phase.stop + 1]).astype(np.int8),
        capture_steps=np.array([episode.steps for episode in done], dtype=np.int32),
        paths=tuple(_path(episode) for _, episode in typical(done)),
        errors={name: errors[phase].astype(np.float32) for name, errors in record.prequential.items()},
        judgements=float(np.sum(np.isfinite(record.feedback[phase]))),
        repeat=int(record.experiment.robot.options.get("repeat", 1)),
        prequential_curve=curves["prequential"][phase].astype(np.float32),
        memory_error_curve=curves["memory"][phase].astype(np.float32),
        pair_error_curve=curves["pairs"][phase].astype(np.float32),
        **_obedience(record, span, phase),
        **_learning(record, span, curves),
        **_scored(record, span, episodes, filmed=filmed),
    )


def _scored(record: RunRecord, span: Span, episodes: list[Episode], *, filmed: bool) -> dict[str, Any]:
    score, _ = machines.measured(record)
    ended = [episode for episode in episodes if span.start < episode.stop <= span.stop]
    whole = [episode for episode in ended if span.start <= episode.start]
    films = films_of(record, machines.to_be_shown(whole or ended, score)) if filmed else ()
    if score is None:
        return {"films": films}
    return {
        "scores": np.array([score(episode) for episode in whole], dtype=np.float32),
        "ended_after": np.array([episode.stop for episode in ended], dtype=np.int32),
        "ended_scores": np.array([score(episode) for episode in ended], dtype=np.float32),
        "films": films,
    }


def _obedience(record: RunRecord, span: Span, phase: slice) -> dict[str, Any]:
    found = measures.obeyed(record)[phase]
    marks = np.where(np.isfinite(found), found, ABSENT).astype(np.int8)
    if span.teacher is None:
        nothing = {"obedience": math.nan, "iterations_to_obedience": math.nan, "disobeyed_at_first": math.nan}
        return {"commands": 0, "obeyed": marks, **nothing}
    return {
        "commands": int(np.sum(marks != ABSENT)),
        "obeyed": marks,
        "obedience": measures.obedience(record, measures.obedience_window(span)),
        "iterations_to_obedience": measures.iterations_to_obedience(record, span),
        "disobeyed_at_first": measures.disobeyed_at_first(record, span),
    }


def _learning(record: RunRecord, span: Span, curves: Mapping[str, Doubles]) -> dict[str, Any]:
    nothing = {"iterations_to_error": math.nan, "prequential": math.nan, "pair_error": math.nan}
    if span.teacher is None or record.iterations < span.stop:
        return nothing
    pairs = curves["pairs"][span.stop - 1]
    errors = curves["prequential"][span.start : span.stop]
    errors = errors[np.isfinite(errors)][-measures.AVERAGED :]
    if not len(errors):
        return nothing | {"pair_error": float(pairs)}
    return {
        "iterations_to_error": measures.iterations_below(record, span),
        "prequential": float(errors.mean()),
        "pair_error": float(pairs),
    }


def _path(episode: Episode) -> Curve:
    if not set(POSES) <= set(episode.places[0]):
        return np.zeros(0, np.float32)
    first = episode.places[0]
    places = [place[name] for place in episode.places for name in POSES[2:]]
    return np.array([*(first[name] for name in POSES[:2]), *places], dtype=np.float32)


CURVES = tuple(field.name for field in fields(PhaseRow) if field.type in ("Marks", "Curve", "Counts"))
"""The columns that hold a list of numbers."""
