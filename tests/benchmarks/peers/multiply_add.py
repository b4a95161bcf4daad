"""How many float32 multiply-adds a second the core can do, and how many the fitness kernel does.

Two yardsticks: a plain numba loop, whose vectors LLVM makes only 256 bits wide, and the same loop with 512-bit
vectors written out, which is the core's own limit where it has them.
"""

import time
from collections.abc import Callable

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from tests.benchmarks.peers.ours import Ours
from tests.benchmarks.peers.problem import first_population, recorded

DEPTH, LENGTH = 8, 64
"""The plain loop: a polynomial of this degree for each of so many numbers, all independent of one another."""
LANES, CHAINS = 16, 12
"""The wide loop: accumulators of so many numbers; fewer than 8 of them would wait for one another."""
FUSED = ("contract",)
TANH_OPERATIONS = 6
"""Instructions a tanh costs at least: 4 multiply-adds, a product, a rough quotient."""
SIZES = (("communication", 500, 200), ("communication", 2000, 500), ("object", 500, 200))


@njit(fastmath={"contract"})
def _plain(values, factor, sums, rounds):
    for _ in range(rounds):
        for i in range(LENGTH):
            value = total = values[i]
            for _ in range(DEPTH):
                total = total * value + factor
            sums[i] = total


@intrinsic
def _wide_loop(_, _start, _factor, _rounds):
    """Emit the loop by hand: LLVM's vectoriser would not choose 512 bits."""
    vector = ir.VectorType(ir.FloatType(), LANES)
    index = ir.IntType(64)

    def splat(builder, value):
        one = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), zeros)

    def generate(_, builder, __, arguments):
        starts, factors = splat(builder, arguments[0]), splat(builder, arguments[1])
        before, loop, after = builder.block, builder.append_basic_block(), builder.append_basic_block()
        first = [builder.fmul(starts, ir.Constant(vector, [1.0 + chain] * LANES)) for chain in range(CHAINS)]
        builder.branch(loop)
        builder.position_at_end(loop)
        count, sums = builder.phi(index), [builder.phi(vector) for _ in range(CHAINS)]
        following = [builder.fadd(builder.fmul(one, factors, flags=FUSED), starts, flags=FUSED) for one in sums]
        counted = builder.add(count, ir.Constant(index, 1))
        for phi, entering, next_value in zip(
            (count, *sums), (ir.Constant(index, 0), *first), (counted, *following), strict=True
        ):
            phi.add_incoming(entering, before)
            phi.add_incoming(next_value, loop)
        builder.cbranch(builder.icmp_signed("<", counted, arguments[2]), loop, after)
        builder.position_at_end(after)
        total = following[0]
        for other in following[1:]:
            total = builder.fadd(total, other)
        return builder.extract_element(total, ir.Constant(ir.IntType(32), 0))

    return types.float32(types.float32, types.float32, types.int64), generate


@njit
def _wide(start, factor, rounds):
    return _wide_loop(start, factor, rounds)


def rates(repeats: int) -> dict[str, list[float]]:
    """Return multiply-adds a second, `repeats` of each, interleaved: the two loops, the kernel at each size."""
    values, sums = np.linspace(-0.4, 0.4, LENGTH, dtype=np.float32), np.empty(LENGTH, np.float32)
    half = np.float32(0.5)
    rounds = 100_000
    jobs: dict[str, tuple[float, Callable[[], object]]] = {
        "plain loop": (rounds * LENGTH * DEPTH, lambda: _plain(values, half, sums, rounds)),
        "wide loop": (rounds * LANES * CHAINS, lambda: _wide(half, half, rounds)),
    }
    for name, population, pairs in SIZES:
        problem = recorded(name).of_size(pairs)
        ours, genomes = Ours(problem, population), first_population(problem, population, 0)
        count = problem.weights * population * pairs
        jobs[f"kernel {name} {population}x{pairs}"] = count, lambda ours=ours, genomes=genomes: ours.errors(genomes)
    found: dict[str, list[float]] = {name: [] for name in jobs}
    for repeat in range(repeats + 1):
        for name, (count, job) in jobs.items():
            began = time.process_time()
            job()
            if repeat:  # the first compiles
                found[name].append(count / (time.process_time() - began))
    return found
