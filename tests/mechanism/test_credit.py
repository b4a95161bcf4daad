"""Feedback that does not say what it is for finds its action by what it is like."""

from itertools import count

import numpy as np
import pytest

from mdb_services.mechanism.feedback.credit import KEPT, Credit
from mdb_services.mechanism.networks.network import Floats

LAGS, NOTES, ACTIONS = 7, 5, 5
PATIENCE = 40


class Lesson:
    """Random notes and actions, and a teacher who is late: what he says is credited to some action."""

    def __init__(self, seed: int, before: Credit | None = None) -> None:
        self.rng = np.random.default_rng(seed)
        self.means = self.rng.permutation(NOTES)
        self.credit = Credit(LAGS, [NOTES + 1, 1], before)
        self.rows: list[tuple[Floats, Floats]] = []
        self.deserved: list[float] = []
        self.owed: list[tuple[int, int]] = []
        self.given: dict[int, float] = {}
        self.known_at: int | None = None

    def act(self, *, obedient: bool = False) -> None:
        note = int(self.rng.integers(NOTES))
        action = int(self.means[note]) if obedient else int(self.rng.integers(ACTIONS))
        missed = abs(action - int(self.means[note]))
        row = np.append(np.eye(NOTES)[note], action / 2 - 1).astype(np.float32)
        self.rows.append((row, np.array([missed / 2 - 1 + 0.1 * self.rng.normal()], np.float32)))
        self.deserved.append(1.0 - missed / 2)

    def at(self, iteration: int) -> tuple[Floats, Floats]:
        if 0 <= iteration < len(self.rows):
            return self.rows[iteration]
        return np.full(NOTES + 1, np.nan, np.float32), np.full(1, np.nan, np.float32)

    def go_on(
        self, iterations: int, lag: int, *, spread: int = 0, judged: float = 1.0, obedient: bool = False
    ) -> None:
        for _ in range(iterations):
            self.act(obedient=obedient)
            now = len(self.rows)
            if self.rng.random() < judged:
                self.owed.append((now + lag + int(self.rng.integers(-spread, spread + 1)), now - 1))
            rows = [np.stack(rows) for rows in zip(*(self.at(now - 1 - i) for i in range(LAGS)), strict=True)]
            for due, iteration in [owed for owed in self.owed if owed[0] == now]:
                self.owed.remove((due, iteration))
                self.credit.hear(now, rows, self.deserved[iteration])
            for iteration, value in self.credit.due(now, PATIENCE):
                self.given.setdefault(iteration, value)
            if self.credit.window is not None and self.known_at is None:
                self.known_at = now

    def wrong(self, since: int = 0) -> float:
        """The share of the credited actions whose feedback is not what they deserve."""
        return float(np.mean([abs(self.deserved[i] - value) > 0.3 for i, value in self.given.items() if i >= since]))


@pytest.mark.parametrize("lag", range(LAGS))
@pytest.mark.parametrize("seed", [1, 2])
def test_however_late_a_teacher_is_his_feedback_finds_its_actions(lag: int, seed: int) -> None:
    lesson = Lesson(seed)
    lesson.go_on(120, lag)
    assert lesson.credit.window == (lag, lag)
    assert lesson.wrong() == 0.0
    assert len(lesson.given) == 120 - lag, "that which waited, too"
    assert lesson.known_at is not None
    assert lesson.known_at < PATIENCE


def test_feedback_that_is_always_the_same_is_credited_when_the_patience_is_over_and_proves_nothing() -> None:
    lesson = Lesson(1)
    lesson.go_on(PATIENCE, 0, obedient=True)
    assert lesson.given == {}
    lesson.go_on(2, 0, obedient=True)
    assert list(lesson.given) == [0, 1]
    assert lesson.credit.window is None


def test_a_lag_that_is_known_stays_known_while_nothing_tells_it_from_others() -> None:
    lesson = Lesson(1)
    lesson.go_on(100, 3)
    lesson.go_on(3 * KEPT, 3, obedient=True)
    lesson.go_on(50, 3)
    assert lesson.credit.window == (3, 3)
    assert lesson.wrong() == 0.0


def test_a_teacher_who_becomes_slower_is_found_out() -> None:
    lesson = Lesson(1)
    lesson.go_on(100, 1)
    lesson.go_on(160, 4)
    assert lesson.credit.window == (4, 4)
    assert lesson.wrong(since=220) == 0.0


def test_another_teacher_is_taken_for_as_late_as_the_one_before_until_he_shows_otherwise() -> None:
    one = Lesson(1)
    one.go_on(100, 2)
    same = Lesson(2, one.credit)
    same.go_on(60, 2)
    assert (same.known_at, same.wrong(), len(same.given)) == (1, 0.0, 58)
    other = Lesson(2, one.credit)
    other.go_on(120, 5)
    assert other.credit.window == (5, 5)
    assert other.wrong(since=60) == 0.0
    assert one.credit.window == (2, 2)


def test_a_teacher_who_judges_seldom_is_understood_too() -> None:
    lesson = Lesson(1)
    lesson.go_on(300, 3, judged=0.3)
    assert lesson.credit.window == (3, 3)
    assert lesson.wrong(since=150) == 0.0


def test_feedback_whose_delay_varies_is_credited_where_it_is_clear_what_it_is_for() -> None:
    lesson = Lesson(1)
    lesson.go_on(300, 3, spread=1)
    assert lesson.credit.window is not None
    assert lesson.credit.window[0] <= 2
    assert lesson.credit.window[1] >= 4
    assert lesson.wrong() < 0.15, "two of three lags differ from the middle one, and most other actions deserve else"
    assert len(lesson.given) > 200
    last = max(lesson.given)
    lesson.go_on(100, 3, spread=1, obedient=True)
    assert len([i for i in lesson.given if i > last]) > 90, "what is the same for all candidates is for any of them"


def test_without_rows_nothing_is_told_apart_and_nothing_breaks() -> None:
    for widths in ([], [2]):
        credit, iterations = Credit(3, widths), count(1)
        rows = [np.full((3, width), np.nan, np.float32) for width in widths]
        for now in range(1, 60):
            credit.hear(now, rows, 1.0 if now % 2 else -1.0)
            for iteration, _ in credit.due(now, 10):
                assert iteration == next(iterations) - 1
        assert credit.window is None


def test_the_same_feedback_gives_the_same_credit() -> None:
    def given() -> dict[int, float]:
        lesson = Lesson(5)
        lesson.go_on(150, 2, spread=1)
        return lesson.given

    assert given() == given()
