"""What the brain thought when it chose an action: what it foresaw of each, which it took, and why, in words.

Computed as the action optimizer did: from the models of the versions that it acted upon, by the same `foresee`. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mdb_deploy.web.telling.plan import LOOKED_AT, MOST_SHOWN, Plan, number
from mdb_protocol.messages import Action, Intention, IterationReport
from mdb_services.mechanism.actions.choice import ALIKE, RANDOM_MODE, SUPPORTED
from mdb_services.mechanism.actions.foresight import Foreseen, Mode, Models, foresee
from mdb_services.mechanism.networks.encoding import Facts, gather

DIGITS = 5
"""Of satisfactions and supports."""
ALMOST = 0.05
"""Of two promises that differ by less one does not say that one is more."""
MOST_NAMED = 3
"""So many teachers are named in one sentence."""


@dataclass(frozen=True)
class Around:
    """What is known beside the action itself: whose feedback was learnt so far, and who teaches now, if anybody."""

    learnt_from: Sequence[str] = ()
    teacher: str | None = None


@dataclass(frozen=True)
class Looked:
    """The actions that are shown, each fact (n,), which of them was chosen, and what was foreseen of each.

    `best`: the highest promise of all that were looked at.
    """

    facts: Facts
    chosen: int | None
    foreseen: Foreseen | None
    best: float = 0.0


def thought(
    plan: Plan, action: Action, models: Models, report: IterationReport | None = None, around: Around | None = None
) -> dict[str, Any]:
    """Return the part `thought` of an action.

    models: those of the versions in the action's intention; what is missing is not foreseen. report: that of this
    iteration, when it is there.
    """
    around = around or Around()
    meant = action.intention or _unknown()
    mode = plan.modes.get(meant.mode)
    found = look(plan, action, meant, mode, models)
    badge = badge_of(plan, meant, mode)
    return {
        "iteration": action.iteration,
        "mode": meant.mode,
        "note": meant.note,
        "teacher": meant.teacher,
        "explored": meant.explored,
        "predicted": number(meant.predicted, DIGITS),
        "badge": badge,
        "badge_words": _badge_words(badge, meant, around),
        "why": why(plan, action, mode, found, around),
        "actions": _shown(plan, meant, found),
        "came": None if report is None else {"feedback": number(report.feedback), "event": report.event},
    }


def waiting(words: str) -> dict[str, Any]:
    """Return the part `thought` of a brain that waits and has not chosen anything yet."""
    return {
        "iteration": 0, "mode": None, "note": None, "teacher": None, "explored": False, "predicted": None,
        "badge": "waits", "badge_words": words, "why": "", "actions": [], "came": None,
    }  # fmt: skip


def look(plan: Plan, action: Action, meant: Intention, mode: Mode | None, models: Models) -> Looked:
    """Return the actions to show and what was foreseen of them: all choices, or some points of the ranges."""
    choices = bool(plan.brain.choice)
    if choices:
        facts = plan.choices()
        place = None if action.choice not in plan.order else plan.order.index(action.choice)
    elif set(plan.actuators) <= set(action.action):
        facts, place = plan.spread(action.action), 0
    else:
        facts, place = plan.grid(), None
    foreseen = None
    if mode is not None:
        foreseen = foresee(mode, models, gather(before=meant.before, note=meant.note), facts)
    best = -np.inf if foreseen is None else float(foreseen.promise.max())
    if choices:
        return Looked(facts, place, foreseen, best)
    kept = _spread_places(plan, facts, foreseen, place)
    facts = {name: values[kept] for name, values in facts.items()}
    if foreseen is not None:
        foreseen = Foreseen(*(values[kept] for values in foreseen))
    return Looked(facts, None if place is None else kept.index(place), foreseen, best)


def _spread_places(plan: Plan, facts: Facts, foreseen: Foreseen | None, chosen: int | None) -> list[int]:
    """Return the places of at most `MOST_SHOWN` points, by their values: the chosen one, the best, and a spread."""
    count = len(next(iter(facts.values())))
    must = set() if chosen is None else {chosen}
    if foreseen is not None:
        must.add(int(np.argmax(foreseen.promise)))
    room = MOST_SHOWN - len(must)
    if count <= MOST_SHOWN:
        kept = set(range(count))
    elif len(plan.actuators) == 1:
        kept = must | set(np.linspace(1, LOOKED_AT - 1, room).round().astype(int).tolist())
    else:
        kept = must | set([place for place in range(1, count) if place not in must][:room])
    points = np.column_stack([facts[name] for name in plan.actuators])
    if chosen is not None:  # one of the spread may be the same
        same = np.flatnonzero(np.isclose(points, points[chosen]).all(axis=1)).tolist()
        kept -= set(same) - {chosen}
    return sorted(kept, key=lambda place: points[place].tolist())


def badge_of(plan: Plan, meant: Intention, mode: Mode | None) -> str:
    """Return "obeys", "explores" or "alone"."""
    if meant.explored or mode is None:
        return "explores"
    return "obeys" if meant.note is not None and plan.uses_note(mode) else "alone"


def why(plan: Plan, action: Action, mode: Mode | None, found: Looked, around: Around) -> str:
    """Return one short sentence, with numbers, of why this action was chosen."""
    meant = action.intention or _unknown()
    name = f"'{plan.name(action.action, action.choice)}'"
    first = plan.brain.optimizer.random_iterations
    if meant.explored and action.iteration < first:
        return f"The first {first} iterations are random, so that it sees everything once."
    if mode is None:
        chance = meant.mode == RANDOM_MODE
        return f"It can foresee nothing here, so it tries {name} by chance." if chance else f"It does {name}."
    obeys = meant.note is not None and plan.uses_note(mode)
    begin = f"Note {meant.note}: it" if obeys else "It"
    if found.foreseen is None or found.chosen is None:
        return (
            f"{begin} {'tries' if meant.explored else 'does'} {name}; its models of that moment are not known here."
        )
    if meant.explored:
        return _why_explored(begin, name, mode, found, " under this note" if obeys else "")
    if obeys:
        return _why_best(plan, begin, name, mode, found)
    alone = "No teacher is there." if around.teacher is None else "No note came."
    return f"{alone} {_why_best(plan, begin, name, mode, found)}"


def _why_best(plan: Plan, begin: str, name: str, mode: Mode, found: Looked) -> str:
    """Return why a mode took what promises most, or about as much."""
    assert found.foreseen is not None
    assert found.chosen is not None
    promise = found.foreseen.promise
    mine, others = float(promise[found.chosen]), np.delete(promise, found.chosen)
    expects = f"{begin} expects {mine:+.2f} of {name}"
    if mine < found.best - ALIKE:
        if mode.margin and mine >= found.best - mode.margin - ALIKE:
            return f"{expects}, nearly the most ({found.best:+.2f}), and knows it better."
        return f"{expects}, the most of what it looked at."
    if plan.brain.choice and mine - others.max() < ALMOST:
        second = int(np.argmax(others))
        second += second >= found.chosen
        return f"{expects}, about as much as of '{_name_at(plan, found, second)}'."
    if not plan.uses_note(mode) and mode.satisfaction in plan.books:
        return f"It foresees that {name} brings it nearest to what was praised ({mine:+.2f})."
    return f"{expects}, {'more than of any other action' if plan.brain.choice else 'the most of what it looked at'}."


def _why_explored(begin: str, name: str, mode: Mode, found: Looked, under: str) -> str:
    assert found.foreseen is not None
    support = float(found.foreseen.support[found.chosen])
    if mode.aspiration is None or (mode.babbling > 0 and found.best >= mode.aspiration):
        return f"{begin} tries {name}: now and then it does anything at all, to learn from it."
    if mode.curiosity > 0 and support < SUPPORTED:
        return f"{begin} tries {name}: it knows little of it{under}."
    return f"{begin} tries {name}: the best that it expects{under} is {found.best:+.2f}, which is not enough."


def _badge_words(badge: str, meant: Intention, around: Around) -> str:
    if badge == "obeys":
        return f"obeys {meant.teacher or 'its teacher'}"
    if badge == "explores":
        return "explores"
    names = list(around.learnt_from)
    if not names:
        return "on its own"
    if len(names) > MOST_NAMED:
        return "on its own, by what it learnt from its teachers"
    return f"on its own, by what it learnt from {listed(names)}"


def listed(names: Sequence[str]) -> str:
    """Return names in a sentence: "a", "a and b", "a, b and c"."""
    return " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else "".join(names)


def _shown(plan: Plan, meant: Intention, found: Looked) -> list[dict[str, Any]]:
    shown = []
    for place in range(len(next(iter(found.facts.values())))):
        values = {name: number(found.facts[name][place], 6) for name in plan.actuators}
        chosen, foreseen = place == found.chosen, found.foreseen
        known = None if foreseen is None else foreseen.satisfaction[place]
        shown.append(
            {
                "name": _name_at(plan, found, place),
                "choice": _choice_at(found, place),
                "values": values,
                "satisfaction": number(meant.predicted if chosen and known is None else known, DIGITS),
                "support": None if foreseen is None else number(foreseen.support[place], DIGITS),
                "promise": None if foreseen is None else number(foreseen.promise[place], DIGITS),
                "chosen": chosen,
            }
        )
    return shown


def _choice_at(found: Looked, place: int) -> int | None:
    return int(found.facts["action"][place]) if "action" in found.facts else None


def _name_at(plan: Plan, found: Looked, place: int) -> str:
    values = {name: float(found.facts[name][place]) for name in plan.actuators}
    return plan.name(values, _choice_at(found, place))


def _unknown() -> Intention:
    """Return the intention of an action that carries none: a robot's own, or a log of before."""
    return Intention(
        before={}, note=None, teacher=None, holder=None, mode="unknown", explored=False, predicted=None, versions={}
    )
