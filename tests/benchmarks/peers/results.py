"""What one run's measurements say: the numbers that the tables and the plot share."""

from typing import Any

import numpy as np

from tests.benchmarks.peers.match import Results
from tests.benchmarks.peers.problem import recorded

MAIN_NETWORK = "communication"
"""The network of the targets and of the plot."""


def case(results: Results, network: str, population: int, pairs: int) -> Results:
    """Return the measurements of one network, population and number of pairs."""
    wanted = (network, population, pairs)
    return next(c for c in results["generation"] if (c["network"], c["population"], c["pairs"]) == wanted)


def processor(times: list[list[float]]) -> np.ndarray:
    """Return the processor's seconds of each repeat."""
    return np.array([processor_s for processor_s, _ in times])


def clock(times: list[list[float]]) -> np.ndarray:
    """Return the clock's seconds of each repeat."""
    return np.array([clock_s for _, clock_s in times])


def ratios(case: Results, name: str) -> np.ndarray:
    """Return, for each round, how many times as long as ours a contestant's generation took."""
    return processor(case["times"][name]) / processor(case["times"]["ours"])


def exponent(sizes: Any, seconds: Any) -> float:
    """Return b of the fit seconds = a * sizes ** b."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def least_s(results: Results, case: Results) -> float:
    """Return the seconds that a generation's multiply-adds alone take at the core's own limit."""
    count = recorded(case["network"]).weights * case["population"] * case["pairs"]
    return count / float(np.median(results["rates"]["wide loop"]))


def rate_share(results: Results, kernel: str, loop: str) -> float:
    """Return the part of a loop's multiply-adds a second that the kernel does."""
    return float(np.median(np.array(results["rates"][kernel]) / np.array(results["rates"][loop])))


def reach(tries: list[Any], place: int) -> tuple[float, float, int]:
    """Return the median seconds and generations to an error over the seeds, infinite for most failing; successes."""
    seconds = [np.inf if spent[place] is None else spent[place] for spent, _, _ in tries]
    generations = [np.inf if needed[place] is None else needed[place] for _, needed, _ in tries]
    return float(np.median(seconds)), float(np.median(generations)), int(np.isfinite(seconds).sum())


def growth(results: Results, kind: str, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return sizes and seconds of a generation as pairs or population grow."""
    cases = results[kind]
    sizes = np.array([case[kind] for case in cases])
    return sizes, np.array([np.median(processor(case["times"][name])) for case in cases])
