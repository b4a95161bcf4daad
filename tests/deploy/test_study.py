"""Variants fit any experiment file, and a study that was interrupted or changed goes on as it should."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import psutil
import pyarrow.parquet as pq
import pytest
import structlog
import tomli_w
from rich.console import Console

from mdb_deploy.cli.main import main
from mdb_deploy.experiments import experiment_path
from mdb_deploy.studies import sweep
from mdb_deploy.studies import workers as processes
from mdb_deploy.studies.sweep import Sweep
from mdb_protocol.errors import ConfigError
from mdb_sim.runs.experiment import Experiment
from mdb_sim.studies import results, running, tables
from mdb_sim.studies.catalogue import ACCEPTANCE, STUDIES
from mdb_sim.studies.results import decode
from tests.integration.brain import SHORT
from tests.services.small import CONTENT
from tests.sim.phases import label, run

PAPER = experiment_path("paper")
TINY = (
    "optimizer.random_iterations=4",
    "evolution.population=20",
    "model.communication.evolution.generations=1",
    "model.object.evolution.generations=1",
    "model.induced.evolution={population=20, generations=1}",
)
PHASES = (
    "experiment.iterations=40",
    "teacher.phase.alone.start=10",
    "teacher.phase.second teacher.start=20",
    "teacher.phase.alone again.start=30",
)


@pytest.fixture(autouse=True)
def _log_of_its_own() -> Iterator[None]:
    """`main` lets the log write to the standard error of this test, which is gone after it."""
    yield
    structlog.reset_defaults()


def variants_of(study: str, experiment: Experiment) -> dict[str, tuple[str, ...]]:
    return {variant.name: variant.overrides for variant in tables.VARIANTS[study](experiment)}


def other_experiment(path: Path, **sections: Any) -> Path:
    """A file with other names, one mode that explores, and settings of a model's own."""
    communication, thing = CONTENT["model"]
    content = CONTENT | {
        "model": [
            communication | {"name": "ears", "capacity": 3, "long_term": {"capacity": 5}},
            thing | {"name": "thing", "capacity": 41, "learner": {"name": "pbga"}},
            thing | {"name": "fitted", "learner": {"name": "ridge"}, "context": {"enabled": False}},
        ],
        "mode": [
            {"name": "heard", "world": "ears", "satisfaction": "feedback", "aspiration": 0.5, "exploration": 0.2},
            {"name": "alone", "world": "thing", "satisfaction": "next.distance", "aspiration": 0.5, "reach": 0.2},
        ],
        "memory": {"distance": 1.0, "outcome": 0.5},
        "robot": {"body": "kinematic", "successes": ["capture"], "ends": ["capture", "bump", "lost"]},
    }
    path.write_text(tomli_w.dumps(content | sections), encoding="utf-8")
    return path


# ---- the tables ----


def test_variants_of_the_ablation_take_one_ingredient_away_each() -> None:
    fifo = [f"model.{name}.memory={{recency=1.0}}" for name in ("communication", "object", "induced")]
    smaller = [f"model.{name}.capacity={n}" for name, n in (("communication", 50), ("object", 100), ("induced", 100))]
    populations = ("object", 200), ("induced", 192)
    alone = [
        f"model.{name}.{setting}" for name, n in populations for setting in ("members=1", f"evolution.population={n}")
    ]
    taught = 'name="taught", world="communication", satisfaction="feedback", aspiration=0.8, exploration=0.5'
    induced = 'name="induced", world="object", satisfaction="induced", exploration=0.0'
    assert variants_of("ablation", Experiment.read(PAPER)) == {
        "as shipped": (),
        "promoters off": ("learner.name=ga",),
        "long-term memory off": ("long_term.capacity=0",),
        "no context detection": ("context.enabled=false",),
        "FIFO only": (*fifo, "context.enabled=false"),
        "punishments not kept": ("model.induced.memory.outcome=0",),
        "no committees": tuple(alone),
        "no support": (
            f"mode=[{{{taught}, curiosity=0.5, margin=0.0, babbling=0.0}}, "
            f"{{{induced}, curiosity=0.0, margin=0.2, babbling=0.0}}]",
        ),
        "no aspiration": ("mode.taught.exploration=0", "mode.taught.curiosity=0"),
        "scalar note": ("channels.note={low=0, high=6}",),
        "smaller memories": tuple(smaller),
    }


def test_variants_of_another_file_have_its_names_and_heed_settings_of_a_models_own(tmp_path: Path) -> None:
    overrides = variants_of("ablation", Experiment.read(other_experiment(tmp_path / "other.toml")))
    assert overrides["promoters off"] == ("learner.name=ga", "model.thing.learner.name=ga")
    assert overrides["long-term memory off"] == ("model.ears.long_term.capacity=0", "long_term.capacity=0")
    assert overrides["no context detection"] == ("context.enabled=false",)
    assert overrides["FIFO only"][0] == "model.ears.memory={recency=1.0, distance=0.0, outcome=0.0}"
    assert overrides["punishments not kept"] == ("memory.outcome=0",)
    assert overrides["no aspiration"] == ("mode.heard.exploration=0",)
    assert overrides["scalar note"] == ("channels.note={low=0, high=2}",)
    assert overrides["smaller memories"] == (
        "model.ears.capacity=1",
        "model.thing.capacity=10",
        "model.fitted.capacity=1",
    )


@pytest.mark.parametrize("paper", [True, False])
def test_every_variant_is_an_experiment_that_has_nothing_more_to_take_away(*, paper: bool, tmp_path: Path) -> None:
    path = PAPER if paper else other_experiment(tmp_path / "other.toml")
    for name, overrides in variants_of("ablation", Experiment.read(path)).items():
        left = variants_of("ablation", Experiment.read(path, overrides))
        assert name in ("as shipped", "smaller memories") or not left[name], name


def test_without_support_the_modes_are_as_they_were_but_for_their_reach(tmp_path: Path) -> None:
    for path in (PAPER, other_experiment(tmp_path / "other.toml")):
        before = Experiment.read(path).brain
        after = Experiment.read(path, tables.without_support(before)).brain
        assert [replace(mode, reach=None) for mode in before.modes()] == after.modes()


def test_a_file_without_an_ingredient_has_no_such_variant(tmp_path: Path) -> None:
    path = other_experiment(tmp_path / "other.toml", channels=CONTENT["channels"] | {"note": {"high": 2.0}})
    believing = tables.without_support(Experiment.read(path).brain)
    bare = (*believing, "memory={}", "context.enabled=false", "mode.heard.exploration=0")
    variants = tables.VARIANTS["ablation"](Experiment.read(path, bare))
    assert [variant.name for variant in variants if not variant.applies] == [
        "no context detection", "FIFO only", "punishments not kept", "no committees", "no support", "no aspiration",
        "scalar note",
    ]  # fmt: skip


def test_the_paper_as_written_lacks_every_addition_and_each_comes_back_alone() -> None:
    variants = variants_of("paper", Experiment.read(PAPER))
    written = variants["paper as written"]
    assert "channels.action={low=0, high=6}" in written
    assert 'model.object.inputs=["distance", "angle", "continuity", "action"]' in written
    experiment = Experiment.read(PAPER, written)
    channels = experiment.brain.variables()
    assert [channels[name].encoding for name in ("note", "action")] == ["scalar"] * 2
    assert [(mode.reach, mode.exploration, mode.curiosity) for mode in experiment.brain.mode] == [(None, 0, 0)] * 2
    assert not any(tables.VARIANTS["paper"](experiment)[0].overrides)
    assert [v.name for v in tables.VARIANTS["paper"](experiment) if not v.applies][:1] == [
        "written + notes without order"
    ]
    of_paper = tables.VARIANTS["paper"](Experiment.read(PAPER))
    assert [v.name for v in of_paper if not v.applies] == [
        "written + punishments kept",
        "written + praise by the best of late",
    ], "nothing without the rest"
    for name, away in tables.ADDITIONS:
        taken = away(Experiment.read(PAPER).brain)
        assert variants[f"shipped - {name}"] == taken
        assert set(variants[f"written + {name}"]) == set(written) - set(taken)


@pytest.mark.parametrize("study", [*STUDIES, "acceptance"])
def test_all_variants_of_all_studies_can_be_run(study: str) -> None:
    base = tables.overrides_of(STUDIES.get(study, ACCEPTANCE))
    experiment = Experiment.read(PAPER, base)
    variants = tables.VARIANTS[study](experiment)
    assert len({variant.name for variant in variants}) == len(variants) >= 1
    files = [PAPER if variant.file is None else experiment_path(variant.file) for variant in variants]
    contents = [
        Experiment.read(file, (*base, *variant.overrides)).content
        for file, variant in zip(files, variants, strict=True)
    ]
    players = [variant.player for variant in variants]
    assert all(content not in contents[:i] or players[i] != "brain" for i, content in enumerate(contents))


def test_where_teachers_return_each_has_a_language_of_his_own_and_in_a_long_life_the_robot_is_alone_between() -> None:
    memory = Experiment.read(PAPER, tables.overrides_of(STUDIES["memory"], 300))
    assert memory.brain.experiment.iterations == 1500
    assert memory.teacher is not None
    assert [(phase.start, phase.teacher) for phase in memory.teacher.phase] == [
        (0, "A"), (300, "B"), (600, "A"), (900, "B"), (1200, "A"),
    ]  # fmt: skip
    life = Experiment.read(PAPER, tables.overrides_of(STUDIES["life"]))
    assert life.brain.experiment.iterations == 5000
    assert life.teacher is not None
    assert [phase.teacher for phase in life.teacher.phase] == ["A", None, "B", None, "C", None, "D", None, "E", None]


def test_the_short_experiment_of_the_other_tests_has_the_same_variants() -> None:
    short, paper = Experiment.read(PAPER, SHORT), Experiment.read(PAPER)
    assert variants_of("ablation", short) == variants_of("ablation", paper)


# ---- sweeps ----


def wanted(out: Path, *overrides: str, **changes: Any) -> Sweep:
    settings = {"seeds": (801, 802), "workers": 0} | changes
    return Sweep(experiment=PAPER, overrides=(*TINY, *PHASES, *overrides), out=out, **settings)


def swept(study: str, of: Sweep) -> tuple[sweep.Outcome, str]:
    told = StringIO()
    outcome = sweep.run(sweep.tasks_of(STUDIES[study], of), of, Console(file=told, width=200))
    return outcome, told.getvalue()


def test_an_interrupted_sweep_goes_on_where_it_stopped_and_leaves_no_run_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir()
    of = wanted(tmp_path / "out")
    outcome, told = swept("reproduction", of)
    assert (outcome.there, outcome.done, outcome.failed) == (0, 4, {})
    assert "[4/4] done: reproduction, binary reward, seed 802" in told
    assert list((tmp_path / "tmp").iterdir()) == []
    files = sorted(of.out.glob("*/*/*.parquet"))
    before = {path: path.stat().st_mtime_ns for path in files}
    files[0].unlink()
    outcome, told = swept("reproduction", of)
    assert (outcome.there, outcome.done) == (3, 1)
    assert "3 of 4 runs are already there" in told
    assert all(path.stat().st_mtime_ns == before[path] for path in files[1:])


def test_another_experiment_another_code_and_fresh_are_run_again_and_another_study_shares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    of = wanted(tmp_path, seeds=(801,))
    assert swept("alone", of)[0].done == 1
    assert swept("reproduction", of)[0].there == 1
    assert swept("alone", wanted(tmp_path, "evolution.elite=2", seeds=(801,)))[0].done == 1
    assert swept("alone", wanted(tmp_path, seeds=(801,), fresh=True))[0].done == 1
    assert swept("alone", of)[0].there == 1
    monkeypatch.setattr(running, "code_checksum", lambda: "another")
    assert swept("alone", of)[0].done == 1


def test_a_run_that_fails_is_named_and_does_not_end_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = running.do

    def do(task: running.Task) -> bytes:
        if task.label.seed == 801:
            raise RuntimeError("the disk is full")
        return real(task)

    monkeypatch.setattr(running, "do", do)
    settings = [word for override in (*TINY, *PHASES) for word in ("--set", override)]
    status = main(["study", "alone", "--seeds", "801-802", "--workers", "0", "--out", str(tmp_path), *settings])
    out, progress = capsys.readouterr()
    assert status == 3
    assert "failed: alone, as shipped, seed 801: RuntimeError: the disk is full" in progress
    assert "seed 802" in out


def dies_with_801(task: running.Task) -> bytes:
    if task.label.seed == 801:
        os._exit(9)
    return b"done"


@pytest.mark.parametrize("workers", [1, 2])
def test_a_run_that_kills_its_process_is_named_and_all_others_are_done(tmp_path: Path, workers: int) -> None:
    tasks = sweep.tasks_of(STUDIES["alone"], wanted(tmp_path, seeds=(801, 802, 803, 804)))
    answers = {task.label.seed: answer for task, answer in processes.answers(dies_with_801, tasks, workers)}
    assert isinstance(answers.pop(801), BrokenProcessPool)
    assert answers == dict.fromkeys((802, 803, 804), b"done")


def test_an_older_result_is_not_counted_where_its_run_failed(tmp_path: Path) -> None:
    of = wanted(tmp_path, seeds=(801,))
    assert swept("alone", of)[0].done == 1
    changed = sweep.tasks_of(STUDIES["alone"], wanted(tmp_path, "evolution.elite=2", seeds=(801,)))
    assert len(sweep.results_of(sweep.tasks_of(STUDIES["alone"], of), tmp_path)) == 1
    assert sweep.results_of(changed, tmp_path) == []


def test_a_file_of_another_version_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = results.write(tmp_path, results.encode(label("alone"), run(11)), label("alone"))
    table = pq.read_table(written, partitioning=None)
    pq.write_table(table.drop_columns(["bumps", "captured"]), written)
    assert main(["study", "report", "--results", str(tmp_path), "--out", str(tmp_path / "R.md")]) == 2
    error = capsys.readouterr().err
    assert f"made by another version of the project, which kept other things of a run: {written}" in error
    assert "run their studies again" in error


def test_a_run_folder_has_its_name_when_its_run_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def do(task: running.Task) -> bytes:
        Path(str(task.keep)).mkdir(parents=True)
        raise RuntimeError("the disk is full")

    of = wanted(tmp_path, seeds=(801,))
    assert swept("alone", of)[0].done == 1
    keeping = replace(of, keep=True)
    with monkeypatch.context() as patched:
        patched.setattr(running, "do", do)
        assert len(swept("alone", keeping)[0].failed) == 1
    assert [path.name for path in tmp_path.glob("runs/*/*/*")] == ["seed801-kinematic.part"]
    assert swept("alone", keeping)[0].done == 1
    assert [path.name for path in tmp_path.glob("runs/*/*/*")] == ["seed801-kinematic"]


def test_run_folders_are_kept_when_that_is_asked_for(tmp_path: Path) -> None:
    of = wanted(tmp_path, seeds=(801,), keep=True)
    assert swept("alone", of)[0].done == 1
    assert (tmp_path / "runs" / "alone" / "as-shipped" / "seed801-kinematic" / "run.mcap").exists()
    assert swept("alone", of)[0].there == 1


def test_only_some_variants_are_run_and_the_first_always(tmp_path: Path) -> None:
    tasks = sweep.tasks_of(STUDIES["ablation"], wanted(tmp_path, only=("scalar-note",)))
    assert [(task.label.variant, task.label.seed) for task in tasks] == [
        ("as shipped", 801), ("scalar note", 801), ("as shipped", 802), ("scalar note", 802),
    ]  # fmt: skip
    with pytest.raises(ConfigError, match=r"--only 'notes': no such variant; there are as-shipped, promoters-off"):
        sweep.tasks_of(STUDIES["ablation"], wanted(tmp_path, only=("notes",)))


def test_machines_are_asked_for_by_file_or_name_and_no_other_is_run_beside(tmp_path: Path) -> None:
    only = ("cartpole", "pendulum-v1-a-torque-in-a-range")
    tasks = sweep.tasks_of(STUDIES["machines"], replace(wanted(tmp_path, only=only), overrides=()))
    assert {task.label.variant for task in tasks} == {"CartPole-v1", "Pendulum-v1, a torque in a range"}


def test_a_worker_of_another_version_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = sweep.tasks_of(STUDIES["alone"], wanted(tmp_path))[0]
    monkeypatch.setattr(running, "code_checksum", lambda: "another")
    with pytest.raises(Exception, match="install the same version of the project on every worker"):
        running.do(task)


def test_a_pool_of_processes_gives_what_this_process_gives(tmp_path: Path) -> None:
    of = wanted(tmp_path, seeds=(801,), workers=1)
    task = sweep.tasks_of(STUDIES["alone"], of)[0]
    assert swept("alone", of)[0].done == 1
    here, there = decode(running.do(task)), sweep.results_of([task], tmp_path)[0]
    assert [row.captures for row in here.rows] == [row.captures for row in there.rows]


# ---- the commands ----


def study(*words: str) -> int:
    settings = [word for override in TINY for word in ("--set", override)]
    return main(["study", *words, "--seeds", "801,802", "--workers", "0", *settings])


def test_an_ablation_makes_table_and_figure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    phases = [word for override in PHASES for word in ("--set", override)]
    assert study("ablation", "--only", "no-aspiration", "--out", str(tmp_path), *phases) == 0
    out, _ = capsys.readouterr()
    assert (tmp_path / "ablation.md").read_text(encoding="utf-8") == out
    assert "no aspiration" in out
    assert (tmp_path / "ablation.png").read_bytes().startswith(b"\x89PNG")


def test_comings_are_compared_with_and_without_a_long_term_memory_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert study("comings", "--out", str(tmp_path), "--phase", "22") == 0
    out, _ = capsys.readouterr()
    assert out.count("| 802 | long-term memory o") == 2
    assert (tmp_path / "comings.png").read_bytes().startswith(b"\x89PNG")
    report = tmp_path / "sim" / "REPORT.md"
    assert main(["study", "report", "--results", str(tmp_path), "--out", str(report)]) == 0
    assert "`mdb study memory` is missing" in report.read_text(encoding="utf-8")


def test_an_acceptance_that_misses_a_criterion_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = [word for override in (*TINY, *PHASES, tables.KINEMATIC) for word in ("--set", override)]
    assert main(["acceptance", "--seeds", "801", "--workers", "0", "--out", str(tmp_path), *settings]) == 1
    out, _ = capsys.readouterr()
    assert (tmp_path / "acceptance.md").read_text(encoding="utf-8") == out
    assert "**no**" in out


def test_what_cannot_be_run_says_so_before_its_first_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "comings", "--set", "long_term.capacity=0"]) == 2
    assert "expected a long-term memory" in capsys.readouterr().err
    assert main(["study", "ablation", "--set", "evolution.elites=2"]) == 2
    assert "elites" in capsys.readouterr().err
    assert main(["study", "report", "--results", str(tmp_path / "none"), "--out", str(tmp_path / "R.md")]) == 2
    assert "no such folder" in capsys.readouterr().err


@pytest.mark.slow
def test_a_study_that_is_ended_takes_its_workers_with_it_and_leaves_no_run_folder(tmp_path: Path) -> None:
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    settings = [word for override in (*TINY, *PHASES, "experiment.iterations=400") for word in ("--set", override)]
    command = [sys.executable, "-m", "mdb_deploy.cli", "study", "alone", "--seeds", "801-812", *settings]
    with subprocess.Popen(
        [*command, "--out", str(tmp_path / "out")],
        env=os.environ | {"TMPDIR": str(temporary)},
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        first = process.stderr.readline()
        workers = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 130
    assert first.startswith("[1/12] done")
    _, alive = psutil.wait_procs(workers, 10)
    assert alive == []
    assert list(temporary.glob("mdb-study-*")) == []
    assert len(list((tmp_path / "out").glob("*/*/*.parquet"))) < 12


def test_a_body_that_changes_is_studied_in_windows_taught_and_alone_with_learning_and_without() -> None:
    base = tables.overrides_of(STUDIES["readapt"])
    variants = tables.VARIANTS["readapt"](Experiment.read(PAPER, base))
    assert len(variants) == 24
    made = {variant.name: Experiment.read(PAPER, (*base, *variant.overrides)) for variant in variants}
    stopped, taught = made[f"half turns, alone, {tables.STOPPED}"], made["half turns, taught"]
    assert stopped.robot.changes == taught.robot.changes == {600: {"turn_share": 0.5}}
    assert stopped.teacher is not None
    assert taught.teacher is not None
    assert [(p.start, p.teacher) for p in stopped.teacher.phase] == [
        (0, "one"),
        (500, None),
        (600, None),
        (750, None),
    ]
    assert {p.teacher for p in taught.teacher.phase} == {"one"}
    assert (stopped.brain.store.learns_until, taught.brain.store.learns_until) == (600, None)
    stopped.check_machine()
