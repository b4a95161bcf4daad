"""Variants fit any experiment file, and a study that was interrupted goes on where it stopped."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import structlog
import tomli_w

from mdb_deploy import acceptance
from mdb_deploy.acceptance import Job, finished_record
from mdb_deploy.cli import experiment_path, main
from mdb_deploy.study import ablation_variants, chosen, comings_overrides
from mdb_protocol.errors import ConfigError
from mdb_sim.acceptance import acceptance_row
from mdb_sim.experiment import Experiment
from tests.integration.brain import SHORT
from tests.services.small import CONTENT

PAPER = experiment_path("paper")
TINY = (
    "robot.body=kinematic",
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


def overrides_of(experiment: Experiment) -> dict[str, tuple[str, ...]]:
    return {variant.folder: variant.overrides for variant in ablation_variants(experiment.brain)}


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
            {"name": "alone", "world": "thing", "satisfaction": "next.distance", "aspiration": 0.5},
        ],
        "memory": {"distance": 1.0},
        "robot": {"body": "kinematic", "world": {"turns_deg": [0, -20, 20]}},
    }
    path.write_text(tomli_w.dumps(content | sections), encoding="utf-8")
    return path


def test_variants_of_the_paper_take_one_ingredient_away_each() -> None:
    overrides = overrides_of(Experiment.read(PAPER))
    fifo = [f"model.{name}.memory={{recency=1.0}}" for name in ("communication", "object", "induced")]
    smaller = [f"model.{name}.capacity={n}" for name, n in (("communication", 20), ("object", 100), ("induced", 100))]
    assert overrides == {
        "as-shipped": (),
        "promoters-off": ("learner.name=ga",),
        "long-term-memory-off": ("long_term.capacity=0",),
        "no-context-detection": ("context.enabled=false",),
        "fifo-only": (*fifo, "context.enabled=false"),
        "no-aspiration": ("mode.taught.exploration=0",),
        "scalar-note": ("channels.note={low=0, high=6}",),
        "smaller-memories": tuple(smaller),
    }


def test_variants_of_another_file_have_its_names_and_heed_settings_of_a_models_own(tmp_path: Path) -> None:
    path = other_experiment(tmp_path / "other.toml")
    overrides = overrides_of(Experiment.read(path))
    assert overrides["promoters-off"] == ("learner.name=ga", "model.thing.learner.name=ga")
    assert overrides["long-term-memory-off"] == ("model.ears.long_term.capacity=0", "long_term.capacity=0")
    assert overrides["no-context-detection"] == ("context.enabled=false",)
    assert overrides["fifo-only"][0] == "model.ears.memory={recency=1.0, distance=0.0}"
    assert overrides["no-aspiration"] == ("mode.heard.exploration=0",)
    assert overrides["scalar-note"] == ("channels.note={low=0, high=2}",)
    assert overrides["smaller-memories"] == (
        "model.ears.capacity=1",
        "model.thing.capacity=10",
        "model.fitted.capacity=1",
    )


@pytest.mark.parametrize("paper", [True, False])
def test_every_variant_is_an_experiment_that_has_nothing_more_to_take_away(*, paper: bool, tmp_path: Path) -> None:
    path = PAPER if paper else other_experiment(tmp_path / "other.toml")
    for folder, overrides in overrides_of(Experiment.read(path)).items():
        left = overrides_of(Experiment.read(path, overrides))
        assert folder in ("as-shipped", "smaller-memories") or not left[folder], folder


def test_a_file_without_an_ingredient_has_no_such_variant(tmp_path: Path) -> None:
    path = other_experiment(tmp_path / "other.toml", channels=CONTENT["channels"] | {"note": {"high": 2.0}})
    bare = ("memory={}", "context.enabled=false", "mode.heard.exploration=0")
    overrides = overrides_of(Experiment.read(path, bare))
    assert [name for name, needed in overrides.items() if not needed] == [
        "as-shipped", "no-context-detection", "fifo-only", "no-aspiration", "scalar-note",
    ]  # fmt: skip


def test_some_variants_can_be_chosen_and_the_first_is_always_there() -> None:
    variants = ablation_variants(Experiment.read(PAPER).brain)
    assert [variant.folder for variant in chosen(variants, ["scalar-note"])] == ["as-shipped", "scalar-note"]
    assert chosen(variants, []) == variants
    with pytest.raises(ConfigError, match=r"--only 'notes': no such variant; there are as-shipped, promoters-off"):
        chosen(variants, ["notes"])


def test_in_the_study_of_comings_two_teachers_with_their_own_languages_take_turns() -> None:
    experiment = Experiment.read(PAPER, comings_overrides(500))
    assert experiment.brain.experiment.iterations == 2500
    assert experiment.teacher is not None
    phases = experiment.teacher.phase
    assert [(phase.start, phase.teacher) for phase in phases] == [
        (0, "A"), (500, "B"), (1000, "A"), (1500, "B"), (2000, "A"),
    ]  # fmt: skip


def study(*words: str, overrides: tuple[str, ...] = TINY) -> int:
    settings = [word for override in overrides for word in ("--set", override)]
    return main(["study", *words, "--seeds", "11,12", "--workers", "1", *settings])


def test_an_ablation_makes_table_and_figure_and_goes_on_where_it_stopped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("ablation", "--only", "no-aspiration", "--out", str(tmp_path / "out"))
    assert study(*words, overrides=(*TINY, *PHASES)) == 0
    out, progress = capsys.readouterr()
    assert progress.count("done in") == 4
    assert (tmp_path / "out" / "ablation.md").read_text(encoding="utf-8") == out
    assert "| no aspiration |" in out
    assert (tmp_path / "out" / "ablation.png").read_bytes().startswith(b"\x89PNG")
    assert "seed11" in (tmp_path / "out" / "no-aspiration" / "acceptance.md").read_text(encoding="utf-8")

    (tmp_path / "out" / "as-shipped" / "seed12" / "run.mcap").write_bytes(b"")
    assert study(*words, overrides=(*TINY, *PHASES)) == 0
    again, progress = capsys.readouterr()
    assert again == out
    assert (progress.count("already there"), progress.count("done in")) == (3, 1)


def test_comings_are_compared_with_and_without_a_long_term_memory(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert study("comings", "--out", str(tmp_path), "--phase", "22") == 0
    out, _ = capsys.readouterr()
    assert out.count("| 12 | long-term memory o") == 2
    assert (tmp_path / "comings.png").read_bytes().startswith(b"\x89PNG")


def test_a_run_of_another_experiment_or_one_that_was_stopped_is_not_taken_for_this_one(tmp_path: Path) -> None:
    job = Job(PAPER, 11, (*TINY, *PHASES), tmp_path / "run", acceptance_row, reuse=True)
    assert finished_record(job) is None
    assert "done in" in acceptance._do((0, job))[2]
    assert finished_record(job) is not None
    assert finished_record(replace(job, overrides=(*job.overrides, "evolution.elite=2"))) is None
    assert finished_record(replace(job, seed=12)) is None
    log = tmp_path / "run" / "run.mcap"
    whole = log.read_bytes()
    log.write_bytes(whole[: len(whole) * 9 // 10])
    assert finished_record(job) is None


def test_a_study_that_cannot_be_run_says_so_before_its_first_run(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "comings", "--set", "long_term.capacity=0"]) == 2
    assert "expected a long-term memory" in capsys.readouterr().err
    assert main(["study", "ablation", "--set", "evolution.elites=2"]) == 2
    assert "elites" in capsys.readouterr().err


def test_the_short_experiment_of_the_other_tests_has_the_same_variants() -> None:
    assert overrides_of(Experiment.read(PAPER, SHORT)) == overrides_of(Experiment.read(PAPER))
