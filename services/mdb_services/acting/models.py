"""The current models that the optimizer acts upon. Sends and waits for nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mdb_protocol import messages
from mdb_services.mechanism.actions.foresight import Known
from mdb_services.mechanism.networks.encoding import Codebook
from mdb_services.mechanism.networks.network import Network
from mdb_services.shell.facts import facts_of


@dataclass
class CurrentModels:
    """The newest valid model of each name, ready to use."""

    codebooks: dict[str, Codebook]
    usable: dict[str, Known] = field(default_factory=dict)
    versions: dict[str, int] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    """Mean squared, of each over its memory, in scaled units."""
    required: dict[str, int] = field(default_factory=dict)
    """Of each model, the version of its memory that it is to have learnt, as far as is known."""

    @property
    def are_in(self) -> bool:
        """Whether each has learnt what it is required to."""
        return all(self.versions.get(name, 0) >= version for name, version in self.required.items())

    def behind(self) -> dict[str, int]:
        """Return how many versions each is behind."""
        return {name: max(v - self.versions.get(name, 0), 0) for name, v in self.required.items()}

    def take(self, model: messages.CurrentModel) -> str | None:
        """Use a model from now on; return what is wrong with it instead, if anything is."""
        codebook = self.codebooks.get(model.model)
        if codebook is None:
            return f"no model {model.model!r} in this experiment"
        if (misfit := codebook.misfit(model.layers)) is not None:
            return f"model {model.model}: {misfit}"
        try:
            network = Network.from_arrays(model.layers, model.weights)
        except ValueError as error:
            return str(error)
        self.usable[model.model] = Known(codebook, network, model.support)
        self.versions[model.model], self.errors[model.model] = model.version, model.error
        return None


def prequential(models: Mapping[str, Known], pair: messages.Pair) -> dict[str, float]:
    """Return each model's mean squared error on a pair that it has not learnt yet."""
    facts, errors = facts_of(pair), {}
    for name, (codebook, network, _) in models.items():
        inputs, targets = codebook.input_rows(facts), codebook.target_rows(facts)
        if inputs is not None and targets is not None:
            squares = np.square(network.predict(inputs) - targets)
            errors[name] = float(np.add.reduce(squares, axis=None) / squares.size)
    return errors
