"""Whether a body can carry out an action is said before it is asked to."""

import math

import pytest

from mdb_sim.body import Actuator, BodyError, Numbers, Spec, check

TWO = Spec(
    sensors=(),
    actuators=(Actuator(name="turn", low=-90.0, high=90.0, unit="deg"), Actuator(name="push", low=0.0, high=1.0)),
)
SOME = Spec(sensors=(), actuators=(TWO.actuators[1],), choices=({"push": 0.0}, {"push": 1.0}))


@pytest.mark.parametrize("values", [{"turn": -90.0, "push": 1.0}, {"push": 0, "turn": 90}])
def test_values_within_their_ranges_can_be_carried_out(values: Numbers) -> None:
    check(TWO, values)
    check(SOME, {"push": 1.0})


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({}, "expected a value for each of turn, push, and for nothing else"),
        ({"turn": 0.0}, "expected a value for each of turn, push"),
        ({"turn": 0.0, "push": 0.0, "lift": 0.0}, "expected a value for each of turn, push"),
        ({"turn": 90.5, "push": 0.0}, r"turn = 90\.5; expected -90 to 90 deg"),
        ({"turn": 0.0, "push": -0.1}, r"push = -0\.1; expected 0 to 1$"),
        ({"turn": math.nan, "push": 0.0}, "turn = nan; expected -90 to 90 deg"),
        ({"turn": 0.0, "push": math.inf}, "push = inf; expected 0 to 1"),
    ],
)
def test_any_others_are_refused_with_what_was_expected(values: Numbers, says: str) -> None:
    with pytest.raises(BodyError, match=says):
        check(TWO, values)


def test_where_there_are_choices_no_other_values_can_be_carried_out() -> None:
    with pytest.raises(BodyError, match=r"action \{'push': 0\.5\} is none of the 2 that this body can carry out"):
        check(SOME, {"push": 0.5})
