"""A follower gives each publisher's samples in order and once, asks for what is missing, keeps little of a flood."""

import pytest

from mdb_protocol import following
from mdb_protocol.following import Follower, Manner, Origin
from mdb_protocol.waiting import Raw

KEY = "mdb/b/teacher/anna/command"
ZID = "ab12"


class Rig:
    """A follower, what it has handed over, and its clock."""

    def __init__(self, history: int = 0, *, whole: bool = True) -> None:
        self.now = 0.0
        self.got: list[int] = []
        self.woken = 0
        self.follower = Follower(self._take, lambda _: Manner(history, whole), self._wake, lambda: self.now)

    def _take(self, raw: Raw) -> None:
        self.got.append(int(raw.payload))

    def _wake(self) -> None:
        self.woken += 1

    def hear(self, *numbers: int, past: bool = False, eid: int = 1, key: str = KEY) -> None:
        for number in numbers:
            self.follower.hear(Raw(key, b"%d" % number, ""), Origin(ZID, eid, number), past=past)

    def beat(self, number: int, key: str = KEY) -> None:
        self.follower.heartbeat(f"{key}/@adv/pub/{ZID}/1/_", number)

    def asked(self) -> list[str]:
        self.wanted = self.follower.wanted()
        return [wanted.selector.partition("?")[2] for wanted in self.wanted]

    def answered(self, *numbers: int) -> None:
        self.hear(*numbers, past=True)
        for wanted in self.wanted:
            wanted.done()


def test_what_comes_in_order_is_handed_over_at_once() -> None:
    rig = Rig()
    rig.hear(5, 6, 7)
    assert rig.got == [5, 6, 7]
    assert (rig.asked(), rig.woken) == ([], 0)


def test_what_was_missed_is_asked_for_and_comes_before_what_follows() -> None:
    rig = Rig()
    rig.hear(5, 8, 9)
    assert rig.got == [5]
    assert rig.woken
    assert rig.asked() == ["_sn=6..9"]
    assert rig.asked() == [], "once"
    rig.answered(6, 7, 8, 9)
    assert rig.got == [5, 6, 7, 8, 9]
    rig.hear(8, 10)
    assert rig.got == [5, 6, 7, 8, 9, 10], "none twice"
    assert not rig.asked()
    assert not rig.follower.missing()


def test_who_does_not_answer_is_not_waited_for() -> None:
    rig = Rig()
    rig.hear(5, 8)
    assert rig.asked() == ["_sn=6..8"]
    rig.hear(10)
    rig.answered()
    assert rig.got == [5, 8]
    assert rig.asked() == [], "not so soon again"
    rig.now += following.ASKED_EVERY_S
    assert rig.asked() == ["_sn=9..10"]
    rig.answered()
    assert rig.got == [5, 8, 10]


def test_a_heartbeat_says_that_the_last_is_missing() -> None:
    rig = Rig()
    rig.hear(5)
    rig.beat(5)
    assert rig.asked() == []
    rig.beat(7)
    assert rig.asked() == ["_sn=6..7"]
    rig.answered(6, 7)
    assert rig.got == [5, 6, 7]


@pytest.mark.parametrize(("history", "asked"), [(0, []), (1, ["_sn=40..40"]), (32, ["_sn=9..40"])])
def test_a_late_joiner_asks_for_so_much_of_the_past_as_is_wanted(history: int, asked: list[str]) -> None:
    rig = Rig(history)
    rig.beat(40)
    assert rig.asked() == asked
    rig.hear(41)
    if asked:
        rig.answered(40)
    assert rig.got == ([40, 41] if asked else [41])


def test_the_past_that_was_asked_for_at_the_beginning_comes_in_order() -> None:
    rig = Rig(32)
    rig.hear(3, 4, past=True)
    rig.hear(5)
    assert rig.got == [3, 4, 5]
    assert rig.asked() == []


def test_of_latest_values_nothing_is_waited_for_and_none_is_older_than_the_one_before() -> None:
    rig = Rig(256, whole=False)
    rig.hear(5, 9)
    rig.hear(7, past=True)
    rig.beat(20)
    assert rig.got == [5, 9]
    assert rig.asked() == []


def test_behind_gaps_little_is_kept_whatever_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(following, "HELD_BYTES", 10_000)
    rig = Rig()
    most = 0
    for number in range(0, 20_000, 2):
        rig.hear(number, eid=number % 7 + 1, key=KEY if number % 3 else f"{KEY}/{number}")
        rig.asked()  # and never answered
        rig.now += 0.01
        most = max(most, number // 2 + 1 - len(rig.got))
    assert most < 10_000 / len(KEY)
    assert len(rig.follower._keys) <= following.KEYS
    assert len(rig.follower._gaps) <= following.KEYS * following.SOURCES


def test_of_a_long_gap_the_newest_are_asked_for() -> None:
    rig = Rig()
    rig.hear(0)
    rig.beat(10**6)
    assert rig.asked() == [f"_sn={10**6 + 1 - following.ASKED_AT_ONCE}..{10**6}"]


def test_what_is_no_heartbeat_is_none() -> None:
    rig = Rig(32)
    for key in ("", "/@adv/pub", "/@adv/sub/ab/1/_", "/@adv/pub/no-zid/1/_", "/@adv/pub/ab/x/_"):
        rig.follower.heartbeat(f"{KEY}{key}", 5)
    assert rig.asked() == []
