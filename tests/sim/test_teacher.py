"""The scripted teacher: what it wants, in which notes, and how it rewards."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdb_sim.body import Placement, Pose, RobotConfig
from mdb_sim.teaching.teacher import (
    Language,
    TeacherError,
    binary_feedback,
    graded_feedback,
    make_language,
    turn_ranks,
    wanted_action,
)

TURNS_DEG = RobotConfig().turns_deg
TURNS_RAD = RobotConfig().turns_rad
NONE, SMALL_RIGHT, MEDIUM_RIGHT, LARGE_RIGHT, SMALL_LEFT, MEDIUM_LEFT, LARGE_LEFT = range(7)


def seen_at(phi_deg, heading_rad=0.7):
    angle = heading_rad + math.radians(phi_deg)
    return Placement(Pose(0.3, -0.2, heading_rad), 0.3 + math.cos(angle), -0.2 + math.sin(angle))


@pytest.mark.parametrize(
    ("phi_deg", "action"),
    [
        (0, NONE), (9, NONE), (11, SMALL_LEFT), (-11, SMALL_RIGHT), (40, MEDIUM_LEFT), (-66, MEDIUM_RIGHT),
        (70, LARGE_LEFT), (-90, LARGE_RIGHT), (170, LARGE_LEFT), (-170, LARGE_RIGHT),
    ],
)  # fmt: skip
def test_the_wanted_turn_best_faces_the_object(phi_deg, action):
    assert wanted_action(seen_at(phi_deg), TURNS_RAD) == action


@given(st.floats(-180, 180), st.floats(-3.2, 3.2))
def test_no_other_turn_leaves_the_object_nearer_the_front(phi_deg, heading_rad):
    chosen = wanted_action(seen_at(phi_deg, heading_rad), TURNS_RAD)
    left_deg = [abs(math.remainder(phi_deg - turn, 360)) for turn in TURNS_DEG]
    assert left_deg[chosen] == pytest.approx(min(left_deg), abs=1e-6)


def test_feedback_falls_with_each_step_of_turn_missed():
    by_turn = [LARGE_RIGHT, MEDIUM_RIGHT, SMALL_RIGHT, NONE, SMALL_LEFT, MEDIUM_LEFT, LARGE_LEFT]
    graded = [graded_feedback(LARGE_RIGHT, action, TURNS_DEG) for action in by_turn]
    assert graded == pytest.approx([1.0, 1 / 3, -1 / 3, -1.0, -1.0, -1.0, -1.0])
    assert [binary_feedback(NONE, action, TURNS_DEG) for action in by_turn] == [-1, -1, -1, 1, -1, -1, -1]


@given(st.integers(0, 6), st.integers(0, 6))
def test_feedback_is_symmetric_and_full_only_for_obedience(command, action):
    value = graded_feedback(command, action, TURNS_DEG)
    assert value == graded_feedback(action, command, TURNS_RAD)
    assert (value == 1.0) == (command == action)
    assert -1.0 <= value <= 1.0


def test_named_languages():
    assert make_language("paper", TURNS_DEG).notes == (0, 1, 2, 3, 4, 5, 6)
    ordered, reverse = make_language("ordered", TURNS_DEG), make_language("reversed", TURNS_DEG)
    assert ordered.notes == turn_ranks(TURNS_DEG) == (3, 2, 1, 0, 4, 5, 6)
    assert [ordered.command(note) for note in range(7)] == [reverse.command(6 - note) for note in range(7)]
    assert make_language("notes:6,5,4,3,2,1,0", TURNS_DEG).note(NONE) == 6


@given(st.integers(0, 2**64 - 1))
def test_random_languages_are_permutations_that_their_seed_repeats(seed):
    language = make_language(f"random:{seed}", TURNS_DEG)
    assert language == make_language(f"random:{seed}", TURNS_DEG)
    assert [language.command(language.note(command)) for command in range(7)] == list(range(7))


def test_random_languages_differ():
    assert len({make_language(f"random:{seed}", TURNS_DEG).notes for seed in range(50)}) > 45


@pytest.mark.parametrize(
    "name", ["esperanto", "random:", "random:-1", "random:x", f"random:{2**64}", "notes:0,1", ""]
)
def test_an_unknown_language_is_refused_with_the_known_ones(name):
    with pytest.raises(TeacherError, match="expected 'ordered', 'reversed', 'paper', 'random:SEED'"):
        make_language(name, TURNS_DEG)


def test_ambiguous_languages_and_what_does_not_exist_are_refused():
    with pytest.raises(TeacherError, match="exactly once"):
        Language("mumble", (0, 0, 1))
    with pytest.raises(TeacherError, match="exactly once"):
        make_language("notes:0,1,2,3,4,5,5", TURNS_DEG)
    with pytest.raises(TeacherError, match="note=7 does not exist; expected an int from 0 to 6"):
        make_language("paper", TURNS_DEG).command(7)
    with pytest.raises(TeacherError, match="action=9"):
        graded_feedback(0, 9, TURNS_DEG)
