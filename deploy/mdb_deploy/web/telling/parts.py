"""Parts that are one message in other words: models, pictures, perceptions, durations. Pure."""

from __future__ import annotations

import base64
import math
import struct
import zlib
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mdb_deploy.web.telling.plan import Plan, number, numbers
from mdb_protocol.messages import CurrentModel, Message, Perception, Picture
from mdb_services.mechanism.networks.network import split_layers

MOST_WEIGHTS = 20_000
"""Of a network that is told whole; of a larger one the layers alone are."""
PNG = b"\x89PNG\r\n\x1a\n"


def model_part(plan: Plan, model: CurrentModel) -> dict[str, Any]:
    """Return the part of one current model; its weights are null when they are too many to be drawn."""
    section = plan.brain.model_named(model.model)
    expressed = sum(model.layers[1:-1])
    weights = None
    if len(model.weights) <= MOST_WEIGHTS:
        weights = [numbers(layer) for layer in split_layers(model.layers, model.weights)]
    return {
        "version": model.version,
        "generation": model.generation,
        "error": number(model.error, 6),
        "layers": list(model.layers),
        "expressed": expressed,
        "silent": max(sum(plan.brain.reported_hidden(section)) - expressed, 0),
        "weights": weights,
    }


def picture_part(picture: Picture) -> dict[str, Any]:
    """Return the part of a picture."""
    drawing = None if picture.drawing is None else plain(picture.drawing)
    image = None if picture.image is None else png_url(picture.image)
    return {"iteration": picture.iteration, "drawing": drawing, "image": image}


def perception_part(perception: Perception) -> dict[str, Any]:
    """Return the part of a perception: what the next action begins from, and what the last one ended with."""
    return {"iteration": perception.iteration, "event": perception.event, "reading": perception.reading}


def plain(message: Message) -> Any:
    """Return a message without arrays as plain values."""
    return msgspec.to_builtins(message)


def png_url(image: NDArray[np.uint8]) -> str:
    """Return an image (rows, columns, 3) of bytes as a data URL in PNG."""
    rows, columns, _ = image.shape
    lines = np.zeros((rows, 1 + 3 * columns), np.uint8)  # before each row the number of its filter, none
    lines[:, 1:] = np.ascontiguousarray(image).reshape(rows, 3 * columns)
    head = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", zlib.compress(lines.tobytes(), 1)), (b"IEND", b""))
    data = PNG + b"".join(_chunk(kind, content) for kind, content in parts)
    return f"data:image/png;base64,{base64.b64encode(data).decode('ascii')}"


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def percentile_ms(seconds: list[float], share: float) -> float | None:
    """Return a percentile of durations in milliseconds; None of none."""
    if not seconds:
        return None
    ordered = sorted(seconds)
    place = min(len(ordered) - 1, math.ceil(share * len(ordered)) - 1)
    return number(1000 * ordered[max(place, 0)], 2)
