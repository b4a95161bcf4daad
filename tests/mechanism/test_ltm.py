"""The long-term memory: what is stored once, what is forgotten, what fits, and which pairs tell of a context."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mdb_services.mechanism.memories.ltm import LongTermConfig, LongTermMemory, Stability, Stored, sample_of
from mdb_services.mechanism.networks.network import Network

fixed = settings(derandomize=True, deadline=None, max_examples=100)

INPUTS = np.array([[0], [1], [2], [3]], np.float32)


def says(value: float) -> Network:
    """A network without hidden units that always says `value`."""
    return Network([np.zeros((0, 2)), np.array([[value]])])


def rows(value: float, count: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Pairs that a network saying `value` explains."""
    return INPUTS[:count], np.full((count, 1), value, np.float32)


def holding(*values: float, config: LongTermConfig | None = None) -> LongTermMemory:
    """A memory of networks that always say something else, ids 1 and on, each stored when its id was the time."""
    memory = LongTermMemory(config or LongTermConfig())
    for now, value in enumerate(values, start=1):
        assert memory.store(says(value), *rows(value), now)[0].id == now
    return memory


def ids(memory: LongTermMemory) -> list[int]:
    return [stored.id for stored in memory]


def test_what_explains_the_same_is_stored_once_and_keeps_its_id_and_uses() -> None:
    memory = holding(0.5, -0.5)
    memory.use(1, now=7)
    better, inputs = says(0.52), INPUTS[1:]
    stored, forgotten = memory.store(better, inputs, np.full((3, 1), 0.52, np.float32), now=9)
    assert (stored.id, stored.uses, stored.touched, forgotten) == (1, 1, 9, [])
    assert ids(memory) == [1, 2]
    assert stored in list(memory)
    assert stored.network is better, "the newer network and its sample take the place of the older"
    assert stored.inputs is inputs


def test_what_explains_something_else_is_stored_under_an_id_of_its_own() -> None:
    memory = holding(0.5, -0.5)
    stored, forgotten = memory.store(says(0.0), *rows(0.0), now=9)
    assert (stored.id, stored.uses, stored.touched, forgotten) == (3, 0, 9, [])
    assert ids(memory) == [1, 2, 3]


STEP = Network([np.array([[8.0, -20.0]]), np.array([[0.5, 0.5]])])
"""0 up to 2, 1 from 3 on."""
NARROW = INPUTS[:1], np.zeros((1, 1), np.float32)
WIDE = INPUTS, np.array([[0], [0], [0], [1]], np.float32)


def test_a_model_that_knows_more_takes_the_place_of_all_that_knew_less() -> None:
    memory = holding(0.5)
    memory.store(says(0.0), *NARROW, 2)
    memory.restore(Stored(7, says(0.01), *NARROW, uses=2, touched=3))
    memory.use(2, now=4)
    stored, forgotten = memory.store(STEP, *WIDE, 5)
    assert (stored.id, stored.uses, stored.touched, forgotten) == (2, 3, 5, [7])
    assert ids(memory) == [1, 2]
    assert stored.network is STEP


def test_a_model_that_knows_less_leaves_the_one_that_knows_more_as_it_is() -> None:
    memory = holding(0.5)
    memory.store(STEP, *WIDE, 2)
    stored, forgotten = memory.store(says(0.0), *NARROW, 3)
    assert (stored.id, stored.touched, forgotten) == (2, 3, [])
    assert stored.network is STEP
    assert len(stored.inputs) == 4
    assert ids(memory) == [1, 2]


def test_models_of_which_neither_knows_what_the_other_knows_are_both_kept() -> None:
    memory = LongTermMemory(LongTermConfig())
    memory.store(STEP, *WIDE, 1)
    assert memory.store(says(0.0), INPUTS, np.zeros((4, 1), np.float32), 2)[0].id == 2
    assert ids(memory) == [1, 2]


def test_a_model_is_measured_against_how_well_the_other_does_itself() -> None:
    memory = LongTermMemory(LongTermConfig())
    noisy = np.array([[-0.4], [0.4], [-0.4], [0.4]], np.float32)
    memory.store(says(0.0), INPUTS, noisy, 1)  # its own error on its sample is 0.16
    assert memory.store(says(0.1), INPUTS, noisy + 0.1, 2)[0].id == 1
    assert memory.store(says(0.5), INPUTS, noisy + 0.5, 3)[0].id == 2


def test_the_least_useful_is_forgotten_and_never_the_one_just_stored() -> None:
    memory = holding(-0.9, -0.6, -0.3, config=LongTermConfig(capacity=3))
    for id, now in ((1, 10), (1, 11), (2, 12), (3, 13)):
        memory.use(id, now)
    stored, forgotten = memory.store(says(0.0), *rows(0.0), now=14)
    assert (stored.id, forgotten) == (4, [2]), "used once as 3, but longer ago; 4, never used, has just come"
    stored, forgotten = memory.store(says(0.3), *rows(0.3), now=15)
    assert (stored.id, forgotten) == (5, [4])
    assert ids(memory) == [1, 3, 5]


def test_of_equally_useful_ones_the_one_stored_again_lately_stays() -> None:
    memory = holding(-0.9, -0.6, config=LongTermConfig(capacity=2))
    memory.store(says(-0.9), *rows(-0.9), now=8)
    assert memory.store(says(0.0), *rows(0.0), now=9)[1] == [2]


def test_more_than_fit_in_are_taken_over_and_forgotten_when_something_is_stored() -> None:
    memory = LongTermMemory(LongTermConfig(capacity=2))
    for id, uses in ((1, 0), (2, 5), (3, 1), (4, 2)):
        memory.restore(Stored(id, says(id / 10), *rows(id / 10), uses=uses, touched=id))
    assert len(memory) == 4
    stored, forgotten = memory.store(says(-0.9), *rows(-0.9), now=9)
    assert (stored.id, forgotten, ids(memory)) == (5, [1, 3, 4], [2, 5])


def test_trials_are_sorted_by_error_and_say_what_fits() -> None:
    memory = holding(-1.0, 0.75, 0.25, 0.5)
    found = memory.trials(*rows(0.49), before=9)
    assert [trial.stored.id for trial in found] == [4, 3, 2, 1]
    np.testing.assert_allclose([trial.error for trial in found], [0.0001, 0.0576, 0.0676, 2.2201], rtol=1e-5)
    assert [trial.fits for trial in found] == [True, True, True, False]
    strict = holding(-1.0, 0.75, 0.25, 0.5, config=LongTermConfig(fit_error=0.06))
    assert [trial.fits for trial in strict.trials(*rows(0.49), before=9)] == [True, True, False, False]


def test_of_equal_models_the_one_stored_first_comes_first() -> None:
    memory = LongTermMemory(LongTermConfig())
    for id in (3, 1, 2):
        memory.restore(Stored(id, says(0.5), *rows(0.5)))
    assert [trial.stored.id for trial in memory.trials(*rows(0.5), before=9)] == [1, 2, 3]


def test_a_trial_needs_a_few_pairs_and_takes_the_newest() -> None:
    memory = holding(0.5, config=LongTermConfig(fit_pairs=2, newest=3))
    assert memory.trials(*rows(0.5, 0), before=9) == memory.trials(*rows(0.5, 1), before=9) == []
    assert len(memory.trials(*rows(0.5, 2), before=9)) == 1
    targets = np.array([[-1], [0.5], [0.5], [0.5]], np.float32)
    assert memory.trials(INPUTS, targets, before=9)[0].error == 0
    assert memory.trials(INPUTS, targets[::-1], before=9)[0].error == pytest.approx(0.75)
    assert LongTermMemory(LongTermConfig()).trials(*rows(0.5), before=9) == []


def test_what_was_stored_in_the_context_itself_is_not_tried() -> None:
    memory = holding(-0.9, 0.5, -0.3)  # touched at 1, 2 and 3
    memory.use(1, now=5)
    for before, expected in ((1, []), (2, []), (3, [2]), (4, [2, 3]), (6, [2, 3, 1])):
        assert [trial.stored.id for trial in memory.trials(*rows(0.5), before=before)] == expected


def test_uses_are_counted_and_the_most_useful_is_known() -> None:
    memory = LongTermMemory(LongTermConfig())
    assert memory.most_useful() is None
    memory = holding(-0.9, -0.6, -0.3)
    best = memory.most_useful()
    assert best is not None
    assert best.id == 3, "of equals the newest"
    used = memory.use(2, now=20)
    assert (used.uses, used.touched) == (1, 20)
    assert memory.most_useful() == used


# ---- what is worth storing ----


def due(errors: list[float], config: LongTermConfig) -> list[int]:
    """After how many errors the model should be stored."""
    stability = Stability(config)
    return [count for count, error in enumerate(errors, start=1) if stability.step(error)]


SMALL = LongTermConfig(stable_pairs=5, good_error=0.1)


def test_a_model_is_due_after_enough_good_pairs_and_again_as_often() -> None:
    assert due([0.0] * 22, SMALL) == [5, 10, 15, 20]
    assert due([0.0] * 4, SMALL) == []
    assert due([0.1] * 50, SMALL) == []


def test_a_model_is_due_as_soon_as_its_last_pairs_were_good() -> None:
    assert due([1.0, 1.0, *[0.0] * 6], SMALL) == [7]
    assert due([0.0, 0.0, 0.0, 0.0, 0.6, *[0.0] * 9], SMALL) == [10], "one bad pair is too much until it is past"
    assert due([0.0, 0.0, 0.0, 0.0, 0.4], SMALL) == [5], "their mean is what counts"


def test_after_a_change_of_context_all_begins_anew() -> None:
    stability = Stability(SMALL)
    assert [stability.step(0.0) for _ in range(4)] == [False] * 4
    stability.begin()
    assert stability.error == 0
    assert [stability.step(0.05) for _ in range(5)] == [False] * 4 + [True]
    assert stability.error == pytest.approx(0.05)


# ---- the sample of a context ----

rows_of = hnp.arrays(
    np.float32, st.tuples(st.integers(1, 30), st.integers(1, 3)), elements=st.sampled_from([-1.0, 0.0, 0.5, 1.0])
)


@fixed
@given(rows_of, st.integers(1, 35))
def test_a_sample_has_no_repeats_and_is_the_same_each_time(inputs: np.ndarray, count: int) -> None:
    chosen = sample_of(inputs, count)
    assert len(chosen) == len(set(chosen.tolist())) == min(count, len(inputs))
    assert chosen.tolist() == sorted(chosen.tolist()) == sample_of(inputs.copy(), count).tolist()
    assert 0 <= chosen.min() <= chosen.max() < len(inputs)


@fixed
@given(rows_of, st.integers(1, 35))
def test_a_sample_holds_every_kind_of_row_if_there_is_room(inputs: np.ndarray, count: int) -> None:
    kinds = {tuple(row) for row in inputs.tolist()}
    sampled = {tuple(row) for row in inputs[sample_of(inputs, count)].tolist()}
    assert len(sampled) == min(count, len(kinds))


@fixed
@given(hnp.arrays(np.float32, (40, 2), elements=st.floats(-1, 1, width=32)), st.integers(1, 10))
def test_no_row_is_farther_from_the_sample_than_sampled_rows_from_one_another(inputs: np.ndarray, count: int) -> None:
    chosen = sample_of(inputs, count + 1)
    gaps = np.square(inputs[:, None] - inputs[chosen][None]).sum(axis=2)
    apart = gaps[chosen][~np.eye(count + 1, dtype=bool)].min()
    assert gaps.min(axis=1).max() <= apart


def test_a_sample_covers_what_is_rare() -> None:
    inputs = np.zeros((200, 3), np.float32)
    inputs[[17, 90, 163], [0, 1, 2]] = 1.0
    assert {17, 90, 163} <= set(sample_of(inputs, 5).tolist())


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"capacity": -1}, "expected none negative"),
        ({"seeds": -1}, "expected none negative"),
        ({"stable_pairs": 0}, "stable_pairs is 0; expected 1 or more"),
        ({"sample": 0}, "sample is 0"),
        ({"fit_pairs": 0}, "fit_pairs is 0"),
        ({"newest": 1}, "newest is 1; expected fit_pairs = 2 or more"),
        ({"good_error": 0.0}, "good_error is 0.0; expected a positive number"),
        ({"same_error": -0.1}, "same_error is -0.1"),
        ({"fit_error": float("inf")}, "fit_error is inf"),
        ({"missed_error": 0.0}, "missed_error is 0.0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(fields: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        LongTermConfig(**fields)  # type: ignore[arg-type]
