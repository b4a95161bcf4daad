"""The report: one section a study, in a fixed order, from results alone. What is missing is said to be missing.

Owns the frame: titles, what a section is made of, where figures go. What is shown of each study is in `sections`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median

from mdb_sim.report.paper import statements_table
from mdb_sim.report.sections import SECTIONS, Section
from mdb_sim.report.short import in_short
from mdb_sim.studies import machines
from mdb_sim.studies.catalogue import REPORTED, Study
from mdb_sim.studies.results import Result
from mdb_sim.verdicts.quantities import all_runs_of, runs_of
from mdb_sim.verdicts.statistics import seeds_text

GALLERY = "gallery"
UNPAIRED = ("reproduction", "rivals")
"""Studies that show each variant with all its own seeds."""
OF_ALL_BODIES = machines.STUDIES
"""Studies whose variants are of different bodies: they are shown together, each with its own settings."""
INTRODUCTION = """\
# The study

What the mechanism does, over many seeds, and what of the paper it keeps: *Induced behavior in a real agent using
the Multilevel Darwinist Brain* (Bellas, Becerra, Duro). `mdb study all` makes the results, `mdb study report`
this page and its figures from them. All runs are in lockstep: a seed gives the same run every time.

How to read it. A run's captures in a phase are compared with its own **ideal**: a policy that sees the truth and
always faces the object, from where the phase begins, on the same placements of the object. In the first phase both
count from the end of the forced exploration on. **Obedience** is the share of commands obeyed in the last two fifths
of a phase; **iterations to 90 % obedience** end with the first 20 commands of which 18 were obeyed, so 20 is the
least. Errors are mean squared, feedback lies in ±1, and 0.1 is what “10 %” means: **prequential** is the error on
each pair before it was learnt (mean of 40), the one **over all pairs** is that on every command with every action.
Intervals are 95 % bootstrap intervals over the seeds. “never” counts as more than any number; “–” is what a run does
not hold.
"""


Variants = Mapping[str, Collection[str]]
"""The names of a study's variants, by study."""


def write(results: Sequence[Result], out: Path, variants: Variants | None = None) -> list[Path]:
    """Write the report and its figures, which go into `gallery` beside it; return the files.

    variants: those that each study has now. Results of others are left out, which is said; None: all are shown.
    """
    found, gone = _sorted(results, variants or {})
    parts, files = [INTRODUCTION, in_short(found)], []
    gallery = out.parent / GALLERY
    for number, study in enumerate(REPORTED, 1):
        parts.append(f"## {number}. {study.name.capitalize()}: {study.what}")
        if study.name == "reproduction":
            parts += ["### The paper's statements, one by one", statements_table(found)]
        if study.name not in found:
            parts.append(f"Not measured yet: `mdb study {study.name}` is missing in these results.")
            continue
        text, figures = _section(study, found[study.name], gallery, GALLERY)
        parts += [_left_out(gone.get(study.name, [])), text]
        files += figures
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(_joined(parts), encoding="utf-8")
    return [out, *files]


def _sorted(results: Sequence[Result], variants: Variants) -> tuple[dict[str, list[Result]], dict[str, list[Result]]]:
    """Return results by study: those of variants that it has, and those of variants that it no longer has."""
    found: dict[str, list[Result]] = {}
    gone: dict[str, list[Result]] = {}
    for result in results:
        known = variants.get(result.label.study)
        there = known is None or result.label.variant in known
        (found if there else gone).setdefault(result.label.study, []).append(result)
    return found, gone


def _left_out(gone: Sequence[Result]) -> str:
    if not gone:
        return ""
    names = ", ".join(f"“{name}”" for name in dict.fromkeys(result.label.variant for result in gone))
    runs = f"{len(gone)} run{'s' if len(gone) != 1 else ''}"
    return f"**Left out**: {runs} of variants that this study no longer has: {names}."


def one(study: Study, results: Sequence[Result], folder: Path) -> tuple[str, list[Path]]:
    """Return what is said of one study, and its figures, which are drawn into a folder."""
    text, figures = _section(study, results, folder, ".")
    return _joined([f"# {study.name.capitalize()}: {study.what}", text]), figures


def _section(study: Study, results: Sequence[Result], folder: Path, link: str) -> tuple[str, list[Path]]:
    parts: list[str] = []
    files: list[Path] = []
    mixed = study.name in OF_ALL_BODIES
    bodies = list(dict.fromkeys("" if mixed else result.label.body for result in results))
    for body in bodies:
        of = [result for result in results if mixed or result.label.body == body]
        name = study.name if body in ("kinematic", "") else f"{study.name}-{body}"
        seconds: dict[str, list[float]] = {}
        for result in sorted(of, key=lambda result: result.label.order):
            seconds.setdefault(result.label.variant, []).append(result.label.seconds)
        stem = folder / "".join(c if c.isalnum() else "-" for c in name)
        took = {variant: median(each) for variant, each in seconds.items()}
        section = Section(study, runs_of(of), all_runs_of(of), stem, link, took)
        if len(bodies) > 1:
            parts.append(f"### Body: {body}")
        parts.append(_described(study, of))
        if study.name not in UNPAIRED and not any(section.runs.values()):
            parts.append("No seed was run under all variants, so there is nothing to compare yet.")
            continue
        parts.append(SECTIONS[study.name](section))
        files += section.files
    return _joined(parts), files


def _described(study: Study, results: Sequence[Result]) -> str:
    """Return what the results are of: seeds, body, code, settings; and what is missing in them."""
    first = results[0]
    counts = Counter(result.label.seed for result in results)
    variants = {result.label.variant for result in results}
    seeds = sorted(counts)
    whole = [seed for seed in seeds if counts[seed] == len(variants)]
    codes = sorted({result.label.code for result in results})
    minutes = sum(result.label.seconds for result in results) / 60
    everywhere = [each for each in first.label.overrides if all(each in r.label.overrides for r in results)]
    mixed = study.name in OF_ALL_BODIES
    what = "" if mixed else f"{first.rows[-1].stop} iterations, body {first.label.body}, "
    text = (
        f"`mdb study {study.name}`: {what}{seeds_text(seeds)}; "
        f"{len(results)} runs, {minutes:.0f} minutes of one core; code {', '.join(codes)}."
    )
    if everywhere and not mixed:
        text += f" Set for all: {_settings(everywhere)}."
    if len(codes) > 1:
        text += " **These runs are of more than one version of the code**: `mdb study` again makes them alike."
    if len(whole) < len(seeds):
        lacking = seeds_text([seed for seed in seeds if seed not in whole])
        where = " of what is compared side by side" if study.name in UNPAIRED else ""
        text += f" **Not whole**: runs of {lacking} are missing for some variants; they are left out{where}."
    return " ".join([text, *_mixed(results)])


def _mixed(results: Sequence[Result]) -> Iterator[str]:
    """Yield a sentence for each variant whose seeds were not all run with the same settings."""
    by_variant: dict[str, dict[tuple[str, ...], list[int]]] = {}
    for result in results:
        by_settings = by_variant.setdefault(result.label.variant, {})
        by_settings.setdefault(result.label.overrides, []).append(result.label.seed)
    for variant, by_settings in by_variant.items():
        if len(by_settings) > 1:
            told = [f"{seeds_text(sorted(seeds))} with {_settings(own)}" for own, seeds in by_settings.items()]
            yield f"**Mixed settings** under “{variant}”: {'; '.join(told)}: `mdb study` again makes them alike."


def _settings(overrides: Sequence[str]) -> str:
    return ", ".join(f"`{override}`" for override in overrides) or "none"


def _joined(parts: Iterable[str]) -> str:
    return "\n\n".join(part.strip("\n") for part in parts if part) + "\n"
