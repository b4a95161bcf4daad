"""The experiment files that are shipped, and how a file is named on the command line."""

from __future__ import annotations

import os
from pathlib import Path

from mdb_deploy.shipped import shipped
from mdb_protocol.errors import ConfigError
from mdb_services.experiment.run_folder import EXPERIMENT_FILE

EXPERIMENTS = shipped("experiments")
SUFFIX = ".toml"
DEFAULT = "demo"
"""What `mdb up` runs when nobody names an experiment."""


def default_experiment(shipped: str = DEFAULT) -> str:
    """Return the name of the experiment that nobody names: the one in this folder, else a shipped one."""
    return "." if os.path.exists(EXPERIMENT_FILE) else shipped  # in a folder of others there is none, and no error


def experiment_path(name: str) -> Path:
    """Return the path of an experiment file, of the one in a folder, or of a shipped one: `paper`, or `paper.toml`.

    What is there goes before what is shipped. ConfigError, with the nearest shipped one, when there is neither.
    """
    path = Path(name)
    known = {file.stem: file for file in EXPERIMENTS.glob(f"*{SUFFIX}")}
    wanted = name[: -len(SUFFIX)] if name.lower().endswith(SUFFIX) else name
    # A folder of this name may be of something else, as a paper's text.
    if path.is_dir() and (wanted not in known or (path / EXPERIMENT_FILE).exists()):
        return path / EXPERIMENT_FILE
    if path.exists() and not path.is_dir():
        return path
    if wanted in known:
        return known[wanted]
    if path.name != name:  # a path: of a file, not of a shipped one
        raise ConfigError(f"cannot read the experiment file {name}: there is no such file")
    from mdb_services.experiment.reading import nearest

    raise ConfigError(
        f"cannot read the experiment file {name}: there is none here, nor a shipped one{nearest(wanted, known)}"
    )
