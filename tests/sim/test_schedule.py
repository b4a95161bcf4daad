"""Who teaches when, and in which language."""

import math
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_protocol import messages
from mdb_sim.body import NOTHING, Numbers
from mdb_sim.teaching.languages import TeacherError
from mdb_sim.teaching.schedule import Schedule, TeacherSection, schedule_of

TWO = [
    {"start": 0, "name": "first", "teacher": "one", "language": "random"},
    {"start": 10, "name": "alone"},
    {"start": 20, "name": "second", "teacher": "two", "language": "random"},
    {"start": 30, "name": "one again", "teacher": "one"},
]


def schedule(phases: list[dict[str, Any]], seed: int = 1, turns_deg: tuple[float, ...] | None = None) -> Schedule:
    options = {"turns_deg": list(turns_deg)} if turns_deg else {}
    return schedule_of(msgspec.convert({"phase": phases, "options": options}, TeacherSection), seed)


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
    assert schedule(TWO, seed).phases == schedule(TWO, seed).phases


def test_another_seed_gives_other_languages() -> None:
    assert len({schedule(TWO, seed).phases[0].language.notes for seed in range(20)}) > 15  # type: ignore[union-attr]


def test_for_two_commands_there_are_two_languages_and_no_third() -> None:
    def teachers(count: int) -> list[dict[str, Any]]:
        return [{"start": i, "name": "p", "teacher": f"t{i}", "language": "random"} for i in range(count)]

    for seed in range(10):
        one, two = schedule(teachers(2), seed, (0.0, 90.0)).phases
        assert {one.language.notes, two.language.notes} == {(0, 1), (1, 0)}  # type: ignore[union-attr]
    with pytest.raises(TeacherError, match="no language is left for teacher 't2'"):
        schedule(teachers(3), 1, (0.0, 90.0))


def test_of_one_command_all_teachers_speak_the_only_language() -> None:
    phases = [{"start": i, "name": "p", "teacher": f"t{i}", "language": "random"} for i in range(2)]
    both = schedule_of(msgspec.convert({"policy": "nearer", "phase": phases}, TeacherSection), 1).phases
    assert [phase.language.notes for phase in both if phase.language is not None] == [(0,), (0,)]
    section = msgspec.convert({"policy": "nearer", "phase": [phases[0] | {"wrong_notes": 0.1}]}, TeacherSection)
    with pytest.raises(TeacherError, match="policy 'nearer' has one command, and there is no wrong note"):
        schedule_of(section, 1)


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
    ("section", "said"),
    [
        ({"policy": "obey"}, "no policy named 'obey'"),
        ({"options": {"turns": [1, 2]}}, r"does not take the options \{'turns': \[1, 2\]\}"),
        ({"options": {"turns_deg": [5]}}, "expected two or more of -180 to 180, all different"),
    ],
)
def test_a_policy_that_cannot_be_had_makes_no_schedule(section: dict[str, Any], said: str) -> None:
    with pytest.raises(TeacherError, match=said):
        schedule_of(msgspec.convert({"phase": TWO} | section, TeacherSection), 1)


# ---- what is wanted, and how it is judged ----


def seen(bearing_rad: float, heading_rad: float = 0.0) -> Numbers:
    towards = bearing_rad + heading_rad
    object_m = {"object_x_m": math.cos(towards), "object_y_m": math.sin(towards)}
    return {"x_m": 0.0, "y_m": 0.0, "heading_rad": heading_rad} | object_m


def shown(before: Numbers | None, turn_deg: float, **fields: Any) -> messages.Scene:
    """What came of a turn; its action says another one."""
    reached = (before or seen(0.0)) | {"heading_rad": math.radians(turn_deg)}
    plain = {"episode": 0, "successes": 0, "event": NOTHING, "action": {"turn": -turn_deg}, "now": reached}
    return messages.Scene(iteration=1, before=before, reached=reached, **(plain | fields))


def only(**settings: Any) -> Schedule:
    phase = {"start": 0, "name": "p", "teacher": "one", "language": "paper"}
    return schedule_of(msgspec.convert({"phase": [phase]} | settings, TeacherSection), 1)


def test_the_note_is_that_of_the_turn_that_faces_the_object() -> None:
    assert [only().note(0, seen(math.radians(angle))) for angle in (0, 25, -80)] == [0, 4, 3]


def test_nobody_who_teaches_and_nothing_that_is_wanted_are_silence() -> None:
    assert schedule(TWO).note(10, seen(0.0)) is None
    named = only(policy="mdb_sim.teaching.policies.plain:Named", options={"commands": ["come", "go"]})
    assert named.note(0, {}) is None
    assert named.judgement(0, shown(seen(0.0), 0.0)) is None


def test_the_turn_that_was_made_is_judged_where_it_was_begun() -> None:
    wanted_left = seen(math.radians(90.0))
    judged = [only().judgement(0, shown(wanted_left, turn_deg)) for turn_deg in (90.0, 67.5, 45.0, 0.0)]
    assert judged == pytest.approx([1.0, 2 / 3, 1 / 3, -1.0])
    elsewhere = shown(wanted_left, 90.0, now=seen(0.0), ended=True, event="capture")
    assert only().judgement(0, elsewhere) == 1.0
    assert only().judgement(0, shown(None, 90.0)) is None, "nothing was done yet"


def test_who_knows_obedience_only_says_one_or_the_other() -> None:
    wanted_left = seen(math.radians(90.0))
    turns_deg = (90.0, 89.0, 67.5, 45.0, 0.0)
    binary = only(feedback="binary")
    assert [binary.judgement(0, shown(wanted_left, turn)) for turn in turns_deg] == [1.0, 1.0, -1.0, -1.0, -1.0]


def test_who_mistakes_feedback_says_the_opposite_of_the_judgement() -> None:
    phase = {"start": 0, "name": "p", "teacher": "one", "language": "paper", "wrong_feedback": 1.0}
    wanted_left = seen(math.radians(90.0))
    assert only(phase=[phase]).judgement(0, shown(wanted_left, 45.0)) == pytest.approx(-1 / 3)


def test_a_scene_that_lacks_what_the_policy_looks_at_is_a_lookup_error() -> None:
    with pytest.raises(LookupError, match="object_y_m"):
        only().note(0, {"x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0})
    with pytest.raises(LookupError, match="heading_rad"):
        only().judgement(0, msgspec.structs.replace(shown(seen(0.0), 0.0), reached={"x_m": 0.0}))


@pytest.mark.parametrize(
    "section",
    [
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


def starts(ended: list[int]) -> list[tuple[int, str]]:
    return [(phase.start, phase.name) for phase in schedule(TWO).with_ended(ended).phases]


@pytest.mark.parametrize(
    ("ended", "expected"),
    [
        ([], [0, 10, 20, 30]),
        ([4], [0, 5, 15, 25]),
        ([4, 4], [0, 5, 15, 25]),
        ([4, 7], [0, 5, 8, 18]),
        ([7, 4], [0, 5, 8, 18]),
        ([9], [0, 10, 20, 30]),
        ([0, 1, 2], [0, 1, 2, 3]),
        ([25], [0, 10, 20, 26]),
        ([40, 35], [0, 10, 20, 30]),
    ],
)
def test_a_phase_ends_where_it_is_ended_and_later_ones_begin_earlier(ended: list[int], expected: list[int]) -> None:
    assert starts(ended) == list(zip(expected, ["first", "alone", "second", "one again"], strict=True))


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.lists(st.integers(0, 60), max_size=8))
def test_however_phases_are_ended_each_comes_in_its_order_and_lasts(ended: list[int]) -> None:
    found = schedule(TWO).with_ended(ended)
    begins = [phase.start for phase in found.phases]
    assert begins == sorted(set(begins))
    assert begins[0] == 0
    for iteration in ended:
        last = found.at(iteration).name == "one again"
        assert (found.at(iteration + 1) is found.at(iteration)) == last
