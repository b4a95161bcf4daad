"""The report in short: a few lines, each a number that was measured, the failures among them.

Owns what is said at the top of the report. A study without results says nothing here; its section says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from mdb_sim.studies import tables
from mdb_sim.studies.results import Result
from mdb_sim.verdicts.acceptance import failures, judge
from mdb_sim.verdicts.comings import comings_of, own_firsts
from mdb_sim.verdicts.quantities import OBEDIENCE, SHARE, Runs, phases_of, pooled, quantity, runs_of
from mdb_sim.verdicts.statistics import Estimate, estimate, interval, number, percent, seeds_text, text, wilson

WELL_OBEYED, WELL_ALONE = 0.8, 0.9
"""Obedience to the last teacher, and share of the ideal alone, below which teachers or learners are named."""


def in_short(found: Mapping[str, Sequence[Result]]) -> str:
    """Return a list in Markdown, a line a study and body."""
    lines = []
    for study, told in TOLD.items():
        bodies = list(dict.fromkeys(result.label.body for result in found.get(study, ())))
        for body in bodies:
            runs = runs_of(result for result in found[study] if result.label.body == body)
            if not next(iter(runs.values())):
                continue
            where = "" if body == "kinematic" else f", {body}"
            seeds = seeds_text(list(next(iter(runs.values()))))
            lines.append(f"- **{study}** ({seeds}{where}): {told(runs)}")
    return "\n".join(["## In short", "", *lines]) if lines else ""


def _alone(runs: Runs) -> str:
    seeds = next(iter(runs.values()))
    variant = next(iter(runs))
    shares = []
    for row in phases_of(runs):
        if row.alone:
            share = quantity(runs, SHARE, row.phase)
            worst, seed = share.worst(variant)
            mean = interval(share.estimate(variant), percent)
            shares.append(f"{row.name} {mean}, worst {text(worst, percent)} (seed {seed})")
    count, of = failures(seeds)
    missed = [criterion.name for criterion in judge(seeds) if not criterion.met]
    return (
        f"captures as a share of the ideal: {'; '.join(shares)}. {count} of {of} phases alone below 90 % "
        f"({interval(wilson(count, of), percent)}). "
        + (f"Missed: {'; '.join(missed)}." if missed else "All criteria met.")
    )


def _reproduction(runs: Runs) -> str:
    last = max(row.phase for row in phases_of(runs) if not row.alone)
    obedience = quantity(runs, OBEDIENCE, last)
    told = [
        f"{variant}: obedience to the last teacher {interval(obedience.estimate(variant), percent)}, "
        f"captures alone as a share of the ideal {interval(_alone_share(runs, variant), percent)}"
        for variant in runs
    ]
    return "; ".join(told) + "."


def _paper(runs: Runs) -> str:
    last = max(row.phase for row in phases_of(runs) if not row.alone)
    obedience = quantity(runs, OBEDIENCE, last)
    told = [
        f"{variant} {interval(obedience.estimate(variant), percent)}"
        for variant in (tables.AS_WRITTEN, tables.AS_SHIPPED)
        if variant in runs
    ]
    return f"obedience to the last teacher: {'; '.join(told)}."


def _named(runs: Runs) -> str:
    last = max(row.phase for row in phases_of(runs) if not row.alone)
    obedience = quantity(runs, OBEDIENCE, last)
    disobeyed = [
        f"{variant} {text(obedience.estimate(variant).value, percent)}"
        for variant in runs
        if not obedience.estimate(variant).value >= WELL_OBEYED
    ]
    lost = [
        f"{variant} {text(_alone_share(runs, variant).value, percent)}"
        for variant in runs
        if not _alone_share(runs, variant).value >= WELL_ALONE
    ]
    return (
        f"of {len(runs)}, obedience to the last teacher below {WELL_OBEYED:.0%}: ".replace("%", " %")
        + f"{', '.join(disobeyed) or 'none'}; captures alone below 90 % of the ideal: {', '.join(lost) or 'none'}."
    )


def _alone_share(runs: Runs, variant: str) -> Estimate:
    alone = [row.phase for row in phases_of(runs) if row.alone]
    return pooled(runs, SHARE, alone, "alone").estimate(variant)


def _memory(runs: Runs) -> str:
    told = []
    for variant, rows in comings_of(runs).items():
        returning = own_firsts([coming.teacher for coming in rows[0].comings])
        returns = [estimate([row.comings[i].iterations for row in rows], "median").value for i in returning]
        told.append(f"{variant} {', '.join(text(value, number) for value in returns) or 'nobody returns'}")
    return f"iterations to 90 % obedience of each return, medians: {'; '.join(told)}."


def _life(runs: Runs) -> str:
    seeds = next(iter(runs.values()))
    alone = [row.phase for row in phases_of(runs) if row.alone]
    variant = next(iter(runs))
    first, last = (
        interval(quantity(runs, SHARE, place).estimate(variant), percent) for place in (alone[0], alone[-1])
    )
    count, of = failures(seeds)
    return (
        f"captures alone as a share of the ideal, after the first teacher {first}, after the last {last}; "
        f"{count} of {of} phases alone below 90 % ({interval(wilson(count, of), percent)})."
    )


TOLD: dict[str, Callable[[Runs], str]] = {
    "alone": _alone,
    "reproduction": _reproduction,
    "paper": _paper,
    "teachers": _named,
    "learners": _named,
    "memory": _memory,
    "life": _life,
}
"""What is said of each study."""
