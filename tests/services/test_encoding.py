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
    assert channel.decode(encoded[:, 0])[2] == pytest.approx(value, abs=1e-5 * (abs(low) + width))


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
    facts = gather(note=1, action=1, feedback=1.0)
    assert book.input_rows(facts) is not None
    assert book.input_rows(facts | {name: values(index)}) is None
    assert book.input_rows({"note": values(0, 0), "action": values(0, 0)} | {name: values(0, index)}) is None


@pytest.mark.parametrize(
    "fields",
    [
        {"low": 1.0, "high": 1.0}, {"low": float("nan")}, {"high": float("inf")}, {"encoding": "one_hot"},
        {"encoding": "rank", "values": (1.0,)}, {"encoding": "rank", "values": (1.0, float("nan"))},
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
        (Channel(encoding="value", values=(0, -22.5), of="action"), "value of 0, -22.5"),
    ],
)
def test_a_channel_says_how_it_becomes_numbers(channel: Channel, words: str) -> None:
    assert channel.describe() == words


channels = st.one_of(
    st.builds(Channel, low=st.integers(-3, 0).map(float), high=st.integers(1, 3).map(float)),
    st.builds(Channel, encoding=st.just("one_hot"), size=st.integers(1, 3)),
    st.builds(
        Channel,
        encoding=st.sampled_from(["rank", "value"]),
        values=st.lists(st.integers(-2, 2).map(float), min_size=2, max_size=3, unique=True).map(tuple),
    ),
)


@settings(derandomize=True, deadline=None, max_examples=300)
@given(channels, channels)
def test_equal_words_mean_equal_numbers(one: Channel, other: Channel) -> None:
    if one.describe() == other.describe():
        index = values(*range(one.indices or 2))
        assert np.array_equal(one.encode(index), other.encode(index))
        assert one == other


def test_facts_hold_what_was_there_and_nothing_else() -> None:
    facts = gather(before={"distance": 1.0, "angle": 0.2}, after={"distance": 0.75}, action=2)
    assert {name: value.tolist() for name, value in facts.items()} == {
        "distance": [1.0], "angle": [0.2], "next.distance": [0.75], "covered.distance": [0.25], "action": [2.0],
    }  # fmt: skip
    assert gather() == {}
    assert "note" in gather(note=0)
    assert gather(feedback=0.0)["feedback"].tolist() == [0.0]


def test_a_sensor_cannot_speak_for_the_teacher() -> None:
    sensed = {"note": 1.0, "feedback": 1.0, "action": 1.0, "next.distance": 1.0, "covered.distance": 1.0}
    assert gather(before=sensed, after=sensed) == {}
    assert gather(before=sensed, note=2)["note"].tolist() == [2.0]


@pytest.mark.parametrize("missing", ["distance", "action"])
def test_a_missing_input_gives_no_row(missing: str) -> None:
    book = Codebook(CHANNELS, ["distance", "action"], ["next.distance"])
    facts = gather(before={"distance": 1.0}, after={"distance": 0.5}, action=1)
    assert book.input_rows(facts) is not None
    assert book.input_rows({k: v for k, v in facts.items() if k != missing}) is None
    assert book.target_rows({k: v for k, v in facts.items() if k != "next.distance"}) is None


def test_rows_hold_the_inputs_side_by_side_and_targets_end_at_one() -> None:
    book = Codebook(CHANNELS, ["note", "distance", "action"], ["next.distance", "feedback"])
    facts = gather(before={"distance": 2.0}, after={"distance": 5.0}, note=1, action=2, feedback=-1.0)
    assert book.width == 5
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


def test_a_second_reading_of_a_variable_scales_its_value_by_size() -> None:
    turn = Channel(encoding="value", values=(0, -20, 20, 60), of="action")
    book = Codebook(CHANNELS | {"turn": turn}, ["turn"], ["feedback"])
    rows = book.input_rows({"action": values(0, 1, 2, 3)})
    assert rows[:, 0].tolist() == pytest.approx([-0.5, -1, 0, 1])
    assert book.input_rows({"action": values(4)}) is None
    assert book.input_rows({"turn": values(1)}) is None
