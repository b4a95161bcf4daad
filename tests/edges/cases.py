"""Files of strangers, as data: of each kind the inputs that are tried, how each is made, and what reads it.

An input is made in a copy of a small run, RUN, beside which there is a file FILE and a folder OUT for what is made.
`table.py` tries all of them and says which held.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.edges import databases, logs, plain

Make = Callable[[Path], object]
"""Makes the input; given the path of the file that it takes the place of."""
LTM = ("ltm list RUN", "ltm show RUN", "ltm export RUN --out OUT/x")
MEMORY = (*LTM, "rescue RUN --out OUT/new")
LOG = ("plot RUN --out OUT", "replay RUN", "export RUN --out OUT")
EXPERIMENT = (*LOG, "rescue RUN --out OUT/new", "up RUN --inline --runs OUT")
MODELS = ("ltm list FILE", "ltm import FILE RUN", "up RUN --inline --runs OUT --long-term FILE")
RESULTS = ("study report --results RESULTS --out OUT/report.md",)


@dataclass(frozen=True)
class Kind:
    """A kind of file: where it is, what reads it, and the inputs by name."""

    name: str
    file: str
    commands: tuple[str, ...]
    inputs: dict[str, Make]
    may_pass: frozenset[str] = frozenset()
    """Inputs that are strange and well-formed: a command may do what it can with them."""


NO_FILES: dict[str, Make] = {
    "a named pipe": plain.pipe,
    "a link to a device that never ends": plain.device,
    "a folder": plain.folder,
    "a link to itself": plain.loop,
    "a socket": plain.socket_file,
}
"""What stands in the place of any file."""
NONSENSE: dict[str, Make] = {
    "empty": plain.empty,
    "a text": plain.text,
    "8 GB that take no room": plain.sparse,
    "random bytes": plain.noise,
}
"""What any file may hold."""

KINDS = (
    Kind("memory file", "RUN/memory.sqlite", MEMORY, NO_FILES | NONSENSE | databases.INPUTS),
    Kind("memory file of which models are asked", "RUN/memory.sqlite", LTM, databases.MODELS),
    Kind("run log", "RUN/run.mcap", LOG, NO_FILES | NONSENSE | logs.INPUTS, logs.WELL_FORMED),
    Kind("experiment file", "RUN/experiment.toml", EXPERIMENT, NO_FILES | NONSENSE | plain.EXPERIMENTS),
    Kind("exported models", "FILE", MODELS, NO_FILES | NONSENSE | databases.EXPORTS, databases.WELL_FORMED),
    Kind("result of a study", "RESULTS/memory/a/seed1.parquet", RESULTS, NO_FILES | NONSENSE | plain.RESULTS),
)
