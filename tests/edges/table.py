"""The table of what was tried: `python -m tests.edges.table` prints it in Markdown, `--json` all outcomes.

Status 1 when an input did not hold.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.edges.cases import KINDS, Kind
from tests.edges.trial import Outcome, attempt, made, warm


def outcomes(kind: Kind, names: list[str] | None = None) -> Iterator[Outcome]:
    """Try the inputs of a kind with every command that reads it."""
    for name in names or kind.inputs:
        for command in kind.commands:
            with TemporaryDirectory() as folder:
                made(kind, kind.inputs[name], Path(folder))
                yield attempt(kind, name, command, Path(folder))


def table(found: list[Outcome]) -> str:
    """Return a row a kind: what reads it, the inputs, how many held, what they took at the most."""
    rows = ["| kind | read by | inputs | held | most processor time | most memory |", "|---|---|---|--:|--:|--:|"]
    for kind in KINDS:
        own = [outcome for outcome in found if outcome.kind == kind.name]
        if not own:
            continue
        held = sum(outcome.held is None for outcome in own)
        read_by = ", ".join(dict.fromkeys(f"`{' '.join(_verbs(o.command))}`" for o in own))
        rows.append(
            f"| {kind.name} | {read_by} | {', '.join(dict.fromkeys(o.input for o in own))} | {held} of {len(own)} | "
            f"{max(o.processor_s for o in own):.1f} s | {max(o.grown_bytes for o in own) / 2**20:.0f} MB |"
        )
    return "\n".join(rows)


def _verbs(command: str) -> list[str]:
    words = command.split()
    return words[: 2 if words[0] in ("ltm", "study") else 1]


def main() -> int:
    """Try everything and print."""
    warm()
    only = [word for word in sys.argv[1:] if not word.startswith("-")]
    found = [outcome for kind in KINDS if not only or kind.name in only for outcome in outcomes(kind)]
    if "--json" in sys.argv:
        sys.stdout.write(json.dumps([asdict(o) | {"held": o.held} for o in found], indent=1) + "\n")
    else:
        sys.stdout.write(table(found) + "\n")
    for outcome in found:
        if outcome.held is not None:
            words = (outcome.kind, outcome.input, outcome.command, outcome.held, outcome.said[-300:])
            sys.stderr.write(" | ".join(words) + "\n")
    return 0 if all(outcome.held is None for outcome in found) else 1


if __name__ == "__main__":
    sys.exit(main())
