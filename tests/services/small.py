"""A brain of two small models for tests, and messages that fit it."""

from itertools import pairwise
from typing import Any

import numpy as np

from mdb_protocol import messages
from mdb_services.experiment.brain import BrainConfig, brain_config

BRAIN = "test"

CONTENT: dict[str, Any] = {
    "experiment": {"name": "small", "brain": BRAIN, "iterations": 5, "seed": 3, "pace": "concurrent"},
    "channels": {
        "distance": {"low": 0.0, "high": 2.0, "change": 0.5},
        "note": {"encoding": "one_hot", "size": 3},
        "action": {"encoding": "rank", "values": [0, -20, 20]},
        "feedback": {"low": -1.0, "high": 1.0},
    },
    "model": [
        {"name": "communication", "role": "world", "inputs": ["note", "action"], "outputs": ["feedback"],
         "hidden": [3], "capacity": 4},
        {"name": "object", "role": "world", "inputs": ["distance", "action"], "outputs": ["next.distance"],
         "hidden": [3], "capacity": 4},
    ],
    "mode": [
        {"name": "taught", "world": "communication", "satisfaction": "feedback"},
        {"name": "alone", "world": "object", "satisfaction": "next.distance"},
    ],
    "optimizer": {"actions": 3},
    "evolution": {"population": 20, "generations": 2, "elite": 1},
}  # fmt: skip
"""Communication: 3 notes and an action's rank in, feedback out; object: distance and action in, distance out."""

INPUTS = {"communication": 4, "object": 2}


def content(**sections: dict[str, Any]) -> dict[str, Any]:
    """The content of the experiment file with some settings of some sections changed."""
    return CONTENT | {name: CONTENT.get(name, {}) | section for name, section in sections.items()}


def config(**sections: dict[str, Any]) -> BrainConfig:
    return brain_config(content(**sections), "small.toml")


LOCKSTEP = {"pace": "lockstep"}


def pair(iteration: int, **fields: Any) -> messages.Pair:
    plain = {
        "before": {"distance": 1.0 + 0.01 * iteration},
        "note": iteration % 3,
        "action": (iteration // 3) % 3,
        "after": {"distance": 0.9},
        "feedback": 1.0 if iteration % 2 else -1.0,
        "versions": {},
    }
    return messages.Pair(iteration=iteration, **(plain | fields))


def perception(iteration: int, distance: float = 1.0, **fields: Any) -> messages.Perception:
    reading = {"distance": distance}
    plain = {"event": "none", "outcome": reading, "reading": reading}
    return messages.Perception(iteration=iteration, **(plain | fields))


def model(
    name: str, version: int = 1, *, layers: list[int] | None = None, last: float = 0.5
) -> messages.CurrentModel:
    """A current model without hidden units that always says `last`."""
    layers = layers or [INPUTS[name], 0, 1]
    weights = np.zeros(sum((i + 1) * o for i, o in pairwise(layers)), np.float32)
    weights[-1:] = last
    return messages.CurrentModel(
        model=name, version=version, generation=version, layers=layers, weights=weights, error=0.1
    )
