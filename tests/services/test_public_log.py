"""A run log is read by public libraries alone: `mcap`, JSON and JSON Schema. Nothing of this project is imported here
but by the fixture that makes the run, in another process.
"""

import base64
import json
import struct
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from mcap.reader import make_reader
from mcap.well_known import MessageEncoding, SchemaEncoding

ITERATIONS = 12


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    words = ("up", "paper", "--inline", "--no-plot", "--iterations", str(ITERATIONS), "--runs", str(folder))
    small = ("--set", "robot.body=kinematic", "--set", "model.induced.members=1", "--set", "model.object.members=1")
    subprocess.run([sys.executable, "-m", "mdb_deploy.cli", *words, *small], check=True, timeout=100.0)
    (found,) = folder.glob("*/run.mcap")
    return found


def said(log: Path) -> Iterator[tuple[str, dict[str, Any], Any]]:
    """The schema's name, the schema and the message, of each message of a log."""
    with log.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == (SchemaEncoding.JSONSchema, MessageEncoding.JSON)
            yield schema.name, json.loads(schema.data), json.loads(message.data)


def test_each_message_is_what_the_schema_of_its_channel_says(log: Path) -> None:
    found: dict[str, list[Any]] = defaultdict(list)
    schemas = {}
    for name, schema, message in said(log):
        found[name].append(message)
        schemas[name] = schema
    for name, schema in schemas.items():
        assert schema["type"] == "object", "as viewers want it"
        assert "$ref" not in json.dumps(schema), "complete in itself"
        Draft202012Validator.check_schema(schema)
        check = Draft202012Validator(schema)
        for message in found[name]:
            check.validate(message)
    assert len(found["Pair"]) >= ITERATIONS
    assert {"Action", "Perception", "Scene", "CurrentModel", "MemoryChange", "IterationReport"} <= set(found)


def test_a_schema_refuses_what_is_no_such_message(log: Path) -> None:
    schema, message = next((schema, message) for name, schema, message in said(log) if name == "Pair")
    check = Draft202012Validator(schema)
    assert check.is_valid(message)
    assert not check.is_valid(message | {"iteration": "first"})
    assert not check.is_valid({name: value for name, value in message.items() if name != "before"})


def test_the_weights_of_a_network_are_there_number_by_number(log: Path) -> None:
    models = [message for name, _, message in said(log) if name == "CurrentModel"]
    assert models
    for model in models:
        weights, layers = model["weights"], model["layers"]
        numbers = struct.unpack(f"<{weights['shape'][0]}f", base64.b64decode(weights["data"]))
        assert weights["dtype"] == "<f4"
        assert len(numbers) == sum((i + 1) * o for i, o in pairwise(layers))
        assert max(map(abs, numbers)) > 0.0
