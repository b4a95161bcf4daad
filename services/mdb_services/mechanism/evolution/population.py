"""A population of genomes with promoters, as compiled code evolves it; threads help where there is much to do."""

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.evolution import native, threads
from mdb_services.mechanism.evolution.layout import (
    EVOLVE,
    HELP,
    PUT_UP,
    Evolved,
    Numbers,
    Pairs,
    Rates,
    Spaces,
    new_board,
    spaces_for,
)
from mdb_services.mechanism.networks.network import Floats, Shape
from mdb_services.mechanism.settings import EvolutionConfig

PART = 64
"""Individuals that a thread takes at once."""
MUCH = 1e7
"""All weights of a population times the pairs, from which on threads help. It pays from a tenth of that on, but where
a population is small, other processes have more use for the cores."""


class Population:
    """Weights (population, weights) float32, promoters (population, hidden units) uint8, steps (population,) float32.

    errors and fitness (population,) float64 are those of the last memory. All are changed in place, so nobody may put
    others in their stead.
    """

    def __init__(
        self,
        shape: Shape,
        config: EvolutionConfig,
        individuals: tuple[Floats, NDArray[np.uint8], Floats],
        errors: NDArray[np.float64],
        fitness: NDArray[np.float64],
    ) -> None:
        """Take the arrays; raises ValueError when one is not of its kind or size."""
        count = len(errors)
        sizes = [(count, shape.weights), (count, shape.units), (count,), (count,)]
        if [array.shape for array in (*individuals, fitness)] != sizes:
            raise ValueError(f"arrays of other sizes than those of {count} individuals of {shape}: {sizes}")
        if not all(array.flags.writeable for array in (*individuals, errors, fitness)):
            raise ValueError("an array cannot be written to; expected some that can: copy it")
        self._shape, self._count = shape, count
        self._elite, self._all_weights = config.elite, count * shape.weights
        parents = max(1, round(config.parent_share * count))
        immigrants = min(count - config.elite, round(config.immigrant_share * count))
        weights, promoters, steps = individuals
        self._numbers = np.array(Numbers(0, 0, 0, count, config.elite, parents, immigrants))
        self._task = native.Table(
            Evolved(
                weights,
                promoters,
                steps,
                np.zeros_like(weights),
                np.zeros_like(promoters),
                np.zeros_like(steps),
                errors,
                fitness,
                order=np.zeros(count + 1, np.int64),
                sizes=np.array(shape.sizes, np.int64),
                numbers=self._numbers,
                rates=np.array([getattr(config, name) for name in Rates._fields]),
                board=new_board(),
            )
        )
        self._spaces = self._new_spaces()

    def _new_spaces(self) -> native.Table[Spaces]:
        return native.Table(spaces_for(self._shape.sizes, self._count, self._elite))

    def evolve(self, pairs: native.Table[Pairs], key: int, generations: range, helpers: int | None = None) -> None:
        """Evolve on pairs, of `genomes.as_pairs`, with as many inputs and targets as the networks have.

        The generations are those of this memory. First everyone is measured on the present memory: an old fitness
        says nothing once the memory changed. In a generation the best few stay, and offspring of the better part of
        the population, all of whose members have the same chance, replace the others but for a few immigrants, if
        their share comes to one: neutral operators cannot bring back what all have lost, say every unit of a layer.
        helpers: how many threads help; as many as there are idle cores, if there is much to do, when it is not given.
        """
        if helpers is None:
            helpers = threads.idle() if self._all_weights * pairs.arrays.count[0] >= MUCH else 0
        signed = key - 2**64 if key >= 2**63 else key
        numbers = self._numbers  # one by one: of a few, that is the fastest way
        numbers[0], numbers[1], numbers[2] = signed, generations.start, len(generations)
        numbers[3] = PART if helpers else self._count
        native.load()
        # A board of its own: nobody who helped before can take part in this.
        task, board = self._task.arrays, new_board()
        table, helping = native.Table(task._replace(board=board)) if helpers else self._task, []
        task.board[:] = 0
        try:
            for _ in range(helpers):
                helping += threads.helping(1, native.run, table, pairs, self._new_spaces(), HELP)
            native.run(table, pairs, self._spaces, EVOLVE)
        finally:
            board[PUT_UP] = -1
            threads.finish(helping)
