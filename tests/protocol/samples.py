"""A hypothesis strategy of valid messages for each class that travels or is kept on disk."""

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
EVENTS = st.sampled_from([messages.NOTHING, "capture", "lost", "my-own.word_2"]) | NAMES
READINGS = st.dictionaries(NAMES, FLOATS | st.lists(FLOATS, max_size=5), max_size=4)
"""What sensors gave: numbers, and vectors of them."""
VALUES = st.dictionaries(NAMES, FLOATS, max_size=4)
"""Of actuators, or of what is true in a scene."""
VERSIONS = st.dictionaries(NAMES, COUNTS, max_size=4)
NOTES = st.none() | st.integers(0, 127)
CHOICES = st.none() | st.integers(0, 1023)
SHARES = st.floats(-1, 1)
TEXTS = st.text(max_size=20)
SHAPES = st.builds(
    messages.Shape,
    kind=st.sampled_from(["line", "circle", "disc", "cross", "words"]),
    points=st.lists(st.tuples(FLOATS, FLOATS), min_size=1, max_size=4),
    radius=st.floats(0, 1e6),
    what=st.sampled_from(["robot", "thing", "trail", "sensed", "wall", "ground"]),
    words=TEXTS,
)
SIDES = st.tuples(FLOATS, FLOATS).map(sorted).filter(lambda side: side[0] < side[1])
BOXES = st.tuples(SIDES, SIDES).map(lambda sides: (sides[0][0], sides[1][0], sides[0][1], sides[1][1]))
"""Left, low, right, high."""
DRAWINGS = st.builds(
    messages.Drawing, shapes=st.lists(SHAPES, max_size=3), box=BOXES, front_rad=st.none() | st.floats(-4, 4)
)
IMAGES = st.tuples(st.integers(1, 9), st.integers(1, 9)).flatmap(lambda size: hnp.arrays(np.uint8, (*size, 3)))


def floats(shape: Any) -> st.SearchStrategy[np.ndarray]:
    """Arrays of finite numbers in one of the two float types that travel."""
    narrow = hnp.arrays(np.float32, shape, elements=st.floats(-1e5, 1e5, width=32))
    return narrow | hnp.arrays(np.float64, shape, elements=FLOATS)


def indices(shape: Any) -> st.SearchStrategy[np.ndarray]:
    """Arrays of slots or of pairs, some of them recalled ones."""
    return hnp.arrays(np.int64, shape, elements=st.integers(-(2**53), 2**53))


@st.composite
def networks(draw: st.DrawFn) -> dict[str, Any]:
    """Layers, and as many weights as they need."""
    layers = draw(st.lists(st.integers(0, 6), min_size=2, max_size=5))
    weights = sum((i + 1) * o for i, o in pairwise(layers))
    return {"layers": layers, "weights": draw(floats(weights))}


@st.composite
def with_network(draw: st.DrawFn, cls: type[Message], **fields: st.SearchStrategy[Any]) -> Message:
    """A message that holds a network, and other fields."""
    return cls(**draw(networks()), **{name: draw(field) for name, field in fields.items()})


WEIGHTS = with_network(messages.ModelWeights)


@st.composite
def current_models(draw: st.DrawFn) -> messages.CurrentModel:
    """A current model, with or without the inputs that support it."""
    network = draw(networks())
    return messages.CurrentModel(
        model=draw(NAMES),
        version=draw(COUNTS),
        generation=draw(COUNTS),
        error=draw(FLOATS),
        support=draw(st.none() | st.integers(0, 5).flatmap(lambda n: floats((n, network["layers"][0])))),
        **network,
    )


@st.composite
def memories(draw: st.DrawFn, cls: type[Message], **fields: st.SearchStrategy[Any]) -> Message:
    """A message that holds pairs with their slots and rows, and other fields."""
    rows, inputs, outputs = draw(st.integers(0, 5)), draw(st.integers(1, 4)), draw(st.integers(1, 3))
    return cls(
        model=draw(NAMES),
        version=draw(COUNTS),
        slots=draw(indices(rows)),
        pairs=draw(indices(rows)),
        inputs=draw(floats((rows, inputs))),
        targets=draw(floats((rows, outputs))),
        seeds=draw(st.lists(WEIGHTS, max_size=2)),
        **{name: draw(field) for name, field in fields.items()},
    )


PAIRS = st.builds(
    messages.Pair,
    iteration=COUNTS,
    before=READINGS,
    note=NOTES,
    action=VALUES,
    choice=CHOICES,
    after=READINGS,
    feedback=st.none() | SHARES,
    versions=VERSIONS,
    teacher=st.none() | NAMES,
    judges=st.lists(NAMES, max_size=3),
    best=st.none() | SHARES,
)
INTENTIONS = st.builds(
    messages.Intention,
    before=READINGS,
    note=NOTES,
    teacher=st.none() | NAMES,
    holder=st.none() | NAMES,
    mode=NAMES,
    explored=st.booleans(),
    predicted=st.none() | FLOATS,
    versions=VERSIONS,
)
ACTION_MESSAGES = st.builds(
    messages.Action,
    iteration=COUNTS,
    action=VALUES,
    choice=CHOICES,
    valid_for_s=st.floats(0, 3600, exclude_min=True),
    stamp=FLOATS,
    intention=st.none() | INTENTIONS,
)
CHANGES = memories(
    messages.MemoryChange,
    freed=st.integers(0, 4).flatmap(indices),
    evicted=st.integers(0, 4).flatmap(indices),
)
SNAPSHOTS = memories(messages.MemorySnapshot)
CHECKPOINTS = st.builds(
    messages.Checkpoint,
    model=NAMES,
    version=COUNTS,
    generation=COUNTS,
    state=st.dictionaries(NAMES, floats((2, 3)), max_size=2),
    memory=SNAPSHOTS,
)
LONG_TERM = with_network(
    messages.LongTermModel,
    id=COUNTS,
    model=NAMES,
    reads=st.dictionaries(TEXTS, TEXTS, max_size=4),
    error=FLOATS,
    pairs=st.lists(PAIRS, max_size=3),
    uses=COUNTS,
    touched=COUNTS,
    iteration=COUNTS,
    experiment=TEXTS,
    brain=TEXTS,
    seed=st.integers(0, 2**62),
    origin=TEXTS,
)

SAMPLES: dict[type[Message], st.SearchStrategy[Message]] = {
    messages.Perception: st.builds(
        messages.Perception,
        iteration=COUNTS,
        event=EVENTS,
        outcome=READINGS,
        reading=READINGS,
        done=st.none() | ACTION_MESSAGES,
        stamp=FLOATS,
    ),
    messages.Scene: st.builds(
        messages.Scene,
        iteration=COUNTS,
        episode=COUNTS,
        successes=COUNTS,
        event=EVENTS,
        action=st.none() | VALUES,
        before=st.none() | VALUES,
        reached=VALUES,
        now=VALUES,
        success=st.booleans(),
        ended=st.booleans(),
    ),
    messages.Picture: st.builds(
        messages.Picture, iteration=COUNTS, drawing=st.none() | DRAWINGS, image=st.none() | IMAGES
    ),
    messages.Action: ACTION_MESSAGES,
    messages.Command: st.builds(messages.Command, teacher=NAMES, iteration=COUNTS, note=NOTES)
    | st.builds(messages.Command, teacher=NAMES, iteration=COUNTS, note=st.none(), later=st.just(True)),
    messages.Feedback: st.builds(
        messages.Feedback, teacher=NAMES, iteration=st.none() | COUNTS, value=st.none() | SHARES
    )
    | st.builds(messages.Feedback, teacher=NAMES, iteration=COUNTS, value=st.none(), later=st.just(True)),
    messages.AudioFrame: st.builds(
        messages.AudioFrame,
        teacher=NAMES,
        iteration=COUNTS,
        rate_hz=st.integers(8000, 48000),
        samples=hnp.arrays(np.int16, st.integers(0, 50)),
        begin=st.booleans(),
        end=st.booleans(),
    ),
    messages.Phase: st.builds(messages.Phase, iteration=COUNTS, name=st.text(max_size=50), teacher=st.none() | NAMES),
    messages.Pair: PAIRS,
    messages.PairStored: st.builds(messages.PairStored, iteration=COUNTS, versions=VERSIONS, judged=st.booleans()),
    messages.MemoryChange: CHANGES,
    messages.MemorySnapshot: SNAPSHOTS,
    messages.Checkpoint: CHECKPOINTS,
    messages.Resume: st.builds(
        messages.Resume,
        model=NAMES,
        checkpoint=st.none() | CHECKPOINTS,
        changes=st.lists(CHANGES, max_size=2),
        memory=SNAPSHOTS,
    ),
    messages.Progress: st.integers(0, 4).flatmap(
        lambda n: st.builds(
            messages.Progress,
            iteration=COUNTS,
            versions=VERSIONS,
            unjudged=st.lists(PAIRS, max_size=2),
            judged=st.lists(PAIRS, max_size=2),
            notes=indices(n),
            choices=indices(n),
            iterations=indices(n),
        )
    ),
    messages.ContextEvent: st.builds(
        messages.ContextEvent,
        model=NAMES,
        iteration=COUNTS,
        kind=st.sampled_from(["changed", "known", "stored", "recalled"]),
        stored=st.none() | COUNTS,
        error=FLOATS,
    ),
    messages.CurrentModel: current_models(),
    messages.LongTermModel: LONG_TERM,
    messages.LongTermFile: st.builds(messages.LongTermFile, models=st.lists(LONG_TERM, max_size=2)),
    messages.IterationReport: st.builds(
        messages.IterationReport,
        iteration=COUNTS,
        mode=NAMES,
        action=VALUES,
        choice=CHOICES,
        explored=st.booleans(),
        predicted=st.none() | FLOATS,
        note=NOTES,
        feedback=st.none() | SHARES,
        event=EVENTS,
        prequential=VALUES,
        versions=VERSIONS,
        teacher=st.none() | NAMES,
        judges=st.lists(NAMES, max_size=3),
        holder=st.none() | NAMES,
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
        dropped=st.dictionaries(st.text(max_size=20), COUNTS, max_size=4),
        rate_hz=ANY_FLOATS,
        queued=COUNTS,
        memory_bytes=COUNTS,
    ),
}

SAMPLES[messages.Change] = st.builds(
    messages.Change,
    settings=st.dictionaries(
        NAMES,
        st.booleans() | st.integers(-1000, 1000) | FLOATS | st.lists(st.integers(0, 15) | FLOATS, max_size=3) | TEXTS,
        min_size=1,
        max_size=4,
    ),
)
SAMPLES[messages.Control] = st.builds(
    messages.Control,
    iteration=COUNTS,
    paused=st.booleans(),
    action_s=st.none() | st.floats(0, messages.MAX_ACTION_S),
    script=st.booleans(),
    ended=st.lists(COUNTS, max_size=5),
)
SAMPLES[messages.Lesson] = st.lists(st.integers(0, 127), unique=True, max_size=5).flatmap(
    lambda notes: st.builds(
        messages.Lesson,
        teacher=NAMES,
        iteration=COUNTS,
        notes=st.just(notes),
        commands=st.lists(TEXTS, min_size=len(notes), max_size=len(notes)),
        over=st.booleans(),
    )
)
SAMPLES[messages.RobotState] = st.builds(
    messages.RobotState,
    perception=SAMPLES[messages.Perception],
    scene=SAMPLES[messages.Scene],
    age=COUNTS,
    body=st.none() | st.binary(max_size=20),
)

ON_DISK: set[type[Message]] = {messages.LongTermModel, messages.LongTermFile, messages.RobotState}
"""Message classes that no key carries: the long-term memory's rows, what goes from run to run, where a robot was."""
TYPES = sorted({row.message for row in keys.KEYS if row.message} | ON_DISK, key=lambda cls: cls.__name__)
"""Every message class that is encoded as a whole."""
