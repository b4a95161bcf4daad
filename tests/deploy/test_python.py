"""Runs in Python: `run` and `Run`, the tables and their files."""

import csv
from pathlib import Path

import numpy as np
import pytest

import mdb_deploy
from mdb_deploy import Run, run
from mdb_deploy.cli.main import main
from mdb_protocol.errors import MdbError
from tests.replay.record import GOLDEN

SMALL = {
    "robot.body": "kinematic",
    "optimizer.random_iterations": 10,
    "model.object.members": 1,
    "model.induced.members": 1,
}


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp("python") / "run"
    return run("paper", iterations=25, seed=4, folder=folder, settings=SMALL)


def test_a_run_that_was_made_is_the_same_when_it_is_read(done: Run) -> None:
    again = Run(done.path)
    assert repr(again).endswith(f": 25 iterations, seed 4, {done.record.successes[-1]} successes")
    assert again.experiment.brain.lockstep
    for name in ("iterations", "pairs", "models", "contexts", "scenes"):
        table = getattr(again, name)
        assert table.keys() == getattr(done, name).keys()
        assert len({len(column) for column in table.values()}) == 1, "one length"


def test_the_tables_are_what_was_said(done: Run) -> None:
    table, pairs, record = done.iterations, done.pairs, done.record
    assert table["iteration"].tolist() == pairs["iteration"].tolist() == list(range(25))
    assert table["feedback"].tolist() == record.feedback.tolist()
    assert table["note"].dtype == np.int64
    assert set(table["phase"]) == {"first teacher"}
    assert (pairs["action.turn"] == table["action.turn"]).all()
    assert pairs["before.distance"].dtype == np.float64
    assert done.scenes["iteration"].tolist() == list(range(26))
    assert np.isnan(done.scenes["before.x_m"][0]), "nothing was done yet"
    assert set(done.models["model"]) == {"communication", "object", "induced"}
    weights = record.models["communication", 25].weights
    assert weights.dtype == np.float32


def test_late_feedback_is_with_its_pair_and_old_logs_have_tables_too() -> None:
    late = Run(GOLDEN / "late")
    assert np.isfinite(late.pairs["feedback"]).sum() == np.isfinite(late.iterations["feedback"]).sum() > 20
    assert {"changed", "known", "stored", "recalled"} == set(late.contexts["kind"])


def test_csv_has_the_numbers_exactly(done: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(done.path), "--to", "csv", "--out", str(tmp_path)]) == 0
    files = capsys.readouterr().out.split()
    assert [Path(file).name for file in files] == [
        "iterations.csv", "pairs.csv", "models.csv", "contexts.csv", "scenes.csv",
    ]  # fmt: skip
    with (tmp_path / "pairs.csv").open() as file:
        rows = list(csv.DictReader(file))
    told = [float(row["after.distance"]) if row["after.distance"] else np.nan for row in rows]
    assert np.array_equal(told, done.pairs["after.distance"], equal_nan=True)


def test_arrow_and_parquet_have_them_with_nulls(done: Run, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    done.export("parquet", tmp_path)
    read = parquet.read_table(tmp_path / "scenes.parquet")
    assert read.equals(done.arrow("scenes"))
    assert read["before.x_m"].null_count == 1
    assert read["before.x_m"].to_pylist()[1:] == done.scenes["before.x_m"][1:].tolist()


def test_what_is_wrong_is_told(done: Run, tmp_path: Path) -> None:
    with pytest.raises(MdbError, match="is no run folder: it has no experiment"):
        _ = Run(tmp_path).pairs
    with pytest.raises(MdbError, match="holds a run already; give another folder, or read it"):
        run("paper", folder=done.path)
    with pytest.raises(MdbError, match="no table 'pair'; there are iterations, pairs, models"):
        done.table("pair")
    with pytest.raises(MdbError, match="an Experiment has its own"):
        run(done.experiment, seed=3)
    with pytest.raises(MdbError, match="no such kind of file; expected 'parquet' or 'csv'"):
        done.export("xlsx")  # type: ignore[arg-type]
    with pytest.raises(AttributeError, match="has no attribute 'runs_of'; it has Run, run"):
        _ = mdb_deploy.runs_of


@pytest.mark.long
def test_a_run_in_processes(tmp_path: Path) -> None:
    done = run("paper", iterations=20, folder=tmp_path / "run", settings=SMALL, processes=True)
    assert done.iterations["iteration"].tolist() == list(range(20))
    assert not done.experiment.brain.lockstep
