"""`mdb rescue`: a new run folder from one whose memory file is damaged, with all that can be read.

Owns what belongs to a run besides its memory: experiment, robot's state and run log go along as they are.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec

from mdb_deploy.running.processes import ENDPOINT_FILE
from mdb_protocol.errors import ConfigError, MdbError
from mdb_services.experiment.brain import EXPERIMENT_FILE, MEMORY_FILE
from mdb_services.memory import rescue as memory_rescue
from mdb_services.memory.rescue import Salvage
from mdb_sim.robot.state_file import StateFile
from mdb_sim.runs.experiment import ROBOT_FILE, Experiment

LEFT_BEHIND = (f"{MEMORY_FILE}*", ENDPOINT_FILE, "lock", "logs")


def rescue_run(run: Path, out: Path) -> Salvage:
    """Make a run folder at `out` that `mdb up --resume` goes on with; return what of the memory could be read.

    MdbError when `run` is no run folder or `out` is there already. Nothing in `run` is changed.
    """
    try:
        experiment = Experiment.read(run / EXPERIMENT_FILE)
    except ConfigError as error:
        raise MdbError(f"{run} is not a run folder: {error}") from error
    if out.exists():
        raise MdbError(f"{out} is there already; give a new place")
    shutil.copytree(run, out, ignore=shutil.ignore_patterns(*LEFT_BEHIND))
    found = memory_rescue.rescue(run / MEMORY_FILE, experiment.brain, out / MEMORY_FILE)
    if len(found.whole) < len(experiment.brain.model):
        _forget_intention(StateFile(out / ROBOT_FILE))
    return found


def _forget_intention(file: StateFile) -> None:
    """Let the robot's last action be one without a pair: it was meant with versions of memories that are no more."""
    state = file.read()
    if state is not None:
        seen = msgspec.structs.replace(state.perception, done=None)
        file.write(msgspec.structs.replace(state, perception=seen))
