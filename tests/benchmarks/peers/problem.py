"""The problems: networks, and the short-term memories of a real run that they are evolved on.

The memories are of seed 90 with the kinematic body. To record them anew:

    mdb up paper --inline --no-plot --set robot.body=kinematic --iterations 500 --seed 90
    python -m tests.benchmarks.peers.problem RUN
"""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

RECORDED = Path(__file__).parents[1] / "data" / "recorded.npz"
HIDDEN = {"communication": 16, "object": 20}
"""Hidden units of the recorded models' networks, as in the paper's experiment."""
RECORDED_AT = {"communication": 200, "object": 500}
"""Iterations after which a memory was recorded; once it obeys, a robot hears nothing but praise, which is no task."""


@dataclass(frozen=True)
class Problem:
    """Pairs, inputs (n, inputs) and targets (n, outputs), and the tanh perceptron that is to predict them.

    A genome is flat: for each hidden unit, then each output, its weights with the bias last.
    """

    name: str
    hidden: int
    inputs: Floats
    targets: Floats

    @property
    def layers(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Shapes of the two weight matrices, (units, units before + 1)."""
        return (self.hidden, self.inputs.shape[1] + 1), (self.targets.shape[1], self.hidden + 1)

    @property
    def weights(self) -> int:
        """Numbers in a genome, and multiplications and additions that one pair costs."""
        return sum(rows * columns for rows, columns in self.layers)

    def of_size(self, pairs: int) -> "Problem":
        """Return the problem with exactly so many pairs: the first ones, or all of them again and again."""
        sizes = ((pairs, array.shape[1]) for array in (self.inputs, self.targets))
        inputs, targets = (
            np.resize(array, size) for array, size in zip((self.inputs, self.targets), sizes, strict=True)
        )
        return replace(self, inputs=inputs, targets=targets)


def recorded(name: str) -> Problem:
    """Return a recorded memory as a problem."""
    with np.load(RECORDED) as arrays:
        return Problem(name, HIDDEN[name], arrays[f"{name}.inputs"], arrays[f"{name}.targets"])


def first_population(problem: Problem, population: int, seed: int) -> Floats:
    """Return the genomes (population, weights) that every contestant begins with."""
    random = np.random.default_rng(seed)
    return random.uniform(-1, 1, (population, problem.weights)).astype(np.float32)


def oracle(problem: Problem, genomes: Floats) -> NDArray[np.float64]:
    """Return the mean squared errors (population,) in double precision, by plain numpy."""
    (hidden, before), (outputs, after) = problem.layers
    errors = []
    for genome in genomes.astype(np.float64):
        first, last = (
            genome[: hidden * before].reshape(hidden, before),
            genome[hidden * before :].reshape(outputs, after),
        )
        rows = np.tanh(problem.inputs @ first[:, :-1].T + first[:, -1]) @ last[:, :-1].T + last[:, -1]
        errors.append(np.mean((rows - problem.targets) ** 2))
    return np.array(errors)


def record(run: Path, path: Path) -> None:
    """Write the short-term memories of a run, from its experiment file and its log."""
    from mdb_protocol.messages import Pair
    from mdb_services.experiment.brain import brain_config
    from mdb_services.experiment.reading import read_file
    from mdb_services.experiment.run_folder import EXPERIMENT_FILE
    from mdb_services.mechanism.memories.stm import ShortTermMemory
    from mdb_services.mechanism.networks.encoding import Codebook, gather
    from mdb_services.recorder import read_log

    config = brain_config(read_file(run / EXPERIMENT_FILE), run)
    pairs = {sent.message.iteration: sent.message for sent in read_log(run) if isinstance(sent.message, Pair)}
    arrays = {}
    for name in HIDDEN:
        section = config.model_named(name)
        codebook = Codebook(config.variables(), section.inputs, section.outputs)
        memory = ShortTermMemory(section.capacity, codebook.width, len(section.outputs), config.memory_of(section))
        for iteration in range(RECORDED_AT[name]):
            pair = pairs[iteration]
            facts = gather(
                before=pair.before, after=pair.after, note=pair.note, action=pair.action, feedback=pair.feedback
            )
            inputs, targets = codebook.input_rows(facts), codebook.target_rows(facts)
            if inputs is not None and targets is not None:
                memory.insert(iteration, inputs[0], targets[0], 0.0)
        arrays[f"{name}.inputs"], arrays[f"{name}.targets"], _ = memory.arrays()
    np.savez_compressed(path, **arrays)


if __name__ == "__main__":
    record(Path(sys.argv[1]), RECORDED)
