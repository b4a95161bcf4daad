"""Messages to bytes and back: MessagePack, arrays as an extension type, the version in the encoding.

Pure: no input or output. `decode` accepts only the type that the key carries and raises `DecodeError`
with the path of what is wrong; it never returns a half-valid message.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, lru_cache
from typing import Annotated, Any, Literal, TypeVar, get_args

import msgpack
import msgspec
import numpy as np
from msgspec import Meta

from mdb_protocol.errors import DecodeError
from mdb_protocol.messages import Message

M = TypeVar("M", bound=Message)

VERSION = 2
"""Protocol version. A reader takes `2` and any `2.x`, whose messages may have more fields, and refuses all others."""
MAX_BYTES = 16 * 2**20
"""Largest payload that is decoded, in bytes."""
MAX_ITEMS = 10_000
"""Most items of one list or map. So many bytes cannot hold more: they are decoded without counting."""
MAX_VALUES = 1_000_000
"""Most items of all lists and maps of a payload together: a small payload can stand for a lot of memory."""
LETTERS = 128
"""Most letters of an encoding."""
ARRAY_EXT = 1
"""MessagePack extension type of an array: [dtype, shape, raw little-endian bytes]."""
Dtype = Literal["<f4", "<f8", "<i2", "<i8", "|u1"]
DTYPES = get_args(Dtype)
ArrayShape = Annotated[list[Annotated[int, Meta(ge=0, le=MAX_BYTES)]], Meta(min_length=1, max_length=4)]
"""Lengths that a payload has room for."""


def encoding_of(message_type: type[Message]) -> str:
    """Return the Zenoh encoding string of a message type, protocol version included."""
    return f"application/msgpack;mdb={VERSION};{message_type.__name__}"


def encode(message: Message) -> bytes:
    """Return the MessagePack bytes of a message."""
    return _ENCODER.encode(message)


def decode(message_type: type[M], payload: bytes, encoding: str) -> M:
    """Return the message in `payload`.

    Raises `DecodeError` when the encoding names another type or version, or the bytes are not it.
    """
    check_encoding(message_type, encoding)
    if len(payload) > MAX_BYTES:
        raise DecodeError(f"payload has {len(payload)} bytes; at most {MAX_BYTES} are accepted")
    try:
        if len(payload) <= MAX_ITEMS:
            message: M = _decoder(message_type).decode(payload)
            return message
        return msgspec.convert(unpack(payload), message_type, dec_hook=_dec_hook)
    except (
        msgspec.MsgspecError,
        msgpack.UnpackException,
        ValueError,
        TypeError,
        OverflowError,
        RecursionError,
    ) as error:
        raise DecodeError(f"not a valid {message_type.__name__}: {error}") from error


def check_encoding(message_type: type[Message], encoding: str) -> None:
    """Raise `DecodeError` unless an encoding is that of a message type, in this version or one alike."""
    if len(encoding) > LETTERS:
        raise DecodeError(f"encoding of {len(encoding)} letters; expected {encoding_of(message_type)}")
    _check_encoding(message_type, encoding)


@lru_cache(maxsize=64)
def _check_encoding(message_type: type[Message], encoding: str) -> None:
    if encoding != encoding_of(message_type) and not _is_alike(encoding, message_type):
        raise DecodeError(f"encoding is {encoding!r}; expected {encoding_of(message_type)!r}")


def _is_alike(encoding: str, message_type: type[Message]) -> bool:
    """Whether an encoding is that of a message type in a minor version of this protocol."""
    before, _, after = encoding_of(message_type).rpartition(f"={VERSION}")
    minor = encoding.removeprefix(f"{before}={VERSION}.").removesuffix(after)
    return minor.isdecimal() and encoding == f"{before}={VERSION}.{minor}{after}"


def unpack(payload: bytes, ext_hook: Callable[[int, bytes], Any] | None = None) -> Any:
    """Return what MessagePack bytes hold, as no message yet; ValueError, and msgpack's and msgspec's, when nothing.

    `ext_hook` makes something of an array in it; left out, an array.
    """
    left = MAX_VALUES

    def count(items: Any) -> Any:
        nonlocal left
        left -= len(items)
        if left < 0:
            raise ValueError(f"more than {MAX_VALUES} values")
        return items

    counted = {"list_hook": count, "object_hook": count} if len(payload) > MAX_ITEMS else {}
    return msgpack.unpackb(
        payload,
        ext_hook=ext_hook or _ext_hook,
        strict_map_key=True,
        max_array_len=MAX_ITEMS,
        max_map_len=MAX_ITEMS,
        **counted,
    )


def to_plain(message: Message) -> dict[str, Any]:
    """Return the message as plain dicts, lists and numbers (arrays as lists), for JSON and comparing."""
    plain = msgspec.to_builtins(message, enc_hook=lambda value: value.tolist())
    assert isinstance(plain, dict)
    return plain


def _to_plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        array = np.ascontiguousarray(value)
        dtype = array.dtype.str
        if dtype not in DTYPES:
            raise TypeError(f"array dtype is {dtype}; expected one of {', '.join(DTYPES)}")
        return msgspec.msgpack.Ext(ARRAY_EXT, msgspec.msgpack.encode((dtype, array.shape, array.tobytes())))
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be sent: {value!r}")


_ENCODER = msgspec.msgpack.Encoder(enc_hook=_to_plain)


@cache
def _decoder(message_type: type[M]) -> msgspec.msgpack.Decoder[M]:
    return msgspec.msgpack.Decoder(message_type, ext_hook=_ext_hook, dec_hook=_dec_hook)


def _ext_hook(code: int, data: bytes | memoryview) -> Any:
    dtype, shape, raw = array_parts(code, data)
    return np.ndarray(shape, dtype, raw)  # read-only, as bytes are


def array_parts(code: int, data: bytes | memoryview) -> tuple[str, list[int], bytes]:
    """Return type, shape and bytes of an array in MessagePack; ValueError, or msgspec's, when it is none."""
    if code != ARRAY_EXT:
        raise ValueError(f"extension type {code} is unknown; expected {ARRAY_EXT}, an array")
    dtype, shape, raw = _ARRAY.decode(data)
    expected = math.prod(shape) * int(dtype[-1])
    if expected != len(raw):
        raise ValueError(f"array of shape {shape} has {len(raw)} bytes; expected {expected}")
    return dtype, shape, raw


_ARRAY = msgspec.msgpack.Decoder(tuple[Dtype, ArrayShape, bytes])
"""[dtype, shape, bytes]."""


def _dec_hook(wanted: type, value: Any) -> Any:
    if wanted is np.ndarray and isinstance(value, np.ndarray):
        return value
    raise ValueError(f"expected an array, got {type(value).__name__}")
