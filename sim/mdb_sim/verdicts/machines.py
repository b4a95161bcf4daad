"""How competent machines became: alone after so much teaching, and how much of it was needed.

Competence is the mean score of the episodes of a phase alone (`studies.machines`), or the successes as a share of the
ideal's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mdb_sim.studies.machines import MACHINES, RETURN, Machine
from mdb_sim.studies.rows import PhaseRow
from mdb_sim.verdicts.quantities import Runs
from mdb_sim.verdicts.statistics import Shape, estimate, interval, markdown, number, percent, text, worst

OF = {machine.what: machine for machine in MACHINES}


@dataclass(frozen=True)
class Curve:
    """One run: the competence alone after so many iterations taught, or steps trained."""

    taught: tuple[int, ...]
    competence: tuple[float, ...]
    judgements: tuple[float, ...]
    """So many were given by then."""

    @property
    def last(self) -> float:
        """The competence alone at the end."""
        return self.competence[-1]

    def needed(self, target: float) -> float:
        """Return the iterations taught from which on it was competent each time; inf: it was not at the end."""
        return self._at(self._kept(target), self.taught)

    def judged(self, target: float) -> float:
        """Return the judgements after which it was competent each time; inf: it was not at the end."""
        return self._at(self._kept(target), self.judgements)

    def first(self, target: float) -> float:
        """Return the iterations taught after which it was competent for the first time; inf: it never was."""
        good = [place for place, value in enumerate(self.competence) if value >= target]
        return self._at(good[0] if good else len(self.taught), self.taught)

    def _kept(self, target: float) -> int:
        short = [place for place, value in enumerate(self.competence) if not value >= target]
        return short[-1] + 1 if short else 0

    def _at(self, place: int, counts: Sequence[float]) -> float:
        return float(counts[place]) if place < len(counts) else math.inf


def curve(machine: Machine, rows: Sequence[PhaseRow]) -> Curve:
    """Return a run's curve."""
    taught, judged, points = 0, 0.0, list[tuple[int, float, float]]()
    for row in rows:
        if row.alone:
            points.append((taught, _competence(machine, row), judged))
        else:
            taught, judged = taught + row.stop - row.start, judged + row.judgements
    at, competence, judgements = zip(*points, strict=True)
    return Curve(at, competence, judgements)


def _competence(machine: Machine, row: PhaseRow) -> float:
    if machine.score is None:
        return row.share
    return float(np.mean(row.scores)) if len(row.scores) else math.nan


def shape_of(machine: Machine) -> Shape:
    """Return how a competence is written."""
    return number if machine.measure == RETURN else percent


def machines_table(runs: Runs) -> str:
    """Return what each machine reached alone, and after how much teaching."""
    head = ["machine", "measure", "aim", "alone at the end, median [95 %]", "worst (seed)", "met"]
    head.append("iterations taught until competent, median (worst)")
    rows = []
    for what, seeds in runs.items():
        machine = OF[what]
        curves = curves_of(machine, seeds)
        shape = shape_of(machine)
        last = [each.last for each in curves.values()]
        middle = estimate(last, "median")
        value, seed = worst(last, list(curves))
        needed = [each.needed(machine.target) for each in curves.values()]
        took = f"{text(float(np.median(needed)), number)} ({text(max(needed), number)})"
        rows.append(
            [
                what,
                machine.measure,
                shape(machine.target),
                interval(middle, shape),
                f"{text(value, shape)} ({seed})",
                "yes" if middle.value >= machine.target else "**no**",
                took,
            ]
        )
    return markdown(head, rows)


def curves_of(machine: Machine, seeds: Mapping[int, Sequence[PhaseRow]]) -> dict[int, Curve]:
    """Return the curves of a machine's runs, by seed."""
    return {seed: curve(machine, rows) for seed, rows in seeds.items()}
