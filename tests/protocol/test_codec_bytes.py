"""The codec's two ways: one encoder writes what the other would, both decoders read and refuse the same."""

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
from tests.protocol.test_codec import same

every_message = pytest.mark.parametrize("cls", TYPES, ids=lambda cls: cls.__name__)

WHOLE = st.integers(-(2**63), 2**64 - 1) | st.sampled_from(
    [edge + step for bits in (5, 7, 8, 15, 16, 31, 32, 63) for edge in (2**bits, -(2**bits)) for step in (-1, 0, 1)][
        :-4
    ]
)
"""Also where MessagePack begins to write an integer in another way."""
LENGTHS = st.sampled_from([0, 15, 16, 31, 32, 255, 256, 65535, 65536])
"""Where it begins to write a text, a list or a map in another way."""
VALUES = st.recursive(
    st.none() | st.booleans() | WHOLE | st.floats() | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=20) | st.dictionaries(st.text(max_size=40), inner, max_size=20),
    max_leaves=20,
)


def packed(message: Message) -> bytes:
    """A message's bytes by msgpack's own encoder."""

    def plain(value: Any) -> Any:
        if isinstance(value, Message):
            return {field: getattr(value, field) for field in value.__struct_fields__}
        header = [value.dtype.str, value.shape, np.ascontiguousarray(value).tobytes()]
        return msgpack.ExtType(codec.ARRAY_EXT, msgpack.packb(header))

    return msgpack.packb(message, default=plain)


def read(cls: type[Message], payload: bytes) -> Message | None:
    """What the codec reads, or None."""
    try:
        return codec.decode(cls, payload, codec.encoding_of(cls))
    except DecodeError:
        return None


def read_in_two_steps(cls: type[Message], payload: bytes) -> Message | None:
    """What msgpack's own decoder reads, put into the class; or None."""
    try:
        return msgspec.convert(codec.unpack(payload), cls, dec_hook=codec._dec_hook)
    except (msgspec.MsgspecError, msgpack.UnpackException, ValueError, TypeError, OverflowError, RecursionError):
        return None


def alike(one: Message | None, other: Message | None) -> bool:
    return (one is None and other is None) or same(one, other)


@every_message
@fixed
@given(data=st.data())
def test_every_message_has_the_bytes_that_msgpack_gives(cls: type[Message], data: st.DataObject) -> None:
    message = data.draw(SAMPLES[cls])
    payload = codec.encode(message)
    assert payload == packed(message)
    found = read_in_two_steps(cls, payload)
    assert found is not None
    assert same(found, read(cls, payload))


@fixed
@given(VALUES)
def test_every_value_has_the_bytes_that_msgpack_gives(value: Any) -> None:
    assert codec._ENCODER.encode(value) == msgpack.packb(value)


@fixed
@given(LENGTHS, WHOLE, st.floats())
def test_so_have_long_ones(length: int, whole: int, real: float) -> None:
    for value in (
        "x" * length,
        "\u00e4" * length,
        bytes(length),
        [whole] * length,
        {str(i): real for i in range(length)},
    ):
        assert codec._ENCODER.encode(value) == msgpack.packb(value)


@every_message
@fixed
@given(data=st.data())
def test_bad_bytes_are_refused_by_both(cls: type[Message], data: st.DataObject) -> None:
    payload = bytearray(codec.encode(data.draw(SAMPLES[cls])))
    for place, value in data.draw(st.lists(st.tuples(st.integers(0, 2**16), st.integers(0, 255)), max_size=3)):
        payload[place % len(payload)] = value
    cut = bytes(payload[: data.draw(st.integers(0, len(payload)))])
    for bad in (bytes(payload), cut, cut + b"\xc1"):
        read_now, before = read(cls, bad), read_in_two_steps(cls, bad)
        assert before is None or alike(read_now, before), "what msgpack reads is read, and the same"


@pytest.mark.parametrize(
    "payload", [b"", b"\xc1", b"\x81", b"\x81\xaaiterations", b"\x91\x01", b"\x81\xaaiterations\xff"]
)
def test_what_is_no_message_is_one_error_whatever_its_length(payload: bytes) -> None:
    for bad in (payload, payload + bytes(codec.MAX_ITEMS)):
        with pytest.raises(DecodeError, match="not a valid Finished: "):
            codec.decode(messages.Finished, bad, codec.encoding_of(messages.Finished))
