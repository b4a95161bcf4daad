"""The clock of a robot that acts every period."""

import pytest

from mdb_sim.robot.clock import KEPT, Clock


def ticks(clock: Clock, *times_s: float) -> list[bool]:
    return [clock.tick(time_s) for time_s in times_s]


def test_a_period_begins_at_once_and_then_each_time_it_is_over() -> None:
    clock = Clock(0.1, 5.0)
    assert ticks(clock, 5.0, 5.05, 5.1, 5.19, 5.2) == [True, False, True, False, True]
    assert clock.due_s == pytest.approx(5.3)
    assert clock.values()["periods"] == 3.0
    assert clock.values()["missed_share"] == 0.0


def test_beginning_late_makes_no_later_period_late() -> None:
    clock = Clock(1.0, 0.0)
    assert ticks(clock, 0.25, 1.0, 2.75, 3.0) == [True] * 4
    values = clock.values()
    assert (values["jitter_p50_s"], values["periods"]) == (0.125, 4.0)
    assert values["jitter_p99_s"] == pytest.approx(0.75, abs=0.02)


def test_periods_that_went_by_are_left_out_and_counted() -> None:
    clock = Clock(1.0, 0.0)
    assert ticks(clock, 0.0, 3.5, 3.9, 4.0) == [True, True, False, True]
    assert clock.missed == 2
    assert clock.values()["periods"] == 5.0
    assert clock.values()["missed_share"] == 0.4
    clock.miss()
    assert clock.values()["missed_share"] == 0.6


def test_jitter_is_that_of_late() -> None:
    clock = Clock(1.0, 0.0)
    for number in range(2 * KEPT):
        clock.tick(number + (0.5 if number < KEPT else 0.0))
    assert clock.values()["jitter_p99_s"] == 0.0


def test_before_the_first_period_there_is_nothing_to_tell() -> None:
    assert set(Clock(1.0, 9.0).values().values()) == {0.0}
