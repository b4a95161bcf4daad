"""What a teacher wants, and how good what happened was: the contract, and how a policy is found by its name.

A policy sees scenes, that is named numbers that are true, as a bystander does. It judges what happened between two
scenes, never the action: with motors that are swapped, the teacher still teaches what he means.
`tests/conformance/policy_conformance.py` holds a policy to this page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from mdb_protocol import messages
from mdb_sim.bodies.finding import check_members, find
from mdb_sim.body import BodyError, Numbers
from mdb_sim.teaching.languages import Language, TeacherError

POLICIES = {
    "reach": "mdb_sim.teaching.policies.pioneer:Reach",
    "avoid": "mdb_sim.teaching.policies.pioneer:Avoid",
    "follow-wall": "mdb_sim.teaching.policies.pioneer:FollowWall",
    "balance": "mdb_sim.teaching.policies.control:Balance",
    "swing": "mdb_sim.teaching.policies.control:Swing",
    "whip": "mdb_sim.teaching.policies.control:Whip",
    "nearer": "mdb_sim.teaching.policies.places:Nearer",
    "upright": "mdb_sim.teaching.policies.control:Upright",
    "drive": "mdb_sim.teaching.policies.bullet:Drive",
    "guide": "mdb_sim.teaching.policies.bullet:Guide",
}
"""The policies that have a short name; any other is named "package.module:Factory"."""
MEMBERS = ("commands", "order", "needs", "want", "judge", "expected")
OBEYED = 0.9
"""A judgement from here on says that what was wanted was done: the one meaning of obedience."""


class Policy(Protocol):
    """What a teacher wants. Pure: the same scenes, the same answers."""

    @property
    def commands(self) -> tuple[str, ...]:
        """What can be wanted, by name; a command is a place in this list."""

    @property
    def order(self) -> tuple[int, ...]:
        """For each command its rank among all, where there is an order, as from the right to the left."""

    @property
    def needs(self) -> tuple[str, ...]:
        """The names of the scene's numbers that it looks at."""

    def want(self, scene: Mapping[str, float]) -> int | None:
        """Return the command that is wanted in a scene; None: none is."""

    def judge(self, before: Mapping[str, float], after: Mapping[str, float], event: str, wanted: int) -> float | None:
        """Return how well what happened between two scenes is what was wanted: -1 to 1, from `OBEYED` on it is.

        None: it cannot be told, whatever was wanted.
        """

    def expected(self, wanted: int, action: Mapping[str, float]) -> float | None:
        """Return the judgement of an action that does what it is meant to do; None: that depends on where."""


@runtime_checkable
class Rating(Protocol):
    """A policy that also judges where it wants nothing: a teacher who only praises and punishes (TAMER)."""

    def rate(self, before: Mapping[str, float], after: Mapping[str, float], event: str) -> float | None:
        """Return how good what happened between two scenes was: -1 to 1. None: it cannot be told."""


def make_policy(name: str, options: Mapping[str, Any], folder: Path | None = None) -> Policy:
    """Make a policy with the options of `[teacher.options]`; TeacherError tells what was wrong."""
    try:
        factory = find(name, folder, "policy", POLICIES)
        policy = factory(**options)
        check_members(policy, MEMBERS, f"policy={name!r}", "mdb_sim.teaching.policy.Policy")
    except BodyError as error:
        raise TeacherError(str(error)) from error
    except (TypeError, ValueError) as error:
        raise TeacherError(f"policy={name!r} does not take the options {dict(options)}: {error}") from error
    made: Policy = policy
    return made


def likest(policy: Policy, before: Numbers, after: Numbers, event: str) -> int | None:
    """Return the command that what happened is most like, the first of equals; None: it cannot be told."""
    worth = [policy.judge(before, after, event, wanted) for wanted in range(len(policy.commands))]
    told = {command: value for command, value in enumerate(worth) if value is not None}
    return max(told, key=lambda command: told[command]) if told else None


def judgement(policy: Policy, scene: messages.Scene) -> float | None:
    """Return how well what was wanted before a scene was done; None: it cannot be told.

    Where nothing was wanted, how good what happened was, if the policy can rate that; None if it cannot.
    """
    if scene.before is None:
        return None
    wanted = policy.want(scene.before)
    if wanted is None:
        return policy.rate(scene.before, scene.reached, scene.event) if isinstance(policy, Rating) else None
    return policy.judge(scene.before, scene.reached, scene.event, wanted)


def obeyed(policy: Policy, language: Language, note: int, scene: messages.Scene) -> bool | None:
    """Return whether what a note meant was done before a scene; None: that cannot be said."""
    return done(policy, language.command(note), scene) if 0 <= note < len(language.notes) else None


def done(policy: Policy, command: int, scene: messages.Scene) -> bool | None:
    """Return whether a command was done before a scene; None: that cannot be said."""
    if scene.before is None or not shows(policy, scene):
        return None
    worth = policy.judge(scene.before, scene.reached, scene.event, command)
    return None if worth is None else worth >= OBEYED


def shows(policy: Policy, scene: messages.Scene) -> bool:
    """Return whether a scene has what a policy looks at, before the action and after it."""
    return scene.before is not None and set(policy.needs) <= set(scene.before) & set(scene.reached)


def as_listed(commands: Sequence[str]) -> tuple[int, ...]:
    """Return the order of commands that are in order already, or in none."""
    return tuple(range(len(commands)))
