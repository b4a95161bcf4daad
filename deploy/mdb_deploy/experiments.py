"""The experiment files that are shipped, and how a file is named on the command line."""

from __future__ import annotations

from pathlib import Path

from mdb_services.experiment.brain import EXPERIMENT_FILE

EXPERIMENTS = Path(__file__).parents[1] / "experiments"


def default_experiment() -> str:
    """Return the name of the experiment that nobody names: the one in this folder, else the paper's."""
    return "." if Path(EXPERIMENT_FILE).exists() else "paper"


def experiment_path(name: str) -> Path:
    """Return the path of an experiment file, of the one in a folder, or of a shipped one by its name."""
    shipped = EXPERIMENTS / f"{name}.toml"
    if Path(name).is_dir():
        return Path(name) / EXPERIMENT_FILE
    return shipped if shipped.exists() and not Path(name).exists() else Path(name)
