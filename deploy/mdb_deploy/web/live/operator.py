"""The operator's part: changes of the robot, and how the run goes on, on a bus of its own.

One order after the other. How the run goes on is one state, of which the last word counts: each order changes a part
of what was said last, by whomever. Who comes late hears it from the bus that has said it, and from two buses in any
order. So what a bridge has said that has died is said again, and a bus after which another has spoken is left.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import structlog

from mdb_deploy.running.changing import ANSWER_S, ROBOT, change_robot
from mdb_deploy.web.live.finding import Found
from mdb_deploy.web.live.hub import Hub
from mdb_deploy.web.live.orders import ControlRun
from mdb_deploy.web.telling.hello import changes_of
from mdb_protocol import keys, messages
from mdb_protocol.bus import Bus, Publisher
from mdb_protocol.errors import MdbError
from mdb_protocol.messages.world import MAX_ENDED
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_sim.runs.experiment import Experiment

log = structlog.get_logger()

JOIN_S = 4.5
"""Bound on joining a router: with the two below less than a browser waits for an answer, 10 s."""
HEARD_S, LOOK_S = 2.0, 0.005
"""Bound on hearing ourselves what was said, and how often it is looked for."""
BUSY_S = 3.0
"""Bound on waiting for the order before."""
BEHIND_S = 1.0
"""So long after our word another's is not taken for one that came before it."""
TEACHER = "teacher/script"


class Operator:
    """See the module's docstring. Its methods wait, with a bound: to be called in a thread."""

    def __init__(self, found: Found, credentials: Path | None) -> None:
        self._found, self._credentials = found, credentials
        self._lock = threading.Lock()
        self._bus: ZenohBus | None = None
        self._controls: Publisher
        self._changes: Publisher
        self._said: messages.Control | None = None
        """What our bus says to who comes late of how the run goes on, ..."""
        self._said_s = 0.0
        """... and since when."""
        self._ended = False

    def change(self, settings: Mapping[str, Any]) -> str:
        """Change something of the robot; return what was done. MdbError when it was not."""
        try:
            msgspec.convert({"settings": dict(settings)}, messages.Change)
        except (msgspec.ValidationError, ValueError, TypeError) as error:
            raise MdbError(f"this is no change of a robot: {error}") from error
        known = changes_of(self._found.experiment)
        with self._turn():
            bus = self._joined()
            change_robot(bus, self._changes, settings, known)
        return f"changed: {', '.join(settings)}"

    def control(self, order: ControlRun, hub: Hub) -> None:
        """Say how the run goes on: what was said last, with what the order changes. MdbError when that cannot be."""
        changes: dict[str, Any] = {
            name: value
            for name in ("paused", "action_s", "script")
            if (value := getattr(order, name)) is not msgspec.UNSET
        }
        if not (changes or order.end_phase):
            raise MdbError("nothing is to be changed; give paused, action_s, script or end_phase")
        with self._turn():
            self._joined()
            before, iteration = hub.control, hub.iteration
            if order.end_phase:
                _check_ends(self._found.experiment, before, iteration)
                changes["ended"] = sorted({*before.ended, iteration})
            said = msgspec.structs.replace(before, iteration=iteration, **changes)
            self._say(said)
            until_s = time.monotonic() + HEARD_S
            while said != before and hub.control == before:  # the next order begins with this one
                if time.monotonic() > until_s:
                    raise MdbError("it was said and is not heard: do these keys let you? ('mdb keys roles')")
                time.sleep(LOOK_S)

    def keep(self, hub: Hub) -> None:
        """Say again how the run goes on, because nobody does any more; nothing when it is as in the experiment file.

        Known is it by the run's log. Where that is not on this machine, robot and scripted teacher are asked how they
        are; which phases were ended early is not known then.
        """
        with self._turn():
            bus = self._joined()
            known = hub.control
            if self._found.run is None:
                known = _as_they_are(bus, self._found.experiment, known)
            if not known.is_usual:
                log.info("how the run goes on is said again", paused=known.paused, script=known.script)
                self._say(known)

    def is_behind(self, control: messages.Control) -> bool:
        """Whether another has said something else after us: then what we said is to be said no more."""
        said_s = time.monotonic() - self._said_s
        return self._said is not None and control != self._said and said_s > BEHIND_S and not self._lock.locked()

    def _say(self, control: messages.Control) -> None:
        self._controls.put(control)
        self._said, self._said_s = control, time.monotonic()

    @contextmanager
    def _turn(self) -> Iterator[None]:
        """Wait until the order before is done; MdbError when that takes too long."""
        if not self._lock.acquire(timeout=BUSY_S):
            raise MdbError("another order is being carried out; ask again in a moment")
        try:
            yield
        finally:
            self._lock.release()

    def _joined(self) -> ZenohBus:
        if self._ended:
            raise MdbError("another run is shown now; ask again")
        if self._bus is not None and not self._bus.connected():
            raise MdbError("the router is gone; ask again when it is back")
        if self._bus is None:
            bus = ZenohBus(
                self._found.brain,
                self._found.endpoint,
                credentials=self._credentials,
                connect_timeout_s=JOIN_S,
            )
            try:
                self._controls, self._changes = bus.publisher(keys.CONTROL), bus.publisher(keys.CHANGE)
            except BaseException:
                bus.close()
                raise
            self._bus = bus
        return self._bus

    def close(self) -> None:
        """Leave for ever."""
        self._ended = True
        self.leave()

    def leave(self) -> None:
        """Leave the router until the next order; who comes late does not hear us any more."""
        with self._lock:
            if self._bus is not None:
                self._bus.close()
            self._bus = self._said = None


def _check_ends(experiment: Experiment, control: messages.Control, iteration: int) -> None:
    """Raise MdbError when the phase of an iteration cannot be ended: there is none, or none after it."""
    if experiment.teacher is None:
        raise MdbError("this experiment has no phases")
    if len(control.ended) >= MAX_ENDED:
        raise MdbError(f"{MAX_ENDED} phases of this run were ended already; no more can be")
    try:
        schedule = experiment.schedule().with_ended(control.ended)
    except (MdbError, ValueError):  # its policy cannot be had on this machine
        return
    if schedule.at(iteration) is schedule.phases[-1]:
        raise MdbError("this is the last phase: none comes after it")


def _as_they_are(bus: Bus, experiment: Experiment, known: messages.Control) -> messages.Control:
    """Return how robot and scripted teacher say that the run goes on; of who does not answer it is as known."""
    alive, robot = bus.alive(), dict[str, float]()
    found = known
    for token in (ROBOT, TEACHER):
        role, _, instance = token.partition("/")
        if token not in alive:
            continue
        for answer in bus.query(keys.STATUS, ANSWER_S, role=role, instance=instance):
            robot |= answer.values
    if "paused" in robot:
        found = msgspec.structs.replace(found, paused=bool(robot["paused"]))
    usual_s = 0.0 if experiment.brain.lockstep or experiment.robot.period_s else experiment.robot.action_s
    if 0.0 <= (least_s := robot.get("least_s", usual_s)) <= messages.MAX_ACTION_S and least_s != usual_s:
        found = msgspec.structs.replace(found, action_s=least_s)
    if "silenced" in robot:
        found = msgspec.structs.replace(found, script=not robot["silenced"])
    return found
