"""The key table: what it names, that each key belongs to one row, and that names cannot break out of it."""

import re
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdb_protocol import keys, messages
from mdb_protocol.errors import MdbError
from mdb_protocol.keys import KEYS, Delivery, Key
from tests.protocol.samples import NAMES, ON_DISK, fixed

every_row = pytest.mark.parametrize("row", KEYS, ids=lambda row: row.path)


@every_row
def test_a_key_is_found_again_with_its_parameters(row: Key) -> None:
    @fixed
    @given(NAMES, st.lists(NAMES, min_size=3, max_size=3))
    def check(brain: str, names: list[str]) -> None:
        parameters = dict(zip(row.parameters, names, strict=False))
        key = row.at(brain, **parameters)
        assert row.match(brain, key) == parameters
        assert keys.find(brain, key) is row
        assert [other.path for other in KEYS if other.match(brain, key) is not None] == [row.path]
        assert row.match(brain + "x", key) is None
        assert row.match(brain, key + "/more") is None
        assert row.match(brain, key + "\n") is None

    check()


@every_row
def test_a_key_with_wildcards_is_no_sample_of_the_row(row: Key) -> None:
    if row.parameters:
        assert row.match("brain", row.at("brain")) is None
        assert keys.find("brain", row.at("brain")) is None
    for key in ("mdb/brain/*", "mdb/brain/**", "mdb/**", "*/brain/" + row.path, "mdb/*/" + row.path):
        assert row.match("brain", key) is None


@pytest.mark.parametrize("name", ["", "a/b", "**", "*a", "$*", "a?b", "a#", "ä", "a b", "a\n", "@adv", "x" * 65])
def test_names_that_would_break_a_key_are_refused(name: str) -> None:
    with pytest.raises(MdbError, match=r"teacher is .*expected 1 to 64 letters"):
        keys.COMMAND.at("brain", teacher=name)
    with pytest.raises(MdbError, match="brain is"):
        keys.ACTION.at(name)


def test_the_brain_of_a_key_is_never_a_wildcard() -> None:
    with pytest.raises(MdbError, match="brain is"):
        keys.ACTION.at("*")


def test_a_parameter_that_the_row_lacks_is_refused() -> None:
    with pytest.raises(MdbError, match="has no parameter teacher"):
        keys.ACTION.at("brain", teacher="anna")


def test_every_message_lies_on_exactly_the_rows_expected() -> None:
    rows = Counter(row.message.__name__ for row in KEYS if row.message)
    classes = [
        cls for cls in vars(messages).values()
        if isinstance(cls, type) and issubclass(cls, messages.Message) and cls is not messages.Message
    ]  # fmt: skip
    parts = {"Shape", "Drawing", "ModelWeights", "Intention"} | {cls.__name__ for cls in ON_DISK}
    twice = {"Command": 2, "CurrentModel": 2}
    assert rows == {cls.__name__: twice.get(cls.__name__, 1) for cls in classes if cls.__name__ not in parts}
    assert [row for row in KEYS if row.message is None] == [keys.ALIVE, keys.CLAIM]
    assert {row for row in KEYS if row.delivery is Delivery.TOKEN} == {keys.ALIVE, keys.CLAIM}


def test_the_table_holds_every_row_that_the_module_names() -> None:
    named = [value for value in vars(keys).values() if isinstance(value, Key)]
    assert sorted(row.path for row in named) == sorted(row.path for row in KEYS)
    assert len({row.path for row in KEYS}) == len(KEYS)
    printed = re.findall(r"^\| `([^`]+)` \| (\w+) \|", keys.table(), re.MULTILINE)
    assert printed == [(row.path, row.message.__name__ if row.message else "none") for row in KEYS]


def test_a_parameter_of_a_key_is_checked_against_the_message_where_it_says_the_same() -> None:
    for row in KEYS:
        for name in row.parameters:
            if row.message is not None:
                assert name in row.message.__struct_fields__
