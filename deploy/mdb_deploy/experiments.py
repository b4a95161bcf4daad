"""The experiment files that are shipped, and how a file is named on the command line."""

from __future__ import annotations

from pathlib import Path

EXPERIMENTS = Path(__file__).parents[1] / "experiments"


def experiment_path(name: str) -> Path:
    """Return the path of an experiment file, or of a shipped one by its name."""
    shipped = EXPERIMENTS / f"{name}.toml"
    return shipped if shipped.exists() and not Path(name).exists() else Path(name)
