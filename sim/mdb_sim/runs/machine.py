"""Whether an experiment file fits the body and the policy that it names. Pure: each difference in words."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, Protocol

from mdb_services.experiment.brain import BrainConfig
from mdb_services.mechanism.networks.encoding import DERIVED, NOT_SENSED
from mdb_sim.body import Spec
from mdb_sim.robot.course import TIMEOUT
from mdb_sim.teaching.policy import Policy


class Declared(Protocol):
    """What a file says of its robot."""

    @property
    def successes(self) -> Sequence[str]:
        """The events that are successes."""

    @property
    def ends(self) -> Sequence[str]:
        """The events that end an episode."""

    @property
    def changes(self) -> Mapping[int, Mapping[str, Any]]:
        """What changes, before the action of which iteration."""


def differences(brain: BrainConfig, robot: Declared, spec: Spec | None, policy: Policy | None) -> list[str]:
    """Return what of a file does not fit, each in words; nothing when all fits. Without `spec` only the teacher's."""
    notes = _notes(brain, policy) if policy is not None else ()
    if spec is None:
        return [*notes]
    found = [*_actions(brain, spec), *_sensors(brain, spec)]
    words = {*spec.events, TIMEOUT}
    for setting, events in (("successes", robot.successes), ("ends", robot.ends)):
        found += [
            f"robot.{setting} has {event!r}, which is none of its events ({_listed(words)})"
            for event in events
            if event not in words
        ]
    found += [
        f"its event {event!r} ends an episode; add it to robot.ends"
        for event in spec.final
        if event not in robot.ends
    ]
    names = {name for settings in robot.changes.values() for name in settings}
    found += [
        f"robot.change sets {name!r}, which cannot be changed ({_listed(spec.changes)})"
        for name in sorted(names)
        if name not in spec.changes
    ]
    if policy is not None:
        found += [
            f"the teacher's policy looks at {name!r}, which its scene does not have ({_listed(spec.scene)})"
            for name in policy.needs
            if name not in spec.scene
        ]
    return [*found, *notes]


def _actions(brain: BrainConfig, spec: Spec) -> Iterator[str]:
    theirs = {actuator.name: actuator for actuator in spec.actuators}
    for name in brain.actuators:
        if name not in theirs:
            yield f"it has no actuator {name!r} ({_listed(theirs)})"
    for name in theirs:
        if name not in brain.actuators:
            yield f"its actuator {name!r} is not in the file; add [actuators.{name}] with low and high"
    if set(theirs) != set(brain.actuators):
        return
    for name, actuator in theirs.items():
        ours = brain.actuators[name]
        if not actuator.low <= ours.low < ours.high <= actuator.high:
            yield (
                f"actuators.{name} goes from {ours.low:g} to {ours.high:g}, the body's from {actuator.low:g} to "
                f"{actuator.high:g} {actuator.unit}".rstrip()
            )
    if spec.choices and not brain.choice:
        yield f"it can do {len(spec.choices)} things only; add a [[choice]] for each"
    for choice in brain.choice:
        if spec.choices and choice.values not in spec.choices:
            yield f"choice {choice.name!r} is none of the {len(spec.choices)} things that it can do"


def _sensors(brain: BrainConfig, spec: Spec) -> Iterator[str]:
    theirs = {sensor.name: sensor for sensor in spec.sensors}
    for name, channel in brain.channels.items():
        if name in NOT_SENSED or name in brain.actuators or name.startswith(DERIVED):
            continue
        if name not in theirs:
            yield f"channels.{name}: it has no such sensor or actuator ({_listed(theirs)})"
        elif theirs[name].numbers != channel.numbers:
            yield f"channels.{name}: the sensor gives {theirs[name].numbers} numbers, not {channel.numbers}"


def _notes(brain: BrainConfig, policy: Policy) -> Iterator[str]:
    notes = brain.variables()["note"].indices if "note" in brain.channels else None
    if notes is not None and notes != len(policy.commands):
        yield f"the teacher's policy has {len(policy.commands)} commands, but channels.note {notes} notes"


def _listed(names: Collection[str]) -> str:
    return f"there are {', '.join(sorted(names))}" if names else "there are none"
