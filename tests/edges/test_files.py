"""A file of a stranger's is refused in words, soon and in little memory, and nothing is written beside it."""

from collections.abc import Callable

import pytest

from tests.edges.cases import KINDS, Kind
from tests.edges.table import MOST_BYTES, MOST_S
from tests.edges.trial import Outcome, outcomes, warm

QUICK = {
    ("memory file", "its models are an endless view"),
    ("memory file", "pages that name one another"),
    ("memory file", "a named pipe"),
    ("run log", "a gigabyte in 32 kB, zstd"),
    ("run log", "8 GB of nothing behind its head"),
    ("run log", "another brain's"),
    ("experiment file", "a key of 50000 names"),
    ("exported models", "layers [0, 0]"),
    ("exported models", "a link to a device that never ends"),
    ("result of a study", "columns of somebody else"),
}
"""Tried in every run of the tests; the others by the command that makes the table."""
assert {(kind.name, name) for kind in KINDS for name in kind.inputs} >= QUICK
ALL = [
    pytest.param(
        kind,
        name,
        id=f"{kind.name}-{name}",
        marks=[pytest.mark.edge(kind.name, name), *([] if (kind.name, name) in QUICK else [pytest.mark.slow])],
    )
    for kind in KINDS
    for name in kind.inputs
]


@pytest.fixture(scope="module", autouse=True)
def _warm() -> None:
    warm()


@pytest.mark.parametrize(("kind", "name"), ALL)
def test_is_refused(kind: Kind, name: str, record_property: Callable[[str, object], None]) -> None:
    found: list[Outcome] = list(outcomes(kind, name))
    record_property(MOST_S, max(outcome.processor_s for outcome in found))
    record_property(MOST_BYTES, max(outcome.grown_bytes for outcome in found))
    assert {(outcome.command, outcome.held): outcome.said for outcome in found if outcome.held is not None} == {}
