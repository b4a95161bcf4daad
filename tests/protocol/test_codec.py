"""The codec: every message comes back as it went; anything else is a DecodeError and nothing but."""

import math
import tracemalloc
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdb_protocol import codec, messages
from mdb_protocol.errors import DecodeError
from mdb_protocol.messages import Message
from tests.protocol.samples import SAMPLES, TYPES, fixed

every_message = pytest.mark.parametrize("cls", TYPES, ids=lambda cls: cls.__name__)


def same(one: Any, other: Any) -> bool:
    """Equality field by field: structs that hold arrays cannot be compared with ==."""
    if isinstance(one, np.ndarray):
        return isinstance(other, np.ndarray) and one.dtype == other.dtype and np.array_equal(one, other)
    if isinstance(one, Message):
        return type(one) is type(other) and all(
            same(getattr(one, field), getattr(other, field)) for field in one.__struct_fields__
        )
    if isinstance(one, list):
        return isinstance(other, list) and len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict):
        return isinstance(other, dict) and one.keys() == other.keys() and all(same(one[k], other[k]) for k in one)
    return bool(one == other)


def accepted(cls: type[Message], payload: bytes) -> Message | None:
    """The message, whole, or None when it was refused with the one error that is allowed."""
    try:
        message = codec.decode(cls, payload, codec.encoding_of(cls))
    except DecodeError:
        return None
    assert same(codec.decode(cls, codec.encode(message), codec.encoding_of(cls)), message)
    return message


def packed(cls: type[Message], **fields: Any) -> bytes:
    """The bytes of a valid message with some fields put to what no class would let through."""
    plain = {
        messages.Action: {"iteration": 1, "action": {"turn": 1.0}, "valid_for_s": 1.0},
        messages.Command: {"teacher": "anna", "iteration": 1, "note": 1},
        messages.Feedback: {"teacher": "anna", "iteration": 1, "value": 0.5},
        messages.Perception: {"iteration": 1, "event": "none", "outcome": {}, "reading": {"distance": 1.0}},
        messages.Pair: {
            "iteration": 1, "before": {}, "note": 1, "action": {"turn": 1.0}, "after": {}, "feedback": 1.0,
            "versions": {},
        },
        messages.Scene: {
            "iteration": 1, "episode": 1, "successes": 0, "event": "none", "action": {"turn": 1.0},
            "before": {"x": 1.0}, "reached": {"x": 1.0}, "now": {"x": 1.0},
        },
        messages.Picture: {"iteration": 1},
        messages.IterationReport: {
            "iteration": 1, "mode": "m", "action": {"turn": 1.0}, "explored": False, "predicted": 0.5, "note": None,
            "feedback": None, "event": "none", "prequential": {}, "versions": {},
        },
        messages.Timing: {"iteration": 1, "perception_to_action_s": 0.1, "cycle_s": 0.1},
        messages.Finished: {"iterations": 1},
        messages.MemoryChange: {
            "model": "m", "version": 1, "slots": array("<i8", [1], bytes(8)), "pairs": array("<i8", [1], bytes(8)),
            "inputs": array("<f4", [1, 1], bytes(4)), "targets": array("<f4", [1, 1], bytes(4)),
            "freed": array("<i8", [0], b""), "evicted": array("<i8", [0], b""),
        },
        messages.MemorySnapshot: {
            "model": "m", "version": 1, "slots": array("<i8", [1], bytes(8)), "pairs": array("<i8", [1], bytes(8)),
            "inputs": array("<f4", [1, 2], bytes(8)), "targets": array("<f4", [1, 1], bytes(4)),
        },
        messages.ContextEvent: {"model": "m", "iteration": 1, "kind": "changed"},
        messages.LongTermModel: {
            "id": 1, "model": "m", "reads": {"note": "one_hot of 3"}, "layers": [1, 1],
            "weights": array("<f4", [2], bytes(8)), "error": 0.5, "pairs": [],
        },
        messages.LongTermFile: {"models": []},
        messages.CurrentModel: {
            "model": "m", "version": 1, "generation": 1, "layers": [1, 1],
            "weights": array("<f4", [2], bytes(8)), "error": 0.5,
        },
    }[cls]  # fmt: skip
    return bytes(msgpack.packb(plain | fields))


def array(dtype: Any, shape: Any, raw: Any) -> msgpack.ExtType:
    return msgpack.ExtType(codec.ARRAY_EXT, msgpack.packb([dtype, shape, raw]))


def shape(**fields: Any) -> dict[str, Any]:
    return {"kind": "line", "points": [[0.0, 0.0], [1.0, 1.0]]} | fields


def drawing(**fields: Any) -> dict[str, Any]:
    return {"shapes": [shape()], "box": [0.0, 0.0, 1.0, 1.0]} | fields


def weights_of(value: float) -> dict[str, Any]:
    """A network in which one weight is what no class would let through."""
    return {"layers": [1, 1], "weights": array("<f8", [2], np.array([0, value]).tobytes())}


def test_every_class_that_is_encoded_has_samples() -> None:
    assert set(SAMPLES) == set(TYPES)


@every_message
def test_a_message_comes_back_as_it_went(cls: type[Message]) -> None:
    @fixed
    @given(SAMPLES[cls])
    def check(message: Message) -> None:
        back = codec.decode(cls, codec.encode(message), codec.encoding_of(cls))
        assert same(message, back)
        assert isinstance(codec.to_plain(back), dict)

    check()


@every_message
def test_random_bytes_are_refused_or_whole(cls: type[Message]) -> None:
    @fixed
    @given(st.binary(max_size=200))
    def check(payload: bytes) -> None:
        accepted(cls, payload)

    check()


@every_message
def test_truncated_messages_are_refused(cls: type[Message]) -> None:
    @fixed
    @given(SAMPLES[cls], st.floats(0, 1, exclude_max=True))
    def check(message: Message, share: float) -> None:
        payload = codec.encode(message)
        assert accepted(cls, payload[: int(len(payload) * share)]) is None
        assert accepted(cls, payload + b"\x00") is None

    check()


@every_message
def test_mutated_bytes_are_refused_or_whole(cls: type[Message]) -> None:
    @fixed
    @given(SAMPLES[cls], st.lists(st.tuples(st.integers(0, 2**16), st.integers(0, 255)), min_size=1, max_size=4))
    def check(message: Message, changes: list[tuple[int, int]]) -> None:
        payload = bytearray(codec.encode(message))
        for place, value in changes:
            payload[place % len(payload)] = value
        accepted(cls, bytes(payload))

    check()


texts = st.text(max_size=8)
plain_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | texts | st.binary(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts | st.binary(max_size=4), inner, max_size=3),
    max_leaves=6,
)


@every_message
def test_a_field_of_another_type_is_refused_or_whole(cls: type[Message]) -> None:
    fields = {field.name: field for field in msgspec.structs.fields(cls)}

    @fixed
    @given(SAMPLES[cls], st.sampled_from(sorted(fields)), plain_values)
    def check(message: Message, field: str, value: Any) -> None:
        plain = msgpack.unpackb(codec.encode(message))
        accepted(cls, msgpack.packb(plain | {field: value}))
        without = accepted(cls, msgpack.packb({k: v for k, v in plain.items() if k != field}))
        assert (without is None) == fields[field].required

    check()


@every_message
def test_unknown_fields_are_accepted_and_other_encodings_refused(cls: type[Message]) -> None:
    @fixed
    @given(SAMPLES[cls])
    def check(message: Message) -> None:
        payload = codec.encode(message)
        newer = msgpack.packb(msgpack.unpackb(payload) | {"field_of_tomorrow": [1, {"a": 2}]})
        right = codec.encoding_of(cls)
        assert same(codec.decode(cls, newer, right), message)
        for wrong in ("", "text/plain", of_version(cls, codec.VERSION - 1), right + "x", right.lower()):
            with pytest.raises(DecodeError, match="encoding is"):
                codec.decode(cls, payload, wrong)

    check()


def of_version(cls: type[Message], version: Any) -> str:
    """The encoding of a message class in another version of the protocol."""
    return codec.encoding_of(cls).replace(f"mdb={codec.VERSION};", f"mdb={version};")


def test_the_version_is_in_the_encoding() -> None:
    assert codec.encoding_of(messages.Finished) == "application/msgpack;mdb=2;Finished"


@fixed
@given(st.sampled_from(TYPES), st.integers(0, 10**9), st.data())
def test_a_minor_version_of_this_protocol_is_read(cls: type[Message], minor: int, data: st.DataObject) -> None:
    message = data.draw(SAMPLES[cls])
    newer = msgpack.packb(msgpack.unpackb(codec.encode(message)) | {"field_of_tomorrow": [1, {"a": 2}]})
    assert same(codec.decode(cls, newer, of_version(cls, f"{codec.VERSION}.{minor}")), message)


@pytest.mark.parametrize(
    "encoding",
    [
        *(f"application/msgpack;mdb={version};Finished" for version in (
            "", "0", "1", "3", "1.2", "3.0", "22", "2.", ".2", "2.x", "2.-1", "2.+1", "2.1.1", "2. 1", " 2.1", "2.1 ",
            "2,1", "2.1;mdb=2.1", "02.1",
        )),
        "application/msgpack;mdb=2.1;Phase",
        "application/msgpack;mdb=2.1;",
        "application/msgpack;mdb=2.1",
        "application/msgpack;mdb=2.1;Finished;",
        "application/msgpack;mdb=2.1;Finished\n",
        "application/msgpack;MDB=2.1;Finished",
        "text/plain;mdb=2.1;Finished",
        "mdb=2.1;Finished",
    ],
)  # fmt: skip
def test_any_other_version_and_what_is_none_is_refused(encoding: str) -> None:
    payload = packed(messages.Finished)
    assert accepted(messages.Finished, payload) is not None
    with pytest.raises(DecodeError, match="encoding is"):
        codec.decode(messages.Finished, payload, encoding)


@fixed
@given(st.text("2.0;mdb=Fxyz", max_size=12))
def test_no_other_words_in_the_place_of_the_version_are_taken_for_one(words: str) -> None:
    encoding = f"application/msgpack;mdb={words};Finished"
    major, dot, minor = words.partition(".")
    is_version = major == "2" and (not dot or minor.isdecimal())
    try:
        codec.decode(messages.Finished, packed(messages.Finished), encoding)
    except DecodeError:
        assert not is_version
    else:
        assert is_version


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("cls", "fields"),
    [
        (messages.Action, lambda v: {"valid_for_s": v}),
        (messages.Action, lambda v: {"stamp": v}),
        (messages.Perception, lambda v: {"stamp": v}),
        (messages.Feedback, lambda v: {"value": v}),
        (messages.Perception, lambda v: {"reading": {"distance": v}}),
        (messages.Perception, lambda v: {"outcome": {"distance": v}}),
        (messages.Perception, lambda v: {"reading": {"sonar": [0.0, v]}}),
        (messages.Perception, lambda v: {"outcome": {"sonar": [v]}}),
        (messages.Action, lambda v: {"action": {"turn": v}}),
        (messages.Pair, lambda v: {"action": {"turn": 0.0, "speed": v}}),
        (messages.Pair, lambda v: {"after": {"sonar": [0.0, v]}}),
        (messages.IterationReport, lambda v: {"action": {"turn": v}}),
        (messages.Scene, lambda v: {"action": {"turn": v}}),
        (messages.Scene, lambda v: {"before": {"x": v}}),
        (messages.Scene, lambda v: {"reached": {"x": v}}),
        (messages.Scene, lambda v: {"now": {"x": v}}),
        (messages.Picture, lambda v: {"drawing": drawing(box=[v, 0.0, 1.0, 1.0])}),
        (messages.Picture, lambda v: {"drawing": drawing(box=[0.0, 0.0, 1.0, v])}),
        (messages.Picture, lambda v: {"drawing": drawing(front_rad=v)}),
        (messages.Picture, lambda v: {"drawing": drawing(shapes=[shape(points=[[0.0, 0.0], [0.0, v]])])}),
        (messages.Picture, lambda v: {"drawing": drawing(shapes=[shape(radius=v)])}),
        (messages.Pair, lambda v: {"before": {"distance": v}}),
        (messages.Pair, lambda v: {"feedback": v}),
        (messages.CurrentModel, lambda v: {"error": v}),
        (messages.CurrentModel, lambda v: {"weights": array("<f8", [2], np.array([0, v]).tobytes())}),
        (messages.CurrentModel, lambda v: {"support": array("<f8", [1, 1], np.array([v]).tobytes())}),
        (messages.MemoryChange, lambda v: {"inputs": array("<f8", [1, 1], np.array([v]).tobytes())}),
        (messages.MemoryChange, lambda v: {"targets": array("<f8", [1, 1], np.array([v]).tobytes())}),
        (messages.MemoryChange, lambda v: {"seeds": [weights_of(v)]}),
        (messages.MemorySnapshot, lambda v: {"inputs": array("<f8", [1, 1], np.array([v]).tobytes())}),
        (messages.MemorySnapshot, lambda v: {"seeds": [weights_of(0.0), weights_of(v)]}),
        (messages.ContextEvent, lambda v: {"error": v}),
        (messages.LongTermModel, lambda v: {"error": v}),
        (messages.LongTermModel, weights_of),
        (messages.IterationReport, lambda v: {"predicted": v}),
        (messages.IterationReport, lambda v: {"feedback": v}),
        (messages.IterationReport, lambda v: {"prequential": {"object": v}}),
        (messages.Timing, lambda v: {"cycle_s": v}),
        (messages.Timing, lambda v: {"perception_to_action_s": v}),
    ],
)
def test_numbers_that_are_not_finite_are_refused(cls: type[Message], fields: Any, bad: float) -> None:
    assert accepted(cls, packed(cls)) is not None
    assert accepted(cls, packed(cls, **fields(bad))) is None


@pytest.mark.parametrize(
    "value",
    [
        array("<f4", [2, 1], bytes(4)),
        array("<f4", [1, 1], bytes(5)),
        array("<f4", [], bytes(4)),
        array("<f4", [1, 1, 1, 1, 1], bytes(4)),
        array("<f4", [-1, 1], bytes(4)),
        array("<f4", [True, 1], bytes(4)),
        array("<f4", [0, 2**64 - 1], b""),
        array("<f4", [2**62, 2**62, 0], b""),
        array("<f4", [2**40, 1], b""),
        array("<f4", [1], bytes(4)),
        array("<f4", [1, 1, 1], bytes(4)),
        array("<i8", [1, 1], bytes(8)),
        array("|O", [1, 1], bytes(8)),
        array("<c8", [1, 1], bytes(8)),
        array(["<f4"], [1, 1], bytes(4)),
        array("<f4", "11", bytes(4)),
        array("<f4", [1, 1], "abcd"),
        array("<f4", [1, 1], None),
        msgpack.ExtType(codec.ARRAY_EXT, b""),
        msgpack.ExtType(codec.ARRAY_EXT, b"\xc1"),
        msgpack.ExtType(codec.ARRAY_EXT, msgpack.packb({"a": 1})),
        msgpack.ExtType(codec.ARRAY_EXT, msgpack.packb([array("<f4", [1, 1], bytes(4))] * 3)),
        msgpack.ExtType(2, bytes(4)),
        msgpack.Timestamp(1, 2),
        [0.5],
        0.5,
        None,
    ],
    ids=range(27),
)
def test_damaged_arrays_are_refused(value: Any) -> None:
    assert accepted(messages.MemoryChange, packed(messages.MemoryChange, inputs=value)) is None


def test_rows_that_do_not_fit_each_other_are_refused() -> None:
    two = array("<i8", [2], bytes(16))
    for cls in (messages.MemorySnapshot, messages.MemoryChange):
        assert accepted(cls, packed(cls, freed=two, evicted=two)) is not None, "they belong to no row"
        for name in ("slots", "pairs"):
            assert accepted(cls, packed(cls, **{name: two})) is None
        for name in ("inputs", "targets"):
            assert accepted(cls, packed(cls, **{name: array("<f4", [2, 1], bytes(8))})) is None
    assert accepted(messages.CurrentModel, packed(messages.CurrentModel, layers=[2, 1])) is None
    assert accepted(messages.CurrentModel, packed(messages.CurrentModel, layers=[4096] * 8)) is None
    assert accepted(messages.LongTermModel, packed(messages.LongTermModel, layers=[2, 1])) is None
    seed = weights_of(0.0) | {"layers": [2, 1]}
    assert accepted(messages.MemoryChange, packed(messages.MemoryChange, seeds=[seed])) is None


@pytest.mark.parametrize(
    ("support", "said"),
    [
        (array("<f4", [2, 2], bytes(16)), "support has 2 columns; the network has 1 inputs"),
        (array("<f4", [0, 0], b""), "support has 0 columns; the network has 1 inputs"),
        (array("<f4", [1], bytes(4)), "support: got 1 dimensions of float32; expected 2"),
        (array("<i8", [1, 1], bytes(8)), "support: got 2 dimensions of int64; expected 2 of kind 'f'"),
    ],
)
def test_a_support_that_does_not_fit_its_network_is_refused_and_said(support: msgpack.ExtType, said: str) -> None:
    cls = messages.CurrentModel
    assert accepted(cls, packed(cls, support=array("<f4", [2, 1], bytes(8)))) is not None
    assert accepted(cls, packed(cls, support=None)) is not None
    with pytest.raises(DecodeError, match=said):
        codec.decode(cls, packed(cls, support=support), codec.encoding_of(cls))


@pytest.mark.parametrize("name", ["slots", "pairs", "freed", "evicted"])
def test_slots_and_pairs_are_whole_numbers_in_a_row(name: str) -> None:
    for value in (array("<f8", [1], bytes(8)), array("<i8", [1, 1], bytes(8)), array("|u1", [1], bytes(1)), [0], 0):
        assert accepted(messages.MemoryChange, packed(messages.MemoryChange, **{name: value})) is None


def test_more_seeds_than_any_population_takes_are_refused() -> None:
    for count, taken in ((100, True), (101, False)):
        payload = packed(messages.MemoryChange, seeds=[weights_of(0.0)] * count)
        assert (accepted(messages.MemoryChange, payload) is not None) == taken


@pytest.mark.parametrize("name", ["", "a/b", "a*", "a\n", "ä", "x" * 65, "a b", "a\x00"])
def test_names_that_no_key_could_have_are_refused(name: str) -> None:
    assert accepted(messages.Command, packed(messages.Command, teacher=name)) is None
    assert accepted(messages.Perception, packed(messages.Perception, reading={name: 1.0})) is None


def test_huge_and_deep_payloads_are_refused() -> None:
    assert accepted(messages.Finished, bytes(codec.MAX_BYTES + 1)) is None
    assert accepted(messages.Finished, b"\x91" * 100_000) is None
    assert accepted(messages.Finished, b"\x81\xa1a" * 100_000) is None
    assert accepted(messages.Finished, b"\xdd\xff\xff\xff\xff") is None
    assert accepted(messages.Finished, b"\xc6\xff\xff\xff\xff") is None


@pytest.mark.parametrize(
    "payload",
    [
        b"\xdc\x05\xdc" + (b"\xdc\x27\x10" + b"\x90" * 10_000) * 1500,
        b"\xdc\x27\x10" * 5_000_000,
        b"\xdd\x00\xf0\x00\x00" * 3_000_000,
        b"\xdf\x00\xf0\x00\x00" * 3_000_000,
        b"\xc9\x00\xe4\xe1\xc0\x01" + b"\x94" * 15_000_000,
        b"\x81\xaaiterations" + b"\xdd\x00\xe4\xe1\xc0" + b"\x00" * 15_000_000,
    ],
    ids=["empty lists", "nested", "nested, long", "maps", "in an array", "one long list"],
)
def test_a_payload_that_stands_for_much_memory_is_refused_before_it_takes_it(payload: bytes) -> None:
    tracemalloc.start()
    try:
        assert accepted(messages.Finished, payload[: codec.MAX_BYTES]) is None
        assert tracemalloc.get_traced_memory()[1] < 8 * codec.MAX_BYTES
    finally:
        tracemalloc.stop()


def test_more_items_than_any_message_has_are_refused() -> None:
    for count, taken in ((256, True), (257, False)):
        reading = {f"sensor{i}": [1.0] for i in range(count)}
        judges = ["anna"] * count
        assert (accepted(messages.Perception, packed(messages.Perception, reading=reading)) is not None) == taken
        assert (accepted(messages.Pair, packed(messages.Pair, judges=judges)) is not None) == taken


@pytest.mark.parametrize("reading", [{}, {"sonar": []}, {"sonar": [1.0, 2]}, {"sonar": [0.5] * 4096, "distance": 1}])
def test_what_a_sensor_gives_is_a_number_or_a_vector(reading: dict[str, Any]) -> None:
    message = accepted(messages.Perception, packed(messages.Perception, reading=reading))
    assert isinstance(message, messages.Perception)
    assert message.reading == reading


@pytest.mark.parametrize(
    "value", [None, "1", True, b"1", {}, {"a": 1.0}, [[1.0]], [None], ["1"], [0.5] * 4097, [1e6 + 1], -1e7]
)
def test_what_no_sensor_gives_is_refused(value: Any) -> None:
    for cls, field in ((messages.Perception, "reading"), (messages.Perception, "outcome"), (messages.Pair, "before")):
        assert accepted(cls, packed(cls, **{field: {"sonar": 1.0}})) is not None
        assert accepted(cls, packed(cls, **{field: {"sonar": value}})) is None


@pytest.mark.parametrize("cls", [messages.Action, messages.Pair, messages.IterationReport, messages.Scene])
def test_an_action_is_a_number_for_each_actuator(cls: type[Message]) -> None:
    many = {f"joint{i}": 0.5 for i in range(256)}
    for action in ({"turn": -20.0}, {"turn": 0}, {"left": 0.5, "right": -1e6}, many):
        message = accepted(cls, packed(cls, action=action))
        assert message is not None
        assert message.action == action  # type: ignore[attr-defined]
    bad = (1, [1.0], {"turn": [1.0]}, {"turn": None}, {"turn": "left"}, {"turn": True}, {"turn": 2e6}, {"a/b": 1.0})
    for action in (*bad, {1: 1.0}, many | {"more": 0.5}):
        assert accepted(cls, packed(cls, action=action)) is None


@pytest.mark.parametrize("cls", [messages.Action, messages.Pair, messages.IterationReport])
def test_a_choice_is_an_index_or_none(cls: type[Message]) -> None:
    assert accepted(cls, packed(cls)).choice is None  # type: ignore[union-attr]
    for choice in (None, 0, 1023):
        assert accepted(cls, packed(cls, choice=choice)).choice == choice  # type: ignore[union-attr]
    for bad in (-1, 1024, 0.0, True, "0"):
        assert accepted(cls, packed(cls, choice=bad)) is None


@pytest.mark.parametrize(
    ("event", "taken"), [("capture", True), ("my-own.word_2", True), ("", False), ("a b", False)]
)
def test_an_event_is_any_word(event: str, taken: bool) -> None:
    for cls in (messages.Perception, messages.Scene, messages.IterationReport):
        assert (accepted(cls, packed(cls, event=event)) is not None) == taken


@pytest.mark.parametrize(
    "fields",
    [
        {"kind": "square"}, {"what": "cat"}, {"points": []}, {"points": [[0.0]]}, {"points": [[0.0, 0.0, 0.0]]},
        {"points": [[0.0, 2e6]]}, {"points": [[0.0, 0.0]] * 1001}, {"radius": -0.1}, {"radius": 2e6},
        {"words": "x" * 101},
    ],
)  # fmt: skip
def test_shapes_that_cannot_be_drawn_are_refused(fields: dict[str, Any]) -> None:
    assert accepted(messages.Picture, packed(messages.Picture, drawing=drawing())) is not None
    assert accepted(messages.Picture, packed(messages.Picture, drawing=drawing(shapes=[shape(**fields)]))) is None


def test_drawings_without_an_inside_and_of_too_many_shapes_are_refused() -> None:
    for box in (
        [0.0, 0.0, 0.0, 1.0],
        [0.0, 0.0, 1.0, 0.0],
        [1.0, 0.0, 0.0, 1.0],
        [0.0, 0.0, 1.0],
        [0.0, 0.0, 1.0, 2e6],
    ):
        assert accepted(messages.Picture, packed(messages.Picture, drawing=drawing(box=box))) is None
    for count, taken in ((0, True), (1000, True), (1001, False)):
        payload = packed(messages.Picture, drawing=drawing(shapes=[shape()] * count))
        assert (accepted(messages.Picture, payload) is not None) == taken


@pytest.mark.parametrize(
    ("shape_of", "dtype", "taken"),
    [
        ((1, 1, 3), "|u1", True),
        ((256, 256, 3), "|u1", True),
        ((257, 1, 3), "|u1", False),
        ((1, 257, 3), "|u1", False),
        ((1, 1, 4), "|u1", False),
        ((1, 1, 1), "|u1", False),
        ((1, 3), "|u1", False),
        ((1, 1, 3), "<i2", False),
        ((1, 1, 3), "<f4", False),
        ((0, 5, 3), "|u1", False),
        ((5, 0, 3), "|u1", False),
    ],
    ids=str,
)
def test_an_image_is_some_rows_and_columns_of_three_bytes(shape_of: Any, dtype: str, taken: bool) -> None:
    image = array(dtype, list(shape_of), np.zeros(shape_of, dtype).tobytes())
    assert (accepted(messages.Picture, packed(messages.Picture, image=image)) is not None) == taken


def test_numbers_that_are_no_counts_are_refused() -> None:
    for value in (-1, 2**53 + 1, 2**64 - 1, 1.0, True, "1", None):
        assert accepted(messages.Finished, packed(messages.Finished, iterations=value)) is None


def test_what_cannot_travel_is_refused_at_the_sender() -> None:
    one = np.zeros(1, np.int32)
    row = np.zeros((1, 1), np.float32)
    with pytest.raises(TypeError, match="dtype is"):
        codec.encode(messages.MemorySnapshot(model="m", version=1, slots=one, pairs=one, inputs=row, targets=row))
    with pytest.raises(TypeError, match="cannot be sent"):
        codec.encode(messages.Phase(iteration=1, name=object()))  # type: ignore[arg-type]
