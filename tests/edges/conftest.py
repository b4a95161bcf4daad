"""What is tried at the edges, and of which kind it is: in the results (`--junit-xml`) as properties of each test."""

from collections.abc import Callable

import pytest


@pytest.fixture(autouse=True)
def _kind_and_input(request: pytest.FixtureRequest, record_property: Callable[[str, object], None]) -> None:
    mark = request.node.get_closest_marker("edge")
    assert mark is not None, "a test of this folder says its kind and its input: @pytest.mark.edge(KIND, INPUT)"
    kind, tried = mark.args
    record_property("kind", kind)
    record_property("input", tried)
