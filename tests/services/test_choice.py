"""The choice of the current action among what the models foresee."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_services.mechanism.choice import RANDOM, Mode, Models, aspired, choose, satisfactions
from mdb_services.mechanism.encoding import Channel, Codebook, gather
from mdb_services.mechanism.network import Network

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
        "communication": (communication, linear([0, 0, *liked])),
        "object": (world, linear([0.5, *away])),
        "induced": (induced, linear([1.0])),
    }


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
    assert satisfactions(ALONE, models, facts, ACTIONS) is None
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
    aspiring = [replace(mode, aspiration=0.8) for mode in (TAUGHT, ALONE)]
    assert [aspired(mode, models, errors) for mode in aspiring] == pytest.approx([0.3, 0.2])
    assert [aspired(mode, models, {}) for mode in aspiring] == [0.8, 0.8]
    assert aspired(TAUGHT, models, errors) == -np.inf


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
