"""What every space of actions must do: derive a test class from `SpaceConformance` and supply `make`.

Owns the meaning of the `Space` contract as tests. `ChoicesConformance` and `RangesConformance` add what is said of
these two kinds. Uses the contract's members only.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mdb_services.mechanism.actions.foresight import Foreseen
from mdb_services.mechanism.actions.spaces import REMEMBERED, Choices, Ranges, Space
from mdb_services.mechanism.networks.encoding import Facts
from tests.protocol.samples import fixed

EVALUATIONS = 64
DRAWN = 4000
SEEDS = st.integers(0, 2**31)
NOTES = st.none() | st.integers(0, 2)
TENTHS = st.integers(-30, 30).map(lambda tenths: tenths / 10)

Values = dict[str, float]
Tried = tuple[Values, int | None]
"""An action: the actuators' values, and which choice it is."""
Numbers = NDArray[np.float64]


def foreseen(satisfaction: Numbers, support: Numbers | None = None) -> Foreseen:
    """What a mode foresees of some actions; without support, all are supported."""
    return Foreseen(satisfaction, np.ones(len(satisfaction)) if support is None else support, 0.0 * satisfaction)


class Foresight:
    """Foresees in the place of a mode, the same for the same action; remembers what it was asked."""

    def __init__(self, foresees: Callable[[Facts], Foreseen | None], *, nothing_at: int | None = None) -> None:
        """`nothing_at`: the question to which there is no answer."""
        self._foresees, self._nothing_at = foresees, nothing_at
        self.asked: list[Facts] = []

    def __call__(self, actions: Facts) -> Foreseen | None:
        self.asked.append({name: values.copy() for name, values in actions.items()})
        return None if len(self.asked) - 1 == self._nothing_at else self._foresees(actions)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def count(actions: Facts) -> int:
    (length,) = {values.shape for values in actions.values()}
    return int(length[0])


def assert_same(one: Facts, other: Facts) -> None:
    assert one.keys() == other.keys()
    for name, values in one.items():
        assert np.array_equal(values, other[name]), name


def rough(seed: int) -> Callable[[Facts], Foreseen]:
    """A promise without any order in it, and a support."""

    def foresees(actions: Facts) -> Foreseen:
        mixed = sum(np.sin((seed % 97 + 3) * (i + 1) * values) for i, values in enumerate(actions.values()))
        return foreseen(np.sin(40 * mixed), 0.5 + 0.5 * np.cos(30 * mixed))

    return foresees


def flat(actions: Facts) -> Foreseen:
    """All promise as much."""
    return foreseen(np.zeros(count(actions)))


class SpaceConformance:
    """The suite; a subclass supplies `make` and what it says of its own actions."""

    ends: Mapping[str, tuple[float, float]]
    """The lowest and the highest value of each actuator."""

    def make(self, evaluations: int = EVALUATIONS) -> Space:
        raise NotImplementedError

    def holds(self, values: Values, choice: int | None) -> bool:
        """Whether an action is of this space."""
        raise NotImplementedError

    def parts(self, values: Values, choice: int | None) -> Sequence[tuple[int, int]]:
        """In which part of the space an action is, and how many such parts there are, all as large; for each way to
        part it."""
        raise NotImplementedError

    def strangers(self) -> Sequence[Tried]:
        """Actions that are none of this space."""
        raise NotImplementedError

    def assert_least_like(self, places: list[int], tried: Sequence[Tried], actions: Facts) -> None:
        """Check which of some actions are least like those that were tried, in the order in which they were."""
        raise NotImplementedError

    # ---- helpers ----

    def assert_inside(self, space: Space, actions: Facts) -> None:
        for values in actions.values():
            assert (values.dtype, values.ndim) == (np.float64, 1)
        for place in range(count(actions)):
            assert self.holds(space.values(actions, place), space.choice(actions, place))

    def smooth(self, target: Numbers, *, by_support: bool = False) -> Callable[[Facts], Foreseen]:
        """A promise that is greatest at a target (actuators,), each from 0 to 1, and less with the distance."""

        def foresees(actions: Facts) -> Foreseen:
            loss = np.square(self.unit(actions) - target).sum(axis=1)
            return foreseen(np.ones(len(loss)), np.exp(-loss)) if by_support else foreseen(-loss)

        return foresees

    def unit(self, actions: Facts) -> Numbers:
        """Where actions lie between the ends (n, actuators), from 0 to 1."""
        low, high = np.array(list(self.ends.values())).T
        return (np.column_stack([actions[name] for name in self.ends]) - low) / (high - low)

    def targets(self) -> list[Numbers]:
        """Some places for the best, corners of the space among them."""
        ends = len(self.ends)
        inside = [rng(seed).random(ends) for seed in range(30)]
        return inside + [rng(seed).integers(0, 2, ends).astype(np.float64) for seed in range(10)]

    def tries(self, space: Space, notes: Sequence[int | None], seed: int) -> Mapping[int | None, list[Tried]]:
        """Try a random action under each of some notes, one after the other; return those of each note."""
        random, tried = rng(seed), defaultdict(list)
        for iteration, note in enumerate(notes):
            action = space.random(random)
            one = space.values(action, 0), space.choice(action, 0)
            space.remember(note, iteration, *one)
            tried[note].append(one)
        return tried

    @staticmethod
    def some(space: Space, seed: int = 0) -> Facts:
        """The actions that are looked at where all promise as much."""
        looked = space.look(flat, rng(seed))
        assert looked is not None
        return looked[0]

    # ---- any ----

    def test_its_actuators_are_told(self) -> None:
        assert self.make().actuators == tuple(self.ends)

    def test_a_random_action_is_one_of_the_space_and_the_same_for_the_same_numbers(self) -> None:
        space = self.make()

        @fixed
        @given(SEEDS)
        def check(seed: int) -> None:
            action = space.random(rng(seed))
            assert count(action) == 1
            self.assert_inside(space, action)
            assert_same(action, space.random(rng(seed)))

        check()

    def test_random_actions_are_spread_evenly_over_all_of_it(self) -> None:
        space, random = self.make(), rng()
        drawn = [space.random(random) for _ in range(DRAWN)]
        where = [self.parts(space.values(action, 0), space.choice(action, 0)) for action in drawn]
        for parts in zip(*where, strict=True):
            (parted,) = {so_many for _, so_many in parts}
            found = Counter(part for part, _ in parts)
            expected = DRAWN / parted
            assert found.keys() == set(range(parted))
            assert 0.8 * expected < min(found.values()) <= max(found.values()) < 1.2 * expected

    # ---- what is looked at ----

    def test_all_that_is_looked_at_is_of_the_space_and_was_foreseen(self) -> None:
        @fixed
        @given(SEEDS, st.sampled_from([7, 16, EVALUATIONS]))
        def check(seed: int, evaluations: int) -> None:
            space, foresight = self.make(evaluations), Foresight(rough(seed))
            looked = space.look(foresight, rng(seed))
            assert looked is not None
            actions, told = looked
            self.assert_inside(space, actions)
            assert count(actions) >= 1
            joined = {name: np.concatenate([asked[name] for asked in foresight.asked]) for name in actions}
            assert_same(joined, actions)
            for given_, expected in zip(told, rough(seed)(actions), strict=True):
                assert given_ == pytest.approx(expected), "each is told of its own action"

        check()

    def test_nothing_is_looked_at_where_nothing_can_be_foreseen(self) -> None:
        asked = Foresight(rough(1))
        assert self.make().look(asked, rng()) is not None
        for question in range(len(asked.asked)):
            assert self.make().look(Foresight(rough(1), nothing_at=question), rng()) is None

    def test_the_same_numbers_look_at_the_same_and_looking_changes_nothing(self) -> None:
        space, other = self.make(), self.make()

        @fixed
        @given(SEEDS)
        def check(seed: int) -> None:
            looked = [one.look(rough(seed), rng(seed)) for one in (space, space, other)]
            for again in looked[1:]:
                assert again is not None
                assert looked[0] is not None
                assert_same(looked[0][0], again[0])
                assert np.array_equal(looked[0][1].promise, again[1].promise)

        check()
        assert space.longest_ago(None, self.some(space)).tolist() == list(range(count(self.some(space))))

    def test_nothing_that_is_looked_at_may_be_changed_by_another_look(self) -> None:
        space = self.make()
        first = self.some(space, 1)
        kept = {name: values.copy() for name, values in first.items()}
        self.some(space, 2)
        assert_same(first, kept)

    # ---- values ----

    def test_an_actions_values_are_those_of_its_place(self) -> None:
        space = self.make()
        actions = self.some(space)
        for place in range(count(actions)):
            values = space.values(actions, place)
            assert list(values) == list(self.ends)
            assert all(type(value) is float for value in values.values())
            assert values == {name: actions[name][place] for name in self.ends}

    # ---- what was tried ----

    def test_what_is_least_like_what_was_tried_under_a_note_is_told(self) -> None:
        @fixed
        @given(SEEDS, st.lists(NOTES, max_size=20), NOTES)
        def check(seed: int, notes: list[int | None], asked: int | None) -> None:
            space = self.make()
            tried = self.tries(space, notes, seed).get(asked, [])
            actions = self.some(space, seed)
            places = space.longest_ago(asked, actions).tolist()
            assert places == sorted(set(places))
            assert set(places) <= set(range(count(actions)))
            assert len(places) >= 1
            if tried:
                self.assert_least_like(places, tried, actions)
            else:
                assert places == list(range(count(actions))), "all are as unlike nothing"

        check()

    def test_to_ask_changes_nothing(self) -> None:
        space = self.make()
        self.tries(space, [0, None, 0], 3)
        actions = self.some(space)
        for note in (0, None, 2):
            assert space.longest_ago(note, actions).tolist() == space.longest_ago(note, actions).tolist()

    def test_what_is_none_of_the_space_is_passed_over(self) -> None:
        for values, choice in self.strangers():
            space = self.make()
            actions = self.some(space)
            space.remember(0, 1, values, choice)
            assert space.longest_ago(0, actions).tolist() == list(range(count(actions))), (values, choice)
            tried = self.tries(space, [0, 0, 0], 5)[0]
            before = space.longest_ago(0, actions).tolist()
            space.remember(0, 9, values, choice)
            assert space.longest_ago(0, actions).tolist() == before
            self.assert_least_like(before, tried, actions)


class ChoicesConformance(SpaceConformance):
    """The suite for a space of some actions: all are looked at, and the best of them is found exactly."""

    choices: Sequence[Values]

    def make(self, evaluations: int = EVALUATIONS) -> Space:
        del evaluations
        return Choices(self.choices)

    def holds(self, values: Values, choice: int | None) -> bool:
        return choice is not None and values == self.choices[choice]

    def parts(self, values: Values, choice: int | None) -> Sequence[tuple[int, int]]:
        del values
        assert choice is not None
        return [(choice, len(self.choices))]

    def strangers(self) -> Sequence[Tried]:
        unknown: list[Tried] = [({}, choice) for choice in (None, -1, len(self.choices), 1023)]
        return [*unknown, (dict(self.choices[0]), None), (dict(self.choices[0]), len(self.choices))]

    def assert_least_like(self, places: list[int], tried: Sequence[Tried], actions: Facts) -> None:
        del actions
        last = {choice: iteration for iteration, (_, choice) in enumerate(tried)}
        ago = [last.get(choice, -1) for choice in range(len(self.choices))]
        assert places == [choice for choice, iteration in enumerate(ago) if iteration == min(ago)]

    def test_all_are_looked_at_at_once_in_their_order_and_no_number_is_drawn(self) -> None:
        space, random, foresight = self.make(), rng(), Foresight(rough(3))
        looked = space.look(foresight, random)
        assert looked is not None
        actions, _ = looked
        assert len(foresight.asked) == 1
        assert [space.choice(actions, place) for place in range(count(actions))] == list(range(len(self.choices)))
        assert random.random() == rng().random()

    def test_a_random_action_takes_one_number(self) -> None:
        one, other = rng(), rng()
        self.make().random(one)
        other.integers(len(self.choices))
        assert one.random() == other.random()

    @pytest.mark.parametrize("by_support", [False, True])
    def test_the_best_is_found_exactly(self, by_support: bool) -> None:
        everything = {name: np.array([choice[name] for choice in self.choices]) for name in self.ends}
        for target in self.targets():
            promise = self.smooth(target, by_support=by_support)
            looked = self.make().look(promise, rng())
            assert looked is not None
            best = int(np.argmax(promise(everything).promise))
            assert int(np.argmax(looked[1].promise)) == best

    def test_a_choice_can_be_remembered_by_its_place_alone(self) -> None:
        whole, bare = self.make(), self.make()
        for iteration, choice in enumerate([1, 0, 1]):
            whole.remember(None, iteration, dict(self.choices[choice]), choice)
            bare.remember(None, iteration, {}, choice)
        actions = self.some(whole)
        assert whole.longest_ago(None, actions).tolist() == bare.longest_ago(None, actions).tolist()


class RangesConformance(SpaceConformance):
    """The suite for a space of ranges: few points are looked at, and the best of them is near the best."""

    method: str
    near = 0.02
    """How far from the best the best of 64 points is usually, as a share of the ranges; it is never ..."""
    never = 0.05
    """... further than this."""

    def make(self, evaluations: int = EVALUATIONS) -> Space:
        return self.make_of(self.ends, evaluations)

    def make_of(self, ends: Mapping[str, tuple[float, float]], evaluations: int) -> Space:
        if self.method == "cma":
            pytest.importorskip("cmaes")
        return Ranges(ends, self.method, evaluations)

    def holds(self, values: Values, choice: int | None) -> bool:
        inside = (self.ends[name][0] <= value <= self.ends[name][1] for name, value in values.items())
        return choice is None and values.keys() == self.ends.keys() and all(inside)

    def parts(self, values: Values, choice: int | None) -> Sequence[tuple[int, int]]:
        del choice
        (unit,) = self.unit({name: np.array([value]) for name, value in values.items()})
        tenths = [(min(int(10 * share), 9), 10) for share in unit]
        halves = [int(share >= 0.5) for share in unit]
        return [*tenths, (sum(half << i for i, half in enumerate(halves)), 2 ** len(halves))]

    def strangers(self) -> Sequence[Tried]:
        middle = {name: (low + high) / 2 for name, (low, high) in self.ends.items()}
        lacking: list[Tried] = [
            ({name: value for name, value in middle.items() if name != gone}, None) for gone in middle
        ]
        return [({}, None), ({}, 0), ({"other": 0.0}, None), *lacking]

    def assert_least_like(self, places: list[int], tried: Sequence[Tried], actions: Facts) -> None:
        known = self.unit({name: np.array([values[name] for values, _ in tried]) for name in self.ends})
        gaps = [float(np.linalg.norm(known - point, axis=1).min()) for point in self.unit(actions)]
        assert [gaps[place] for place in places] == pytest.approx([max(gaps)] * len(places))

    def test_no_more_points_are_looked_at_than_is_allowed_and_some_however_few(self) -> None:
        @fixed
        @given(SEEDS, st.integers(2, 40))
        def check(seed: int, evaluations: int) -> None:
            space = self.make(evaluations)
            looked = space.look(rough(seed), rng(seed))
            assert looked is not None
            assert 1 <= count(looked[0]) <= evaluations

        check()

    def test_points_at_the_ends_are_not_beyond_them(self) -> None:
        """Not even by rounding: what is beyond is no action of the experiment."""

        @fixed
        @given(st.lists(st.tuples(TENTHS, TENTHS), min_size=len(self.ends), max_size=len(self.ends)), SEEDS)
        def check(drawn: list[tuple[float, float]], seed: int) -> None:
            ends = {
                name: (min(pair), max(pair) + (pair[0] == pair[1]))
                for name, pair in zip(self.ends, drawn, strict=True)
            }

            def outwards(actions: Facts) -> Foreseen:
                return foreseen(np.sum([(-1) ** (seed >> i) * actions[name] for i, name in enumerate(ends)], axis=0))

            looked = self.make_of(ends, EVALUATIONS).look(outwards, rng(seed))
            assert looked is not None
            for name, (low, high) in ends.items():
                assert low <= looked[0][name].min()
                assert looked[0][name].max() <= high

        check()

    @pytest.mark.parametrize("by_support", [False, True])
    def test_the_best_is_nearly_found(self, by_support: bool) -> None:
        missed = self.missed(EVALUATIONS, by_support=by_support)
        assert np.median(missed) < self.near
        assert max(missed) < self.never

    def test_the_best_is_found_better_with_more_points(self) -> None:
        missed = self.missed(4 * EVALUATIONS)
        assert np.median(missed) < 0.02
        assert max(missed) < 0.1

    def missed(self, evaluations: int, *, by_support: bool = False) -> list[float]:
        """How far from each target the best point is that was looked at, as a share of the ranges."""
        missed = []
        for seed, target in enumerate(self.targets()):
            looked = self.make(evaluations).look(self.smooth(target, by_support=by_support), rng(seed))
            assert looked is not None
            best = self.unit(looked[0])[int(np.argmax(looked[1].promise))]
            missed.append(float(np.abs(best - target).max()))
        return missed

    def test_other_numbers_look_at_other_points(self) -> None:
        space = self.make()
        assert not np.array_equal(self.unit(self.some(space, 1)), self.unit(self.some(space, 2)))

    def test_where_all_promise_as_much_all_of_the_space_is_looked_at_sooner_or_later(self) -> None:
        points = np.concatenate([self.unit(self.some(self.make(), seed)) for seed in range(10)])
        assert (points.min(axis=0) < 0.1).all()
        assert (points.max(axis=0) > 0.9).all()

    def test_points_beyond_the_ends_are_none_of_the_space(self) -> None:
        space = self.make()
        actions = self.some(space)
        for name, (low, high) in self.ends.items():
            middle = {other: (below + above) / 2 for other, (below, above) in self.ends.items()}
            for beyond in (low - 0.1 * (high - low), high + 0.1 * (high - low)):
                space.remember(0, 1, middle | {name: beyond}, None)
        assert space.longest_ago(0, actions).tolist() == list(range(count(actions)))

    def test_what_was_tried_long_ago_is_forgotten(self) -> None:
        space = self.make()
        low, high = ({name: ends[side] for name, ends in self.ends.items()} for side in (0, 1))
        actions = self.some(space)
        space.remember(None, 0, low, None)
        for iteration in range(REMEMBERED - 1):
            space.remember(None, iteration + 1, high, None)
        self.assert_least_like(space.longest_ago(None, actions).tolist(), [(low, None), (high, None)], actions)
        space.remember(None, REMEMBERED, high, None)
        self.assert_least_like(space.longest_ago(None, actions).tolist(), [(high, None)], actions)
