"""What `mdb up` itself hears of its brain, and says: who is alive, the progress, and that this name is taken.

Owns the runner's own bus. It holds the brain's name on the router, so that a second `mdb up` of the name is refused
before it has started anything. Two robots of the name, of which neither asked for the other, are noticed here.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import structlog

from mdb_deploy.running.folder import RunFolder
from mdb_deploy.running.progress import Progress
from mdb_deploy.supervision.compose import ROBOT, ROUTER
from mdb_deploy.supervision.processes import ENDPOINT_FILE, INSTANCES
from mdb_protocol import keys
from mdb_protocol.bus import Bus
from mdb_protocol.errors import BusError, TakenError, UnheardError
from mdb_protocol.holding import GONE_S, hold
from mdb_protocol.messages import Control
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.experiment.run_folder import MEMORY_FILE
from mdb_services.shell.service import Meter, announce
from mdb_sim.runs.experiment import Experiment

log = structlog.get_logger()

JOIN_S = 2.0
"""Bound on joining a router that runs."""
COUNTED_S = 1.0
"""So often robots are counted."""
MIXED = (
    "{robots} robots claim to be that of brain {brain}, and neither asked for the other (duty 1 in "
    "protocol/README.md): what they do would mix"
)


class Watch:
    """See the module's docstring."""

    role, instance = "runner", "up"
    bus: Bus
    """There once a router is joined."""

    def __init__(
        self, experiment: Experiment, run: Path, credentials: Path | None, *, await_robot: bool = False
    ) -> None:
        """`await_robot`: of a robot of somebody else's it is not told before it stands where the run begins."""
        self._brain = experiment.brain.experiment.brain
        settings = experiment.brain.optimizer
        self.patience_s = settings.command_patience_s + settings.feedback_patience_s
        """How long a teacher who hesitates may hold up an iteration."""
        self.run, self._credentials = run, credentials
        self._folder = RunFolder(run, experiment.brain.store.when_full)
        self._endpoint, self._where = run / ENDPOINT_FILE, ""
        self._bus: ZenohBus | None = None
        self._meter: Meter | None = None
        self._iteration, self._moved_s = 0, time.monotonic()
        """The newest one, and when it came."""
        self._control = Control(iteration=0)
        """What an operator said last."""
        self._awaited = await_robot and not (run / MEMORY_FILE).exists()
        """Whether a robot is awaited that has not acted: one of an earlier run has another count."""
        self._elsewhere = self._mixed = False
        self._counted_s = self._alone_s = time.monotonic()
        """When robots were counted last, and when there was one at the most."""
        self.on_endpoint: Callable[[str], None] = lambda _: None
        self.on_unheard: Callable[[str], None] = lambda _: None
        """Called when the router gives us nothing any more."""

    def join(self, endpoint: str) -> None:
        """Join a router that runs.

        Raises BusError when it does not answer, TakenError when this brain is somebody else's there.
        """
        self._where = endpoint
        self._join(ZenohBus(self._brain, endpoint, credentials=self._credentials, connect_timeout_s=JOIN_S))

    def alive(self) -> frozenset[str]:
        """Return the liveliness tokens, and the router's name once it answers: its own router says where it is."""
        if self._bus is None and self._endpoint.exists():
            self._find(self._endpoint.read_text(encoding="utf-8"))
        if self._bus is None or not self._bus.connected():
            return frozenset()
        self._serve()
        alive = self._bus.alive() | {ROUTER}
        if self._awaited:
            self._meet()
        return alive if not self._awaited else frozenset(n for n in alive if n.partition("/")[0] != ROBOT)

    def _meet(self) -> None:
        """Look whether the robot that is awaited stands where the run begins."""
        shown = self._perceptions.take()
        if shown is None:
            return
        elsewhere, robots = shown.iteration > 0, self._robots()
        if elsewhere and not self._elsewhere:
            log.warning("the robot has acted in an earlier run; start it again: the run waits", at=shown.iteration)
        if robots > 1 and not self._mixed:
            log.warning("one robot is awaited; stop the others: " + MIXED.format(robots=robots, brain=self._brain))
        self._elsewhere, self._mixed = elsewhere, robots > 1
        self._awaited = elsewhere or self._mixed

    def _robots(self) -> int:
        return len(self._bus.holders(ROBOT, INSTANCES[ROBOT])) if self._bus is not None else 0

    def _count(self) -> None:
        """Raise TakenError when there is more than one robot, and has been for longer than the dead are seen."""
        now_s = time.monotonic()
        if self._awaited or now_s - self._counted_s < COUNTED_S:
            return
        self._counted_s, robots = now_s, self._robots()
        if robots <= 1:
            self._alone_s = now_s
        elif now_s - self._alone_s > GONE_S:
            mixed = MIXED.format(robots=robots, brain=self._brain)
            raise TakenError(f"{mixed}. Stop all but one, and go on with 'mdb up --resume {self.run}'")

    def _find(self, endpoint: str) -> None:
        try:
            bus = ZenohBus(self._brain, endpoint, credentials=self._credentials, connect_timeout_s=0.0)
        except BusError:
            return
        self._where = endpoint
        self._join(bus)
        self.on_endpoint(endpoint)

    def _join(self, bus: ZenohBus) -> None:
        self._bus = self.bus = bus
        hold(bus, self.role, self.instance)
        self._meter = announce(self, self.run)
        if self._awaited:
            self._perceptions = bus.subscriber(keys.PERCEPTION)
        self._reports = bus.subscriber(keys.ITERATION)
        self._scenes = bus.subscriber(keys.SCENE)
        self._phases = bus.subscriber(keys.PHASE)
        self._models = bus.subscriber(keys.CURRENT_MODEL)
        self._finished = bus.subscriber(keys.FINISHED)
        self._controls = bus.subscriber(keys.CONTROL)
        self._asking = bus.subscriber(keys.COMMAND), bus.subscriber(keys.FEEDBACK)

    def _serve(self) -> None:
        """Answer who asks how we are."""
        self._folder.look()
        self.bus.serve()
        try:
            self.bus.check_heard()
        except UnheardError as error:
            self.on_unheard(str(error))
        self._count()
        if self._meter is not None:
            self._meter.tick()

    def show(self, progress: Progress) -> bool:
        """Hand what has come to the display; return whether the run goes on as it should.

        An iteration was among it, the run is paused, a teacher asks to be waited for, or an operator wants actions to
        take longer than it is since the last one.
        """
        moved = False
        self._serve()
        while (control := self._controls.take()) is not None:
            self._control = control
            progress.control(control)
        while (phase := self._phases.take()) is not None:
            progress.phase(phase)
        while (model := self._models.take()) is not None:
            progress.model(model)
        while (scene := self._scenes.take()) is not None:
            progress.scene(scene)
        while (report := self._reports.take()) is not None:
            progress.report(report)
            self._iteration, self._moved_s = report.iteration, time.monotonic()
            moved = True
        return self._is_slow() or moved

    def _is_slow(self) -> bool:
        """Whether somebody wants that nothing moves now."""
        asks = [message.later for inbox in self._asking for message in inbox.some()]
        slow_s = 0.0 if self._control.action_s is None else self._control.action_s
        return self._control.paused or any(asks) or time.monotonic() - self._moved_s < slow_s

    def lost(self) -> str:
        """Return what there is to say of a run in which nothing moves any more."""
        if self._folder.trouble:
            return f": the run folder {self.run} is {self._folder.trouble}"
        if self._bus is not None and self._bus.connected():
            return f"; the logs of the processes are in {self.run / 'logs'}"
        return (
            f": the router at {self._where} is gone. One that 'mdb up' starts ends with it; 'mdb run router' starts "
            f"one that stays. Go on with 'mdb up --resume {self.run} --connect ENDPOINT'"
        )

    def finished(self) -> bool:
        """Whether the optimizer has said that the experiment is over."""
        return self._finished.take() is not None

    def step(self) -> bool:
        """Do nothing: the runner's own loop asks for what it wants."""
        return False

    def values(self) -> dict[str, float]:
        """Return the newest iteration."""
        return {"iteration": float(self._iteration)}

    def close(self) -> None:
        """Leave the router, if one was joined."""
        if self._bus is not None:
            self._bus.close()
