"""The tables of one run's measurements, as Markdown."""

from typing import Any

import numpy as np

from tests.benchmarks.peers import match
from tests.benchmarks.peers.contestant import ENTRIES
from tests.benchmarks.peers.match import Results
from tests.benchmarks.peers.multiply_add import TANH_OPERATIONS
from tests.benchmarks.peers.problem import HIDDEN, recorded
from tests.benchmarks.peers.results import (
    MAIN_NETWORK,
    case,
    clock,
    exponent,
    growth,
    least_s,
    processor,
    rate_share,
    ratios,
    reach,
)

INSTALL = "pip install -e '.[bench]'"
TARGETS = (("evosax", 500, 200, 8), ("evotorch", 500, 200, 25), ("deap", 500, 200, 60), ("evosax", 240, 20, 3))
"""Library, population, pairs, and how many times as long its generation should take as ours."""
RATE_TARGET = 0.35
"""Share of the loop's multiply-adds a second that the kernel should reach."""


def markdown(results: Results) -> str:
    """Return all tables."""
    parts = [_header(results), _targets(results), _generations(results), _rates(results), _reached(results)]
    return "\n\n".join([*parts, _wider(results), _growth(results), _starts(results)]) + "\n"


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table; all columns but the first are to the right."""
    lines = [head, ["---", *["--:"] * (len(head) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _header(results: Results) -> str:
    machine, (before, after) = results["machine"], results["load"]
    shares = [
        processor_s / clock_s
        for kind in ("generation", "pairs", "population")
        for case in results[kind]
        for times in case["times"].values()
        for processor_s, clock_s in times
    ]
    versions = ", ".join(f"{package} {version}" for package, version in machine["versions"].items())
    missing = [ENTRIES[name].label for name in ENTRIES if name not in results["names"]]
    lines = [
        "# Evolution here against public libraries",
        f"{machine['processor']}, {machine['cores']} cores, all pinned to core {machine['core']}. "
        f"Python {machine['python']}, {versions}.",
        f"Load average over 1, 5, 15 minutes before {_load(before)}, after {_load(after)}; while a contestant was at "
        f"work it had {np.median(shares):.0%} of the core in the median (times are the processor's).",
    ]
    if missing:
        lines.append(f"Not installed ({INSTALL}): {'; '.join(missing)}.")
    return "\n\n".join(lines)


def _load(averages: list[float]) -> str:
    return "/".join(f"{average:.1f}" for average in averages)


def _targets(results: Results) -> str:
    rows = []
    for library, population, pairs, target in TARGETS:
        here = case(results, MAIN_NETWORK, population, pairs)
        cells = [f"{library}, {population}x{pairs}", f"{target}x"]
        for name in (library, f"{library}+"):
            cells.append(
                _against(float(np.median(ratios(here, name))), target)
                if name in results["names"]
                else "not installed"
            )
        fastest = here["times"].get(f"{library}+")
        cells.append(f"{np.median(processor(fastest)) / least_s(results, here):.0f}x" if fastest else "")
        rows.append(cells)
    kernel = f"kernel {MAIN_NETWORK} 500x200"
    shares = [rate_share(results, kernel, loop) for loop in ("plain loop", "wide loop")]
    forms = ("{:.0%} of the plain loop", "{:.0%} of the wide loop")
    verdicts = [_against(share, RATE_TARGET, form) for share, form in zip(shares, forms, strict=True)]
    rows.append(["kernel, 500x200", f"{RATE_TARGET:.0%}", *verdicts, "100%"])
    head = ["target", "at least", "as documented", "fastest form", "bound for the fastest form"]
    text = (
        "How many times as long as ours a generation takes, and to what that would be bound if ours did nothing but "
        "its multiply-adds, at the rate of the wide loop."
    )
    return "\n\n".join(["## Targets", text, table(head, rows), _parts(results)])


def _parts(results: Results) -> str:
    """Say of what our generation is made, which is why a target is met or missed."""
    here = case(results, MAIN_NETWORK, 500, 200)
    whole_s, fitness_s = float(np.median(processor(here["times"]["ours"]))), here["fitness"]["ours"]
    tanh = HIDDEN[MAIN_NETWORK] * here["population"] * here["pairs"]
    return (
        f"At 500x200 our generation takes {1e3 * whole_s:.3g} ms: {1e3 * fitness_s:.3g} ms for fitness, of which the "
        f"multiply-adds alone would take {1e3 * least_s(results, here):.2g} ms (the rest are {tanh:,} tanh), and "
        f"{1e3 * (whole_s - fitness_s):.2g} ms for selection, crossover and mutation."
    )


def _against(value: float, target: float, form: str = "{:.1f}x") -> str:
    verdict = "met" if value >= target else f"missed by {1 - value / target:.0%}"
    return f"{form.format(value)}, {verdict}"


def _generations(results: Results) -> str:
    parts = ["## A whole generation"]
    for here in results["generation"]:
        evaluations = here["population"]
        rows = []
        for name in match.TIMED:
            label = ENTRIES[name].label
            if name not in here["times"]:
                rows.append([label, "not installed", "", "", ""])
                continue
            times = processor(here["times"][name]) * 1e3
            times_ours = ratios(here, name)
            rows.append([
                label,
                f"{np.median(times):.3g} ({times.min():.3g}–{times.max():.3g})",
                f"{1e3 * here['fitness'][name]:.3g}",
                f"{1e3 * evaluations / np.median(times):,.0f}",
                f"{np.median(times_ours):.2f} ({times_ours.min():.2f}–{times_ours.max():.2f})",
            ])  # fmt: skip
        head = ["contestant", "ms a generation", "ms for fitness alone", "evaluations a second", "times ours"]
        fixed = ", ".join(f"{ENTRIES[name].label} {1e3 * seconds:.3g} ms" for name, seconds in here["call"].items())
        parts.append(f"### {here['network']} network, {here['population']}x{here['pairs']}\n\n{table(head, rows)}")
        parts.append(f"A call of `learn` measures the population first; that and its checks: {fixed}.")
    return "\n\n".join(parts)


def _wider(results: Results) -> str:
    """Compare the clock's times on two cores with those on one, where the processor's are the clock's."""
    rows = []
    for here, wide in zip(results["generation"], results["wider"], strict=True):
        size = f"{here['network']}, {here['population']}x{here['pairs']}"
        for name in match.GROWING:
            if name in results["names"]:
                one, two = np.median(processor(here["times"][name])), np.median(clock(wide["times"][name]))
                ours = np.median(clock(wide["times"]["ours"]))
                rows.append([size, ENTRIES[name].label, f"{1e3 * one:.3g}", f"{1e3 * two:.3g}", f"{two / ours:.2f}"])
    head = ["", "contestant", "ms a generation on one core", "ms on two", "times ours on two"]
    return f"## Two cores\n\n{table(head, rows)}"


def _rates(results: Results) -> str:
    rows = []
    for name, rates in results["rates"].items():
        cells = [name, f"{np.median(rates) / 1e9:.1f}"]
        if name.startswith("kernel"):
            network = name.split()[1]
            with_tanh = 1 + HIDDEN[network] * TANH_OPERATIONS / recorded(network).weights
            for loop in ("plain loop", "wide loop"):
                share = rate_share(results, name, loop)
                cells.append(f"{share:.0%} ({share * with_tanh:.0%} with tanh)")
        rows.append(cells + [""] * (4 - len(cells)))
    head = ["", "10⁹ multiply-adds a second", "of the plain loop", "of the wide loop"]
    return f"## Multiply-adds\n\n{table(head, rows)}"


def _reached(results: Results) -> str:
    rows = []
    for name in match.REACHING:
        cells = [ENTRIES[name].label]
        for here in results["reach"]:
            for place in range(len(here["errors"])):
                cells.append(_reach_cell(here["tries"].get(name), place))
        rows.append(cells)
    head = ["contestant"]
    head += [f"{here['network']} to {error:g}" for here in results["reach"] for error in here["errors"]]
    seeds, population = len(match.REACH_SEEDS), match.REACH_POPULATION
    return (
        f"## Time to reach an error\n\nSeconds in the median of {seeds} seeds, population {population}, from scratch "
        f"on the recorded memories; generations, and how many seeds reached it within {match.REACH_LIMIT_S:g} s.\n\n"
        + table(head, rows)
    )


def _reach_cell(tries: list[Any] | None, place: int) -> str:
    if tries is None:
        return "not installed"
    seconds, generations, reached = reach(tries, place)
    if not np.isfinite(seconds):
        return f"not reached ({reached}/{len(tries)})"
    return f"{seconds:.3g} ({generations:.0f} generations, {reached}/{len(tries)})"


def _growth(results: Results) -> str:
    rows = []
    for name in match.GROWING:
        cells = [ENTRIES[name].label]
        for kind in ("pairs", "population"):
            if name not in results["names"]:
                cells.append("not installed")
                continue
            sizes, seconds = growth(results, kind, name)
            cells.append(f"{exponent(sizes, seconds):.2f} ({1e3 * seconds[0]:.3g} to {1e3 * seconds[-1]:.3g} ms)")
        rows.append(cells)
    pairs, populations = match.PAIRS, match.POPULATIONS
    head = [
        "exponent of the cost of a generation",
        f"pairs {pairs[0]} to {pairs[-1]}, population {match.GROWTH_POPULATION}",
        f"population {populations[0]} to {populations[-1]}, {match.GROWTH_PAIRS} pairs",
    ]
    return f"## Growth\n\n{table(head, rows)}"


def _starts(results: Results) -> str:
    here = case(results, MAIN_NETWORK, 500, 200)
    rows = [[ENTRIES[name].label, f"{seconds:.2f}"] for name, seconds in here["start"].items()]
    head = ["contestant", "seconds until warm, 500x200"]
    return "## Not in the times above\n\nCompiling, the first population, two generations.\n\n" + table(head, rows)
