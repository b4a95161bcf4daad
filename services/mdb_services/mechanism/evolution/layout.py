"""What Python and the compiled code agree on: the processor, how pairs lie in memory, which arrays are passed."""

import math
import os
from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from typing import Annotated, Any, NamedTuple, get_type_hints

import llvmlite.binding as llvm  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray


def _features(processor: str) -> str:
    """Return what a processor can do: of the machine's own LLVM knows it, of the "generic" one nothing is assumed."""
    if (given := os.environ.get("NUMBA_CPU_FEATURES")) is not None:
        return given
    with suppress(RuntimeError):  # LLVM cannot tell it of this machine
        return "" if processor == "generic" else str(llvm.get_host_cpu_features().flatten())
    return ""


PROCESSOR: str = os.environ.get("NUMBA_CPU_NAME") or llvm.get_host_cpu_name()
FEATURES = _features(PROCESSOR)
"""What is compiled for; the variables are numba's."""

WIDE = "+avx512f" in FEATURES
"""Whether the processor has AVX-512."""

ROW = 16
"""Lanes of a row: as many numbers as a register of AVX-512 has."""

LANES = 16 if WIDE else 8
"""Numbers in a vector: one register of AVX-512 or AVX, two of smaller processors."""

GROUP = 4
"""Genomes taken through the pairs together: in a vector, the numbers of a pair for each of them lie side by side."""

VECTORS = 5 if LANES == 16 else 3
"""Vectors taken through a layer together: with four units, as many sums as registers have room for."""

BLOCK = LANES // GROUP * VECTORS
"""Pairs of a block. Of the last one, vectors without any pair are left out."""

TANH_ERROR = 1e-4
"""Bound of the absolute error of a hidden unit's tanh, over all float32 numbers."""

LINE = 64
"""Bytes of a cache line: a vector that lies across two is read twice."""

TAKEN, PUT_UP, DONE = 0, 8, 16
"""Places of the counters on a board of parts, in cache lines of their own; what is put up is below 0 at the end."""

DIMENSIONS = 4
"""An array is handed over as its address and as many lengths, in words of 64 bits; those that it lacks are 0."""

ENTRY = "mdb_evolution"
"""The name of the compiled function. It takes three tables of addresses and what is to be done."""

MEASURE, EVOLVE, HELP = 0, 1, 2
"""What is to be done with `Measured` or, the last two, `Evolved`; with `Pairs` and `Spaces`."""

# An array of compiled code: what its numbers are, and how many dimensions it has.
_Bytes = Annotated[Any, np.uint8, 1]
_ByteRows = Annotated[Any, np.uint8, 2]
_Words = Annotated[Any, np.int64, 1]
_WordRows = Annotated[Any, np.int64, 2]
_Places = Annotated[Any, np.uint64, 1]
_Tables = Annotated[Any, np.int32, 3]
_Floats = Annotated[Any, np.float32, 1]
_FloatRows = Annotated[Any, np.float32, 2]
_Blocks = Annotated[Any, np.float32, 4]
_Doubles = Annotated[Any, np.float64, 1]
_DoubleRows = Annotated[Any, np.float64, 2]


class Pairs(NamedTuple):
    """A memory: inputs and targets from `genomes.in_blocks`, and how many pairs they are."""

    inputs: _Blocks
    targets: _Blocks
    count: _Words


class Measured(NamedTuple):
    """Genomes that are measured; see `kernel.population_errors`."""

    weights: _FloatRows
    promoters: _ByteRows
    sizes: _Words
    errors: _Doubles
    squares: _Doubles


class Evolved(NamedTuple):
    """A population that is evolved; what threads share.

    One of two populations has the parents of a generation, the other the children, in turn; order holds the parents,
    the best of them first; numbers is of `Numbers`, rates of `Rates`.
    """

    weights: _FloatRows
    promoters: _ByteRows
    steps: _Floats
    other_weights: _FloatRows
    other_promoters: _ByteRows
    other_steps: _Floats
    errors: _Doubles
    fitness: _Doubles
    order: _Words
    sizes: _Words
    numbers: _Words
    rates: _Doubles
    board: _Words


class Numbers(NamedTuple):
    """Whole numbers of an evolution; first: the number of the first generation; part: individuals taken at once."""

    key: int
    first: int
    generations: int
    part: int
    elite: int
    parents: int
    immigrants: int


class Rates(NamedTuple):
    """The numbers of `settings.EvolutionConfig` that compiled code needs."""

    crossover_rate: float
    mutation_rate: float
    structural_rate: float
    expressed_first: float
    weight_first: float
    step_first: float
    step_rate: float
    step_min: float
    step_max: float
    weight_limit: float
    weight_penalty: float
    error_penalty: float


class Spaces(NamedTuple):
    """Where one thread works: compiled code makes no arrays of its own.

    For a child (see `rows`), for a group of genomes (see `packing`), and for the order of a population.
    """

    genes: _Bytes
    chosen: _Bytes
    shares: _Floats
    places: _Places
    columns: _Tables
    rows: _Tables
    own: _WordRows
    counts: _Words
    starts: _Words
    firsts: _Words
    work: _Blocks
    packed: _Floats
    expressed: _Words
    bins: _Words
    by_size: _Words
    keys: _Words
    best: _Words
    sorting: _Words
    few: _DoubleRows
    group: _Words
    bases: _Words
    sums: _Floats


def _kinds_of(record: type[Any]) -> dict[str, tuple[Any, int]]:
    hints = get_type_hints(record, include_extras=True)
    return {name: hint.__metadata__ for name, hint in hints.items()}


KINDS: dict[type[Any], dict[str, tuple[Any, int]]] = {
    record: _kinds_of(record) for record in (Pairs, Measured, Evolved, Spaces)
}
"""What the arrays of each record are, by name: type of the numbers, and dimensions."""


def new_board() -> NDArray[np.int64]:
    """Return a board without any work."""
    return np.zeros(DONE + 8, np.int64)


def aligned(shape: tuple[int, ...], kind: Any = np.float32) -> NDArray[Any]:
    """Return an array that begins with a cache line; what it holds is not set."""
    size = math.prod(shape) * np.dtype(kind).itemsize
    memory = np.empty(size + LINE, np.uint8)
    start = -memory.ctypes.data % LINE
    array: NDArray[Any] = memory[start : start + size].view(kind).reshape(shape)
    return array


def spaces_for(sizes: Sequence[int], population: int, elite: int = 0) -> Spaces:
    """Return the spaces for networks of layers of these sizes and for as many individuals."""
    layers, last, total, most = len(sizes), len(sizes) - 1, sum(sizes), max(sizes)
    genes, weights = total + 2 * ROW, sum((before + 1) * after for before, after in pairwise(sizes))
    kinds = KINDS[Spaces]
    shapes: dict[str, Any] = {
        "genes": (genes,),
        "chosen": (genes,),
        "shares": (genes,),
        "places": (most,),
        "columns": (layers, GROUP, most + ROW),
        "rows": (layers, GROUP, most + ROW),
        "own": (layers, GROUP),
        "counts": (layers,),
        "starts": (layers,),
        "firsts": (layers,),
        "work": (1, total, BLOCK, GROUP),
        "packed": ((weights + ROW) * GROUP,),
        "bins": (sum(sizes[1:-1]) + 2,),
        "few": (2, elite),
        "group": (GROUP,),
        "bases": (GROUP,),
        "sums": (LANES,),
    }
    of_all = (population + 1,)
    spaces = Spaces(**{name: aligned(shapes.get(name, of_all), kind) for name, (kind, _) in kinds.items()})
    for space in spaces:
        space[...] = 0
    spaces.genes[:] = 1  # of inputs, for ever
    spaces.rows[last, :, : sizes[last]] = np.arange(sizes[last]) * (sizes[last - 1] + 1)
    spaces.own[0], spaces.own[last], spaces.counts[:] = sizes[0], sizes[last], sizes
    spaces.firsts[1:] = np.cumsum(sizes[:-1])
    return spaces
