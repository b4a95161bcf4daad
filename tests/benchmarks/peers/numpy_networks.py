"""The network's errors by numpy: one genome at a time, or many in one product."""

import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.peers.problem import Floats, Problem

CHUNK = 20
"""Genomes at a time, so that activations stay in the cache."""


class NumpyNetwork:
    """A problem's network and pairs."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        ones = np.ones((len(problem.inputs), 1), np.float32)
        self.columns = np.ascontiguousarray(np.hstack([problem.inputs, ones]).T)
        self.target_columns = np.ascontiguousarray(problem.targets.T)

    def error(self, genome: Floats) -> float:
        """Return the error of one genome, as one writes it."""
        (hidden, before), (outputs, after) = self.problem.layers
        first, last = (
            genome[: hidden * before].reshape(hidden, before),
            genome[hidden * before :].reshape(outputs, after),
        )
        rows = np.tanh(self.problem.inputs @ first[:, :-1].T + first[:, -1])
        misses = rows @ last[:, :-1].T + last[:, -1] - self.problem.targets
        return float(np.mean(misses * misses))

    def errors(self, genomes: Floats) -> NDArray:
        """Return the errors (n,) of genomes (n, weights), some at a time."""
        starts = range(0, len(genomes), CHUNK)
        return np.concatenate([self._chunk_errors(genomes[start : start + CHUNK]) for start in starts])

    def _chunk_errors(self, genomes: Floats) -> NDArray:
        (hidden, before), (outputs, after) = self.problem.layers
        first = genomes[:, : hidden * before].reshape(-1, before)
        last = genomes[:, hidden * before :].reshape(-1, outputs, after)
        rows = first @ self.columns
        np.tanh(rows, out=rows)
        misses = last[:, :, :-1] @ rows.reshape(len(genomes), hidden, -1)
        misses += last[:, :, -1:] - self.target_columns
        return np.square(misses, out=misses).mean((1, 2))
