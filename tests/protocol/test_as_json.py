"""Messages as JSON: every message comes back bit by bit, and fits its schema; what is none is a DecodeError."""

import json
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from mdb_protocol import as_json, codec, messages
from mdb_protocol.errors import DecodeError
from mdb_protocol.messages import Message
from tests.protocol.samples import SAMPLES, TYPES, fixed

every_message = pytest.mark.parametrize("cls", TYPES, ids=lambda cls: cls.__name__)


def back(message: Message) -> Message:
    return as_json.decode(type(message), as_json.encode(message), codec.encoding_of(type(message)))


@every_message
@fixed
@given(data=st.data())
def test_a_message_comes_back_bit_by_bit(cls: type[Message], data: st.DataObject) -> None:
    message = data.draw(SAMPLES[cls])
    assert codec.encode(back(message)) == codec.encode(message)
    through_payload = as_json.encode(message, codec.encode(message))
    assert codec.encode(as_json.decode(cls, through_payload, codec.encoding_of(cls))) == codec.encode(message)


@every_message
@fixed
@given(data=st.data())
def test_a_message_fits_its_schema_which_needs_no_other(cls: type[Message], data: st.DataObject) -> None:
    schema = json.loads(as_json.schema_of(cls))
    Draft202012Validator.check_schema(schema)
    assert schema["type"] == "object"
    assert "$ref" not in as_json.schema_of(cls).decode()
    Draft202012Validator(schema).validate(json.loads(as_json.encode(data.draw(SAMPLES[cls]))))


def test_floats_of_32_and_64_bits_are_exact() -> None:
    weights = np.array([1 / 3, 1e-38, -0.0, 0.1], np.float32)
    model = messages.CurrentModel(model="m", version=1, generation=1, layers=[1, 2], weights=weights, error=1 / 3)
    found = back(model)
    assert isinstance(found, messages.CurrentModel)
    assert found.weights.tobytes() == weights.tobytes()
    assert found.error == 1 / 3


def test_fields_that_this_version_does_not_know_are_kept() -> None:
    message = messages.Finished(iterations=3)
    newer = msgpack.packb({"iterations": 3, "why": "done"})
    assert json.loads(as_json.encode(message, newer)) == {"iterations": 3, "why": "done"}
    odd = msgpack.packb({"iterations": 3, "when": msgpack.Timestamp(1)})
    assert json.loads(as_json.encode(message, odd)) == {"iterations": 3}, "what JSON has no word for is left out"


@pytest.mark.parametrize(
    "change",
    [
        {"weights": [1.0]},
        {"weights": {"dtype": "<f4", "shape": [4], "data": "AAAA"}},
        {"weights": {"dtype": "<c8", "shape": [1], "data": ""}},
        {"weights": {"dtype": "<f4", "shape": "4", "data": ""}},
        {"weights": {"dtype": "<f4", "shape": [4], "data": "!!"}},
        {"weights": None},
        {"version": -1},
        {"error": "small"},
    ],
)
def test_what_is_no_message_is_a_decode_error(change: dict[str, Any]) -> None:
    message = messages.CurrentModel(
        model="m", version=1, generation=1, layers=[1, 2], weights=np.zeros(4, np.float32), error=0.1
    )
    text = json.dumps(json.loads(as_json.encode(message)) | change).encode()
    with pytest.raises(DecodeError, match="not a valid CurrentModel"):
        as_json.decode(messages.CurrentModel, text, codec.encoding_of(messages.CurrentModel))


def test_another_type_or_version_is_a_decode_error() -> None:
    text = as_json.encode(messages.Finished(iterations=3))
    for encoding in (codec.encoding_of(messages.Pair), "application/msgpack;mdb=1;Finished", ""):
        with pytest.raises(DecodeError, match="encoding is"):
            as_json.decode(messages.Finished, text, encoding)


@pytest.mark.parametrize(
    "junk",
    [
        b"\xd4\x05\x00",  # an extension type that nobody knows
        b"\xd4\x01\x00",  # an array that is none
        b"\x81\x01\x02",  # a number as a key
        b"\xa1\xff",  # no text
        b"\x91" * 2000 + b"\xc0",
    ],
)
def test_junk_in_a_field_that_this_version_does_not_know_costs_no_more_than_that_field(junk: bytes) -> None:
    payload = b"\x82" + msgpack.packb("iterations") + b"\x03" + msgpack.packb("why") + junk
    message = messages.Finished(iterations=3)
    try:
        codec.decode(messages.Finished, payload, codec.encoding_of(messages.Finished))
    except DecodeError:
        return  # it is not even read
    assert json.loads(as_json.encode(message, payload))["iterations"] == 3
