"""A short-term memory as a message: what the memory store answers with and an evolver's checkpoint holds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mdb_protocol import messages
from mdb_services.mechanism.memories.stm import MemoryMirror


def snapshot_of(
    model: str, memory: MemoryMirror, seeds: Sequence[messages.ModelWeights] = ()
) -> messages.MemorySnapshot:
    """Return the whole memory of a model."""
    inputs, targets, ids = memory.arrays()
    return messages.MemorySnapshot(
        model=model,
        version=memory.version,
        slots=memory.slots.astype(np.int64),
        pairs=np.ascontiguousarray(ids, dtype=np.int64),
        inputs=inputs,
        targets=targets,
        seeds=list(seeds),
    )
