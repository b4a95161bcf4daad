"""The same machines by others: after how many actions and judgements each learner was as competent as is aimed at.

Competence is that of `verdicts.machines`. For who learns by a reward alone an action is a step of the environment.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from mdb_sim.studies.machines import BY_REWARD, Machine
from mdb_sim.studies.rows import PhaseRow
from mdb_sim.verdicts.machines import OF, curves_of, shape_of
from mdb_sim.verdicts.quantities import Runs
from mdb_sim.verdicts.statistics import markdown, number, text, worst

HEAD = (
    "machine, aim",
    "who",
    "seeds",
    "alone at the end, median (worst)",
    "competent to the end",
    "actions until then, median (worst)",
    "judgements until then, median",
    "actions until it was so for the first time, median",
)


def rivals_table(runs: Runs) -> str:
    """Return a row for each machine and learner."""
    rows = []
    for name, seeds in runs.items():
        what, _, who = name.rpartition(": ")
        machine = OF[what]
        rows.append([f"{what}, {shape_of(machine)(machine.target)}", who, *_cells(machine, who, seeds)])
    return markdown(HEAD, rows)


def without_reward(runs: Runs) -> list[str]:
    """Return the machines of these runs that have no reward of their own."""
    found = dict.fromkeys(name.rpartition(": ")[0] for name in runs)
    return [what for what in found if not OF[what].rewarded]


def _cells(machine: Machine, who: str, seeds: Mapping[int, Sequence[PhaseRow]]) -> list[str]:
    curves = curves_of(machine, seeds)
    last = [curve.last for curve in curves.values()]
    shape = shape_of(machine)
    needed = [curve.needed(machine.target) for curve in curves.values()]
    judged = float(np.median([curve.judged(machine.target) for curve in curves.values()]))
    first = [curve.first(machine.target) for curve in curves.values()]
    most = max(curve.taught[-1] for curve in curves.values())
    repeat = next(iter(seeds.values()))[0].repeat
    middle, longest = float(np.median(needed)), max(needed)
    took = _count(middle, most, repeat)
    if not math.isinf(middle):
        took += f" ({_count(longest, most, repeat)})"
    return [
        str(len(curves)),
        f"{text(float(np.median(last)), shape)} ({text(worst(last, list(curves))[0], shape)})",
        f"{sum(map(math.isfinite, needed))} of {len(curves)}",
        took,
        "none" if who in BY_REWARD else "–" if math.isinf(judged) else text(judged, number),
        _count(float(np.median(first)), most, repeat),
    ]


def _count(actions: float, most: int, repeat: int) -> str:
    """Return a number of actions in words, and of the environment's steps where an action lasts several."""
    if math.isinf(actions):
        return f"not within {most}"
    return number(actions) + (f", {number(actions * repeat)} steps" if repeat > 1 else "")
