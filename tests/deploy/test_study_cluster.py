"""A sweep over a Dask cluster gives what a sweep on this machine gives, also when a worker dies on the way."""

import os
import signal
from pathlib import Path
from typing import Any

import pytest
from distributed import Client, LocalCluster

from mdb_deploy.studies import sweep
from mdb_sim.studies import results
from mdb_sim.studies.catalogue import STUDIES
from mdb_sim.studies.results import Label, Result
from tests.deploy.test_study import wanted

pytestmark = pytest.mark.slow


def told(found: list[Result]) -> list[Any]:
    """What was measured, as text, in which nan is nan."""
    return [(r.label.variant, r.label.seed, str(r.rows)) for r in found]


@pytest.mark.timeout(600)
def test_a_cluster_of_which_a_worker_is_killed_gives_what_this_machine_gives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seeds = tuple(range(801, 807))
    local = wanted(tmp_path / "local", "experiment.iterations=200", seeds=seeds, workers=1)
    tasks = sweep.tasks_of(STUDIES["reproduction"], local)
    assert sweep.run(tasks, local).done == len(tasks)

    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        with Client(cluster) as client:
            victim = next(iter(client.run(os.getpid).values()))
        remote = wanted(
            tmp_path / "remote", "experiment.iterations=200", seeds=seeds, scheduler=cluster.scheduler_address
        )
        write, killed = results.write, []

        def kill_then_write(folder: Path, data: bytes, label: Label) -> Path:
            """Once the first result is there and others are under way, end a worker."""
            if not killed:
                killed.append(victim)
                os.kill(victim, signal.SIGKILL)
            return write(folder, data, label)

        monkeypatch.setattr(results, "write", kill_then_write)
        outcome = sweep.run(tasks, remote)
    assert killed == [victim]
    assert outcome.failed == {}
    assert outcome.done == len(tasks)
    assert told(sweep.results_of(tasks, remote.out)) == told(sweep.results_of(tasks, local.out))
