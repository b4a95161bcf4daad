"""Whose word counts when several teach, and what their feedback comes to."""

import math

import pytest

from mdb_protocol.messages import Command, Feedback
from mdb_services.acting.teachers import KEPT_AHEAD, KEPT_TEACHERS, Teachers, Verdict

ANNA, BEN, BOTH, SCRIPT = (
    frozenset(f"teacher/{n}" for n in names) for names in (["a"], ["b"], ["a", "b"], ["script"])
)
NOBODY: frozenset[str] = frozenset({"robot/body"})


def command(teacher: str, iteration: int, note: int | None = 1) -> Command:
    return Command(teacher=teacher, iteration=iteration, note=note)


def obeyed(teachers: Teachers, iteration: int) -> str | None:
    taken = teachers.word(iteration)
    return taken.teacher if taken else None


def test_who_comes_first_holds_the_word() -> None:
    teachers = Teachers("first")
    teachers.hear(command("b", 0))
    teachers.hear(command("a", 0))
    assert (obeyed(teachers, 0), teachers.holder) == ("b", "b")
    teachers.hear(command("a", 1))
    assert not teachers.settled(1, BOTH), "he who holds it is awaited"
    teachers.hear(command("b", 1))
    assert teachers.settled(1, BOTH)
    assert obeyed(teachers, 1) == "b"


def test_the_word_passes_on_when_its_holder_is_silent_or_gone_or_his_time_is_up() -> None:
    for leaves in ("silent", "gone", "late"):
        teachers = Teachers("first")
        teachers.hear(command("b", 0))
        assert teachers.settled(0, BOTH)
        teachers.word(0)
        teachers.hear(command("a", 1, 3))
        if leaves == "silent":
            teachers.hear(command("b", 1, None))
        assert teachers.settled(1, ANNA if leaves == "gone" else BOTH) == (leaves != "late")
        assert (obeyed(teachers, 1), teachers.holder) == ("a", "a")
        teachers.hear(command("b", 2))
        teachers.hear(command("a", 2))
        assert obeyed(teachers, 2) == "a"


def test_a_holder_without_a_token_of_his_own_is_there_while_anybody_is() -> None:
    teachers = Teachers("first")
    teachers.hear(command("one", 0))
    assert teachers.settled(0, SCRIPT)
    teachers.word(0)
    assert not teachers.settled(1, SCRIPT)
    assert teachers.is_there("one", SCRIPT)
    assert teachers.settled(1, NOBODY)
    assert not teachers.is_there("one", NOBODY)


def test_all_are_heard_and_the_first_note_counts() -> None:
    teachers = Teachers("all")
    for iteration, order in enumerate(["ab", "ba", "ab"]):
        for name in order:
            teachers.hear(command(name, iteration))
        assert (obeyed(teachers, iteration), teachers.holder) == (order[0], None)


@pytest.mark.parametrize("word", ["first", "all"])
def test_a_note_beats_silence_and_silence_of_one_does_not_end_the_wait_for_another(word: str) -> None:
    teachers = Teachers(word)  # type: ignore[arg-type]
    teachers.hear(command("b", 0, None))
    assert not teachers.settled(0, BOTH)
    teachers.hear(command("a", 0, 2))
    assert teachers.settled(0, BOTH)
    assert obeyed(teachers, 0) == "a"
    quiet = Teachers(word)  # type: ignore[arg-type]
    quiet.hear(command("b", 0, None))
    quiet.hear(command("a", 0, None))
    assert quiet.settled(0, BOTH)
    assert obeyed(quiet, 0) is None


def test_only_he_who_commanded_judges_where_one_holds_the_word() -> None:
    teachers = Teachers("first")
    for name, value in (("a", -1.0), ("b", 0.5)):
        teachers.judge(Feedback(teacher=name, iteration=0, value=value))
    assert teachers.verdict(0, "b") == Verdict(0.5, ["b"])
    assert teachers.verdict(0, "c") == Verdict(None, [])
    assert teachers.verdict(0, None) == Verdict(-1.0, ["a"]), "what the robot did of itself"


def test_all_judge_where_all_are_heard() -> None:
    teachers = Teachers("all")
    for name, value in (("a", -1.0), ("b", 0.5), ("c", None)):
        teachers.judge(Feedback(teacher=name, iteration=0, value=value))
    assert teachers.verdict(0, "b") == Verdict(-0.25, ["a", "b"])


def test_not_now_answers_and_is_made_good_once() -> None:
    teachers = Teachers("first")
    assert not teachers.answered(0, "a")
    assert teachers.answered(0, None), "nobody is asked when nobody commanded"
    for value in (None, 0.5, -1.0):
        teachers.judge(Feedback(teacher="a", iteration=0, value=value))
        assert teachers.answered(0, "a")
    assert teachers.verdict(0, "a") == Verdict(0.5, ["a"])


def test_a_flood_of_iterations_and_names_needs_bounded_memory() -> None:
    teachers = Teachers("all")
    for i in range(3 * KEPT_AHEAD):
        teachers.hear(command("a", i))
        teachers.judge(Feedback(teacher="a", iteration=i, value=1.0))
    for i in range(3 * KEPT_TEACHERS):
        teachers.hear(command(f"t{i}", 0))
        teachers.judge(Feedback(teacher=f"t{i}", iteration=0, value=1.0))
    assert len(teachers._commands) <= KEPT_AHEAD
    assert len(teachers._feedback) <= KEPT_AHEAD
    assert len(teachers._commands[0]) == len(teachers._feedback[0]) == KEPT_TEACHERS
    teachers.forget(before=5, feedback_before=2)
    assert (min(teachers._commands), min(teachers._feedback)) == (5, 2)


def test_who_names_no_iteration_is_not_waited_for_until_he_names_one() -> None:
    teachers = Teachers("first")
    teachers.judge(Feedback(teacher="a", value=0.5))
    assert teachers.answered(0, "a")
    assert not teachers.answered(0, "b")
    assert teachers.verdict(0, "a") == Verdict(None, [])
    teachers.judge(Feedback(teacher="a", iteration=0, value=1.0))
    assert not teachers.answered(1, "a")
    for i in range(3 * KEPT_TEACHERS):
        teachers.judge(Feedback(teacher=f"t{i}", value=None))
    assert len(teachers._nameless) == KEPT_TEACHERS


def test_feedback_behind_does_not_push_out_what_is_said_now() -> None:
    teachers = Teachers("first", window=1000)
    for iteration in range(600):
        teachers.judge(Feedback(teacher="ann", iteration=iteration, value=1.0))
    assert teachers.verdict(599, "ann").value == 1.0


def later(teacher: str, iteration: int) -> Command:
    return Command(teacher=teacher, iteration=iteration, note=None, later=True)


def test_who_asks_to_be_waited_for_is_awaited_although_all_others_are_silent() -> None:
    teachers = Teachers("first")
    teachers.hear(command("b", 0, None))
    teachers.hear(command("c", 0, None))
    assert teachers.settled(0, BOTH)
    teachers.ask(later("a", 0), 5.0)
    assert not teachers.settled(0, BOTH)
    assert teachers.asked_s(0, BOTH) == 5.0
    assert teachers.settled(0, BEN), "he is gone"
    teachers.hear(command("a", 0, None))
    assert teachers.settled(0, BOTH)
    assert teachers.asked_s(0, BOTH) == -math.inf


def test_who_asks_in_vain_because_another_is_obeyed_or_he_is_gone_is_not_waited_for() -> None:
    teachers = Teachers("first")
    teachers.hear(command("b", 0))
    assert teachers.settled(0, BOTH)
    teachers.word(0)
    teachers.ask(later("a", 1), 5.0)
    assert teachers.asked_s(1, BOTH) == -math.inf, "it is b who is awaited"
    teachers.ask(later("b", 1), 6.0)
    assert teachers.asked_s(1, BOTH) == 6.0
    teachers.hear(command("b", 1))
    assert teachers.settled(1, BOTH), "never in place of a note that came"
    teachers.ask(later("a", 2), 7.0)
    teachers.hear(command("b", 2, None))
    assert not teachers.settled(2, BOTH), "b is silent, so that a may be obeyed"
    assert teachers.settled(2, BEN)
    assert teachers.asked_s(2, BEN) == -math.inf


def test_who_asks_and_was_never_there_is_not_waited_for() -> None:
    teachers = Teachers("first")
    teachers.hear(command("b", 0, None))
    teachers.ask(later("ghost", 0), 5.0)
    assert teachers.settled(0, BEN)
    assert teachers.asked_s(0, BEN) == -math.inf


def test_feedback_to_come_is_no_answer() -> None:
    teachers = Teachers("first")
    teachers.ask(Feedback(teacher="a", iteration=3, value=None, later=True), 5.0)
    teachers.ask(Feedback(teacher="a", value=None, later=True), 6.0)
    assert not teachers.answered(3, "a")
    assert teachers.asked_feedback_s(3, "a") == 5.0
    assert teachers.asked_feedback_s(3, "b") == teachers.asked_feedback_s(4, "a") == -math.inf
    assert teachers.asked_feedback_s(3, None) == -math.inf


def test_a_flood_of_those_who_ask_needs_bounded_memory() -> None:
    teachers = Teachers("first")
    for i in range(3 * KEPT_AHEAD):
        teachers.ask(later("a", i), 1.0)
        teachers.ask(Feedback(teacher="a", iteration=i, value=None, later=True), 1.0)
    for i in range(3 * KEPT_TEACHERS):
        teachers.ask(later(f"t{i}", 0), 1.0)
    assert max(len(teachers._asked), len(teachers._asked_feedback)) <= KEPT_AHEAD
    assert len(teachers._asked[0]) == KEPT_TEACHERS
    teachers.forget(before=5, feedback_before=2)
    assert (min(teachers._asked), min(teachers._asked_feedback)) == (5, 2)
