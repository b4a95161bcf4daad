"""What the compiled kernel must give, by batched numpy in double precision."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.networks.network import Floats, split_layers


def reference_errors(
    weights: Floats, promoters: NDArray[np.uint8], sizes: Sequence[int], inputs: Floats, targets: Floats
) -> NDArray[np.float64]:
    """Return what `population_errors` must give.

    inputs (n, inputs) and targets (n, outputs) are rows, neither transposed nor padded.
    """
    errors = np.empty(len(weights))
    for individual, genome in enumerate(weights.astype(np.float64)):
        rows, gene = inputs.astype(np.float64), 0
        *hidden, last = split_layers(sizes, genome)
        for layer in hidden:
            mask = promoters[individual, gene : gene + len(layer)]
            rows = np.tanh(rows @ layer[:, :-1].T + layer[:, -1]) * mask
            gene += len(layer)
        outputs = rows @ last[:, :-1].T + last[:, -1]
        errors[individual] = np.mean((outputs - targets) ** 2)
    return errors
