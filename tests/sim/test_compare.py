"""Two sequences of values are the same, or the first difference is named with both values."""

from typing import Any

import msgspec
import numpy as np
import pytest

from mdb_protocol import keys, messages
from mdb_protocol.messages import Message
from mdb_sim.runs.compare import Comparison, difference, timeless, within
from tests.services.small import BRAIN, model, pair, perception

PAIR = keys.PAIR.at(BRAIN)
PERCEPTION = keys.PERCEPTION.at(BRAIN)
OBJECT = keys.CURRENT_MODEL.at(BRAIN, model="object")


def compared(
    recorded: list[tuple[str, Message]], replayed: list[tuple[str, Message]], *, gaps: bool = False
) -> Comparison:
    comparison = Comparison(within(0.0), gaps=gaps)
    for key, message in replayed:
        comparison.say(key, message)
    for key, message in recorded:
        comparison.record(key, message)
    comparison.end()
    return comparison


def pairs(*iterations: int, **fields: Any) -> list[tuple[str, Message]]:
    return [(PAIR, pair(i, **fields)) for i in iterations]


def test_the_same_values_in_the_same_order_are_equal_whatever_lies_between() -> None:
    shown = [(PERCEPTION, perception(i)) for i in range(3)]
    mixed = [one for both in zip(pairs(0, 1, 2), shown, strict=True) for one in both]
    found = compared([*pairs(0, 1, 2), *shown], mixed)
    assert (found.difference, found.compared) == (None, 6)


def test_the_first_difference_is_named_with_both_values() -> None:
    found = compared(pairs(0, 1, 2, note=1), [*pairs(0, note=1), *pairs(1, 2, note=2)])
    assert found.difference == "pair, value 2 (iteration 1): note is 1 in the log, 2 in the replay"


def test_a_difference_within_an_action_names_the_actuator() -> None:
    found = compared(pairs(0, 1, choice=1), [*pairs(0, choice=1), *pairs(1, choice=2)])
    assert found.difference == "pair, value 2 (iteration 1): action.turn is -20.0 in the log, 20.0 in the replay"
    found = compared(pairs(0, choice=1), pairs(0, choice=1, action={"steer": -20.0}))
    assert found.difference == "pair, value 1 (iteration 0): action.turn is -20.0 in the log, absent in the replay"


def test_a_difference_within_an_array_says_where() -> None:
    found = compared([(OBJECT, model("object", 7))], [(OBJECT, model("object", 7, last=0.25))])
    assert found.difference == "model/object, value 1 (version 7): weights[0] is 0.5 in the log, 0.25 in the replay"


@pytest.mark.parametrize(
    ("recorded", "replayed", "words"),
    [
        ([0, 1, 3], [0, 1, 2, 3], "pair, value 3 (iteration 3): iteration is 3 in the log, 2 in the replay"),
        ([0, 1, 2], [0, 2], "pair, value 2 (iteration 1): iteration is 1 in the log, 2 in the replay"),
        ([0, 1, 2], [0, 1], "pair, value 3 (iteration 2): in the log, not in the replay"),
        ([0, 1], [0, 1, 2], None),
    ],
)
def test_too_much_or_too_little_is_a_difference_but_not_after_the_end_of_the_log(
    recorded: list[int], replayed: list[int], words: str | None
) -> None:
    assert compared(pairs(*recorded), pairs(*replayed)).difference == words


def test_a_value_on_a_key_that_the_log_does_not_have_is_a_difference() -> None:
    found = compared(pairs(0, 1), [*pairs(0), (PERCEPTION, perception(1)), *pairs(1)])
    assert found.difference == "perception, value 1 (iteration 1): in the replay, not in the log"


def test_what_was_sent_again_or_shown_at_another_time_counts_once() -> None:
    later = [(PERCEPTION, perception(0, stamp=2.5)), (PERCEPTION, perception(1, stamp=3.0))]
    found = compared([*pairs(0, 1, 0), (PERCEPTION, perception(0)), *later], [*pairs(0, 0, 1, 1), *later])
    assert (found.difference, found.compared) == (None, 4)


def test_the_time_of_the_action_that_was_done_does_not_count() -> None:
    action = messages.Action(iteration=0, action={"turn": 1.0}, choice=1, valid_for_s=1.0, stamp=4.0)
    seen = perception(1, done=action, stamp=5.0)
    assert timeless(seen) == perception(1, done=msgspec.structs.replace(action, stamp=0.0))
    assert timeless(action).stamp == 0.0  # type: ignore[attr-defined]


def test_with_gaps_values_are_matched_by_iteration_and_the_rest_is_counted() -> None:
    found = compared(pairs(0, 2, 3), pairs(0, 1, 3), gaps=True)
    assert (found.difference, found.compared, found.unmatched) == (None, 2, 2)
    found = compared(pairs(0, 2), pairs(0, 1, 2, note=1), gaps=True)
    assert found.difference is not None


@pytest.mark.parametrize(
    ("one", "other", "equal"),
    [
        (1.0, 1.0 + 1e-7, True),
        (1e6, 1e6 + 0.5, True),
        (1.0, 1.0 + 1e-5, False),
        (1, 2, False),
        (True, False, False),
        ([1.0], [1.0, 2.0], False),
        ({"a": 1.0}, {"b": 1.0}, False),
        ({"a": None}, {"a": 0.0}, False),
    ],
)
def test_a_tolerance_is_for_floats_alone(one: Any, other: Any, equal: bool) -> None:
    assert (difference(one, other, 1e-6) is None) == equal


def test_arrays_of_other_lengths_differ() -> None:
    change = messages.MemoryChange(
        model="object",
        version=1,
        slots=np.array([0]),
        pairs=np.array([4]),
        inputs=np.zeros((1, 2)),
        targets=np.zeros((1, 1)),
        freed=np.zeros(0, np.int64),
        evicted=np.zeros(0, np.int64),
    )
    more = msgspec.structs.replace(change, evicted=np.array([3]))
    key = keys.MEMORY_CHANGE.at(BRAIN, model="object")
    found = compared([(key, change)], [(key, more)]).difference
    assert found == "memory/object/change, value 1 (version 1): evicted[0] is absent in the log, 3 in the replay"
