"""The choice of the current action among what the models foresee."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mdb_services.mechanism.actions.choice import DOUBT, RANDOM_MODE, SUPPORTED, Choice, choose
from mdb_services.mechanism.actions.foresight import (
    GOOD_ERROR,
    Foreseen,
    Known,
    Mode,
    Models,
    foresee,
    nearness,
    shortfall,
)
from mdb_services.mechanism.actions.spaces import Choices, Ranges, Space
from mdb_services.mechanism.networks.encoding import Channel, Codebook, Facts, gather
from mdb_services.mechanism.networks.network import Network

ACTIONS = 5
NOTE = 0
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


def each(actions: int = ACTIONS) -> Facts:
    """So many choices, to be foreseen all at once."""
    return {"action": np.arange(actions, dtype=np.float64)}


def space(*last: int, actions: int = ACTIONS) -> Space:
    """The choices, and when each was tried last under the note of these tests; -1: never."""
    choices = Choices([turn(action) for action in range(actions)])
    for action, iteration in sorted(enumerate(last), key=lambda tried: tried[1]):
        if iteration >= 0:
            choices.remember(NOTE, iteration, turn(action), action)
    return choices


def turn(choice: int) -> dict[str, float]:
    """The values of the actuators that a choice stands for."""
    return {"turn": 10.0 * choice - 20.0}


def chosen(
    modes: list[Mode],
    models: Models,
    facts: Facts | None = None,
    tried: Space | None = None,
    *,
    seed: int = 0,
    note: int | None = NOTE,
    **fields: Any,
) -> Choice:
    facts = gather(note=note) if facts is None else facts
    return choose(modes, models, facts, tried or space(), note=note, rng=rng(seed), **fields)


SEEKING = replace(TAUGHT, aspiration=0.8, exploration=0.5, reach=0.2, curiosity=0.5)
ALL = list(range(ACTIONS))


def learnt_from(models: Models, actions: list[int], note: int = 0) -> Models:
    """The communication model was learnt from pairs of this note and these actions; another one is out of reach."""
    codebook, network, _ = models["communication"]
    rows = [codebook.input_rows(gather(note=note, choice=action)) for action in actions]
    support = np.array(rows, np.float32).reshape(-1, codebook.width)
    return {**models, "communication": Known(codebook, network, support)}


def choices(mode: Mode, models: Models, tried: Space | None = None, **fields: Any) -> list[Choice]:
    """The choices of many seeds."""
    return [chosen([mode], models, tried=tried, seed=seed, **fields) for seed in range(400)]


def explored(made: list[Choice]) -> float:
    """The share of choices that explored."""
    return sum(choice.explored for choice in made) / len(made)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.lists(st.integers(-9, 9), min_size=ACTIONS, max_size=ACTIONS), st.integers(0, 1))
def test_the_action_foreseen_best_is_taken(liked: list[int], note: int) -> None:
    models = brain([value / 10 for value in liked])
    choice = chosen([TAUGHT], models, note=note)
    assert choice.choice is not None
    assert liked[choice.choice] == max(liked)
    assert choice.action == turn(choice.choice)
    assert (choice.mode, choice.explored) == ("taught", False)
    assert choice.predicted == pytest.approx(max(liked) / 10, abs=1e-3)


def test_the_first_mode_whose_inputs_are_there_acts() -> None:
    models = brain([0, 0, 0, 0.5, 0])
    both, seen, nothing = gather(before={"distance": 1.0}, note=0), gather(before={"distance": 1.0}), gather()
    assert chosen([TAUGHT, ALONE], models, both).choice == 3
    assert chosen([ALONE, TAUGHT], models, both).mode == "alone"
    alone = chosen([TAUGHT, ALONE], models, seen)
    assert (alone.mode, alone.choice) == ("alone", 0), "the action that brings it nearest"
    random = chosen([TAUGHT, ALONE], models, nothing)
    assert (random.mode, random.explored, random.predicted) == (RANDOM_MODE, True, None)
    assert random.action == turn(random.choice)


@pytest.mark.parametrize("gone", ["object", "induced"])
def test_a_mode_without_one_of_its_models_does_not_act(gone: str) -> None:
    models = {name: model for name, model in brain([0] * ACTIONS).items() if name != gone}
    facts = gather(before={"distance": 1.0})
    assert foresee(ALONE, models, facts, each()) is None
    assert chosen([ALONE], models, facts).mode == RANDOM_MODE


def test_actions_are_random_over_all_when_no_mode_applies() -> None:
    taken = {chosen([TAUGHT], {}, seed=seed).choice for seed in range(100)}
    assert taken == set(range(ACTIONS))


def test_an_action_that_the_channel_lacks_makes_the_mode_unusable_and_no_error() -> None:
    choice = chosen([TAUGHT], brain([0] * ACTIONS), tried=space(actions=ACTIONS + 1))
    assert choice.mode == RANDOM_MODE


def test_a_note_of_another_language_makes_the_mode_unusable_and_no_error() -> None:
    facts = gather(before={"distance": 1.0}, note=99)
    assert chosen([TAUGHT, ALONE], brain([0] * ACTIONS), facts, note=99).mode == "alone"


@pytest.mark.parametrize(("best", "explores"), [(0.2, True), (0.9, False)])
def test_below_its_aspiration_a_mode_explores_as_often_as_it_says(best: float, explores: bool) -> None:
    models = brain([0, 0, best, 0, 0])
    mode = Mode("taught", "communication", "feedback", aspiration=0.5, exploration=0.4)
    made = choices(mode, models)
    assert explored(made) == pytest.approx(0.4 if explores else 0.0, abs=0.07)
    assert all(choice.choice == 2 for choice in made if not choice.explored)
    liked = [0, 0, best, 0, 0]
    assert all(choice.predicted == pytest.approx(liked[choice.choice], abs=1e-3) for choice in made)


@pytest.mark.parametrize(("error", "explores"), [(0.0, True), (0.05, True), (0.1, True), (0.3, False)])
def test_what_the_model_cannot_foresee_is_not_aspired_to(error: float, explores: bool) -> None:
    models = brain([0, 0, 0.4, 0, 0])
    mode = Mode("taught", "communication", "feedback", aspiration=0.8, exploration=1.0)
    choice = chosen([mode], models, errors={"communication": error, "induced": 9.0})
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
    assert chosen([mode], models, tried=space(40, 7, 50, 3, 9)).choice == 3
    some = space(-1, 7, 50, 3, -1)
    assert {chosen([mode], models, tried=some, seed=seed).choice for seed in range(50)} == {0, 4}
    other = gather(note=1)
    assert {chosen([mode], models, other, some, seed=seed, note=1).choice for seed in range(99)} == set(ALL), (
        "what was tried under another note counts for that"
    )


def test_forced_exploration_is_always_random_and_still_says_what_was_foreseen() -> None:
    models = brain([0, 0, 0.9, 0, 0])
    made = choices(TAUGHT, models, forced_exploration=True)
    assert {choice.choice for choice in made} == set(ALL)
    assert all(choice.explored and choice.mode == "taught" for choice in made)
    assert all(choice.predicted == pytest.approx(0.9 if choice.choice == 2 else 0, abs=1e-3) for choice in made)


def test_the_same_numbers_are_drawn_whatever_the_modes_are() -> None:
    one, other = rng(), rng()
    choose([], {}, gather(), space(), note=None, rng=one)
    both = [TAUGHT, ALONE]
    choose(both, brain([0] * ACTIONS), gather(note=0), space(), note=0, rng=other, forced_exploration=True)
    assert one.random() == other.random()


# ---- support ----


def supported(rows: np.ndarray, pairs: np.ndarray, reach: float) -> np.ndarray:
    """How far pairs (n, inputs) support each row (m, inputs): as the nearest does, and nothing where none is."""
    return nearness(rows, pairs, reach).max(axis=1, initial=0.0)


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
    foreseen = foresee(replace(TAUGHT, reach=0.2), models, gather(note=0), each())
    assert foreseen is not None
    assert foreseen.support == pytest.approx([0, 1, 1, 0, 0])
    assert foreseen.satisfaction == pytest.approx([0.9, 0.3, -0.5, -0.9, 0], abs=1e-3)
    assert foreseen.promise == pytest.approx([0, 0.3, -0.5, 0, 0], abs=1e-3)
    half = foresee(replace(TAUGHT, reach=2**0.5 / np.log(2) ** 0.5), models, gather(note=0), each())
    assert half is not None
    assert half.promise == pytest.approx([0.45, 0.3, -0.5, -0.45, 0], abs=1e-3), "as far off as one action is"
    choice = chosen([replace(TAUGHT, reach=0.2)], models)
    assert (choice.choice, choice.explored) == (1, False), "the best that is known, not what is only foreseen"


def test_what_nothing_is_known_of_is_better_than_what_was_punished() -> None:
    models = learnt_from(brain([-0.3, -0.3, -0.9, -0.3, -0.3]), [0, 1, 3, 4])
    assert chosen([replace(TAUGHT, reach=0.2)], models).choice == 2


def test_the_support_that_counts_is_that_of_the_model_which_tells_the_satisfaction() -> None:
    models = brain([0] * ACTIONS)
    codebook, network, _ = models["induced"]
    facts = gather(before={"distance": 1.0})
    foreseen = foresee(ALONE, models, facts, each())
    assert foreseen is not None
    there = np.array([[foreseen.satisfaction[0]]], np.float32)  # of this model the one input is its satisfaction
    told = {**models, "induced": Known(codebook, network, there), "object": models["object"]._replace(support=there)}
    weighed = foresee(replace(ALONE, reach=0.1), told, facts, each())
    assert weighed is not None
    gaps = foreseen.satisfaction - foreseen.satisfaction[0]
    assert weighed.support == pytest.approx(np.exp(-(gaps**2) / 0.1**2), abs=1e-3)


def test_with_reach_a_satisfaction_ends_where_targets_end_and_without_it_does_not() -> None:
    models = learnt_from(brain([3, -3, 0.5, 0, 0]), ALL)
    cut = foresee(replace(TAUGHT, reach=0.2), models, gather(note=0), each())
    whole = foresee(TAUGHT, models, gather(note=0), each())
    assert cut is not None
    assert whole is not None
    assert cut.satisfaction == pytest.approx([1, -1, 0.5, 0, 0], abs=1e-3)
    assert whole.satisfaction == pytest.approx([3, -3, 0.5, 0, 0], abs=1e-2)


def test_a_model_whose_support_is_not_told_is_believed() -> None:
    models = brain([0, 0, 0.9, 0, 0])
    assert models["communication"].support is None
    made = choices(SEEKING, models)
    assert {choice.choice for choice in made} == {2}
    assert explored(made) == 0


def test_below_its_aspiration_a_mode_tries_what_may_be_better_at_once() -> None:
    models = learnt_from(brain([-0.9, 0.4, 0.2, -0.9, 0]), [1, 2, 4])
    made = choices(replace(SEEKING, exploration=0.0), models)
    assert {choice.choice for choice in made} == {0, 3}, "nothing like these is in the memory, whatever is foreseen"
    assert explored(made) == 1
    assert all(choice.predicted == pytest.approx(-0.9, abs=1e-3) for choice in made), "what was foreseen is told"


def test_of_what_may_be_better_the_less_supported_is_tried() -> None:
    """The action is a number here: what was learnt of one tells of its neighbours."""
    channels = CHANNELS | {"action": Channel(low=0.0, high=ACTIONS - 1)}
    codebook = Codebook(channels, ["note", "action"], ["feedback"])
    rows = [codebook.input_rows(gather(note=0, choice=action)) for action in (0, 1)]
    models = {"communication": Known(codebook, linear([0, 0, 0]), np.array(rows, np.float32).reshape(2, -1))}
    mode = replace(SEEKING, reach=1.0)
    assert {choice.choice for choice in choices(mode, models)} == {4}, "the farthest from both"


def test_a_mode_that_is_promised_enough_is_not_curious() -> None:
    models = learnt_from(brain([0, 0.9, 0, 0, 0]), [1])
    made = choices(replace(SEEKING, curiosity=10.0, exploration=1.0), models)
    assert {choice.choice for choice in made} == {1}
    assert explored(made) == 0


def test_where_nothing_may_be_better_but_not_all_is_known_what_was_tried_longest_ago_is_explored() -> None:
    """Curiosity alone would be stuck here: 0.6 is known, and what is unknown is worth 0.5."""
    models = learnt_from(brain([-0.9, 0.6, 0, 0, 0]), [1, 2])
    made = choices(SEEKING, models, space(40, 50, 7, 3, 9))
    assert explored(made) == pytest.approx(SEEKING.exploration, abs=0.07)
    assert {(choice.choice, choice.explored) for choice in made} == {(1, False), (3, True)}


@pytest.mark.parametrize(
    ("error", "often"), [(0.0, DOUBT), (GOOD_ERROR, DOUBT), (GOOD_ERROR + 0.04, 0.2), (0.5, 0.5)]
)
def test_once_all_is_known_a_mode_explores_only_as_often_as_the_model_errs_or_a_little(
    error: float, often: float
) -> None:
    models = learnt_from(brain([-0.9, 0.1, 0, 0, 0]), ALL)
    made = choices(SEEKING, models, errors={"communication": error})
    assert explored(made) == pytest.approx(often, abs=0.07)
    assert {choice.choice for choice in made if not choice.explored} == {1}
    assert explored(choices(replace(SEEKING, exploration=0.0), models, errors={"communication": error})) == 0


@pytest.mark.parametrize(("support", "knows"), [(SUPPORTED + 0.01, True), (SUPPORTED - 0.01, False)])
def test_what_is_supported_more_than_it_is_not_counts_as_known(support: float, knows: bool) -> None:
    """All actions but the first, as one-hot, are the root of 2 away from the one pair."""
    mode = replace(SEEKING, reach=float(np.sqrt(-2 / np.log(support))), exploration=1.0, curiosity=0.0)
    made = choices(mode, learnt_from(brain([0.7, 0, 0, 0, 0]), [0]))
    assert explored(made) == pytest.approx(DOUBT if knows else 1, abs=0.07)


def test_without_reach_a_mode_explores_as_if_no_support_were_told() -> None:
    models = brain([0, 0, 0.6, 0, 0])
    plain = replace(TAUGHT, aspiration=0.8, exploration=0.5)
    told = learnt_from(models, [2])
    assert choices(replace(plain, curiosity=0.5), told) == choices(plain, models)
    assert explored(choices(plain, told)) == pytest.approx(0.5, abs=0.07)


def test_forced_exploration_is_as_random_with_support() -> None:
    made = choices(SEEKING, learnt_from(brain([0.9, 0, 0, 0, 0]), [0]), forced_exploration=True)
    assert {choice.choice for choice in made} == set(ALL)
    assert explored(made) == 1


# ---- of those about as good the most familiar ----


def test_of_those_about_as_good_the_most_familiar_is_taken() -> None:
    foreseen = Foreseen(np.array([0.9, 0.75, 0.8, 0.6, -1.0]), np.ones(ACTIONS), np.array([0.1, 3.0, 2.0, 9.0, 99.0]))
    assert foreseen.best(0.0) == 0
    assert foreseen.best(0.12) == 2
    assert foreseen.best(0.2) == 1
    assert foreseen.best(0.31) == 3, "but what promises clearly less is not"
    assert foreseen.best(2.0) == 4
    alike = foreseen._replace(familiarity=np.zeros(ACTIONS))
    assert {alike.best(margin) for margin in (0.0, 0.2, 2.0)} == {0}, "of those as familiar, what promises most"


def test_how_familiar_an_action_is_tells_the_number_of_pairs_near_it() -> None:
    models = learnt_from(brain([0.9, 0.8, 0.3, 0, 0]), [0, 1, 1, 1, 2, 2, 2, 2])
    mode = replace(TAUGHT, reach=0.2, margin=0.2)
    foreseen = foresee(mode, models, gather(note=0), each())
    assert foreseen is not None
    assert foreseen.familiarity == pytest.approx([1, 3, 4, 0, 0])
    assert chosen([mode], models).choice == 1
    assert chosen([replace(mode, margin=0.0)], models).choice == 0
    assert chosen([replace(mode, reach=None)], models).choice == 0, "without reach all are as familiar"


# ---- in ranges ----

TURN = {"turn": (-90.0, 90.0)}
LISTENING = {"turn": Channel(low=-90.0, high=90.0), "note": CHANNELS["note"], "feedback": Channel()}


def in_ranges(slope: float, support: list[float] | None = None) -> Models:
    """Communication that reads the turn itself: the more to one side the better; learnt from pairs of these turns."""
    codebook = Codebook(LISTENING, ["note", "turn"], ["feedback"])
    rows = None
    if support is not None:
        found = [codebook.input_rows(gather(note=NOTE, action={"turn": turned})) for turned in support]
        rows = np.array(found, np.float32).reshape(-1, codebook.width)
    return {"communication": Known(codebook, linear([0, 0, slope]), rows)}


def searched(modes: list[Mode], models: Models, *, seed: int = 0, tried: list[float] = [], **fields: Any) -> Choice:  # noqa: B006
    ranges = Ranges(TURN, "refine", 64)
    for iteration, turned in enumerate(tried):
        ranges.remember(NOTE, iteration, {"turn": turned}, None)
    return choose(modes, models, gather(note=NOTE), ranges, note=NOTE, rng=rng(seed), **fields)


@pytest.mark.parametrize("slope", [0.5, -0.5])
def test_the_best_point_of_a_range_is_found_and_is_no_choice(slope: float) -> None:
    for seed in range(20):
        choice = searched([TAUGHT], in_ranges(slope), seed=seed)
        assert (choice.mode, choice.choice, choice.explored) == ("taught", None, False)
        assert choice.action["turn"] * np.sign(slope) == pytest.approx(90, abs=4)
        assert choice.predicted == pytest.approx(slope * choice.action["turn"] / 90, abs=1e-3)


def test_in_a_range_too_forced_exploration_is_random_and_says_what_was_foreseen() -> None:
    made = [searched([TAUGHT], in_ranges(0.5), seed=seed, forced_exploration=True) for seed in range(300)]
    turned = np.array([choice.action["turn"] for choice in made])
    assert np.histogram(turned, 5, (-90, 90))[0].min() > 30
    assert all(choice.explored and choice.mode == "taught" and choice.choice is None for choice in made)
    assert [choice.predicted for choice in made] == pytest.approx((turned / 180).tolist(), abs=1e-3)


def test_in_a_range_too_an_action_is_random_when_no_mode_applies() -> None:
    choice = searched([TAUGHT], {})
    assert (choice.mode, choice.choice, choice.explored, choice.predicted) == (RANDOM_MODE, None, True, None)
    assert -90 <= choice.action["turn"] <= 90


def test_in_a_range_what_was_tried_longest_ago_is_what_is_least_like_all_that_was() -> None:
    mode = replace(TAUGHT, aspiration=0.9, exploration=1.0)
    for seed in range(20):
        choice = searched([mode], in_ranges(0.3), seed=seed, tried=[20.0, 90.0, 55.0, -10.0])
        assert choice.explored
        assert choice.action["turn"] == pytest.approx(-90, abs=6)


def test_in_a_range_too_what_may_be_better_is_tried_at_once() -> None:
    models = in_ranges(0.0, support=[-90.0, -60.0, -30.0, 0.0])
    mode = replace(SEEKING, reach=1.0, exploration=0.0)
    for seed in range(20):
        choice = searched([mode], models, seed=seed)
        assert choice.explored
        assert choice.action["turn"] == pytest.approx(90, abs=6), "the farthest from all that is known"
