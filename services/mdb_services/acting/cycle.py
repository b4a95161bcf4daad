"""One iteration of the operation cycle in the making, and the models that it acts upon.

Owns what the optimizer knows of the present iteration. Sends and waits for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mdb_protocol import messages
from mdb_services.mechanism.choice import Choice, Known
from mdb_services.mechanism.networks.encoding import Codebook
from mdb_services.mechanism.networks.network import Network
from mdb_services.shell.facts import facts_of


@dataclass
class Cycle:
    """One iteration in the making."""

    perception: messages.Perception
    started_s: float
    """When the perception came."""
    begun_s: float
    """When the cycle before was done: from here on a command is awaited."""
    gave_up: set[str] = field(default_factory=set)
    note: int | None = None
    teacher: str | None = None
    holder: str | None = None
    choice: Choice | None = None
    models: dict[str, Known] = field(default_factory=dict)
    versions: dict[str, int] = field(default_factory=dict)
    acted_s: float = 0.0
    sent_s: float = 0.0
    action: messages.Action | None = None
    outcome: messages.Perception | None = None
    outcome_s: float = 0.0
    taken_up: bool = False
    """Whether it was begun by an optimizer that has died."""


@dataclass
class CurrentModels:
    """The newest valid model of each name, ready to use."""

    codebooks: dict[str, Codebook]
    usable: dict[str, Known] = field(default_factory=dict)
    versions: dict[str, int] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    """Mean squared, of each over its memory, in scaled units."""

    def take(self, model: messages.CurrentModel) -> str | None:
        """Use a model from now on; return what is wrong with it instead, if anything is."""
        codebook = self.codebooks.get(model.model)
        if codebook is None:
            return f"no model {model.model!r} in this experiment"
        if (model.layers[0], model.layers[-1]) != (codebook.width, len(codebook.outputs)):
            return (
                f"model {model.model} has layers {model.layers}, not {codebook.width} in, {len(codebook.outputs)} out"
            )
        try:
            network = Network.from_arrays(model.layers, model.weights)
        except ValueError as error:
            return str(error)
        self.usable[model.model] = Known(codebook, network, model.support)
        self.versions[model.model], self.errors[model.model] = model.version, model.error
        return None


def differs(done: messages.Action | None, wanted: messages.Action | None) -> bool:
    """Whether the robot did something else than was wanted: what an optimizer before us had wanted."""
    if done is None or wanted is None:
        return False
    return (done.action, done.intention) != (wanted.action, wanted.intention)


def prequential(models: dict[str, Known], pair: messages.Pair) -> dict[str, float]:
    """Return each model's mean squared error on a pair that it has not learnt yet."""
    facts, errors = facts_of(pair), {}
    for name, (codebook, network, _) in models.items():
        inputs, targets = codebook.input_rows(facts), codebook.target_rows(facts)
        if inputs is not None and targets is not None:
            errors[name] = float(np.square(network.predict(inputs) - targets).mean())
    return errors
