"""How far rows of numbers are apart."""

import numpy as np

from mdb_services.mechanism.networks.network import Floats

AT_ONCE = 10_000
"""Numbers that are compared in one go: more of them do not stay in the processor's cache."""
FEW = 8
"""Fewer columns are added one after the other, which is faster; numpy adds more of them in another order."""


def squared_gaps(rows: Floats, others: Floats) -> Floats:
    """Return the squared distances (m, n) of rows (m, columns) to others (n, columns)."""
    if 0 < others.shape[1] < FEW:
        gaps = np.zeros((len(rows), len(others)), np.float32)
        for own, its in zip(rows.T, np.ascontiguousarray(others.T), strict=True):
            gap = its - own[:, None]
            gaps += np.square(gap, out=gap)
        return gaps
    some = max(1, AT_ONCE // max(others.size, 1))
    parts = (rows[first : first + some, None] for first in range(0, len(rows), some))
    return np.concatenate([np.add.reduce(np.square(others - part), axis=2) for part in parts])
