"""Changes of context: when they are noticed, and on a recorded stream what that does to the memory.

`data/two_teachers.json` says how it was recorded.
"""

import json
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_services.mechanism.memories.context import ContextConfig, ContextDetector
from mdb_services.mechanism.memories.stm import MemoryConfig, ShortTermMemory
from mdb_services.mechanism.networks.encoding import Channel, Codebook

fixed = settings(derandomize=True, deadline=None, max_examples=100)

CONFIG = ContextConfig()
FIFO = MemoryConfig()
RELEVANCE = MemoryConfig(recency=0.1, distance=1.0)
CAPACITY = 80
"""Pairs in the communication model's memory, as in the paper's experiment."""


def fed(errors: list[float], config: ContextConfig = CONFIG) -> tuple[ContextDetector, list[int]]:
    """A detector that was given these errors from version 1 on, and the versions at which it saw a change."""
    detector = ContextDetector(config)
    changes = [version for version, error in enumerate(errors, start=1) if detector.step(error, version)]
    return detector, changes


def state(detector: ContextDetector) -> dict[str, object]:
    return {name: value for name, value in vars(detector).items() if name != "config"}


GOOD = [0.01] * 30
"""Errors after which a context is known."""


def test_a_context_is_known_after_enough_good_pairs() -> None:
    assert not fed([0.0] * 19)[0].known
    assert fed([0.0] * 20)[0].known
    assert not fed([0.06] * 100)[0].known
    assert fed([0.06] * 100 + [0.0] * 20)[0].known
    eager = ContextConfig(known_pairs=1, known_error=0.1)
    assert fed([0.09], eager)[0].known
    assert not fed([0.11], eager)[0].known


@fixed
@given(st.lists(st.floats(0, 0.09), max_size=300))
def test_a_quiet_noisy_stream_is_no_change(errors: list[float]) -> None:
    assert fed(GOOD + errors)[1] == []


@pytest.mark.parametrize("size", [0.5, 1.0, 4.0, 1e6])
@pytest.mark.parametrize("apart", [12, 50])
def test_a_single_outlier_is_no_change_however_large(size: float, apart: int) -> None:
    detector, changes = fed(GOOD + ([size] + [0.01] * apart) * 20)
    assert (changes, detector.known) == ([], True)


def test_outliers_that_come_often_are_a_change() -> None:
    assert fed([*GOOD, 1.0, 0.01, 1.0])[1] == [33]


def erring(count: int, share: float, seed: int = 0) -> list[float]:
    """Errors on what a teacher says who errs so often, by a model that has learnt what he means."""
    return np.where(np.random.default_rng(seed).random(count) < share, 1.0, 0.02).tolist()


@pytest.mark.parametrize("share", [0.1, 0.15])
def test_who_always_errs_now_and_then_is_known_after_a_while_and_does_not_change(share: float) -> None:
    seen = [fed([1.0] * 20 + erring(500, share, seed)) for seed in range(20)]
    assert sum(bool(changes) for _, changes in seen) <= 1
    assert all(detector.known for detector, changes in seen if not changes)
    assert not fed([1.0] * 20 + erring(129, share))[0].known
    assert fed([1.0] * 20 + erring(130, share))[0].known


def test_the_change_to_another_teacher_is_seen_even_if_the_first_one_erred() -> None:
    for seed in range(20):
        detector, changes = fed([1.0] * 20 + erring(200, 0.1, seed) + [0.9] * 12)
        assert 220 < changes[-1] <= 232, "within a dozen pairs"
        assert detector.first > 200


@pytest.mark.parametrize(("error", "pairs"), [(4.0, 2), (1.0, 2), (0.7, 3), (0.5, 5)])
def test_a_few_bad_pairs_are_a_change_and_the_first_of_them_is_known(error: float, pairs: int) -> None:
    detector, changes = fed(GOOD + [error] * pairs)
    assert changes == [30 + pairs]
    assert detector.first == 31
    assert (detector.known, detector.changing) == (False, True)


def test_what_was_odd_before_the_change_does_not_move_its_beginning() -> None:
    assert fed(GOOD + [1.0] + [0.01] * 15 + [1.0] * 3)[0].first == 47


def test_a_change_is_suspected_from_the_first_bad_pair_until_it_is_told_or_past() -> None:
    detector = ContextDetector(CONFIG)
    suspected = []
    for version, error in enumerate([*GOOD, 0.5, *[0.01] * 5, 1.0, 0.8, 0.8], start=1):
        detector.step(error, version)
        suspected.append(detector.suspected)
    assert suspected == [None] * 30 + [31] * 4 + [None] * 2 + [37] * 2 + [None]
    assert (detector.first, detector.known) == (37, False)


def test_a_context_is_settled_once_it_has_lasted_also_one_that_came_back() -> None:
    detector, _ = fed([1.0] * 19)
    assert not detector.settled
    detector.step(1.0, 20)
    assert detector.settled
    for known in (False, True):
        detector.begin(21, known=known)
        settled = []
        for version in range(21, 42):
            settled.append(detector.settled)
            detector.step(0.0, version)
        assert settled == [False] * 20 + [True]


@fixed
@given(st.lists(st.floats(0, 4), max_size=60))
def test_nothing_is_suspected_before_the_context_is_known(errors: list[float]) -> None:
    detector = ContextDetector(CONFIG)
    for version, error in enumerate(errors, start=1):
        known = detector.known
        detector.step(error, version)
        assert known or detector.suspected is None
        assert detector.suspected is None or detector.first <= detector.suspected <= version


@fixed
@given(st.lists(st.floats(0.051, 4.0), max_size=CONFIG.known_after - 1))
def test_a_context_that_was_never_known_cannot_be_left(errors: list[float]) -> None:
    detector, changes = fed(errors)
    assert (changes, detector.known, detector.changing, detector.first) == ([], False, False, 0)


def test_a_change_lasts_until_the_new_context_is_known() -> None:
    detector, changes = fed(GOOD + [1.0] * 30)
    assert (changes, detector.changing) == ([32], True)
    for version in range(61, 200):
        detector.step(0.0, version)
        assert detector.changing == (not detector.known)
    assert (detector.known, detector.first) == (True, 31)
    assert detector.step(1.0, 200) is False
    assert detector.step(1.0, 201) is True, "and the new one can be left as well"
    assert detector.first == 200


def test_a_context_that_came_back_is_known_at_once() -> None:
    detector, _ = fed([*GOOD, 1.0, 1.0])
    detector.begin(detector.first, known=True)
    assert (detector.known, detector.changing, detector.first) == (True, False, 31)
    assert [detector.step(1.0, version) for version in (33, 34)] == [False, True]
    assert detector.first == 31, "it did not come back after all: the new context began where that one did"


def test_a_detector_that_is_not_enabled_does_nothing() -> None:
    detector, changes = fed(GOOD * 3 + [4.0] * 50, ContextConfig(enabled=False))
    assert changes == []
    assert state(detector) == state(ContextDetector(CONFIG))


@fixed
@given(st.lists(st.one_of(st.floats(0, 0.04), st.floats(0, 4)), max_size=120), st.integers(0, 119))
def test_the_same_errors_give_the_same_state_also_from_the_last_change_on(errors: list[float], known: int) -> None:
    """What a memory store does that was restarted: it has the errors, and where each context began."""
    detector, replayed = ContextDetector(CONFIG), ContextDetector(CONFIG)
    since: list[tuple[float, int]] = []
    began = None
    for version, error in enumerate(errors, start=1):
        since.append((error, version))
        changed = detector.step(error, version)
        if changed or (version == known and detector.changing):  # or a stored model fits by now
            began = (detector.first, not changed)
            detector.begin(began[0], known=began[1])
            since = []
    if began is not None:
        replayed.begin(began[0], known=began[1])
    assert [replayed.step(error, version) for error, version in since] == [False] * len(since)
    assert state(replayed) == state(detector)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"known_error": 0.0}, "known_error is 0.0; expected a positive number"),
        ({"cut_off": -1.0}, "cut_off is -1.0"),
        ({"margin": float("inf")}, "margin is inf"),
        ({"margin": float("nan")}, "margin is nan"),
        ({"threshold": 0.0}, "threshold is 0.0"),
        ({"threshold": 1.0}, "threshold is 1.0; expected more than cut_off"),
        ({"known_pairs": 0}, "known_pairs is 0; expected 1 or more"),
        ({"known_after": 0}, "known_after is 0; expected 1 or more"),
        ({"recency": 0.0}, "label weights"),
        ({"distance": -1.0}, "label weights"),
    ],
)
def test_settings_that_make_no_sense_are_refused(fields: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        ContextConfig(**fields)


def test_the_temporal_setting_has_its_weights() -> None:
    assert CONFIG.temporal == FIFO
    assert ContextConfig(recency=0.5, distance=0.25).temporal == MemoryConfig(recency=0.5, distance=0.25)


# ---- the recorded stream ----


@dataclass(frozen=True)
class Stream:
    """Rows of the communication model (n, 8), (n, 1), its errors (nan: no model yet), each pair's combination."""

    inputs: np.ndarray
    targets: np.ndarray
    errors: np.ndarray
    combinations: list[tuple[int, int]]
    change: int


@cache
def recorded() -> Stream:
    data = json.loads((Path(__file__).parent / "data" / "two_teachers.json").read_text(encoding="utf-8"))
    turns = (0.0, -20.0, -45.0, -90.0, 20.0, 45.0, 90.0)
    channels = {
        "note": Channel(encoding="one_hot", size=7),
        "action": Channel(encoding="rank", values=turns),
        "feedback": Channel(),
    }
    book = Codebook(channels, ["note", "action"], ["feedback"])
    facts = {name: np.array(data[name], np.float64) for name in channels}
    inputs, targets = book.input_rows(facts), book.target_rows(facts)
    assert inputs is not None
    assert targets is not None
    combinations = list(zip(data["note"], data["action"], strict=True))
    return Stream(inputs, targets, np.array(data["error"], np.float64), combinations, data["change"])


def stays(config: MemoryConfig) -> np.ndarray:
    """For how many pairs each pair (n,) of the first teacher stayed in the memory before that teacher left."""
    stream = recorded()
    memory = ShortTermMemory(CAPACITY, 8, 1, config)
    left = np.full(stream.change, stream.change)
    for pair in range(stream.change):
        change = memory.insert(pair, stream.inputs[pair], stream.targets[pair], 0.0)
        assert change is not None
        left[list(change.evicted)] = pair
    return left - np.arange(stream.change)


def rare() -> np.ndarray:
    """Which pairs of the first teacher's are of a command and an action that came together twice at most."""
    stream = recorded()
    first = stream.combinations[: stream.change]
    often = Counter(first)
    return np.flatnonzero([often[combination] <= 2 for combination in first])


def test_relevance_keeps_rare_pairs_longer_than_first_in_first_out() -> None:
    pairs = rare()
    assert len(pairs) >= 20
    first_in, relevant = stays(FIFO)[pairs], stays(RELEVANCE)[pairs]
    assert relevant.mean() > 2 * first_in.mean()
    for later in range(CAPACITY + 1, 2 * CAPACITY):
        could = pairs + later <= recorded().change
        assert (first_in[could] >= later).sum() == 0
        assert (relevant[could] >= later).mean() > 0.6
    assert (relevant > first_in).mean() > 0.8


def test_what_relevance_keeps_longer_is_what_is_rare() -> None:
    pairs, relevant = rare(), stays(RELEVANCE)
    others = np.setdiff1d(np.arange(len(relevant)), pairs)
    assert relevant[pairs].mean() > 2 * relevant[others].mean()
    assert relevant[others].mean() < stays(FIFO)[others].mean()


@dataclass(frozen=True)
class Told:
    """How many pairs of the first teacher are left after each of the second's; when which change was noticed."""

    left: list[int]
    changes: list[tuple[int, int]]
    """The pair at which, and the pair since which."""


def told(relevance: MemoryConfig, config: ContextConfig) -> Told:
    """Let a memory and a detector live through the stream, as a memory store without long-term memory does."""
    stream, detector = recorded(), ContextDetector(config)
    memory = ShortTermMemory(CAPACITY, 8, 1, relevance)
    entered = {}
    left, changes = [], []
    for pair, error in enumerate(stream.errors):
        memory.insert(pair, stream.inputs[pair], stream.targets[pair], 0.0)
        entered[memory.version] = pair
        if not np.isnan(error) and detector.step(error, memory.version):
            changes.append((pair, entered[detector.first]))
            memory.begin_context(detector.first if config.forget else 0)
        memory.configure(config.temporal if detector.changing else relevance)
        if pair >= stream.change:
            left.append(int((memory.arrays()[2] < stream.change).sum()))
    return Told(left, changes)


@pytest.mark.parametrize("forget", [True, False])
def test_the_teachers_change_is_noticed_within_a_few_pairs_and_nothing_else_is(forget: bool) -> None:
    ((at, since),) = told(RELEVANCE, ContextConfig(forget=forget)).changes
    bad = recorded().change + 1  # the first pair of the second teacher means the same in both languages
    errors = recorded().errors
    assert errors[bad - 1] < 0.01
    assert errors[bad] > 1
    assert since == bad
    assert at - recorded().change <= 3


@pytest.mark.parametrize("forget", [True, False])
def test_a_change_empties_the_old_context_no_slower_than_first_in_first_out(forget: bool) -> None:
    first_in = told(FIFO, ContextConfig(enabled=False)).left
    relevant = told(RELEVANCE, ContextConfig(forget=forget)).left
    assert all(mine <= yours for mine, yours in zip(relevant, first_in, strict=True))
    assert relevant[CAPACITY - 1] == 0
    if forget:
        assert relevant[3] == 0
    blind = told(RELEVANCE, ContextConfig(enabled=False)).left
    assert blind[CAPACITY - 1] > 0, "without noticing the change, relevance would keep the old context longer"


SETTLED = [0.001] * 200
"""Small errors, long enough that it is known what is usual."""


def test_small_errors_that_have_risen_and_stay_so_are_a_change_where_that_is_looked_for() -> None:
    risen = [*SETTLED, *([0.03] * 30)]
    assert fed(risen)[1] == [], "they are far below what is odd"
    detector, changes = fed(risen, ContextConfig(rise=10.0))
    assert len(changes) == 1
    assert 205 <= changes[0] <= 215
    assert detector.first == 201, "the context began with the first of them"


def test_a_few_large_errors_or_a_small_rise_are_no_lasting_rise() -> None:
    config = ContextConfig(rise=10.0, margin=0.9)
    assert fed([*SETTLED, *([0.9, 0.001, 0.001, 0.001] * 50)], config)[1] == []
    assert fed([*SETTLED, *([0.003] * 300)], config)[1] == []


def test_a_rise_that_one_pair_could_be_is_refused() -> None:
    with pytest.raises(ValueError, match=r"rise is 2\.0"):
        ContextConfig(rise=2.0)
