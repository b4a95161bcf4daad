"""The table of what was tried at the edges: `python -m tests.edges.table` tries all of it and prints the table.

Each test with the mark `edge(KIND, INPUT)`, wherever it is, is one input of a row. `--write` also puts the table into
deploy/README.md; words of pytest follow, as `-n 2` or `-k TLS`. Status 1 when an input did not hold.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

ROOT = Path(__file__).parents[2]
README = ROOT / "deploy" / "README.md"
BEGIN, END = "<!-- edges: python -m tests.edges.table --write -->\n", "<!-- /edges -->\n"
MOST_S, MOST_BYTES = "processor_s", "grown_bytes"
"""Properties of a test that measures what an input takes."""


@dataclass
class Tried:
    """What came of the inputs of one kind."""

    inputs: list[str] = field(default_factory=list)
    tests: int = 0
    failed: list[str] = field(default_factory=list)
    untried: list[str] = field(default_factory=list)
    processor_s: list[float] = field(default_factory=list)
    grown_bytes: list[float] = field(default_factory=list)


def results(report: Path) -> dict[str, Tried]:
    """Return what a JUnit report of pytest says of each kind."""
    found: dict[str, Tried] = {}
    for case in ElementTree.parse(report).iter("testcase"):
        said = {one.get("name", ""): one.get("value", "") for one in case.iter("property")}
        if "kind" not in said:
            continue
        kind = found.setdefault(said["kind"], Tried())
        tried = said["input"]
        if case.find("skipped") is not None:
            kind.untried.append(tried)
            continue
        kind.tests += 1
        kind.inputs += [] if tried in kind.inputs else [tried]
        kind.failed += [tried] if case.find("failure") is not None or case.find("error") is not None else []
        kind.processor_s += [float(said[MOST_S])] if MOST_S in said else []
        kind.grown_bytes += [float(said[MOST_BYTES])] if MOST_BYTES in said else []
    return found


def rows(found: dict[str, Tried]) -> Iterator[str]:
    """Yield the table in Markdown."""
    yield "| kind | inputs tried | held | took at the most |\n|---|---|--:|---|\n"
    for name, kind in sorted(found.items()):
        inputs = "; ".join(kind.inputs).replace("|", "\\|").replace("\n", " ")
        left = f" (not tried here: {'; '.join(kind.untried)})" if kind.untried else ""
        held = f"{len(kind.inputs) - len(set(kind.failed))} of {len(kind.inputs)}"
        took = ""
        if kind.processor_s:
            took = f"{max(kind.processor_s):.1f} s, {max(*kind.grown_bytes, 0) / 2**20:.0f} MB"
        yield f"| {name} | {inputs}{left} | {held} | {took} |\n"


def written(text: str, table: str) -> str:
    """Return a page with the table in its place."""
    before, _, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise SystemExit(f"{README} has no place for the table: {BEGIN.strip()} ... {END.strip()}")
    return f"{before}{BEGIN}\n{table}\n{END}{after}"


def main() -> int:
    """Try everything and print."""
    words = [word for word in sys.argv[1:] if word != "--write"]
    with TemporaryDirectory() as folder:
        report = Path(folder) / "edges.xml"
        command = [sys.executable, "-P", "-m", "pytest", "tests", "-m", "edge", f"--junit-xml={report}", *words]
        done = subprocess.run(command, cwd=ROOT, stdout=sys.stderr, check=False)
        if not report.exists():
            return done.returncode
        found = results(report)
    table = "".join(rows(found))
    sys.stdout.write(table)
    if "--write" in sys.argv:
        README.write_text(written(README.read_text(encoding="utf-8"), table), encoding="utf-8")
    return int(not found or any(kind.failed for kind in found.values()))


if __name__ == "__main__":
    sys.exit(main())
