"""A short real run: its episodes are seen again from the log alone; its figure tells phases, models and episodes."""

import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest

from mdb_deploy.experiments import experiment_path
from mdb_sim.figures.learning import draw_runs
from mdb_sim.report import document
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.inline import run_experiment
from mdb_sim.runs.record import RunRecord, read_record
from mdb_sim.studies.catalogue import STUDIES
from mdb_sim.studies.results import Result, decode, encode
from mdb_sim.studies.rows import PhaseRow, rows_of
from tests.sim.phases import label
from tests.sim.test_measures import of_another_body, with_another_body, write_run

SETTINGS = (
    "experiment.iterations=110",
    "experiment.seed=5301",
    "experiment.pace=lockstep",
    "optimizer.random_iterations=110",
    'teacher.phase=[{start=0, name="first", teacher="one", language="random"}, {start=20, name="alone"}]',
)
"""All is forced, so that episodes are short and some of them begin and end alone."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("pygame", reason="CartPole is drawn with pygame")
    path = tmp_path_factory.mktemp("runs") / "cartpole"
    run_experiment(Experiment.read(experiment_path("cartpole"), SETTINGS), path)
    return path


@pytest.fixture(scope="module")
def record(run: Path) -> RunRecord:
    return read_record(run)


@pytest.fixture(scope="module")
def rows(record: RunRecord) -> list[PhaseRow]:
    return rows_of(record)


def text_of(svg: Path) -> str:
    return " ".join(ElementTree.parse(svg).getroot().itertext())


def test_of_the_phase_alone_the_median_episode_and_the_worst_are_seen_again(rows: list[PhaseRow]) -> None:
    taught, alone = rows
    assert taught.films == ()
    assert [film.what for film in alone.films] == ["median", "worst"]
    for film in alone.films:
        assert film.missing == ""
        assert (film.start >= 20, film.event, film.score) == (True, "fallen", film.steps), "a reward of 1 an action"
        assert (film.moments[0], film.moments[-1]) == (0, film.steps)
        images = [picture.image for _, picture in film.shown()]
        assert all(image is not None and image.shape == images[0].shape for image in images)
        assert not np.array_equal(images[0], images[-1]), "the pole has fallen"
    assert alone.films[1].score == alone.scores.min() < alone.films[0].score


def test_every_episode_has_its_score_and_every_model_its_errors(rows: list[PhaseRow], record: RunRecord) -> None:
    ends = np.concatenate([row.ended_after for row in rows])
    assert ends.tolist() == [episode.stop for episode in record.episodes()]
    assert np.concatenate([row.ended_scores for row in rows]).tolist() == [e.steps for e in record.episodes()]
    taught, alone = rows
    assert set(taught.errors) == {"communication", "direct"}
    assert np.isfinite(taught.errors["direct"]).sum() > 10
    assert not np.isfinite(alone.errors["direct"]).any(), "nobody judges"


def test_results_keep_errors_and_films(rows: list[PhaseRow]) -> None:
    again = decode(encode(label("machines", "CartPole-v1"), rows)).rows
    assert again[1].films == rows[1].films
    for name, errors in rows[0].errors.items():
        np.testing.assert_array_equal(again[0].errors[name], errors)


def test_the_study_shows_each_machine_from_its_results_alone(rows: list[PhaseRow], tmp_path: Path) -> None:
    found = [
        Result(label("machines", "CartPole-v1", seed), tuple(replace(row, seed=seed) for row in rows))
        for seed in (5301, 5302)
    ]
    text, figures = document.one(STUDIES["machines"], found, tmp_path)
    assert [path.name for path in figures] == ["machines.png", "machines-cartpole.png"]
    assert all(f"({link})" in text for link in ("./machines.png", "./machines-cartpole.png"))
    assert 20_000 < figures[1].stat().st_size < 200_000


def test_results_of_before_are_shown_without(rows: list[PhaseRow], tmp_path: Path) -> None:
    nothing = np.zeros(0, np.float32)
    old = tuple(replace(row, errors={}, films=(), ended_after=nothing, ended_scores=nothing) for row in rows)
    _, figures = document.one(STUDIES["machines"], [Result(label("machines", "CartPole-v1"), old)], tmp_path)
    assert figures[1].stat().st_size > 5_000


def test_a_run_s_figure_names_teachers_models_and_episodes(run: Path, tmp_path: Path) -> None:
    paths = draw_runs([run], tmp_path)
    assert [path.name for path in paths] == ["learning.png", "learning.svg"]
    text = text_of(paths[1])
    for word in (
        "taught by “one”",
        "alone",
        "communication",
        "direct",
        "Typical (median) episode",
        "Worst",
        "return",
    ):
        assert word in text
    assert [path.name for path in draw_runs([run, run], tmp_path)] == ["learning-seeds.png", "learning-seeds.svg"]


def test_where_nothing_can_be_drawn_the_rest_is_and_the_reason_is_said(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "pygame"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pygame", None)  # as where it is not installed
    text = " ".join(text_of(draw_runs([run], tmp_path)[1]).split())
    assert "pygame is not installed" in text
    assert "multilevel-darwinist-brain[gymnasium]" in text
    assert "direct" in text


def test_an_episode_that_goes_another_way_is_not_shown(record: RunRecord, rows: list[PhaseRow]) -> None:
    started = rows[1].films[0].start
    scene = record.scenes[started + 2]
    other = msgspec.structs.replace(scene, reached=scene.reached | {"x": 1.0})
    film = rows_of(replace(record, scenes=record.scenes | {started + 2: other}))[1].films[0]
    assert "goes another way: after 2 actions x is" in film.missing
    assert (film.start, film.pictures) == (started, ())


def test_what_is_no_simulation_is_not_moved(tmp_path: Path) -> None:
    record = write_run(tmp_path / "run", 200, scenes=of_another_body, experiment=with_another_body())
    content = record.experiment.content
    robot = content["robot"] | {"body": "tests.conformance.small_bodies:Turntable"}
    rows = rows_of(replace(record, experiment=Experiment(content | {"robot": robot}, "test")))
    films = [film for row in rows for film in row.films]
    assert films
    assert all("does not say that it is simulated" in film.missing and not film.pictures for film in films)
