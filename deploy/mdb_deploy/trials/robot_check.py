"""`mdb check-robot`: plays the brain against a robot, and says duty by duty what holds (`mdb_protocol.duties`).

Owns how each duty is tried, and the verdicts. Every wait has a bound; a robot that does no action any more is not
tried further, and what was not tried does not hold.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from mdb_deploy.trials.robot_link import Link
from mdb_protocol.duties import DUTIES, INSISTS_S, SHOWN_AGAIN_S
from mdb_protocol.messages import Action, Perception
from mdb_services.mechanism.networks.encoding import DERIVED, NOT_SENSED
from mdb_sim.runs.experiment import Experiment

IDLE_S = 1.5
"""So long the robot is only looked at, to begin with."""
LATE_S = 1.0
"""It must show again after this at the latest; it should after `SHOWN_AGAIN_S`."""
LOOK_S = 0.7
"""So long is looked whether something is done that must not be."""
TOO_OLD_S = 0.3
FIRST, ACTIONS = 7, 5
"""The brain's count at the first action, and how many are done like any."""
AHEAD = 50
"""Iterations by which the brain's count is ahead of the robot's."""
SAME = 1e-6
"""What is true is the same when no number of it moved by more."""
UNSEEN = (
    "Cannot be seen from outside: whether it asks for another robot before it starts (1), does the action rather\n"
    "than says so (6), brings its actuators to rest rather than shows the same (12), halts at its own end (12)."
)


class StopTrial(Exception):  # noqa: N818 - not an error: the verdict is in the report
    """The robot does no action any more, so that nothing more can be tried."""


@dataclass
class Report:
    """What was found of each duty: nothing against it, or why it does not hold."""

    tried: set[int] = field(default_factory=set)
    against: dict[int, list[str]] = field(default_factory=dict)

    def found(self, duty: int, wrong: str | None) -> None:
        """Note that a duty was tried, and what was wrong."""
        self.tried.add(duty)
        if wrong is not None and wrong not in self.against.setdefault(duty, []):
            self.against[duty].append(wrong)

    def failed(self) -> list[int]:
        """Return the duties against which something was found."""
        return sorted(duty for duty, words in self.against.items() if words)

    def holds(self) -> bool:
        """Whether every duty was tried, and nothing was found."""
        return self.tried == set(DUTIES) and not self.failed()

    def text(self) -> str:
        """Return a line for each duty, and what could not be seen."""
        lines = []
        for number, duty in DUTIES.items():
            verdict = "FAILS" if self.against.get(number) else "holds" if number in self.tried else "not tried"
            lines.append(f"{number:>2} {verdict:<9} {duty.title}")
            lines += [f"             {words}" for words in self.against.get(number, ())]
        return "\n".join([*lines, UNSEEN])


class RobotCheck:
    """One trial of one robot; `run` once."""

    def __init__(self, link: Link, experiment: Experiment, *, wait_s: float, patience_s: float) -> None:
        """`wait_s`: how long a robot is waited for; `patience_s`: how long an action may take."""
        self._link, self._experiment = link, experiment
        self._wait_s, self._patience_s = wait_s, patience_s
        self._held = experiment.robot.period_s is not None
        """Whether the robot acts all the time, so that the world moves while nobody commands."""
        self._acted = 0
        self.report = Report()

    def run(self) -> Report:
        """Try every duty, in the order in which that is possible."""
        try:
            self._come()
            self._idle()
            self._first()
            for _ in range(ACTIONS):
                self._act(self._link.now.iteration)
            for trial in (self._again, self._too_old, self._no_action, self._ahead):
                trial()
                self._act(self._link.now.iteration)
            self._rest()
        except StopTrial:
            pass
        self._listened()
        return self.report

    # ---- the beginning ----

    def _come(self) -> None:
        link, found = self._link, self.report.found
        link.listen(self._wait_s, lambda: bool(link.robots() or link.shown or link.unreadable))
        link.listen(LATE_S, lambda: bool(link.robots() and link.shown))
        if not (link.robots() or link.shown or link.unreadable):
            others = ", ".join(name for name in link.bus.brains() if name != link.bus.brain)
            where = f"; here is {others}: is that the name in its keys?" if others else ""
            found(1, f"no robot of brain {link.bus.brain} came within {self._wait_s:g} s{where}")
            raise StopTrial
        if link.robots() != ["body"]:
            had = ", ".join(f"alive/robot/{name}" for name in link.robots()) or "no token"
            found(1, f"there is {had}; expected alive/robot/body alone")
        claims = link.claims()
        if len(claims) != 1:
            had = ", ".join(f"claim/robot/body/{name}" for name in claims) or "no claim"
            why = "by it two that start in the same moment know of each other"
            found(1, f"there is {had}; expected one claim/robot/body/NAME: {why}")
        found(1, None)

    def _idle(self) -> None:
        """Look at a robot that nobody commands."""
        link, began_s = self._link, time.monotonic()
        link.listen(IDLE_S)
        if link.unreadable and not link.shown:
            raise StopTrial
        times = [began_s, *(shown.at_s for shown in link.shown if shown.at_s > began_s), time.monotonic()]
        gap_s = max(after - before for before, after in pairwise(times))
        wrong = f"nothing was shown for {gap_s:.1f} s; expected every {SHOWN_AGAIN_S:g} s"
        self.report.found(4, wrong if gap_s > LATE_S else None)
        if not link.shown:
            raise StopTrial
        self._still(12, "while nobody commanded", link.shown[0].perception)

    def _first(self) -> None:
        """The first action; a robot that has not acted takes any count."""
        now, (values, choice) = self._link.now, self._values()
        if now.iteration == 0 and now.done is None:
            if self._link.tell_until(FIRST, values, choice, self._patience_s):
                self._look(FIRST, duty=11)
                return
            self._act(0)
            self.report.found(11, f"nothing came of a first action of iteration {FIRST}, and of one of 0 it did")
        self._act(self._link.now.iteration)

    # ---- actions ----

    def _values(self) -> tuple[dict[str, float], int | None]:
        """Return what is told next, and its place among the choices."""
        self._acted += 1
        choices = self._experiment.brain.choice
        if choices:
            place = self._acted % len(choices)
            return dict(choices[place].values), place
        share = (self._acted % 5) / 4
        return {n: a.low + share * (a.high - a.low) for n, a in self._experiment.brain.actuators.items()}, None

    def _act(self, iteration: int) -> None:
        """Tell an action as the brain does, and look at what comes of it; StopTrial when nothing does."""
        values, choice = self._values()
        if not self._link.tell_until(iteration, values, choice, self._patience_s):
            told = f"the action {values} of iteration {iteration}"
            self.report.found(6, f"no outcome of {told} within {self._patience_s:g} s")
            raise StopTrial
        self._look(iteration, duty=6)

    def _look(self, iteration: int, duty: int) -> None:
        """Look at what came of the action of an iteration."""
        link, seen = self._link, self._link.now
        wrong = f"after the action of {iteration} it shows {seen.iteration}; expected {iteration + 1}"
        self.report.found(duty, None if seen.iteration == iteration + 1 else wrong)
        self.report.found(7, self._given_back(seen, iteration))
        link.listen(LATE_S, lambda: any(scene.iteration == seen.iteration for scene in link.scenes))

    def _given_back(self, seen: Perception, iteration: int) -> str | None:
        """Return what is wrong with what it says that it has done."""
        done, sent = seen.done, self._link.sent.get(iteration, [])
        if done is None:
            return "`done` is missing"
        if done in sent:
            return None
        meant = [action.intention for action in sent]
        if done.intention not in meant:
            return f"`done` has {'no' if done.intention is None else 'another'} intention than the action"
        return f"`done` is {_brief(done)}, which was not sent"

    # ---- what must not be done ----

    def _again(self) -> None:
        """Send the action that was done once more, as it was and anew."""
        link = self._link
        before, done = link.now, self._link.now.iteration - 1
        if link.sent.get(done):
            link.tell(link.sent[done][-1])
        link.tell(link.action(done, self._values()[0]))
        link.listen(LOOK_S)
        self._still(8, "after an action that was done was sent again", before)

    def _too_old(self) -> None:
        """Answer what was shown some time ago, and what was not shown yet."""
        link = self._link
        before, stamp = link.now, link.now.stamp
        link.listen(2 * TOO_OLD_S)
        link.tell(link.action(before.iteration, self._values()[0], stamp=stamp, valid_for_s=TOO_OLD_S))
        link.listen(LOOK_S)
        self._still(9, f"after an action that was {2 * TOO_OLD_S:g} s old and valid for {TOO_OLD_S:g} s", before)
        before = link.now
        link.tell(link.action(before.iteration, self._values()[0], stamp=before.stamp + 1000.0))
        link.listen(LOOK_S)
        self._still(9, "after an action with a stamp from the future", before)

    def _no_action(self) -> None:
        link = self._link
        before, values = link.now, self._values()[0]
        link.put_junk(link.action(before.iteration, values))
        name, actuator = next(iter(self._experiment.brain.actuators.items()))
        beyond = actuator.high + 10 * (actuator.high - actuator.low)
        for wrong in (values | {name: beyond}, values | {"no-actuator-of-this": 0.0}, {}):
            link.tell(link.action(before.iteration, wrong))
        heard, unreadable = len(link.shown), len(link.unreadable)
        link.listen(LOOK_S)
        link.listen(LATE_S, lambda: len(link.shown) > heard)
        self._still(10, "after what is no action", before)
        if len(link.unreadable) > unreadable:
            self.report.found(10, f"after what is no action it sends what is no message: {link.unreadable[-1]}")
            raise StopTrial
        if len(link.shown) == heard:
            self.report.found(10, "after what is no action it shows nothing any more")
            raise StopTrial

    def _ahead(self) -> None:
        """The brain has another count, says so once, and then insists."""
        link, before = self._link, self._link.now
        iteration = before.iteration + AHEAD
        values, choice = self._values()
        link.tell(link.action(iteration, values, choice=choice))
        link.listen(LOOK_S)
        self._still(11, f"after one action of iteration {iteration}, which may be junk,", before)
        bound_s = self._patience_s + 2 * INSISTS_S
        if not link.tell_until(iteration, values, choice, bound_s, every_s=SHOWN_AGAIN_S):
            self.report.found(11, f"the brain insisted for {bound_s:g} s on iteration {iteration}, in vain")
        else:
            self._look(iteration, duty=11)

    # ---- the end ----

    def _rest(self) -> None:
        link = self._link
        link.listen(self._experiment.robot.hold_s)
        link.listen(LATE_S, lambda: False)
        before, place = link.now, dict(link.place)
        link.listen(LOOK_S + LATE_S)
        self._still(12, "while nobody commanded", before, place)

    def _still(self, duty: int, when: str, before: Perception, place: dict[str, float] | None = None) -> None:
        """Note whether the robot stands where it stood."""
        link = self._link
        wrong = None
        if link.now.iteration != before.iteration:
            wrong = f"{when} it went from iteration {before.iteration} to {link.now.iteration}"
        elif link.now.done != before.done:
            wrong = f"{when} it says that it did {_brief(link.now.done)}"
        elif not self._held and (moved := _moved(self._then(before) if place is None else place, link.place)):
            wrong = f"{when} {moved} of its scene changed"
        self.report.found(duty, wrong)

    def _then(self, before: Perception) -> dict[str, float]:
        """Return what was true when a perception was shown first."""
        return next((dict(s.now) for s in self._link.scenes if s.iteration == before.iteration), {})

    def _listened(self) -> None:
        """Look at all that was heard: form, stamps, names."""
        link, found = self._link, self.report.found
        if link.unreadable:
            found(2, f"{len(link.unreadable)} could not be read, as {link.unreadable[0]}")
        if not link.shown:
            return
        found(2, None)
        found(5, self._stamps())
        for wrong in self._names() or [None]:
            found(3, wrong)

    def _stamps(self) -> str | None:
        shown = self._link.shown
        for before, after in pairwise(shown):
            if after.perception.stamp <= before.perception.stamp:
                return f"a stamp of {after.perception.stamp!r} came after {before.perception.stamp!r}"
        passed_s = shown[-1].at_s - shown[0].at_s
        said_s = shown[-1].perception.stamp - shown[0].perception.stamp
        if passed_s > LATE_S and not passed_s / 2 < said_s < 2 * passed_s:
            return f"within {passed_s:.1f} s the stamps went on by {said_s:.3g}; expected seconds"
        return None

    def _names(self) -> list[str | None]:
        """Return what is wrong with the names and numbers of readings and scenes."""
        brain = self._experiment.brain
        readings = [r for shown in self._link.shown for r in (shown.perception.reading, shown.perception.outcome)]
        wrong: list[str | None] = []
        for name, channel in brain.channels.items():
            if name in NOT_SENSED or name in brain.actuators or name.startswith(DERIVED):
                continue
            values = [reading[name] for reading in readings if name in reading]
            numbers = {len(value) if isinstance(value, list) else 1 for value in values}
            had = ", ".join(sorted({known for reading in readings for known in reading})) or "nothing"
            if not values:
                wrong.append(f"no reading had {name!r}; they had {had}")
            elif numbers != {channel.numbers}:
                wrong.append(f"{name!r} has {sorted(numbers)} numbers; the file says {channel.numbers}")
        return wrong + self._scenes()

    def _scenes(self) -> list[str | None]:
        if self._experiment.teacher is None:
            return []
        scenes = self._link.scenes
        unseen = {shown.perception.iteration for shown in self._link.shown} - {scene.iteration for scene in scenes}
        if unseen:
            return [f"no scene of iteration {min(unseen)} came, and the experiment has a scripted teacher"]
        needs = self._experiment.schedule().policy.needs
        lacks = sorted({name for name in needs for scene in scenes if name not in scene.now})
        return [f"the scene has no {name!r}, at which the teacher's policy looks" for name in lacks]


def _moved(before: dict[str, float], after: Any) -> str | None:
    """Return the name of a number that is another one, if there is one."""
    return next((n for n, value in before.items() if n not in after or abs(after[n] - value) > SAME), None)


def _brief(action: Action | None) -> str:
    return "nothing" if action is None else f"{action.action} of iteration {action.iteration}"
