"""The command line, the process table and its runner; for scripts and notebooks `from mdb_deploy import Run, run`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mdb_deploy.runs.python import Run, run

__all__ = ["Run", "run"]


def __getattr__(name: str) -> Any:
    """Import what runs a brain when it is asked for: a teacher's laptop has `mdb teach`, and no numba."""
    if name in __all__:
        from mdb_deploy.runs import python

        return getattr(python, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}")
