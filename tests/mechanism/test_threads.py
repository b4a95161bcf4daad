from threading import Barrier, get_ident

import numpy as np
import pytest

from mdb_services.mechanism.evolution import threads
from mdb_services.mechanism.evolution.threads import THREADS, together
from mdb_services.mechanism.learners import committee, make_learner
from mdb_services.mechanism.networks.network import Shape
from mdb_services.mechanism.settings import EvolutionConfig


@pytest.fixture
def lent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "_cores", lambda: 9)
    monkeypatch.setattr(threads, "_lent", 0)
    threads.lend()
    assert threads._lent == THREADS - 1


@pytest.mark.usefixtures("lent")
def test_tasks_are_done_at_the_same_time_each_once() -> None:
    met, done = Barrier(THREADS), []

    def task(number: int) -> None:
        if number < THREADS:
            met.wait(30)  # none of these ends before all of them have begun
        done.append(number)

    together([lambda number=number: task(number) for number in range(40)])  # type: ignore[misc]
    assert sorted(done) == list(range(40))


@pytest.mark.usefixtures("lent")
@pytest.mark.parametrize("bad", [0, 1, 5])
def test_what_a_task_raises_is_raised_and_nobody_works_on(bad: int) -> None:
    def task(number: int) -> None:
        if number == bad:
            raise ValueError(number)

    with pytest.raises(ValueError, match=str(bad)):
        together([lambda number=number: task(number) for number in range(6)])  # type: ignore[misc]
    together([lambda: None] * 9)  # the threads are there as before


def test_nobody_helps_where_no_threads_were_lent() -> None:
    by: list[int] = []
    together([lambda: by.append(get_ident())] * 9)
    assert by == [get_ident()] * 9


@pytest.mark.usefixtures("lent")
def test_a_committee_learns_the_same_with_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(0)
    rows = random.uniform(-1, 1, (60, 3)).astype(np.float32), random.uniform(-1, 1, (60, 2)).astype(np.float32)
    states = []
    for worth_s in (0.0, 99.0):
        monkeypatch.setattr(committee, "WORTH_S", worth_s)
        learner = make_learner("pbga", Shape(3, (9,), 2), EvolutionConfig(population=40), 0, "test", members=6)
        for version in range(1, 8):
            learner.learn(*rows, version=version)
        states.append(learner.state())
    for name, array in states[0].items():
        assert np.array_equal(array, states[1][name]), name
