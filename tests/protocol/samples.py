"""A hypothesis strategy of valid messages for each class in the key table."""

from itertools import pairwise
from typing import Any

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mdb_protocol import keys, messages
from mdb_protocol.messages import Message

fixed = settings(derandomize=True, deadline=None, max_examples=25)
"""The same examples every time, so that a test that passes today passes tomorrow."""

NAMES = st.text("abcXYZ019_.-", min_size=1, max_size=64)
COUNTS = st.integers(0, 2**53)
FLOATS = st.floats(-1e6, 1e6)
ANY_FLOATS = st.floats(allow_nan=False, allow_infinity=False)
EVENTS = st.sampled_from(["none", "capture", "bump", "lost", "timeout"])
READINGS = st.dictionaries(NAMES, FLOATS, max_size=4)
VERSIONS = st.dictionaries(NAMES, COUNTS, max_size=4)
NOTES = st.none() | st.integers(0, 127)
ACTIONS = st.integers(0, 1023)
SHARES = st.floats(-1, 1)
PLACEMENTS = st.builds(
    messages.Placement, x_m=FLOATS, y_m=FLOATS, heading_rad=FLOATS, object_x_m=FLOATS, object_y_m=FLOATS
)


def floats(shape: Any) -> st.SearchStrategy[np.ndarray]:
    """Arrays of finite numbers in one of the two float types that travel."""
    narrow = hnp.arrays(np.float32, shape, elements=st.floats(-1e5, 1e5, width=32))
    return narrow | hnp.arrays(np.float64, shape, elements=FLOATS)


ROWS = st.integers(0, 6).flatmap(floats)


@st.composite
def snapshots(draw: st.DrawFn) -> messages.MemorySnapshot:
    rows, inputs, outputs = draw(st.integers(0, 5)), draw(st.integers(1, 4)), draw(st.integers(1, 3))
    return messages.MemorySnapshot(
        model=draw(NAMES),
        version=draw(COUNTS),
        pairs=draw(hnp.arrays(np.int64, rows, elements=COUNTS)),
        inputs=draw(floats((rows, inputs))),
        targets=draw(floats((rows, outputs))),
    )


@st.composite
def current_models(draw: st.DrawFn) -> messages.CurrentModel:
    layers = draw(st.lists(st.integers(0, 6), min_size=2, max_size=5))
    weights = sum((i + 1) * o for i, o in pairwise(layers))
    return messages.CurrentModel(
        model=draw(NAMES),
        version=draw(COUNTS),
        generation=draw(COUNTS),
        layers=layers,
        weights=draw(floats(weights)),
        error=draw(FLOATS),
    )


SAMPLES: dict[type[Message], st.SearchStrategy[Message]] = {
    messages.Perception: st.builds(
        messages.Perception, iteration=COUNTS, event=EVENTS, outcome=READINGS, reading=READINGS
    ),
    messages.Scene: st.builds(
        messages.Scene,
        iteration=COUNTS,
        episode=COUNTS,
        captures=COUNTS,
        event=EVENTS,
        action=st.none() | ACTIONS,
        before=st.none() | PLACEMENTS,
        reached=PLACEMENTS,
        now=PLACEMENTS,
    ),
    messages.Action: st.builds(
        messages.Action, iteration=COUNTS, action=ACTIONS, valid_for_s=st.floats(0, 3600, exclude_min=True)
    ),
    messages.Command: st.builds(messages.Command, teacher=NAMES, iteration=COUNTS, note=NOTES),
    messages.Feedback: st.builds(messages.Feedback, teacher=NAMES, iteration=COUNTS, value=SHARES),
    messages.Phase: st.builds(messages.Phase, iteration=COUNTS, name=st.text(max_size=50), teacher=st.none() | NAMES),
    messages.Pair: st.builds(
        messages.Pair,
        iteration=COUNTS,
        before=READINGS,
        note=NOTES,
        action=ACTIONS,
        after=READINGS,
        feedback=st.none() | SHARES,
        versions=VERSIONS,
    ),
    messages.PairStored: st.builds(messages.PairStored, iteration=COUNTS, versions=VERSIONS),
    messages.MemoryChange: st.builds(
        messages.MemoryChange,
        model=NAMES,
        version=COUNTS,
        slot=st.integers(0, 2**31),
        pair=COUNTS,
        evicted=st.none() | COUNTS,
        inputs=ROWS,
        targets=ROWS,
    ),
    messages.MemorySnapshot: snapshots(),
    messages.CurrentModel: current_models(),
    messages.IterationReport: st.builds(
        messages.IterationReport,
        iteration=COUNTS,
        mode=NAMES,
        action=ACTIONS,
        explored=st.booleans(),
        predicted=st.none() | FLOATS,
        note=NOTES,
        feedback=st.none() | SHARES,
        event=EVENTS,
        prequential=READINGS,
        versions=VERSIONS,
    ),
    messages.Timing: st.builds(messages.Timing, iteration=COUNTS, perception_to_action_s=FLOATS, cycle_s=FLOATS),
    messages.Finished: st.builds(messages.Finished, iterations=COUNTS),
    messages.Status: st.builds(
        messages.Status,
        role=NAMES,
        instance=NAMES,
        pid=COUNTS,
        uptime_s=FLOATS,
        values=st.dictionaries(st.text(max_size=20), ANY_FLOATS, max_size=4),
        refused=st.dictionaries(st.text(max_size=20), COUNTS, max_size=4),
    ),
}

TYPES = sorted({row.message for row in keys.KEYS if row.message}, key=lambda cls: cls.__name__)
"""Every message class of the key table."""
