"""The files that come with the command line: `compose.yaml`, `router.json5`, `experiments/`, `examples/`.

In a checkout they lie beside this package, where people look for them; in an installed one a copy lies within it
(`force-include` in pyproject.toml).
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from mdb_protocol.errors import MdbError

WITHIN = "shipped"


def shipped(name: str) -> Path:
    """Return the path of a shipped file or folder; MdbError when this installation lacks it."""
    package = Path(str(files("mdb_deploy")))
    for path in (package / WITHIN / name, package.parent / name):
        if path.exists():
            return path
    raise MdbError(f"{package} lacks its file {name}; install multilevel-darwinist-brain again")
