"""What holds for every test."""

from collections.abc import Callable, Iterator

import pytest
import structlog
from hypothesis import settings

from mdb_protocol import zenoh_sessions

zenoh_sessions.CLIENT_THREADS = zenoh_sessions.ROUTER_THREADS
"""In the tests' own process are routers and clients together, and whichever comes first says for all which threads
there are: with a client's a router would wait in the thread that its reader needs.
"""

settings.register_profile("the same each time", derandomize=True)
settings.load_profile("the same each time")


@pytest.fixture(autouse=True)
def _log_as_at_first() -> Iterator[None]:
    """A test that runs a command in this process leaves its way of logging behind."""
    yield
    structlog.reset_defaults()


@pytest.fixture(autouse=True)
def _kind_and_input(request: pytest.FixtureRequest, record_property: Callable[[str, object], None]) -> None:
    """Of what is tried at the edges, its kind and its input are properties of the test in the results."""
    if (mark := request.node.get_closest_marker("edge")) is not None:
        kind, tried = mark.args
        record_property("kind", kind)
        record_property("input", tried)
