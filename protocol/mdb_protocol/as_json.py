"""Messages as JSON, as the run log has them, and back: exact, and readable by what knows nothing of this project.

Numbers are written as short as they come back the same, arrays as their type, their shape and their bytes in base64.
Pure. `schema_of` says of a message type what its JSON is, in itself and without references, as viewers of MCAP want
it. On the network messages are MessagePack (`codec`).
"""

from __future__ import annotations

import base64
import binascii
import math
from contextlib import suppress
from functools import cache
from typing import Any, TypeVar

import msgpack
import msgspec
import numpy as np

from mdb_protocol import codec, schema
from mdb_protocol.errors import DecodeError
from mdb_protocol.messages import Message

M = TypeVar("M", bound=Message)

MAX_TEXT = 2 * codec.MAX_BYTES
"""Largest JSON of one message that is decoded, in bytes: base64 and names make it longer than what was sent."""
ARRAY_SCHEMA: dict[str, Any] = {
    "title": schema.ARRAY,
    "description": "An array of numbers: those of `data`, of type `dtype`, the last dimension fastest.",
    "type": "object",
    "properties": {
        "dtype": {
            "type": "string",
            "enum": list(codec.DTYPES),
            "description": "As numpy writes it: < is little-endian.",
        },
        "shape": {"type": "array", "items": {"type": "integer"}},
        "data": {"type": "string", "contentEncoding": "base64"},
    },
    "required": ["dtype", "shape", "data"],
}


def encode(message: Message, payload: bytes | None = None) -> bytes:
    """Return a message as JSON. payload: its MessagePack, whose fields that this version does not know are kept."""
    if payload is not None:
        with suppress(*_NOT_JSON):
            return _ENCODER.encode(codec.unpack(payload, _plain_parts))
    return _ENCODER.encode(message)


def decode(message_type: type[M], text: bytes, encoding: str) -> M:
    """Return the message; `encoding` is that which it had on the network. DecodeError when it is none."""
    codec.check_encoding(message_type, encoding)
    if len(text) > MAX_TEXT:
        raise DecodeError(f"{len(text)} bytes of JSON; at most {MAX_TEXT} are accepted")
    try:
        message: M = _decoder(message_type).decode(text)
    except (
        msgspec.ValidationError,
        msgspec.DecodeError,
        ValueError,
        TypeError,
        OverflowError,
        RecursionError,
    ) as error:
        raise DecodeError(f"not a valid {message_type.__name__}: {error}") from error
    return message


@cache
def schema_of(message_type: type[Message]) -> bytes:
    """Return the JSON Schema of a message type as `encode` writes it."""
    whole = schema.schema_of(message_type)
    definitions = whole["$defs"] | {schema.ARRAY: ARRAY_SCHEMA}
    inside = _inlined(definitions[message_type.__name__], definitions)
    return msgspec.json.encode({"$schema": schema.DRAFT, **inside})


def _inlined(part: Any, definitions: dict[str, Any]) -> Any:
    """Return a part of a schema with what it refers to in its place."""
    if isinstance(part, list):
        return [_inlined(item, definitions) for item in part]
    if not isinstance(part, dict):
        return part
    if "$ref" in part:
        return _inlined(definitions[part["$ref"].rpartition("/")[2]], definitions)
    return {name: _inlined(value, definitions) for name, value in part.items()}


def _plain_parts(code: int, data: bytes) -> dict[str, Any]:
    """Return an array of a payload as `_plain` would, without making it; JSON has bytes in base64."""
    dtype, shape, raw = codec.array_parts(code, data)
    return {"dtype": dtype, "shape": shape, "data": raw}


def _plain(value: Any) -> dict[str, Any]:
    if not isinstance(value, np.ndarray):
        raise TypeError(f"{type(value).__name__} cannot be written: {value!r}")
    data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode("ascii")
    return {"dtype": value.dtype.str, "shape": value.shape, "data": data}


class _Array(msgspec.Struct):
    """An array as `_plain` writes it."""

    dtype: codec.Dtype
    shape: codec.ArrayShape
    data: str


def _array(wanted: type, value: Any) -> np.ndarray:
    if wanted is not np.ndarray:
        raise ValueError(f"expected an array, got {type(value).__name__}")
    given = msgspec.convert(value, _Array)
    try:
        array = np.frombuffer(base64.b64decode(given.data, validate=True), given.dtype)
    except binascii.Error as error:
        raise ValueError(f"data of an array: {error}") from error
    if math.prod(given.shape) != array.size:
        raise ValueError(f"array of shape {given.shape} has {array.size} values; expected {math.prod(given.shape)}")
    return array.reshape(given.shape)


_NOT_JSON = (TypeError, ValueError, OverflowError, RecursionError, msgspec.MsgspecError, msgpack.UnpackException)
"""What a field can lead to that this version does not know: JSON has no word for it, or it is junk."""
_ENCODER = msgspec.json.Encoder(enc_hook=_plain)


@cache
def _decoder(message_type: type[M]) -> msgspec.json.Decoder[M]:
    return msgspec.json.Decoder(message_type, dec_hook=_array)
