"""JSON Schema (draft 2020-12) of the messages, made from their types: for those who write in another language.

Owns the documents and what they say of arrays and bytes, which JSON has none of. A schema is that of a message as
`codec.to_plain` gives it. On the wire a message is a MessagePack map of the same names and values, but for arrays and
bytes. What a schema cannot say (finite numbers, as many rows here as there) is checked when a message is made.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np

from mdb_protocol import messages
from mdb_protocol.codec import ARRAY_EXT, DTYPES
from mdb_protocol.messages import Message

DRAFT = "https://json-schema.org/draft/2020-12/schema"
ARRAY = "Array"
REF = "#/$defs/{name}"
ON_THE_WIRE = (
    "On the wire these are MessagePack maps. Fields that a reader does not know are passed over, so a writer may add "
    "some. No number may be NaN or infinite. A string with contentEncoding base64 travels as MessagePack's bin; "
    f"an {ARRAY} as its extension type {ARRAY_EXT}."
)
ARRAY_SCHEMA: dict[str, Any] = {
    "title": ARRAY,
    "description": (
        f"An array of numbers. As JSON: lists, nested once for each dimension. In MessagePack: extension type "
        f"{ARRAY_EXT}, whose bytes are again MessagePack, the list [dtype, shape, raw]: the type as numpy writes it "
        f"(one of {', '.join(DTYPES)}), the list of 1 to 4 lengths, and the numbers as bin, little-endian, the last "
        "dimension fastest."
    ),
    "type": "array",
    "items": {"anyOf": [{"type": "number"}, {"$ref": REF.format(name=ARRAY)}]},
    "x-msgpack": {"extension": ARRAY_EXT, "dtypes": list(DTYPES)},
}


def every_type() -> list[type[Message]]:
    """Return all message classes by name, those that are parts of others included."""
    found = (getattr(messages, name) for name in messages.__all__)
    classes = [c for c in found if isinstance(c, type) and issubclass(c, Message) and c is not Message]
    return sorted(classes, key=lambda c: c.__name__)


def schema_of(message_type: type[Message]) -> dict[str, Any]:
    """Return the schema of one message, complete in itself."""
    return {
        "$schema": DRAFT,
        "$comment": ON_THE_WIRE,
        "$ref": REF.format(name=message_type.__name__),
        "$defs": _definitions([message_type]),
    }


def document() -> dict[str, Any]:
    """Return the schemas of all messages in one document, each at `#/$defs/NAME`."""
    return {
        "$schema": DRAFT,
        "title": "Messages of the Multilevel Darwinist Brain",
        "$comment": ON_THE_WIRE,
        "$defs": _definitions(every_type()),
    }


def _definitions(types: Iterable[type[Message]]) -> dict[str, Any]:
    _, found = msgspec.json.schema_components(types, schema_hook=_hook, ref_template=REF)
    definitions = {name: _tidy(part) for name, part in found.items()}
    if REF.format(name=ARRAY) in json.dumps(definitions):
        definitions[ARRAY] = ARRAY_SCHEMA
    return dict(sorted(definitions.items()))


def _hook(wanted: type) -> dict[str, Any]:
    if wanted is np.ndarray:
        return {"$ref": REF.format(name=ARRAY)}
    raise NotImplementedError(f"no schema for {wanted}")


def _tidy(part: Any) -> Any:
    """Undo what is Python's own: indented descriptions, and `\\Z`, which other regular expressions do not know."""
    if isinstance(part, list):
        return [_tidy(item) for item in part]
    if not isinstance(part, dict):
        return part
    tidy = {name: _tidy(value) for name, value in part.items()}
    if isinstance(tidy.get("description"), str):
        tidy["description"] = inspect.cleandoc(tidy["description"])
    if isinstance(tidy.get("pattern"), str):
        tidy["pattern"] = tidy["pattern"].replace(r"\Z", "$")
    return tidy
