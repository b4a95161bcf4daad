"""What holds for every test."""

from collections.abc import Iterator

import pytest
import structlog


@pytest.fixture(autouse=True)
def _log_as_at_first() -> Iterator[None]:
    """A test that runs a command in this process leaves its way of logging behind."""
    yield
    structlog.reset_defaults()
