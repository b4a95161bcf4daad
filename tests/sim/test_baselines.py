"""Players without the mechanism, in the same world as the brain, and the ideal that captures are judged by."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from mdb_protocol.errors import ConfigError
from mdb_sim.runs.experiment import Experiment
from mdb_sim.runs.measures import success_window
from mdb_sim.runs.record import RunRecord
from mdb_sim.studies.ideal import ideal_successes
from mdb_sim.studies.players import baselines
from mdb_sim.studies.players.gaussian import Bandit, Induced, posterior
from mdb_sim.studies.rows import rows_of
from mdb_sim.teaching.languages import make_language
from tests.sim.test_measures import PAPER, REACH, TURNS, graded_feedback

SHORT = (
    "robot.body=kinematic",
    "experiment.seed=801",
    "experiment.pace=lockstep",
    "experiment.iterations=800",
    "optimizer.random_iterations=100",
    "teacher.phase.alone.start=250",
    "teacher.phase.second teacher.start=400",
    "teacher.phase.alone again.start=650",
)


def played(name: str, run: Path, *overrides: str) -> RunRecord:
    return baselines.play(Experiment.read(PAPER, (*SHORT, *overrides)), name, run)


def test_the_ideal_policy_captures_what_its_ideal_does(tmp_path: Path) -> None:
    record = played("ideal", tmp_path / "run")
    assert [row.share for row in rows_of(record)] == [1.0] * 4
    assert (tmp_path / "run" / "experiment.toml").exists()


def test_the_ideal_begins_within_the_episode_where_the_phase_begins(tmp_path: Path) -> None:
    record = played("random", tmp_path / "run", "robot.episode_iterations=5")
    window = success_window(record, record.spans[1])
    begin = record.scenes[window[0]]
    assert not begin.ended, "or else this seed shows nothing"
    # A robot that is put down with a fresh episode has longer for its first capture.
    fresh = replace(record, scenes=record.scenes | {window[0]: structs.replace(begin, ended=True)})
    assert 0 < ideal_successes(record, window) <= ideal_successes(fresh, window)


def test_a_foreign_body_and_a_run_that_ended_before_have_no_ideal(tmp_path: Path) -> None:
    record = played("random", tmp_path / "run")
    assert math.isnan(ideal_successes(record, (700, 900)))
    assert record.experiment.robot.body == "kinematic"
    foreign = Experiment.read(PAPER, (*SHORT, "robot.body=mdb_sim.bodies.pioneer.twin:KinematicRobot"))
    assert math.isnan(ideal_successes(replace(record, experiment=foreign), (400, 650)))


def test_who_knows_the_language_obeys_every_note_and_is_lost_without(tmp_path: Path) -> None:
    rows = rows_of(played("obedient", tmp_path / "run"))
    assert [rows[0].obedience, rows[2].obedience] == [1.0, 1.0]
    assert rows[2].share == 1.0
    assert max(rows[1].share, rows[3].share) < 0.4


def test_a_player_is_the_same_every_time(tmp_path: Path) -> None:
    one, other = (played("random", tmp_path / name) for name in ("one", "other"))
    np.testing.assert_array_equal(one.choice, other.choice)
    assert one.scenes == other.scenes
    np.testing.assert_array_equal(one.feedback, other.feedback)


def test_gaussian_processes_learn_both_teachers_and_go_on_alone(tmp_path: Path) -> None:
    rows = rows_of(played("gaussian", tmp_path / "run"))
    assert min(rows[0].obedience, rows[2].obedience) > 0.95
    assert rows[2].iterations_to_obedience < 100
    assert min(row.share for row in rows if row.alone) > 0.8


def test_late_feedback_is_credited_to_the_iteration_that_it_names(tmp_path: Path) -> None:
    late = [f"teacher.phase.{name}.delay=3" for name in ("first teacher", "second teacher")]
    record = played("gaussian", tmp_path / "run", *late)
    assert rows_of(record)[2].obedience > 0.9


def test_a_player_that_there_is_not_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no player 'perfect'; expected one of ideal, obedient, random, gaussian"):
        played("perfect", tmp_path / "run")


def test_a_posterior_is_the_prior_without_data_and_certain_with_much() -> None:
    kernel = np.array([[1.0, 0.5], [0.5, 1.0]])
    mean, deviation = posterior(kernel, np.zeros(0, np.int64), np.zeros(0), 0.1)
    assert (mean.tolist(), deviation.tolist()) == ([0.0, 0.0], [1.0, 1.0])
    mean, deviation = posterior(kernel, np.zeros(50, np.int64), np.ones(50), 0.1)
    assert mean[0] == pytest.approx(1.0, abs=0.01)
    assert deviation[0] < 0.02
    assert mean[1] == pytest.approx(0.5, abs=0.01)


def test_a_bandit_forgets_a_teacher_who_has_changed() -> None:
    bandit = Bandit(REACH.order)
    one, two = make_language("ordered", REACH.order), make_language("reversed", REACH.order)
    for language in (one, two):
        for place in range(140):
            note = place % len(TURNS)
            action = bandit.act(note)
            bandit.learn(note, action, graded_feedback(language.command(note), action))
        assert [bandit.act(note) for note in range(7)] == [language.command(note) for note in range(7)]


def test_what_was_induced_generalises_over_the_angle() -> None:
    turns = (0.0, -0.5, 0.5)
    induced = Induced(turns)
    for angle in np.linspace(-1.0, 1.0, 21).tolist():
        for action, turn in enumerate(turns):
            reading = {"distance": 1.0, "angle": angle, "continuity": 0.0}
            induced.learn(reading, action, 1.0 - 2.0 * abs(angle - turn))
    assert [induced.act({"distance": 1.1, "angle": a, "continuity": 0.0}) for a in (-0.73, 0.03, 0.61)] == [1, 0, 2]
    assert Induced(turns).act({"distance": 1.0, "angle": 0.0, "continuity": 0.0}) is None


def test_the_ideal_of_a_changed_body_is_that_of_the_body_as_it_then_is(tmp_path: Path) -> None:
    record = played("random", tmp_path / "run")
    window = 400, 650

    def ideal_of(settings: dict[str, object], at: int) -> float:
        content = record.experiment.content
        robot = content["robot"] | {"change": [{"at": at, "set": settings}]}
        changed = Experiment(content | {"robot": robot}, "test")
        return ideal_successes(replace(record, experiment=changed), window)

    unchanged = ideal_successes(record, window)
    assert ideal_of({"turn_share": 0.5}, 651) == unchanged, "it changes later"
    assert ideal_of({"swapped": True}, 300) == unchanged, "who knows of it does as well"
    before, within = ideal_of({"left_wheel": 0.5}, 300), ideal_of({"left_wheel": 0.5}, 525)
    assert 0 < before < within < unchanged
    assert ideal_of({"left_wheel": 0.5, "object_x_m": 3.0}, 300) == before, "where the object is the scene tells"
