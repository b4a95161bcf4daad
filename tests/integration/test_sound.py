"""A brain of processes that is taught by sound: the ear is one of them, and hears what was played."""

import os
import signal
from pathlib import Path
from typing import Any

import pytest

from mdb_deploy.experiments import experiment_path
from mdb_protocol import keys
from mdb_protocol.codec import to_plain
from mdb_protocol.messages import Status
from mdb_services.recorder import read_log
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment
from tests.integration.brain import SHORT, Brain, until

pytestmark = pytest.mark.long

SOUND = ("ear.detector=template", "teacher.sound.instrument=piano", "teacher.sound.snr_db=15")


def iterations(run: Path) -> list[dict[str, Any]]:
    return [to_plain(r.message) for r in read_log(run) if r.row is keys.ITERATION]


def test_processes_taught_by_sound_do_what_one_process_does_that_is_told_the_notes(tmp_path: Path) -> None:
    told = Experiment.read(experiment_path("paper"), [*SHORT, "experiment.pace=lockstep"])
    run_experiment(told, tmp_path / "told")
    folder = tmp_path / "processes"
    folder.mkdir()
    with Brain(folder, *SOUND, pace="lockstep") as brain:
        assert brain.wait() == 0, brain.output()
        got = iterations(brain.run)
    assert got == iterations(tmp_path / "told")


def test_an_ear_that_is_killed_comes_back_and_hears_on(tmp_path: Path) -> None:
    settings = ("experiment.iterations=100000", "optimizer.command_patience_s=0.5")
    with Brain(tmp_path, *SOUND, *settings) as brain, brain.bus() as bus:

        def hears() -> Status | None:
            status = brain.status(bus, "ear", "notes")
            return status if status and status.values["notes"] > 10 else None

        first = until(hears)
        assert isinstance(first, Status)
        assert first.values["silences"] == 0
        assert first.values["analysis_s_per_s"] < 0.5
        os.kill(first.pid, signal.SIGKILL)

        def hears_again() -> bool:
            status = hears()
            return status is not None and status.pid != first.pid

        assert until(hears_again)
