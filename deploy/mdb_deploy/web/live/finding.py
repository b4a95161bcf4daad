"""Where the brain is that the page shows: its router, its name, its experiment, its run folder.

What the command line does not say is asked of the brain itself: who is alive at the router, and which run folder they
work in. Every question has a bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mdb_deploy.running.status import NOBODY
from mdb_deploy.supervision.processes import ENDPOINT_FILE
from mdb_deploy.web.opening import Place
from mdb_protocol import files, keys
from mdb_protocol.bundle import brains_of
from mdb_protocol.bus import Bus
from mdb_protocol.errors import MdbError, QueryError
from mdb_protocol.messages import Status
from mdb_protocol.zenoh_bus import ZenohBus
from mdb_services.experiment.run_folder import EXPERIMENT_FILE
from mdb_sim.runs.experiment import Experiment

JOIN_S, ANSWER_S = 1.0, 1.0
"""Bounds on joining a router, and on a service's answer."""
BRAIN = "optimizer/action"
"""The token that means that a brain is at work."""
MOST_BYTES = 4096
"""Of the file that says where a router is."""


class NotYetError(MdbError):
    """There is nothing to show yet; the text says what is waited for."""


@dataclass(frozen=True)
class Found:
    """A brain that can be shown."""

    endpoint: str
    brain: str
    experiment: Experiment
    run: Path | None
    """Its run folder, if it is on this machine."""

    @property
    def name(self) -> str:
        """The run's name, as past runs are named."""
        return self.run.name if self.run is not None else ""


def find(place: Place) -> Found:
    """Return the brain; NotYetError as long as there is none, MdbError when something is wrong."""
    endpoint = place.connect or _endpoint(place)
    if place.run is not None:
        experiment = Experiment.read(place.run / EXPERIMENT_FILE)
        return Found(endpoint, experiment.brain.experiment.brain, experiment, place.run)
    if place.experiment is not None:
        experiment = Experiment.read(place.experiment)
        brain = place.brain or experiment.brain.experiment.brain
        return Found(endpoint, brain, experiment, None)
    brain = place.brain or _brain_at(endpoint, place.keys)
    with ZenohBus(brain, endpoint, credentials=place.keys, connect_timeout_s=JOIN_S) as bus:
        run = run_of(bus)
    if run is None:
        raise NotYetError(f"no brain is at work as {brain} at {endpoint}; 'mdb up' starts one")
    path = run / EXPERIMENT_FILE
    if not path.is_file():
        raise NotYetError(
            f"the run folder {run} of brain {brain} is not on this machine: say with --experiment FILE what it does"
        )
    return Found(endpoint, brain, Experiment.read(path), run)


def run_of(bus: Bus) -> Path | None:
    """Return the run folder that the brain's optimizer works in; None when it is not there or does not say."""
    role, _, instance = BRAIN.partition("/")
    if BRAIN not in bus.alive():
        return None
    try:
        answers: list[Status] = bus.query(keys.STATUS, ANSWER_S, role=role, instance=instance)
    except QueryError:
        return None
    return Path(answers[0].run) if answers and answers[0].run else None


def _endpoint(place: Place) -> str:
    """Return where the router of the run folder is."""
    if place.run is None:
        raise NotYetError("nothing runs here; past runs can be looked at")
    path = place.run / ENDPOINT_FILE
    if not path.exists():
        raise NotYetError("the brain starts")
    return files.content(path, MOST_BYTES).decode(errors="replace").strip()


def _brain_at(endpoint: str, credentials: Path | None) -> str:
    """Return the name of the first brain that is at a router."""
    if credentials is not None:
        return brains_of(credentials)[0]
    bus = ZenohBus(NOBODY, endpoint, connect_timeout_s=JOIN_S)
    with bus:
        brains = bus.brains()
    if not brains:
        raise NotYetError(f"no brain is at work at {endpoint}; 'mdb up' starts one")
    return brains[0]
