"""Feedback is shared out among the actions that it may be for."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mdb_services.mechanism.feedback.sharing import share

ROW = hnp.arrays(np.float32, (8, 2), elements=st.floats(-1, 1, width=32) | st.just(np.nan))


def test_feedback_goes_to_the_pair_that_is_like_others_that_got_the_same() -> None:
    rng = np.random.default_rng(1)
    good = rng.random(60) < 0.5
    rows = [np.where(good, 0.8, -0.8)[:, None].astype(np.float32)]
    lags = rng.integers(0, 2, 60)
    candidates = np.stack([np.arange(60), np.minimum(np.arange(60) + 1, 59)], axis=1)
    meant = candidates[np.arange(60), lags]
    shares = share(rows, candidates, np.ones((60, 2), np.bool_), np.where(good[meant], 1.0, -1.0))
    clear = good[candidates[:, 0]] != good[candidates[:, 1]]
    assert clear.sum() > 20
    assert (np.argmax(shares, axis=1) == lags)[clear].mean() > 0.9


@settings(max_examples=50)
@given(st.lists(ROW, max_size=2), hnp.arrays(np.bool_, (6, 3)), hnp.arrays(np.float64, 6, elements=st.floats(-1, 1)))
def test_all_feedback_is_shared_out_and_only_where_there_is_a_pair(rows, known, values) -> None:  # type: ignore[no-untyped-def]
    candidates = np.arange(6)[:, None] + np.arange(3)
    shares = share(rows, candidates, known, values)
    assert np.allclose(shares.sum(axis=1), known.any(axis=1))
    assert (shares[~known] == 0.0).all()
