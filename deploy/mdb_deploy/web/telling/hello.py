"""What never changes of a run: the frame `hello`. INTERFACE (this is the first commit; the bodies follow)."""

from __future__ import annotations

from typing import Any

from mdb_sim.runs.experiment import Experiment


def hello(
    experiment: Experiment, run: str, *, live: bool = False, teach: bool = False, operate: bool = False
) -> dict[str, Any]:
    """Return the frame `hello`."""
    return {}
