"""How much of each feedback belongs to each of the actions that it may be for, when its lag is not one but several.

Ours: a mixture model, solved by expectation and maximisation. Each feedback has a share in each pair that it may be
for; from the others' shares it is foreseen what each of these pairs deserves; the shares follow from how well that
fits. As a teacher judges an action once at the most, the shares in a pair come to one at the most (by the scaling of
Sinkhorn and Knopp, 1967).

Pure. Pairs are rows of numbers, one row for each model that learns feedback.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mdb_services.mechanism.networks.network import Floats

Values = NDArray[np.float64]
Ints = NDArray[np.int64]

STEPS = 8
SCALINGS = 3
NEIGHBOURS = 5
"""The scale of likeness is the median distance from a pair to its fifth nearest pair."""
NEAREST = 0.1
"""Rows are about in [-1, 1]; pairs that are nearer than this are always alike."""
UNFORESEEN = 0.3
"""The mean of all feedback counts as so many alike pairs where feedback is foreseen."""
VARIANCE = 0.1
"""Of feedback around what is foreseen, in [-1, 1] squared."""
CUT = 1.0
"""Squared errors beyond this count as this: a teacher may err."""


def share(rows: Sequence[Floats], candidates: Ints, known: NDArray[np.bool_], values: Values) -> Values:
    """Return the share of each feedback in each pair that it may be for (n, lags); a row comes to one, or to 0.

    rows: for each model (pairs, w), nan where a variable was not there; candidates (n, lags): places of pairs in
    these; known (n, lags): whether there is such a pair; values (n,): the feedback.
    """
    alike, pairs = [_alike(model.astype(np.float64)) for model in rows], int(candidates.max()) + 1
    shares = _of_one(known.astype(np.float64))
    for _ in range(STEPS):
        fits = np.zeros(shares.shape)
        for kernel in alike:
            foreseen = _foreseen(kernel, candidates, shares, values)
            fits -= np.minimum(np.square(foreseen - values[:, None]), CUT) / (2.0 * VARIANCE)
        shares = np.exp(fits - fits.max(axis=1, keepdims=True)) * known
        shares = _of_one(shares)
        for _ in range(SCALINGS):
            totals = np.bincount(candidates.ravel(), shares.ravel(), pairs)
            shares = _of_one(shares / np.maximum(1.0, totals)[candidates])
    return shares


def _alike(rows: Values) -> Values:
    """Return how much pairs are alike (pairs, pairs): 0 to 1, a pair not with itself."""
    gaps = np.square(rows[:, None] - rows[None]).sum(axis=2)
    gaps = np.where(np.isnan(gaps), np.inf, gaps)
    near = np.median(np.sort(gaps, axis=1)[:, min(NEIGHBOURS, len(rows) - 1)])
    kernel: Values = np.exp(-0.5 * gaps / max(float(near) if np.isfinite(near) else 1.0, NEAREST**2))
    np.fill_diagonal(kernel, 0.0)
    return kernel


def _foreseen(kernel: Values, candidates: Ints, shares: Values, values: Values) -> Values:
    """Return what is foreseen for each candidate (n, lags), without what the same feedback says of the others."""
    own = (kernel[candidates[:, :, None], candidates[:, None, :]] * shares[:, None, :]).sum(axis=2)
    weight = np.bincount(candidates.ravel(), shares.ravel(), len(kernel))
    total = np.bincount(candidates.ravel(), (shares * values[:, None]).ravel(), len(kernel))
    weights = (kernel @ weight)[candidates] - own
    totals = (kernel @ total)[candidates] - own * values[:, None]
    found: Values = (totals + UNFORESEEN * values.mean()) / (weights + UNFORESEEN)
    return found


def _of_one(shares: Values) -> Values:
    """Return shares (n, lags) scaled so that each row comes to one, unless it is 0."""
    scaled: Values = shares / np.maximum(shares.sum(axis=1, keepdims=True), 1e-12)
    return scaled
