"""A brain that learns what a teacher's two notes mean, three languages, and the networks that speak them."""

from typing import Any

import numpy as np

from mdb_protocol import messages
from mdb_services.experiment.brain import BrainConfig, brain_config
from mdb_services.mechanism.memories.stm import Change, MemoryMirror
from mdb_services.mechanism.networks.network import Network
from tests.services.small import BRAIN

NAME = "communication"
CAPACITY = 8
TURNS = 0.0, 90.0
"""What each choice turns by."""

CONTENT: dict[str, Any] = {
    "experiment": {"name": "languages", "brain": BRAIN, "iterations": 100, "seed": 3, "pace": "lockstep"},
    "channels": {
        "note": {"encoding": "one_hot", "size": 2},
        "action": {"encoding": "rank", "by": "turn"},
        "feedback": {"low": -1.0, "high": 1.0},
    },
    "actuators": {"turn": {"low": -90.0, "high": 90.0}},
    "choice": [{"name": f"turn {turn:g}", "values": {"turn": turn}} for turn in TURNS],
    "model": [
        {"name": NAME, "role": "world", "inputs": ["note", "action"], "outputs": ["feedback"], "hidden": [4],
         "capacity": CAPACITY},
    ],
    "mode": [{"name": "taught", "world": NAME, "satisfaction": "feedback"}],
    "context": {"known_pairs": 4},
    "long_term": {"stable_pairs": 6, "sample": 4},
    "evolution": {"population": 40, "generations": 3},
}  # fmt: skip
"""A context is known after 4 pairs, a model stored after 6 good ones with a sample of all 4 combinations."""


def config(**sections: dict[str, Any]) -> BrainConfig:
    return brain_config(CONTENT | {name: CONTENT.get(name, {}) | s for name, s in sections.items()}, "languages.toml")


def _agree(sign: float) -> Network:
    """+sign when the note is the choice, otherwise -sign: two hidden units, nearly exact."""
    hidden = [[-5, 5, 5, -5], [5, -5, -5, -5]]
    return Network([np.array(hidden), np.array([[sign, sign, sign]])])


SPEAKS: dict[str, Network] = {
    "A": _agree(1.0),
    "B": _agree(-1.0),
    "C": Network([np.zeros((0, 4)), np.array([[-1.0]])]),
    "silence": Network([np.zeros((0, 4)), np.array([[0.0]])]),
}
"""A: do what the note says; B: the opposite; C: whatever is done is wrong; silence: no language at all."""


def feedback(language: str, note: int, choice: int) -> float:
    right = {"A": note == choice, "B": note != choice, "C": False}[language]
    return 1.0 if right else -1.0


def done(choice: int) -> dict[str, float]:
    """The values of the actuators that a choice stands for."""
    return {"turn": TURNS[choice]}


def pair(
    iteration: int, language: str, *, note: int | None = None, choice: int | None = None, **fields: Any
) -> messages.Pair:
    """The pair of an iteration: unless told, all four combinations of note and choice, one after the other."""
    note = iteration % 2 if note is None else note
    choice = iteration // 2 % 2 if choice is None else choice
    plain: dict[str, Any] = {"before": {}, "after": {}, "feedback": feedback(language, note, choice), "versions": {}}
    return messages.Pair(iteration=iteration, note=note, action=done(choice), choice=choice, **(plain | fields))


def current(network: Network, version: int) -> messages.CurrentModel:
    layers, weights = network.to_arrays()
    return messages.CurrentModel(
        model=NAME, version=version, generation=version, layers=layers, weights=weights, error=0.0
    )


def language_of(weights: messages.ModelWeights | messages.CurrentModel | messages.LongTermModel) -> str:
    """Which of the languages a network on the wire speaks."""
    network = Network.from_arrays(weights.layers, weights.weights)
    (found,) = [
        name for name, known in SPEAKS.items()
        if network.sizes == known.sizes and all(map(np.array_equal, network.layers, known.layers))
    ]  # fmt: skip
    return found


class Student:
    """In the place of an evolver: follows the memory, and knows the language that explains it best."""

    def __init__(self) -> None:
        self.mirror = MemoryMirror(CAPACITY, 3, 1)
        self.seeds: list[str] = []
        self.model: messages.CurrentModel | None = None

    def follow(self, change: messages.MemoryChange) -> messages.CurrentModel:
        arrays = (change.slots, change.pairs, change.evicted, change.freed)
        slots, ids, evicted, freed = (tuple(array.tolist()) for array in arrays)
        self.mirror.apply(Change(change.version, slots, ids, evicted, freed), change.inputs, change.targets)
        self.seeds += [language_of(seed) for seed in change.seeds]
        inputs, targets, _ = self.mirror.arrays()
        errors = {name: np.square(network.predict(inputs) - targets).mean() for name, network in SPEAKS.items()}
        self.model = current(SPEAKS[min(errors, key=lambda name: errors[name])], self.mirror.version)
        return self.model
