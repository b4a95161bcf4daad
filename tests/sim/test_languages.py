"""Languages: which note stands for which command."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdb_sim.teaching.languages import Language, TeacherError, make_language
from mdb_sim.teaching.policies.pioneer import Reach
from tests.protocol.samples import fixed

ORDER = Reach().order
NONE = 0


def test_named_languages():
    assert make_language("paper", ORDER).notes == (0, 1, 2, 3, 4, 5, 6)
    ordered, reverse = make_language("ordered", ORDER), make_language("reversed", ORDER)
    assert ordered.notes == ORDER == (3, 2, 1, 0, 4, 5, 6)
    assert [ordered.command(note) for note in range(7)] == [reverse.command(6 - note) for note in range(7)]
    assert make_language("notes:6,5,4,3,2,1,0", ORDER).note(NONE) == 6
    assert make_language("notes: 1, 0", (0, 1)).notes == (1, 0)


@fixed
@given(st.integers(0, 2**64 - 1), st.permutations(range(5)))
def test_random_languages_are_permutations_that_their_seed_repeats(seed, order):
    language = make_language(f"random:{seed}", order)
    assert language == make_language(f"random:{seed}", order)
    assert language.notes == make_language(f"random:{seed}", sorted(order)).notes, "of any order"
    assert [language.command(language.note(command)) for command in range(5)] == list(range(5))


def test_random_languages_differ():
    assert len({make_language(f"random:{seed}", ORDER).notes for seed in range(50)}) > 45


@fixed
@given(st.permutations(range(6)))
def test_ordered_languages_rise_and_reversed_ones_fall_with_the_rank(order):
    by_rank = sorted(range(6), key=lambda command: order[command])
    assert [make_language("ordered", order).note(command) for command in by_rank] == [0, 1, 2, 3, 4, 5]
    assert [make_language("reversed", order).note(command) for command in by_rank] == [5, 4, 3, 2, 1, 0]
    assert make_language("paper", order).notes == (0, 1, 2, 3, 4, 5)


@pytest.mark.parametrize(
    "name", ["esperanto", "random:", "random:-1", "random:x", f"random:{2**64}", "notes:0,1", "notes:a,b", ""]
)
def test_an_unknown_language_is_refused_with_the_known_ones(name):
    with pytest.raises(TeacherError, match="expected 'ordered', 'reversed', 'paper', 'random:SEED'"):
        make_language(name, ORDER)


def test_how_many_notes_are_to_be_given_is_said_with_an_example():
    with pytest.raises(TeacherError, match=r"for 3 commands; .* 3 notes \(as in 'notes:0,1,2'\)"):
        make_language("notes:0,1", (0, 1, 2))


def test_ambiguous_languages_and_what_does_not_exist_are_refused():
    with pytest.raises(TeacherError, match="exactly once"):
        Language("mumble", (0, 0, 1))
    with pytest.raises(TeacherError, match="exactly once"):
        make_language("notes:0,1,2,3,4,5,5", ORDER)
    with pytest.raises(TeacherError, match="note=7 does not exist; expected an int from 0 to 6"):
        make_language("paper", ORDER).command(7)
    for command in (7, -1, 1.0, True):
        with pytest.raises(TeacherError, match=r"command=.* does not exist; expected an int from 0 to 6"):
            make_language("paper", ORDER).note(command)
