"""Who teaches when, and in which language."""

from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_sim.body import RobotConfig
from mdb_sim.teaching.schedule import Schedule, TeacherSection, schedule_of
from mdb_sim.teaching.teacher import TeacherError

TWO = [
    {"start": 0, "name": "first", "teacher": "one", "language": "random"},
    {"start": 10, "name": "alone"},
    {"start": 20, "name": "second", "teacher": "two", "language": "random"},
    {"start": 30, "name": "one again", "teacher": "one"},
]


def schedule(phases: list[dict[str, Any]], seed: int = 1, turns_deg: tuple[float, ...] | None = None) -> Schedule:
    section = msgspec.convert({"phase": phases}, TeacherSection)
    return schedule_of(section, seed, RobotConfig(turns_deg=turns_deg) if turns_deg else RobotConfig())


@pytest.mark.parametrize(
    ("iteration", "name"),
    [(0, "first"), (9, "first"), (10, "alone"), (19, "alone"), (20, "second"), (10**9, "one again")],
)
def test_each_iteration_has_its_phase(iteration: int, name: str) -> None:
    assert schedule(TWO).at(iteration).name == name


@settings(derandomize=True, deadline=None, max_examples=40)
@given(st.integers(0, 2**62))
def test_teachers_with_random_languages_speak_differently_and_keep_theirs(seed: int) -> None:
    first, alone, second, again = schedule(TWO, seed).phases
    assert first.language is not None
    assert second.language is not None
    assert first.language.notes != second.language.notes
    assert again.language == first.language
    assert (alone.teacher, alone.language) == (None, None)
    assert schedule(TWO, seed) == schedule(TWO, seed)


def test_another_seed_gives_other_languages() -> None:
    assert len({schedule(TWO, seed).phases[0].language.notes for seed in range(20)}) > 15  # type: ignore[union-attr]


def test_a_body_of_two_actions_has_two_languages_and_no_third() -> None:
    def teachers(count: int) -> list[dict[str, Any]]:
        return [{"start": i, "name": "p", "teacher": f"t{i}", "language": "random"} for i in range(count)]

    for seed in range(10):
        one, two = schedule(teachers(2), seed, (0.0, 90.0)).phases
        assert {one.language.notes, two.language.notes} == {(0, 1), (1, 0)}  # type: ignore[union-attr]
    with pytest.raises(TeacherError, match="no language is left for teacher 't2'"):
        schedule(teachers(3), 1, (0.0, 90.0))


@pytest.mark.parametrize(
    ("phases", "said"),
    [
        ([{"start": 1, "name": "late"}], r"phases start at \[1\]; expected 0 first"),
        ([{"start": 0, "name": "a"}, {"start": 0, "name": "b"}], "then growing"),
        ([{"start": 0, "name": "a"}, {"start": 9, "name": "b"}, {"start": 5, "name": "c"}], "then growing"),
        ([{"start": 0, "name": "a", "teacher": "one"}], "phase 'a': teacher 'one' needs a language"),
        ([{"start": 0, "name": "a", "language": "random"}], "phase 'a': a language needs its teacher"),
        ([{"start": 0, "name": "a", "teacher": "one", "language": "klingon"}], "no language 'klingon'"),
        ([{"start": 0, "name": "a", "teacher": "one", "language": "notes:0,1"}], "notes"),
    ],
)
def test_phases_that_make_no_schedule_are_clear_errors(phases: list[dict[str, Any]], said: str) -> None:
    with pytest.raises(TeacherError, match=said):
        schedule(phases)


@pytest.mark.parametrize(
    "section",
    [
        {"phase": []},
        {"phase": [{"start": -1, "name": "a"}]},
        {"phase": [{"start": 0}]},
        {"phase": [{"start": 0, "name": "a", "teacher": "a/b"}]},
        {"phases": []},
        {"phase": [{"start": 0, "name": "a", "judged": 1.1}]},
        {"phase": [{"start": 0, "name": "a", "praise_half_life": 0}]},
        {"phase": [{"start": 0, "name": "a", "relative": -1}]},
        {"phase": [{"start": 0, "name": "a", "says": "nothing"}]},
        {"phase": [{"start": 0, "name": "a", "delay": 1, "delay_spread": 2}]},
    ],
)
def test_sections_of_another_form_are_refused(section: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(section, TeacherSection)
