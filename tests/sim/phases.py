"""Phases and results made by hand, for tests of what is said of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mdb_sim.studies.results import Label, Result
from mdb_sim.studies.rows import PhaseRow

NAN = float("nan")
PHASE = 500
NAMES = (("first teacher", "one"), ("alone", None), ("second teacher", "two"), ("alone again", None))
IDEAL = (70.0, 118.0, 116.0, 120.0)
GOOD = (69.0, 116.0, 110.0, 117.0)


def phase(seed: int, place: int, **changes: Any) -> PhaseRow:
    """One phase of a good run of the paper's schedule."""
    name, teacher = NAMES[place]
    taught = teacher is not None
    captured = np.zeros(PHASE, np.int8)
    captured[:: PHASE // int(GOOD[place])] = 1
    errors = np.linspace(1.0, 0.0, PHASE, dtype=np.float32) if taught else np.full(PHASE, np.nan, np.float32)
    path = np.array([1.0, 0.2, 0.0, 0.0, 0.0, 0.2, 0.0, 0.1, 0.4, 0.05, 0.2], np.float32)
    row = PhaseRow(
        seed=seed,
        body="kinematic",
        phase=place,
        name=name,
        teacher=teacher,
        start=place * PHASE,
        stop=(place + 1) * PHASE,
        counted_from=200 if place == 0 else place * PHASE,
        captures=GOOD[place],
        ideal_captures=IDEAL[place],
        random_iterations=200,
        commands=PHASE if taught else 0,
        obedience=0.99 if taught else NAN,
        iterations_to_obedience=(217.0, NAN, 44.0, NAN)[place],
        disobeyed_at_first=18.0 if taught else NAN,
        iterations_to_error=70.0 if taught else NAN,
        prequential=0.02 if taught else NAN,
        pair_error=0.04 if taught else NAN,
        bumps=0,
        lost=1,
        timeouts=0,
        captured=captured,
        obeyed=np.full(PHASE, 1 if taught else -1, np.int8),
        prequential_curve=errors,
        memory_error_curve=errors,
        pair_error_curve=errors,
        capture_steps=np.array([4, 5, 4], np.int32),
        paths=(path,),
    )
    return replace(row, **changes)


def run(seed: int, **changes: dict[int, Any]) -> tuple[PhaseRow, ...]:
    """The four phases of a good run; changes: by field, then by phase."""
    rows = [phase(seed, place) for place in range(len(NAMES))]
    for name, by_phase in changes.items():
        for place, value in by_phase.items():
            rows[place] = replace(rows[place], **{name: value})
    return tuple(rows)


def label(study: str = "paper", variant: str = "as shipped", seed: int = 11, order: int = 0, **changes: Any) -> Label:
    """What a result is labelled with."""
    made = Label(
        study=study,
        variant=variant,
        order=order,
        seed=seed,
        body="kinematic",
        fingerprint="f",
        code="c",
        seconds=15.0,
    )
    return replace(made, **changes)


def results(study: str, variants: Iterable[str], seeds: Sequence[int] = (11, 12, 13)) -> list[Result]:
    """Good runs of a study under some variants."""
    return [
        Result(label(study, variant, seed, order), run(seed))
        for order, variant in enumerate(variants)
        for seed in seeds
    ]
