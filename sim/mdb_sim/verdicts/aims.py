"""What was aimed at with teachers as they are, and whether it was reached. A variant that is missing reaches nothing.

Owns the aims: with a fifth of the notes or of the feedback wrong, obedience of 80 % and 100 captures in a phase
alone; praise that fades with a mean loss of 3 % at most; late feedback that names no iteration
within a tenth of such that does.
"""

from __future__ import annotations

from mdb_sim.verdicts.quantities import OBEDIENCE, Measure, Quantity, Runs, phases_of, pooled
from mdb_sim.verdicts.statistics import FEWEST, interval, markdown, number, percent

OBEYED, CAPTURED, TENTH = 0.8, 100.0, 0.9
KEPT = 0.97
"""What is left of the mean under perfect teachers where nothing is said to be lost."""
CAPTURES = Measure("captures", lambda row: row.captures, "mean", number)
WRONG = ("20 % wrong notes", "20 % wrong feedback")
PERFECT, FADING = "perfect", "praise that fades (half in 100)"
LATE = (1, 2, 3)
"""Iterations late up to which naming none should cost little."""
MISSING = ["not measured", "**no**"]


def aims_table(runs: Runs) -> str:
    """Return Markdown: a row an aim, what was reached, and whether that is enough."""
    phases = phases_of(runs)
    taught, alone = ([row.phase for row in phases if row.alone == is_alone] for is_alone in (False, True))
    if not taught or not alone:
        return ""
    obedience = pooled(runs, OBEDIENCE, taught, "obedience, both teachers")
    captures = pooled(runs, CAPTURES, alone, "captures in a phase alone")
    rows = []
    for variant in WRONG:
        rows.append([f"{variant}: obedience ≥ 80 %", *_at_least(obedience, variant, OBEYED)])
        rows.append([f"{variant}: captures alone ≥ {CAPTURED:.0f}", *_at_least(captures, variant, CAPTURED)])
    for measured in (obedience, captures):
        rows.append([f"{FADING}: mean {measured.name} ≥ {KEPT * 100:.0f} % of {PERFECT}", *_no_worse(measured)])
    everything = pooled(runs, CAPTURES, [*taught, *alone], "captures in a phase")
    rows += [[f"late by {n}, not named: captures ≥ 90 % of named", *_of_named(everything, n)] for n in LATE]
    return markdown(["aim", "reached [95 %]", "met"], rows)


def _told(met: bool) -> str:
    return "yes" if met else "**no**"


def _at_least(measured: Quantity, variant: str, least: float) -> list[str]:
    if variant not in measured.values:
        return MISSING
    found = measured.estimate(variant)
    return [interval(found, measured.shape), _told(found.value >= least)]


def _no_worse(measured: Quantity) -> list[str]:
    """Judge by the means: an interval that holds 0 may only be a wide one."""
    if FADING not in measured.values or PERFECT not in measured.values:
        return MISSING
    fading, perfect = (measured.estimate(variant, "mean") for variant in (FADING, PERFECT))
    met = perfect.value > 0 and fading.value >= KEPT * perfect.value
    few = " (few seeds)" if len(measured.seeds) < FEWEST else ""
    found = [interval(each, measured.shape) for each in (fading, perfect)]
    return [f"{found[0]}; {PERFECT} {found[1]}", _told(met) + few]


def _of_named(measured: Quantity, late: int) -> list[str]:
    named, unnamed = f"late by {late}", f"late by {late}, not named"
    if named not in measured.values or unnamed not in measured.values:
        return MISSING
    if measured.estimate(named).value == 0:
        return MISSING  # of nothing there is no share
    share = measured.estimate(unnamed).value / measured.estimate(named).value
    told = f"{percent(share)}: {interval(measured.estimate(unnamed), number)}"
    return [f"{told}; named {interval(measured.estimate(named), number)}", _told(share >= TENTH)]
