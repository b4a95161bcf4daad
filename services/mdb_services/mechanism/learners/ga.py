"""The plain genetic algorithm: the promoter-based one with every unit expressed and no structural mutation.

What the promoters are worth is the difference between the two; all other operators are the same code.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.learners.contract import Arrays
from mdb_services.mechanism.learners.pbga import PromoterGA
from mdb_services.mechanism.networks.network import Network, Shape
from mdb_services.mechanism.settings import EvolutionConfig


class PlainGA(PromoterGA):
    """A population of networks of one size; `expressed_first` and `structural_rate` of the settings are unused."""

    def __init__(self, shape: Shape, config: EvolutionConfig, seed: int, name: str) -> None:
        """Draw the first population from the stream of (seed, name)."""
        super().__init__(shape, replace(config, expressed_first=1.0, structural_rate=0.0), seed, name)

    def _expressed(self, network: Network) -> NDArray[np.bool_]:  # noqa: ARG002 - all units of any network
        return np.ones(self.shape.units, dtype=bool)

    def _check_state(self, state: Arrays) -> None:
        super()._check_state(state)
        if not state["promoters"].all():
            raise ValueError("promoters leave units out: the state is of another learner, start afresh")
