"""A brain of two small models for tests, and messages that fit it."""

from itertools import pairwise
from typing import Any

import numpy as np

from mdb_protocol import messages
from mdb_services.experiment.brain import BrainConfig, brain_config

BRAIN = "test"
TURNS = 0.0, -20.0, 20.0
"""What each choice turns by."""

CONTENT: dict[str, Any] = {
    "experiment": {"name": "small", "brain": BRAIN, "iterations": 5, "seed": 3, "pace": "concurrent"},
    "channels": {
        "distance": {"low": 0.0, "high": 2.0, "change": 0.5},
        "note": {"encoding": "one_hot", "size": 3},
        "action": {"encoding": "rank", "by": "turn"},
        "feedback": {"low": -1.0, "high": 1.0},
    },
    "actuators": {"turn": {"low": -90.0, "high": 90.0}},
    "choice": [{"name": f"turn {turn:g}", "values": {"turn": turn}} for turn in TURNS],
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
    "optimizer": {},
    "evolution": {"population": 20, "generations": 2, "elite": 1},
}  # fmt: skip
"""Communication: 3 notes and a choice's rank in, feedback out; object: distance and choice in, distance out."""

INPUTS = {"communication": 4, "object": 2}


def content(**sections: dict[str, Any]) -> dict[str, Any]:
    """The content of the experiment file with some settings of some sections changed."""
    return CONTENT | {name: CONTENT.get(name, {}) | section for name, section in sections.items()}


def config(**sections: dict[str, Any]) -> BrainConfig:
    return brain_config(content(**sections), "small.toml")


LOCKSTEP = {"pace": "lockstep"}


def without(*sections: str) -> dict[str, Any]:
    """The content of the experiment file without some sections."""
    return {name: section for name, section in CONTENT.items() if name not in sections}


def in_ranges(**sections: Any) -> dict[str, Any]:
    """The same brain without choices: it searches the range of the turn, and reads the turn itself."""
    channels = {name: channel for name, channel in CONTENT["channels"].items() if name != "action"}
    channels["turn"] = {"low": -90.0, "high": 90.0}
    models = [model | {"inputs": [model["inputs"][0], "turn"]} for model in CONTENT["model"]]
    return without("choice") | {"channels": channels, "model": models} | sections


def config_of_vectors(**sections: Any) -> BrainConfig:
    """The same brain with a sonar of three numbers in the place of the distance; the object model foresees all."""
    object_model = CONTENT["model"][1] | {"inputs": ["sonar", "action"], "outputs": ["next.sonar"]}
    alone = CONTENT["mode"][1] | {"satisfaction": "next.sonar"}
    sonar = {"low": 0.0, "high": 4.0, "numbers": 3, "change": 1.0} | sections.pop("channels", {}).get("sonar", {})
    changed = content(channels={"sonar": sonar}, **sections)
    models, modes = [CONTENT["model"][0], object_model], [CONTENT["mode"][0], alone]
    return brain_config(changed | {"model": models, "mode": modes}, "vectors.toml")


def done(choice: int) -> dict[str, float]:
    """The values of the actuators that a choice stands for."""
    return {"turn": TURNS[choice]}


def pair(iteration: int, *, choice: int | None = None, **fields: Any) -> messages.Pair:
    """A pair of an iteration, with a choice of its own unless one or another action is given."""
    if choice is None and "action" not in fields:
        choice = (iteration // 3) % len(TURNS)
    plain = {
        "before": {"distance": 1.0 + 0.01 * iteration},
        "note": iteration % 3,
        "choice": choice,
        "after": {"distance": 0.9},
        "feedback": 1.0 if iteration % 2 else -1.0,
        "versions": {},
    }
    if choice is not None and "action" not in fields:
        plain["action"] = done(choice)
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
