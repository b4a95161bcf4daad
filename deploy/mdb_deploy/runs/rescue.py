"""`mdb rescue`: a new run folder from one whose memory file is damaged, with all that can be read.

Owns what belongs to a run besides its memory: experiment, robot's state and run log go along as they are.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec
import structlog

from mdb_protocol import files
from mdb_protocol.errors import ConfigError, DamageError, MdbError
from mdb_services.experiment.run_folder import BEGINNING_FILE, EXPERIMENT_FILE, MEMORY_FILE
from mdb_services.memory import rescue as memory_rescue
from mdb_services.memory.rescue import Salvage
from mdb_services.recorder import LOG_PATTERN
from mdb_sim.robot.state_file import StateFile
from mdb_sim.runs.experiment import ROBOT_FILE, Experiment

log = structlog.get_logger()

GOES_ALONG = (EXPERIMENT_FILE, BEGINNING_FILE, ROBOT_FILE, LOG_PATTERN)


def rescue_run(run: Path, out: Path) -> Salvage:
    """Make a run folder at `out` that `mdb up --resume` goes on with; return what of the memory could be read.

    MdbError when `run` is no run folder or `out` is there already, or nothing could be
    read: then no folder is made. Nothing in `run` is changed.
    """
    try:
        experiment = Experiment.read(run / EXPERIMENT_FILE)
    except ConfigError as error:
        raise MdbError(f"{run} is not a run folder: {error}") from error
    if out.exists():
        raise MdbError(f"{out} is there already; give a new place")
    out.mkdir(parents=True)
    try:
        found = memory_rescue.rescue(run / MEMORY_FILE, experiment.brain, out / MEMORY_FILE)
        if found.nothing:
            raise MdbError(f"nothing of a brain's memory can be read of {run / MEMORY_FILE}: no run is made of it")
        for path in sorted({path for pattern in GOES_ALONG for path in run.glob(pattern)}):
            _take_along(path, out / path.name)
    except BaseException:
        shutil.rmtree(out)
        raise
    if len(found.whole) < len(experiment.brain.model):
        _forget_intention(StateFile(out / ROBOT_FILE))
    return found


def _take_along(path: Path, to: Path) -> None:
    """Copy a file of the run, if it is one; what is none is told, and left."""
    try:
        files.copy(path, to)
    except (DamageError, OSError) as error:
        if to.exists():  # begun, and the disk is full
            raise
        log.warning("left behind", path=str(path), reason=str(error))


def _forget_intention(file: StateFile) -> None:
    """Let the robot's last action be one without a pair: it was meant with versions of memories that are no more."""
    state = file.read()
    if state is not None:
        seen = msgspec.structs.replace(state.perception, done=None)
        file.write(msgspec.structs.replace(state, perception=seen))
