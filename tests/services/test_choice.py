"""The choice of the current action among what the models foresee."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mdb_services.mechanism.choice import (
    GOOD_ERROR,
    RANDOM,
    SUPPORTED,
    Choice,
    Known,
    Mode,
    Models,
    choose,
    foresee,
    shortfall,
    supported,
)
from mdb_services.mechanism.networks.encoding import Channel, Codebook, gather
from mdb_services.mechanism.networks.network import Network

ACTIONS = 5
UNTRIED = np.full(ACTIONS, -1)
CHANNELS = {
    "distance": Channel(low=0.0, high=2.0),
    "next.distance": Channel(low=0.0, high=2.0),
    "covered.distance": Channel(low=-2.0, high=2.0),
    "note": Channel(encoding="one_hot", size=2),
    "action": Channel(encoding="one_hot", size=ACTIONS),
    "feedback": Channel(),
}
TAUGHT = Mode("taught", "communication", "feedback")
ALONE = Mode("alone", "object", "induced")


def linear(inputs: list[float], bias: float = 0.0) -> Network:
    """A network without hidden units cannot weigh its inputs: one nearly linear unit for each does."""
    small = 1e-3
    hidden = np.hstack([np.eye(len(inputs)) * small, np.zeros((len(inputs), 1))])
    output = np.append(np.array(inputs) / small, bias)[None, :]
    return Network([hidden, output])


def brain(liked: list[float]) -> Models:
    """Communication: the feedback of each action is `liked`; object and induced: nearer is better."""
    communication = Codebook(CHANNELS, ["note", "action"], ["feedback"])
    world = Codebook(CHANNELS, ["distance", "action"], ["next.distance"])
    induced = Codebook(CHANNELS, ["covered.distance"], ["feedback"])
    away = [0.1 * action for action in range(ACTIONS)]
    return {
        "communication": Known(communication, linear([0, 0, *liked])),
        "object": Known(world, linear([0.5, *away])),
        "induced": Known(induced, linear([1.0])),
    }


SEEKING = replace(TAUGHT, aspiration=0.8, exploration=0.5, reach=0.2, curiosity=0.5)
ALL = list(range(ACTIONS))


def learnt_from(models: Models, actions: list[int], note: int = 0) -> Models:
    """The communication model was learnt from pairs of this note and these actions; another one is out of reach."""
    codebook, network, _ = models["communication"]
    rows = [codebook.input_rows(gather(note=note, action=action)) for action in actions]
    support = np.array(rows, np.float32).reshape(-1, codebook.width)
    return {**models, "communication": Known(codebook, network, support)}


def choices(mode: Mode, models: Models, tried: np.ndarray = UNTRIED, **fields: Any) -> list[Choice]:
    """The choices of many seeds."""
    return [choose([mode], models, gather(note=0), tried, rng(seed), **fields) for seed in range(400)]


def explored(made: list[Choice]) -> float:
    """The share of choices that explored."""
    return sum(choice.explored for choice in made) / len(made)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.lists(st.integers(-9, 9), min_size=ACTIONS, max_size=ACTIONS), st.integers(0, 1))
def test_the_action_foreseen_best_is_taken(liked: list[int], note: int) -> None:
    models = brain([value / 10 for value in liked])
    choice = choose([TAUGHT], models, gather(note=note), UNTRIED, rng())
    assert liked[choice.action] == max(liked)
    assert (choice.mode, choice.explored) == ("taught", False)
    assert choice.predicted == pytest.approx(max(liked) / 10, abs=1e-3)


def test_the_first_mode_whose_inputs_are_there_acts() -> None:
    models = brain([0, 0, 0, 0.5, 0])
    both, seen, nothing = gather(before={"distance": 1.0}, note=0), gather(before={"distance": 1.0}), gather()
    assert choose([TAUGHT, ALONE], models, both, UNTRIED, rng()).action == 3
    assert choose([ALONE, TAUGHT], models, both, UNTRIED, rng()).mode == "alone"
    alone = choose([TAUGHT, ALONE], models, seen, UNTRIED, rng())
    assert (alone.mode, alone.action) == ("alone", 0), "the action that brings it nearest"
    random = choose([TAUGHT, ALONE], models, nothing, UNTRIED, rng())
    assert (random.mode, random.explored, random.predicted) == (RANDOM, True, None)


@pytest.mark.parametrize("gone", ["object", "induced"])
def test_a_mode_without_one_of_its_models_does_not_act(gone: str) -> None:
    models = {name: model for name, model in brain([0] * ACTIONS).items() if name != gone}
    facts = gather(before={"distance": 1.0})
    assert foresee(ALONE, models, facts, ACTIONS) is None
    assert choose([ALONE], models, facts, UNTRIED, rng()).mode == RANDOM


def test_actions_are_random_over_all_when_no_mode_applies() -> None:
    taken = {choose([TAUGHT], {}, gather(note=0), UNTRIED, rng(seed)).action for seed in range(100)}
    assert taken == set(range(ACTIONS))


def test_an_action_that_the_channel_lacks_makes_the_mode_unusable_and_no_error() -> None:
    choice = choose([TAUGHT], brain([0] * ACTIONS), gather(note=0), np.full(ACTIONS + 1, -1), rng())
    assert choice.mode == RANDOM


def test_a_note_of_another_language_makes_the_mode_unusable_and_no_error() -> None:
    facts = gather(before={"distance": 1.0}, note=99)
    assert choose([TAUGHT, ALONE], brain([0] * ACTIONS), facts, UNTRIED, rng()).mode == "alone"


@pytest.mark.parametrize(("best", "explores"), [(0.2, True), (0.9, False)])
def test_below_its_aspiration_a_mode_explores_as_often_as_it_says(best: float, explores: bool) -> None:
    models = brain([0, 0, best, 0, 0])
    mode = Mode("taught", "communication", "feedback", aspiration=0.5, exploration=0.4)
    choices = [choose([mode], models, gather(note=0), UNTRIED, rng(seed)) for seed in range(500)]
    share = sum(choice.explored for choice in choices) / len(choices)
    assert share == pytest.approx(0.4 if explores else 0.0, abs=0.07)
    assert all(choice.action == 2 for choice in choices if not choice.explored)
    liked = [0, 0, best, 0, 0]
    assert all(choice.predicted == pytest.approx(liked[choice.action], abs=1e-3) for choice in choices)


@pytest.mark.parametrize(("error", "explores"), [(0.0, True), (0.05, True), (0.1, True), (0.3, False)])
def test_what_the_model_cannot_foresee_is_not_aspired_to(error: float, explores: bool) -> None:
    models = brain([0, 0, 0.4, 0, 0])
    mode = Mode("taught", "communication", "feedback", aspiration=0.8, exploration=1.0)
    choice = choose([mode], models, gather(note=0), UNTRIED, rng(), errors={"communication": error, "induced": 9.0})
    assert choice.explored == explores


def test_the_error_that_counts_is_that_of_the_model_which_tells_the_satisfaction() -> None:
    models, errors = brain([0] * ACTIONS), {"communication": 0.3, "object": 0.01, "induced": 0.41}
    assert [shortfall(mode, models, errors) for mode in (TAUGHT, ALONE)] == pytest.approx([0.5, 0.6])
    assert [shortfall(mode, models, {}) for mode in (TAUGHT, ALONE)] == [0, 0]
    assert shortfall(TAUGHT, models, {"communication": GOOD_ERROR}) == 0, "a good model foresees all"


def test_without_an_aspiration_a_mode_is_content_with_anything() -> None:
    for mode in (replace(TAUGHT, exploration=1.0), replace(SEEKING, aspiration=None)):
        assert not any(choice.explored for choice in choices(mode, learnt_from(brain([-0.9] * ACTIONS), [0])))


def test_what_was_tried_longest_ago_is_explored() -> None:
    models = brain([0, 0, 0.2, 0, 0])
    mode = Mode("taught", "communication", "feedback", aspiration=0.5, exploration=1.0)
    tried = np.array([40, 7, 50, 3, 9])
    assert choose([mode], models, gather(note=0), tried, rng()).action == 3
    tried[[0, 4]] = -1
    assert {choose([mode], models, gather(note=0), tried, rng(seed)).action for seed in range(50)} == {0, 4}


def test_forced_exploration_is_always_random_and_still_says_what_was_foreseen() -> None:
    models = brain([0, 0, 0.9, 0, 0])
    choices = [
        choose([TAUGHT], models, gather(note=0), UNTRIED, rng(seed), forced_exploration=True) for seed in range(100)
    ]
    assert {choice.action for choice in choices} == set(range(ACTIONS))
    assert all(choice.explored and choice.mode == "taught" for choice in choices)
    assert {round(choice.predicted or 0, 2) for choice in choices} == {0.0, 0.9}


def test_the_same_numbers_are_drawn_whatever_the_modes_are() -> None:
    one, other = rng(), rng()
    choose([], {}, gather(), UNTRIED, one)
    choose([TAUGHT, ALONE], brain([0] * ACTIONS), gather(note=0), UNTRIED, other, forced_exploration=True)
    assert one.random() == other.random()


# ---- support ----

PLACES = st.integers(-8, 8).map(lambda eighths: eighths / 8)


def places(rows: int) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.float32, (rows, 3), elements=PLACES)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.integers(1, 9).flatmap(places), places(12), st.floats(0.05, 2), st.randoms(use_true_random=False))
def test_support_is_whole_at_a_pair_and_never_grows_with_the_distance_to_the_nearest(
    pairs: np.ndarray, rows: np.ndarray, reach: float, random: Any
) -> None:
    support = supported(rows, pairs, reach)
    nearest = np.linalg.norm(rows[:, None] - pairs[None], axis=2).min(axis=1)
    assert ((support >= 0) & (support <= 1)).all()
    assert (np.diff(support[np.argsort(nearest)]) <= 0).all()
    assert (support[nearest > 0] < 1).all()
    assert (supported(pairs, pairs, reach) == 1).all()
    order = random.sample(range(len(pairs)), len(pairs))
    assert np.array_equal(supported(rows, pairs[order], reach), support), "the order of the pairs is nothing"
    assert (support >= supported(rows, pairs[:1], reach)).all(), "and another pair never takes some away"


def test_support_falls_with_the_distance_by_the_reach() -> None:
    row, pair = np.array([[0.3, 0.4]], np.float32), np.zeros((1, 2), np.float32)
    assert supported(row, pair, 0.5) == pytest.approx(np.exp(-1))
    assert supported(row, pair, 0.25) == pytest.approx(np.exp(-4))
    assert supported(row, pair[:0], 100.0) == 0, "nothing is supported by an empty memory"


def test_a_promise_counts_by_its_support_and_what_nothing_is_known_of_promises_nothing() -> None:
    models = learnt_from(brain([0.9, 0.3, -0.5, -0.9, 0]), [1, 2])
    foreseen = foresee(replace(TAUGHT, reach=0.2), models, gather(note=0), ACTIONS)
    assert foreseen is not None
    assert foreseen.support == pytest.approx([0, 1, 1, 0, 0])
    assert foreseen.satisfaction == pytest.approx([0.9, 0.3, -0.5, -0.9, 0], abs=1e-3)
    assert foreseen.promise == pytest.approx([0, 0.3, -0.5, 0, 0], abs=1e-3)
    half = foresee(replace(TAUGHT, reach=2**0.5 / np.log(2) ** 0.5), models, gather(note=0), ACTIONS)
    assert half is not None
    assert half.promise == pytest.approx([0.45, 0.3, -0.5, -0.45, 0], abs=1e-3), "as far off as one action is"
    chosen = choose([replace(TAUGHT, reach=0.2)], models, gather(note=0), UNTRIED, rng())
    assert (chosen.action, chosen.explored) == (1, False), "the best that is known, not what is only foreseen"


def test_what_nothing_is_known_of_is_better_than_what_was_punished() -> None:
    models = learnt_from(brain([-0.3, -0.3, -0.9, -0.3, -0.3]), [0, 1, 3, 4])
    assert choose([replace(TAUGHT, reach=0.2)], models, gather(note=0), UNTRIED, rng()).action == 2


def test_the_support_that_counts_is_that_of_the_model_which_tells_the_satisfaction() -> None:
    models = brain([0] * ACTIONS)
    codebook, network, _ = models["induced"]
    facts = gather(before={"distance": 1.0})
    foreseen = foresee(ALONE, models, facts, ACTIONS)
    assert foreseen is not None
    there = np.array([[foreseen.satisfaction[0]]], np.float32)  # of this model the one input is its satisfaction
    told = {**models, "induced": Known(codebook, network, there), "object": models["object"]._replace(support=there)}
    weighed = foresee(replace(ALONE, reach=0.1), told, facts, ACTIONS)
    assert weighed is not None
    gaps = foreseen.satisfaction - foreseen.satisfaction[0]
    assert weighed.support == pytest.approx(np.exp(-(gaps**2) / 0.1**2), abs=1e-3)


def test_with_reach_a_satisfaction_ends_where_targets_end_and_without_it_does_not() -> None:
    models = learnt_from(brain([3, -3, 0.5, 0, 0]), ALL)
    cut = foresee(replace(TAUGHT, reach=0.2), models, gather(note=0), ACTIONS)
    whole = foresee(TAUGHT, models, gather(note=0), ACTIONS)
    assert cut is not None
    assert whole is not None
    assert cut.satisfaction == pytest.approx([1, -1, 0.5, 0, 0], abs=1e-3)
    assert whole.satisfaction == pytest.approx([3, -3, 0.5, 0, 0], abs=1e-2)


def test_a_model_whose_support_is_not_told_is_believed() -> None:
    models = brain([0, 0, 0.9, 0, 0])
    assert models["communication"].support is None
    made = choices(SEEKING, models)
    assert {choice.action for choice in made} == {2}
    assert explored(made) == 0


def test_below_its_aspiration_a_mode_tries_what_may_be_better_at_once() -> None:
    models = learnt_from(brain([-0.9, 0.4, 0.2, -0.9, 0]), [1, 2, 4])
    made = choices(replace(SEEKING, exploration=0.0), models)
    assert {choice.action for choice in made} == {0, 3}, "nothing like these is in the memory, whatever is foreseen"
    assert explored(made) == 1
    assert all(choice.predicted == pytest.approx(-0.9, abs=1e-3) for choice in made), "what was foreseen is told"


def test_of_what_may_be_better_the_less_supported_is_tried() -> None:
    """The action is a number here: what was learnt of one tells of its neighbours."""
    channels = CHANNELS | {"action": Channel(low=0.0, high=ACTIONS - 1)}
    codebook = Codebook(channels, ["note", "action"], ["feedback"])
    rows = [codebook.input_rows(gather(note=0, action=action)) for action in (0, 1)]
    models = {"communication": Known(codebook, linear([0, 0, 0]), np.array(rows, np.float32).reshape(2, -1))}
    mode = replace(SEEKING, reach=1.0)
    assert {choice.action for choice in choices(mode, models)} == {4}, "the farthest from both"


def test_a_mode_that_is_promised_enough_is_not_curious() -> None:
    models = learnt_from(brain([0, 0.9, 0, 0, 0]), [1])
    made = choices(replace(SEEKING, curiosity=10.0, exploration=1.0), models)
    assert {choice.action for choice in made} == {1}
    assert explored(made) == 0


def test_where_nothing_may_be_better_but_not_all_is_known_what_was_tried_longest_ago_is_explored() -> None:
    """Curiosity alone would be stuck here: 0.6 is known, and what is unknown is worth 0.5."""
    models = learnt_from(brain([-0.9, 0.6, 0, 0, 0]), [1, 2])
    made = choices(SEEKING, models, np.array([40, 50, 7, 3, 9]))
    assert explored(made) == pytest.approx(SEEKING.exploration, abs=0.07)
    assert {(choice.action, choice.explored) for choice in made} == {(1, False), (3, True)}


@pytest.mark.parametrize(("error", "often"), [(0.0, 0.0), (GOOD_ERROR, 0.0), (GOOD_ERROR + 0.04, 0.2), (0.5, 0.5)])
def test_once_all_is_known_a_mode_explores_only_as_often_as_the_model_errs(error: float, often: float) -> None:
    models = learnt_from(brain([-0.9, 0.1, 0, 0, 0]), ALL)
    made = choices(SEEKING, models, errors={"communication": error})
    assert explored(made) == pytest.approx(often, abs=0.07)
    assert {choice.action for choice in made if not choice.explored} == {1}


@pytest.mark.parametrize(("support", "knows"), [(SUPPORTED + 0.01, True), (SUPPORTED - 0.01, False)])
def test_what_is_supported_more_than_it_is_not_counts_as_known(support: float, knows: bool) -> None:
    """All actions but the first, as one-hot, are the root of 2 away from the one pair."""
    mode = replace(SEEKING, reach=float(np.sqrt(-2 / np.log(support))), exploration=1.0, curiosity=0.0)
    made = choices(mode, learnt_from(brain([0.7, 0, 0, 0, 0]), [0]))
    assert explored(made) == (0 if knows else 1)


def test_without_reach_a_mode_explores_as_if_no_support_were_told() -> None:
    models = brain([0, 0, 0.6, 0, 0])
    plain = replace(TAUGHT, aspiration=0.8, exploration=0.5)
    told = learnt_from(models, [2])
    assert choices(replace(plain, curiosity=0.5), told) == choices(plain, models)
    assert explored(choices(plain, told)) == pytest.approx(0.5, abs=0.07)


def test_forced_exploration_is_as_random_with_support() -> None:
    made = choices(SEEKING, learnt_from(brain([0.9, 0, 0, 0, 0]), [0]), forced_exploration=True)
    assert {choice.action for choice in made} == set(ALL)
    assert explored(made) == 1
