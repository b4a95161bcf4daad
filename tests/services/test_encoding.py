"""From what was sensed, heard, done and felt to rows, and back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_services.mechanism.networks.encoding import Channel, Codebook, gather

fixed = settings(derandomize=True, deadline=None, max_examples=60)

CHANNELS = {
    "distance": Channel(low=0.0, high=2.0),
    "next.distance": Channel(low=0.0, high=2.0),
    "covered.distance": Channel(low=-0.5, high=0.5),
    "note": Channel(encoding="one_hot", size=3),
    "action": Channel(encoding="rank", values=(0, -20, 20)),
    "feedback": Channel(),
}


def values(*numbers: float) -> np.ndarray:
    return np.array(numbers, np.float64)


@fixed
@given(st.floats(-100, 100), st.floats(0.01, 100), st.floats(0, 1))
def test_a_scalar_comes_back_and_its_ends_are_one(low: float, width: float, share: float) -> None:
    channel = Channel(low=low, high=low + width)
    value = low + share * width
    encoded = channel.encode(values(low, low + width, value))
    assert encoded.shape == (3, 1)
    assert encoded.dtype == np.float32
    assert encoded[:2, 0].tolist() == pytest.approx([-1, 1], abs=1e-5)
    assert channel.decode(encoded).shape == (3,)
    assert channel.decode(encoded)[2] == pytest.approx(value, abs=1e-5 * (abs(low) + width))


def test_values_far_out_are_cut_off() -> None:
    assert CHANNELS["distance"].encode(values(-50, 50))[:, 0].tolist() == [-1.5, 1.5]


@fixed
@given(st.lists(st.integers(-1000, 1000), min_size=2, max_size=9, unique=True))
def test_a_rank_follows_the_order_of_the_values(meant: list[int]) -> None:
    channel = Channel(encoding="rank", values=tuple(float(value) for value in meant))
    encoded = channel.encode(np.arange(len(meant), dtype=np.float64))[:, 0]
    assert np.argsort(encoded).tolist() == np.argsort(meant).tolist()
    assert (encoded.min(), encoded.max()) == (-1, 1)
    assert np.diff(np.sort(encoded)) == pytest.approx(2 / (len(meant) - 1), abs=1e-6)


def test_a_note_is_one_column_of_its_own() -> None:
    assert CHANNELS["note"].encode(values(2, 0)).tolist() == [[0, 0, 1], [1, 0, 0]]


@pytest.mark.parametrize("name", ["note", "action"])
@pytest.mark.parametrize("index", [3, 127, -1, 0.5])
def test_an_index_that_the_channel_lacks_is_like_one_that_is_missing(name: str, index: float) -> None:
    book = Codebook(CHANNELS, ["note", "action"], ["feedback"])
    facts = gather(note=1, choice=1, feedback=1.0)
    assert book.input_rows(facts) is not None
    assert book.input_rows(facts | {name: values(index)}) is None
    assert book.input_rows({"note": values(0, 0), "action": values(0, 0)} | {name: values(0, index)}) is None


@pytest.mark.parametrize(
    "fields",
    [
        {"low": 1.0, "high": 1.0}, {"low": float("nan")}, {"high": float("inf")}, {"encoding": "one_hot"},
        {"encoding": "rank", "values": (1.0,)}, {"encoding": "rank", "values": (1.0, float("nan"))},
        {"numbers": 0}, {"encoding": "one_hot", "size": 3, "numbers": 2},
        {"encoding": "rank", "values": (0.0, 1.0), "numbers": 3},
    ],
)  # fmt: skip
def test_channels_that_cannot_scale_are_refused(fields: dict) -> None:
    with pytest.raises(ValueError, match=r"expected|needs"):
        Channel(**fields)


@pytest.mark.parametrize(
    ("channel", "words"),
    [
        (Channel(), "scalar -1 to 1"),
        (Channel(low=0.0, high=2.5), "scalar 0 to 2.5"),
        (Channel(encoding="one_hot", size=7), "one_hot of 7"),
        (Channel(encoding="rank", values=(0, -20, 20)), "rank of 0, -20, 20"),
        (Channel(encoding="rank", values=(0, -22.5)), "rank of 0, -22.5"),
        (Channel(low=0.0, numbers=24), "24 times scalar 0 to 1"),
    ],
)
def test_a_channel_says_how_it_becomes_numbers(channel: Channel, words: str) -> None:
    assert channel.describe() == words


channels = st.one_of(
    st.builds(
        Channel,
        low=st.integers(-3, 0).map(float),
        high=st.integers(1, 3).map(float),
        numbers=st.integers(1, 2),
    ),
    st.builds(Channel, encoding=st.just("one_hot"), size=st.integers(1, 3)),
    st.builds(
        Channel,
        encoding=st.just("rank"),
        values=st.lists(st.integers(-2, 2).map(float), min_size=2, max_size=3, unique=True).map(tuple),
    ),
)


@settings(derandomize=True, deadline=None, max_examples=300)
@given(channels, channels)
def test_equal_words_mean_equal_numbers(one: Channel, other: Channel) -> None:
    if one.describe() == other.describe():
        index = np.ones((2, one.numbers)) if one.numbers > 1 else values(*range(one.indices or 2))
        assert np.array_equal(one.encode(index), other.encode(index))
        assert one == other


def test_facts_hold_what_was_there_and_nothing_else() -> None:
    facts = gather(
        before={"distance": 1.0, "angle": 0.2},
        after={"distance": 0.75},
        action={"turn": -20.0, "speed": 0.5},
        choice=2,
    )
    assert {name: value.tolist() for name, value in facts.items()} == {
        "distance": [1.0], "angle": [0.2], "next.distance": [0.75], "covered.distance": [0.25], "turn": [-20.0],
        "speed": [0.5], "action": [2.0],
    }  # fmt: skip
    assert gather(action={"turn": 0.0}).keys() == {"turn"}, "no choice, where there are none"
    assert gather() == {}
    assert "note" in gather(note=0)
    assert gather(feedback=0.0)["feedback"].tolist() == [0.0]


def test_a_sensor_cannot_speak_for_the_teacher() -> None:
    sensed = {"note": 1.0, "feedback": 1.0, "action": 1.0, "next.distance": 1.0, "covered.distance": 1.0}
    assert gather(before=sensed, after=sensed) == {}
    assert gather(before=sensed, note=2)["note"].tolist() == [2.0]


def test_a_sensor_cannot_speak_for_an_actuator_that_was_used() -> None:
    facts = gather(before={"turn": 1.0, "distance": 2.0}, action={"turn": 90.0}, choice=1)
    assert facts["turn"].tolist() == [90.0]


@pytest.mark.parametrize("missing", ["distance", "action"])
def test_a_missing_input_gives_no_row(missing: str) -> None:
    book = Codebook(CHANNELS, ["distance", "action"], ["next.distance"])
    facts = gather(before={"distance": 1.0}, after={"distance": 0.5}, choice=1)
    assert book.input_rows(facts) is not None
    assert book.input_rows({k: v for k, v in facts.items() if k != missing}) is None
    assert book.target_rows({k: v for k, v in facts.items() if k != "next.distance"}) is None


def test_rows_hold_the_inputs_side_by_side_and_targets_end_at_one() -> None:
    book = Codebook(CHANNELS, ["note", "distance", "action"], ["next.distance", "feedback"])
    facts = gather(before={"distance": 2.0}, after={"distance": 5.0}, note=1, choice=2, feedback=-1.0)
    assert (book.width, book.output_width) == (5, 2)
    assert book.input_rows(facts).tolist() == [[0, 1, 0, 1, 1]]
    assert book.target_rows(facts).tolist() == [[1, -1]]


@fixed
@given(st.floats(0, 2), st.floats(-1, 1))
def test_predictions_come_back_in_the_variables_units(distance: float, feedback: float) -> None:
    book = Codebook(CHANNELS, ["action"], ["next.distance", "feedback"])
    targets = book.target_rows(gather(after={"distance": distance}, feedback=feedback))
    predicted = book.predicted(targets)
    assert predicted["next.distance"][0] == pytest.approx(distance, abs=1e-5)
    assert predicted["feedback"][0] == pytest.approx(feedback, abs=1e-5)


def test_codebooks_without_usable_channels_are_refused() -> None:
    with pytest.raises(KeyError, match="no channel"):
        Codebook(CHANNELS, ["sound"], ["feedback"])
    with pytest.raises(ValueError, match="must be scalar"):
        Codebook(CHANNELS, ["distance"], ["action"])


def test_the_same_action_can_be_read_as_its_rank_and_by_its_value() -> None:
    book = Codebook(CHANNELS | {"turn": Channel(low=-20.0, high=60.0)}, ["turn", "action"], ["feedback"])
    rows = [book.input_rows(gather(action={"turn": turned}, choice=i)) for i, turned in enumerate((0.0, -20.0, 20.0))]
    assert np.concatenate(rows) == pytest.approx(np.array([[-0.5, 0], [-1, -1], [0, 1]]))
    assert book.input_rows(gather(choice=1)) is None
    assert book.input_rows(gather(action={"turn": 0.0})) is None


# ---- vectors ----

SONAR = Channel(low=0.0, high=4.0, numbers=3)
VECTORS = CHANNELS | {"sonar": SONAR, "next.sonar": SONAR, "covered.sonar": Channel(low=-2.0, high=2.0, numbers=3)}
vectors = st.integers(1, 6).flatmap(
    lambda n: st.tuples(
        st.integers(2, 5).flatmap(
            lambda k: st.lists(st.lists(st.floats(0, 1), min_size=k, max_size=k), min_size=n, max_size=n)
        ),
        st.floats(-100, 100),
        st.floats(0.01, 100),
    )
)
"""Some vectors of one length, in shares of the range from a lowest value on, and how wide it is."""


@fixed
@given(vectors)
def test_a_vector_comes_back_number_by_number_and_each_is_scaled_alike(drawn: tuple[list, float, float]) -> None:
    shares, low, width = np.array(drawn[0]), drawn[1], drawn[2]
    channel, single = Channel(low=low, high=low + width, numbers=shares.shape[1]), Channel(low=low, high=low + width)
    meant = low + shares * width
    assert channel.has(meant)
    encoded = channel.encode(meant)
    assert (encoded.shape, encoded.dtype, channel.width) == (shares.shape, np.float32, shares.shape[1])
    assert encoded == pytest.approx(np.column_stack([single.encode(column) for column in meant.T]))
    assert encoded == pytest.approx(2 * shares - 1, abs=1e-5)
    assert channel.decode(encoded) == pytest.approx(meant, abs=1e-5 * (abs(low) + width))


def test_numbers_of_a_vector_that_are_far_out_are_cut_off_one_by_one() -> None:
    assert SONAR.encode(np.array([[-50.0, 2.0, 50.0]])).tolist() == [[-1.5, 0, 1.5]]


def test_facts_of_a_vector_hold_all_its_numbers_and_their_changes() -> None:
    facts = gather(before={"sonar": [1.0, 2.0, 3.0], "distance": 1.0}, after={"sonar": [0.5, 2.0, 4.0]})
    assert {name: value.tolist() for name, value in facts.items()} == {
        "sonar": [[1.0, 2.0, 3.0]], "distance": [1.0], "next.sonar": [[0.5, 2.0, 4.0]],
        "covered.sonar": [[0.5, 0.0, -1.0]],
    }  # fmt: skip


def test_a_vector_stands_in_its_columns_beside_the_other_variables() -> None:
    book = Codebook(VECTORS, ["note", "sonar", "distance"], ["next.distance", "covered.sonar", "feedback"])
    facts = gather(
        before={"sonar": [0.0, 2.0, 4.0], "distance": 2.0}, after={"sonar": [1.0, 2.0, 9.0], "distance": 1.0}, note=2,
        feedback=-1.0,
    )  # fmt: skip
    assert (book.width, book.output_width) == (7, 5)
    assert book.input_rows(facts).tolist() == [[0, 0, 1, -1, 0, 1, 1]]
    assert book.target_rows(facts).tolist() == [[0, -0.5, 0, -1, -1]], "cut off where targets end"
    assert [book.column(output) for output in book.outputs] == [0, 1, 4]


@fixed
@given(
    st.lists(st.sampled_from(["next.distance", "next.sonar", "covered.sonar", "feedback"]), min_size=1, unique=True)
)
def test_an_outputs_column_is_where_its_numbers_begin(outputs: list[str]) -> None:
    book = Codebook(VECTORS, ["note"], outputs)
    facts = gather(
        after={"distance": 1.5, "sonar": [0.5, 1.0, 3.0]}, before={"sonar": [1.0, 2.0, 3.5]}, feedback=0.25
    )
    (row,) = book.target_rows(facts)
    assert len(row) == book.output_width
    predicted = book.predicted(row[None])
    assert list(predicted) == outputs
    for output in outputs:
        width = VECTORS[output].width
        part = row[book.column(output) : book.column(output) + width]
        assert part == pytest.approx(VECTORS[output].encode(facts[output])[0])
        assert predicted[output] == pytest.approx(facts[output], abs=1e-5)
        assert predicted[output].shape == facts[output].shape


@pytest.mark.parametrize("sonar", [[], [1.0], [1.0, 2.0], [1.0] * 4, 1.0])
def test_a_vector_of_another_length_gives_no_row_and_no_change(sonar: list[float] | float) -> None:
    book = Codebook(VECTORS, ["sonar"], ["next.sonar"])
    whole = [1.0, 2.0, 3.0]
    assert book.input_rows(gather(before={"sonar": whole})) is not None
    assert book.input_rows(gather(before={"sonar": sonar})) is None
    assert book.target_rows(gather(after={"sonar": sonar})) is None
    changed = gather(before={"sonar": whole}, after={"sonar": sonar})
    assert "covered.sonar" not in changed
    assert Codebook(VECTORS, ["sonar"], ["covered.sonar"]).target_rows(changed) is None


@pytest.mark.parametrize("distance", [[], [1.0], [1.0, 2.0]])
def test_a_vector_in_the_place_of_a_number_gives_no_row(distance: list[float]) -> None:
    book = Codebook(VECTORS, ["distance"], ["next.distance"])
    facts = gather(before={"distance": distance}, after={"distance": distance})
    assert (book.input_rows(facts), book.target_rows(facts)) == (None, None)


@fixed
@given(st.integers(0, 12), st.integers(0, 12), st.lists(st.integers(0, 5), max_size=2))
def test_a_network_fits_by_the_numbers_in_and_out_and_else_it_is_said(ins: int, outs: int, hidden: list[int]) -> None:
    book = Codebook(VECTORS, ["note", "sonar"], ["next.sonar", "feedback"])
    said = book.misfit([ins, *hidden, outs])
    assert (said is None) == ((ins, outs) == (6, 4))
    if said is not None:
        assert said == f"layers {[ins, *hidden, outs]}; expected 6 numbers in and 4 out"
