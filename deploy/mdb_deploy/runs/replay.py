"""`mdb replay`: services of a recorded run replayed alone against its log, one line for each.

Owns what is chosen and printed; what a replay is, and what it cannot do, is in `mdb_sim.runs.replay`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import structlog

from mdb_protocol.errors import DamageError, MdbError
from mdb_protocol.words import shown
from mdb_sim.runs.compare import within
from mdb_sim.runs.replay import Outcome, Role, Run, replay, roles


def replay_run(folder: Path, names: Sequence[str], tolerance: float = 0.0) -> int:
    """Replay the named services of a run, or all that its log allows; return 1 when any says something else,
    or there was nothing to compare."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger("warning"))  # they tell of beginnings
    run = Run.read(folder)
    found = roles(run.experiment)
    chosen = _chosen(found, names)
    outcomes = [_replay(run, name, tolerance) for name in chosen]
    left_out = [name for name in found if not found[name].exact]
    if left_out and not names:
        names = ", ".join(left_out)
        sys.stdout.write(f"not replayed: {names} (concurrent pace: what had come to them when is not in the log)\n")
    if not any(outcome.compared for outcome in outcomes):
        sys.stdout.write(f"nothing of {folder} could be compared: that is no agreement\n")
        return 1
    return 0 if all(outcome.holds for outcome in outcomes) else 1


def _chosen(found: dict[str, Role], names: Sequence[str]) -> list[str]:
    """Return the services that are named, "evolver" being all evolvers."""
    for name in names:
        if not any(_is(service, name) for service in found):
            raise MdbError(f"no service {name!r} to be replayed; this run has {', '.join(found)}")
    if not names:
        return [service for service, role in found.items() if role.exact]
    return [service for service in found if any(_is(service, name) for name in names)]


def _is(service: str, name: str) -> bool:
    return name in (service, service.partition("/")[0])


def _replay(run: Run, name: str, tolerance: float) -> Outcome:
    try:
        outcome = replay(run, name, within(tolerance))
    except (LookupError, ValueError, ArithmeticError) as error:  # each message is one, but not of this machine
        raise DamageError(f"the run log does not fit its experiment: {name} cannot take it: {error!r}") from error
    lost = f", {outcome.unmatched} without counterpart" if outcome.unmatched else ""
    if outcome.difference:
        verdict = f"DIFFERS: {shown(outcome.difference)}"
    elif outcome.silent:
        verdict = "silent, now as then"
    else:
        verdict = f"equal{lost}" if outcome.holds else f"NOTHING COMPARED{lost}: the log has nothing that it said"
    sys.stdout.write(f"{name:<22} {outcome.heard:>7} heard {outcome.compared:>7} compared  {verdict}\n")
    sys.stdout.flush()
    return outcome
