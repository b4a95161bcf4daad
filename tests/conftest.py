"""What holds for every test."""

import faulthandler
import os
from collections.abc import Callable, Iterator

import pytest
import structlog
from hypothesis import settings
from pytest_timeout import Settings

from mdb_protocol import zenoh_sessions

zenoh_sessions.CLIENT_THREADS = zenoh_sessions.ROUTER_THREADS
"""In the tests' own process are routers and clients together, and whichever comes first says for all which threads
there are: with a client's a router would wait in the thread that its reader needs.
"""

STUCK_S = 30
"""A test that hangs in a library's code, where its timeout cannot reach it, ends its process so long after it."""
stderr = pytest.StashKey[int]()

settings.register_profile("the same each time", derandomize=True)
settings.load_profile("the same each time")


def pytest_configure(config: pytest.Config) -> None:
    config.stash[stderr] = os.dup(2)  # which is the tests' own later


def pytest_timeout_set_timer(item: pytest.Item, settings: Settings) -> None:
    faulthandler.dump_traceback_later(settings.timeout + STUCK_S, exit=True, file=item.config.stash[stderr])


def pytest_timeout_cancel_timer() -> None:
    faulthandler.cancel_dump_traceback_later()


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
