"""What holds for every test of this folder."""

import pytest


@pytest.fixture(autouse=True)
def _says_its_kind(request: pytest.FixtureRequest) -> None:
    said = request.node.get_closest_marker("edge")
    assert said is not None, "a test of this folder says its kind and its input: @pytest.mark.edge(KIND, INPUT)"
