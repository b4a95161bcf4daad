"""Ridge regression on fixed features: what can be had without any search, as a reference for the others.

The hidden layers are drawn once and stay; the outputs' weights that are best on a memory, but for a penalty on
their squares, are computed from it anew (Hoerl and Kennard 1970; with random features an extreme learning
machine, Huang et al. 2006). Nothing is kept from one memory to the next, so nothing can be stale.
"""

from dataclasses import replace

import numpy as np

from mdb_services.mechanism.evolution.genomes import signals_of
from mdb_services.mechanism.learners.single import SingleNetwork
from mdb_services.mechanism.networks.network import Floats, Shape, split_layers
from mdb_services.mechanism.settings import RidgeConfig


class Ridge(SingleNetwork):
    """A network whose last hidden layer has `features` units, or as many as the shape when that has more.

    A seed's hidden units take the place of the first features: the outputs on them can only become better.
    """

    def __init__(self, shape: Shape, config: RidgeConfig, seed: int, name: str) -> None:
        """Draw the features from the stream of (seed, name)."""
        widest = max(shape.hidden[-1], config.features)
        super().__init__(replace(shape, hidden=(*shape.hidden[:-1], widest)), 1, seed, name)
        self.config = config
        for features in split_layers(self.shape.sizes, self._weights[0])[:-1]:
            np.multiply(features, config.scale, out=features)

    def _begin_anew(self) -> None:
        """Nothing is kept but the features, which have been replaced."""

    def _improve(self, inputs: Floats, targets: Floats, key: int, generations: range) -> None:  # noqa: ARG002
        if not generations:
            return
        layers = split_layers(self.shape.sizes, self._weights[0])
        rows = np.column_stack([signals_of(layers, inputs)[-1], np.ones(len(inputs))])
        penalty = np.full(rows.shape[1], self.config.penalty * len(inputs))
        penalty[-1] = 0.0  # the bias is free
        layers[-1][:] = np.linalg.solve(rows.T @ rows + np.diag(penalty), rows.T @ targets).T
