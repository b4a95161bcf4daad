"""A router that is there and gives us nothing is noticed; one that is gone or slow is not taken for it."""

import pytest

from mdb_protocol.probing import EVERY_S, MISSED, Probe


class Asked:
    """A probe and its time."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.probe = Probe(lambda: self.now_s)

    def ask(self, *, answered: bool) -> None:
        self.now_s += EVERY_S
        assert self.probe.is_due()
        self.probe.ask()
        if not answered:
            self.probe.fail()
        self.probe.end()


@pytest.fixture
def asked() -> Asked:
    return Asked()


def test_who_gets_no_answer_again_and_again_is_unheard(asked: Asked) -> None:
    for missed in range(1, MISSED + 1):
        asked.ask(answered=False)
        assert asked.probe.unheard is (missed == MISSED)


def test_one_answer_between_is_enough(asked: Asked) -> None:
    for answered in (False, False, True, False, False):
        asked.ask(answered=answered)
    assert not asked.probe.unheard


def test_a_question_whose_end_is_never_told_has_no_answer(asked: Asked) -> None:
    for _ in range(MISSED):
        asked.now_s += 2 * EVERY_S
        assert asked.probe.is_due()
        asked.probe.ask()
    asked.now_s += 2 * EVERY_S
    assert asked.probe.is_due()
    assert asked.probe.unheard


def test_who_is_gone_is_not_silent(asked: Asked) -> None:
    for _ in range(2 * MISSED):
        asked.ask(answered=False)
        asked.probe.rest()
    assert not asked.probe.unheard


def test_nobody_is_asked_too_often(asked: Asked) -> None:
    asked.ask(answered=True)
    asked.now_s += EVERY_S / 2
    assert not asked.probe.is_due()
