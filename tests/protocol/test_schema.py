"""The schemas are those of the messages: what is sent fits, what is refused for its form does not."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from jsonschema import Draft202012Validator

from mdb_deploy.cli.main import main
from mdb_protocol import codec, messages
from mdb_protocol.messages import Message
from mdb_protocol.schema import document, every_type, schema_of
from tests.protocol.samples import SAMPLES, TYPES, fixed

FILE = Path(__file__).parents[2] / "protocol" / "messages.schema.json"


def validator(cls: type[Message]) -> Draft202012Validator:
    """What checks one message, itself checked."""
    schema = schema_of(cls)
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


@pytest.mark.parametrize("cls", TYPES, ids=lambda cls: cls.__name__)
def test_every_message_fits_its_schema(cls: type[Message]) -> None:
    checks = validator(cls)

    @fixed
    @given(SAMPLES[cls])
    def check(message: Message) -> None:
        plain = json.loads(json.dumps(codec.to_plain(message)))
        checks.validate(plain)
        checks.validate({**plain, "of_a_later_version": 1})

    check()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("iteration", -1), ("iteration", 1.5), ("iteration", None), ("reading", {"distance": "near"}),
        ("reading", {"no name": 1.0}), ("reading", {"distance": 1e7}), ("outcome", {"ranges": [[1.0]]}),
        ("event", ""), ("done", {"iteration": 1}),
    ],
)  # fmt: skip
def test_what_the_codec_refuses_for_its_form_the_schema_does_too(field: str, value: Any) -> None:
    plain = {"iteration": 1, "event": "none", "outcome": {}, "reading": {"distance": 1.0}, "stamp": 2.0}
    checks = validator(messages.Perception)
    assert checks.is_valid(plain)
    assert not checks.is_valid({**plain, field: value})
    assert not checks.is_valid({name: kept for name, kept in plain.items() if name != "reading"})


def test_all_messages_are_in_one_document() -> None:
    Draft202012Validator.check_schema(document())
    assert {*document()["$defs"]} == {cls.__name__ for cls in every_type()} | {"Array"}
    assert {*TYPES} <= {*every_type()}


def test_the_file_beside_the_protocol_is_the_one_of_the_code(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["keys", "schema"]) == 0
    assert capsys.readouterr().out == FILE.read_text(), "mdb keys schema > protocol/messages.schema.json"


def test_one_message_is_printed_by_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["keys", "schema", "Action"]) == 0
    assert json.loads(capsys.readouterr().out) == schema_of(messages.Action)
    assert main(["keys", "schema", "Acton"]) == 2
    assert "there are Action" in capsys.readouterr().err
