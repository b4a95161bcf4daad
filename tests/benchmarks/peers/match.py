"""The measurements: contestants take turns on the same cores, so that a disturbance meets all of them.

Owns the processes and the order of turns. What the numbers mean is in `results`.
"""

import importlib.util
import json
import os
import platform
import subprocess
import sys
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from tests.benchmarks.peers.contestant import ENTRIES

ROOT = Path(__file__).parents[3]
TIMED = tuple(name for name in ENTRIES if name != "tuned")
"""Whose generations are timed: tuning changes how many are needed, not what one costs."""
CASES = (
    ("communication", 240, 20),
    ("communication", 500, 200),
    ("communication", 2000, 500),
    ("object", 500, 200),
)
"""Network, population, pairs."""
PAIRS = (50, 100, 200, 400, 800)
POPULATIONS = (100, 200, 400, 800, 1600, 3200)
GROWTH_NETWORK, GROWTH_POPULATION, GROWTH_PAIRS = "communication", 200, 200
GROWING = {
    "ours": "this project",
    "evosax+": "evosax SimpleGA",
    "evotorch+": "EvoTorch",
    "deap+": "DEAP",
    "pygad+": "PyGAD",
}
"""The fastest form of each library, with its name in the plot."""
ERRORS = {"communication": (0.05, 0.02), "object": (0.10, 0.05)}
"""Errors to reach, mean squared; the best linear model has 0.46 on the communication pairs, 0.17 on the object's."""
REACHING = ("shipped", "tuned", "evosax+", "evosax snes", "evotorch+", "deap+", "pygad+")
REACH_POPULATION, REACH_SEEDS, REACH_CHUNK, REACH_LIMIT_S = 200, range(5), 10, 4.0
REPEATS, GROWTH_REPEATS, RATE_REPEATS = 5, 3, 15
SAMPLE_S = 0.05
"""About as long as a turn lasts, though never less than `LEAST` generations."""
LEAST = 3
KEEP_MEMORY = {"MALLOC_MMAP_THRESHOLD_": "1000000000", "MALLOC_TRIM_THRESHOLD_": "4000000000"}
"""Freed memory stays with the process: else every large array costs page faults, whose price depends on neighbours.

EvoTorch as documented gains most from it: half its time at 500x200.
"""
PACKAGES = {
    "numba": ("numba", "numpy"),
    "evosax": ("evosax", "jax", "jaxlib"),
    "evotorch": ("evotorch", "torch"),
    "deap": ("deap",),
    "pygad": ("pygad",),
}

Results = dict[str, Any]
"""Plain data, written as JSON beside the tables."""


class Library:
    """The process in which a library's contestants run."""

    def __init__(self, name: str, cores: Iterable[int]) -> None:
        command = [sys.executable, "-m", "tests.benchmarks.peers.worker", *map(str, cores)]
        pipe = subprocess.PIPE
        self.name = name
        self._process = subprocess.Popen(
            command,
            stdin=pipe,
            stdout=pipe,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=ROOT,
            env=os.environ | KEEP_MEMORY,
        )

    def ask(self, do: str, **arguments: Any) -> Any:
        """Give an order and return its answer; RuntimeError with the traceback of what failed there."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"do": do, **arguments}) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        answer = json.loads(line) if line else {"error": f"its process ended: {self._process.wait()}"}
        if "error" in answer:
            raise RuntimeError(f"{self.name}, {do} {arguments}: {answer['error']}")
        return answer["answer"]

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()


def installed() -> list[str]:
    """Return the names of the contestants whose library is there."""
    return [name for name, entry in ENTRIES.items() if importlib.util.find_spec(entry.library)]


class Match:
    """All measurements of one run."""

    def __init__(self, cores: Collection[int]) -> None:
        self.names = installed()
        self.cores = cores
        libraries = dict.fromkeys(ENTRIES[name].library for name in self.names)
        self.libraries = {library: Library(library, cores) for library in libraries}

    def close(self) -> None:
        """End all processes."""
        for library in self.libraries.values():
            library.close()

    def ask(self, name: str, do: str, **arguments: Any) -> Any:
        """Give a contestant's process an order about it."""
        return self.libraries[ENTRIES[name].library].ask(do, name=name, **arguments)

    def present(self, names: Iterable[str]) -> list[str]:
        """Return those of the names whose library is there."""
        return [name for name in names if name in self.names]

    def measure(self) -> Results:
        """Return everything."""
        began = os.getloadavg()
        results: Results = {"machine": self._machine(), "names": self.names}
        ours = self.libraries["numba"]
        results["rates"] = ours.ask("multiply_adds", repeats=RATE_REPEATS)
        results["generation"] = [self._case(*case) for case in CASES]
        results["reach"] = [self._reach(network) for network in ERRORS]
        results["pairs"] = [self._grow(GROWTH_POPULATION, pairs) for pairs in PAIRS]
        results["population"] = [self._grow(population, GROWTH_PAIRS) for population in POPULATIONS]
        results["load"] = [began, os.getloadavg()]
        return results

    def generations(self) -> list[Results]:
        """Return the times of whole generations of the fastest forms."""
        return [self._turns(self.present(GROWING), *case, REPEATS) for case in CASES]

    def _machine(self) -> Results:
        models = {line.partition(":")[2].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")}
        versions = {}
        for name, library in self.libraries.items():
            versions |= library.ask("versions", packages=PACKAGES[name])
        return {
            "processor": ", ".join(sorted(models)) or platform.processor(),
            "cores": os.cpu_count(),
            "core": ", ".join(map(str, self.cores)),
            "python": platform.python_version(),
            "versions": versions,
        }

    def _case(self, network: str, population: int, pairs: int) -> Results:
        names = self.present(TIMED)
        return self._turns(names, network, population, pairs, REPEATS) | {
            "fitness": {name: self.ask(name, "fitness", calls=10) for name in names},
            "call": {
                name: _least(self.ask(name, "sample", generations=0) for _ in range(5))
                for name in ("ours", "shipped")
            },
        }

    def _grow(self, population: int, pairs: int) -> Results:
        return self._turns(self.present(GROWING), GROWTH_NETWORK, population, pairs, GROWTH_REPEATS)

    def _turns(self, names: list[str], network: str, population: int, pairs: int, repeats: int) -> Results:
        """Time whole generations; each round begins with another contestant."""
        for library in self.libraries.values():
            library.ask("drop")
        start = {name: self.ask(name, "load", network=network, population=population, pairs=pairs) for name in names}
        counts = {}
        for name in names:
            one_s = self.ask(name, "sample", generations=LEAST)[0] / LEAST
            counts[name] = max(LEAST, round(SAMPLE_S / one_s))
        times: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
        for turn in range(repeats):
            for name in names[turn % len(names) :] + names[: turn % len(names)]:
                spent = self.ask(name, "sample", generations=counts[name])
                times[name].append(tuple(seconds / counts[name] for seconds in spent))
        return {"network": network, "population": population, "pairs": pairs, "start": start, "times": times}

    def _reach(self, network: str) -> Results:
        names = self.present(REACHING)
        for name in names:
            self.ask(name, "load", network=network, population=REACH_POPULATION, pairs=None)
        tries: dict[str, list[Any]] = {name: [] for name in names}
        order = {"thresholds": ERRORS[network], "chunk": REACH_CHUNK, "limit_s": REACH_LIMIT_S}
        for seed in REACH_SEEDS:
            for name in names:
                tries[name].append(self.ask(name, "reach", seed=seed, **order))
        return {"network": network, "errors": ERRORS[network], "tries": tries}


def _least(samples: Iterable[tuple[float, float]]) -> float:
    return min(processor_s for processor_s, _ in samples)


def _lines(path: str) -> list[str]:
    try:
        return Path(path).read_text().splitlines()
    except OSError:
        return []
