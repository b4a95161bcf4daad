"""The process of one library: it reads orders, one JSON object a line, and answers each with one.

Pinned to its cores, and told to use as many threads, before the library is imported.
"""

import importlib
import json
import os
import sys
import time
import traceback
import warnings
from typing import Any

COUNTED = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""What libraries read their number of threads from, JAX apart."""


def threads(count: int) -> dict[str, str]:
    """Return the variables that make libraries use so many threads."""
    several = str(count > 1).lower()
    flags = f"--xla_cpu_multi_thread_eigen={several} intra_op_parallelism_threads={count}"
    return dict.fromkeys(COUNTED, str(count)) | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}


class Worker:
    """Answers orders; keeps the contestants that it made, one problem and population at a time."""

    def __init__(self) -> None:
        self.contestants: dict[str, Any] = {}

    def versions(self, packages: list[str]) -> dict[str, str]:
        from importlib.metadata import version

        return {package: version(package) for package in packages}

    def errors(self, name: str, network: str, genomes: int) -> list[float]:
        """Return a contestant's errors on genomes that every process draws alike."""
        from tests.benchmarks.peers.problem import first_population, recorded

        problem = recorded(network)
        found = self._make(name, problem, genomes).errors(first_population(problem, genomes, 0))
        return [float(error) for error in found]

    def load(self, name: str, network: str, population: int, pairs: int | None) -> float:
        """Make a contestant ready and warm; return the seconds that took, which is compiling in the first place."""
        from tests.benchmarks.peers.problem import recorded

        problem = recorded(network)
        began = time.perf_counter()
        contestant = self._make(name, problem.of_size(pairs) if pairs else problem, population)
        contestant.reset(0)
        for _ in range(2):  # twice: JAX compiles again when the state comes back
            contestant.run(1)
        self.contestants[name] = contestant
        return time.perf_counter() - began

    def sample(self, name: str, generations: int) -> tuple[float, float]:
        """Return the seconds of processor and of the clock that one call for so many generations takes."""
        contestant = self.contestants[name]
        return _timed(lambda: contestant.run(generations))

    def fitness(self, name: str, calls: int) -> float:
        """Return the processor's seconds of one measurement of a population, the least of so many."""
        from tests.benchmarks.peers.problem import first_population

        contestant = self.contestants[name]
        genomes = first_population(contestant.problem, contestant.population, 0)
        return min(_timed(lambda: contestant.errors(genomes))[0] for _ in range(calls))

    def reach(
        self, name: str, seed: int, thresholds: list[float], chunk: int, limit_s: float
    ) -> tuple[list[float | None], list[int | None], float]:
        """Evolve from scratch; return seconds and generations to each error, and the last error.

        None stands for an error that was not reached within the limit.
        """
        contestant = self.contestants[name]
        seconds: list[float | None] = [None] * len(thresholds)
        needed: list[int | None] = [None] * len(thresholds)
        contestant.reset(seed)
        generations, spent_s, error = 0, 0.0, float("inf")
        while spent_s < limit_s and None in seconds:
            processor_s, _ = _timed(lambda: contestant.run(chunk))
            generations, spent_s, error = generations + chunk, spent_s + processor_s, contestant.best()
            for place, threshold in enumerate(thresholds):
                if seconds[place] is None and error <= threshold:
                    seconds[place], needed[place] = spent_s, generations
        return seconds, needed, error

    def multiply_adds(self, repeats: int) -> dict[str, list[float]]:
        from tests.benchmarks.peers.multiply_add import rates

        return rates(repeats)

    def drop(self) -> None:
        """Forget the contestants."""
        self.contestants.clear()

    @staticmethod
    def _make(name: str, problem: Any, population: int) -> Any:
        from tests.benchmarks.peers.contestant import ENTRIES

        module, _, cls = ENTRIES[name].place.partition(".")
        return getattr(importlib.import_module(f"tests.benchmarks.peers.{module}"), cls)(problem, population)


def _timed(job: Any) -> tuple[float, float]:
    processor_s, clock_s = time.process_time(), time.perf_counter()
    job()
    return time.process_time() - processor_s, time.perf_counter() - clock_s


def main() -> None:
    """Answer until the orders end."""
    cores = {int(core) for core in sys.argv[1:]}
    os.sched_setaffinity(0, cores)
    os.environ.update(threads(len(cores)))
    warnings.simplefilter("ignore")
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library prints is no answer
    worker = Worker()
    for line in sys.stdin:
        order = json.loads(line)
        try:
            answer = {"answer": getattr(worker, order.pop("do"))(**order)}
        except Exception:
            answer = {"error": traceback.format_exc()}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
