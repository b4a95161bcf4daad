"""The sections of an experiment file that the services read. Bounds are checked when they are made."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from mdb_protocol.messages import MOST_SUPPORT
from mdb_services.mechanism.feedback.praise import LATELY
from mdb_services.mechanism.networks.encoding import Encoding

SWIFT_HZ = 47.0, 2093.0
"""Lowest and highest pitch of the swift-f0 network."""
MOST_NUMBERS = 1024
"""In a sensor's vector: more do not fit into the messages that pairs travel in."""

DEFAULT_BRAIN = "pioneer"
Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]{1,64}\Z")]
Seconds = Annotated[float, Meta(gt=0, le=3600)]
Durability = Literal["process", "power"]
Probability = Annotated[float, Meta(ge=0, le=1)]
Word = Literal["first", "all"]
"""first: who comes first is obeyed until he is silent or gone; all: the first note of each iteration counts."""


class Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all sections of an experiment file: immutable, unknown names refused."""


class ExperimentSection(Section, frozen=True, kw_only=True):
    """`[experiment]`: what is run."""

    name: Name
    brain: Name = DEFAULT_BRAIN
    """All keys lie below `mdb/<brain>/`."""
    iterations: Annotated[int, Meta(ge=1, le=10_000_000)]
    seed: Annotated[int, Meta(ge=0, le=2**62)] = 1
    pace: Literal["concurrent", "lockstep"] = "concurrent"
    folder: str | None = None
    """Where the experiment file lay: bodies and policies are looked for there, too. Written when the file is read."""


class ChannelSection(Section, frozen=True, kw_only=True):
    """`[channels.NAME]`: how a variable is scaled; `change` scales `covered.NAME` to ±change.

    `numbers`: how many a sensor gives that is a vector. `by`: the rank of a choice is that of its value for this
    actuator.
    """

    encoding: Encoding = "scalar"
    low: float = -1.0
    high: float = 1.0
    size: Annotated[int, Meta(ge=0, le=MOST_NUMBERS)] = 0
    values: tuple[float, ...] = ()
    numbers: Annotated[int, Meta(ge=1, le=MOST_NUMBERS)] = 1
    by: str | None = None
    change: Annotated[float, Meta(gt=0)] | None = None


class ActuatorSection(Section, frozen=True, kw_only=True):
    """`[actuators.NAME]`: what the robot can be told, and between which values."""

    low: float
    high: float
    unit: str = ""


class ChoiceSection(Section, frozen=True, kw_only=True):
    """`[[choice]]`: one of the actions to choose from. Without any, all in the actuators' ranges are."""

    name: Annotated[str, Meta(min_length=1, max_length=64)]
    values: dict[str, float]


class SearchSection(Section, frozen=True, kw_only=True):
    """`[search]`: how actions are searched in the actuators' ranges, where there are no choices."""

    method: Literal["refine", "cma"] = "refine"
    """"refine": over the whole range, then nearer and nearer the best; "cma": CMA-ES (extra `learners`)."""
    evaluations: Annotated[int, Meta(ge=2, le=100_000)] = 64
    """So many actions are looked at, at most, to choose one."""


class ModelSection(Section, frozen=True, kw_only=True):
    """`[[model]]`: one evolver. `evolution`, `memory`, `context`, `long_term`: what differs from the file's.

    `learner` is instead of the file's: its `name`, and its settings if they are not in `evolution`.
    """

    name: Name
    role: Literal["world", "satisfaction"]
    inputs: Annotated[tuple[str, ...], Meta(min_length=1)]
    outputs: Annotated[tuple[str, ...], Meta(min_length=1)]
    hidden: Annotated[tuple[Annotated[int, Meta(ge=1, le=512)], ...], Meta(min_length=1, max_length=4)]
    capacity: Annotated[int, Meta(ge=1, le=MOST_SUPPORT)]
    """Pairs in its short-term memory."""
    members: Annotated[int, Meta(ge=1, le=64)] = 1
    """So many learners, each with these settings, learn it side by side; the current model is their mean."""
    learner: dict[str, Any] = {}
    evolution: dict[str, Any] = {}
    memory: dict[str, Any] = {}
    context: dict[str, Any] = {}
    long_term: dict[str, Any] = {}


class ModeSection(Section, frozen=True, kw_only=True):
    """`[[mode]]`: a pair of models that can act, in order of precedence."""

    name: Name
    world: str
    satisfaction: str
    aspiration: float | None = None
    exploration: Probability = 0.0
    reach: Annotated[float, Meta(ge=0.001, le=100)] | None = None
    """How far around a pair a model is believed, in scaled units; see `foresight.Mode`."""
    curiosity: Annotated[float, Meta(ge=0, le=10)] = 0.0
    margin: Annotated[float, Meta(ge=0, le=2)] = 0.0
    """What promises so much less than the best, in scaled units, counts as equal; see `foresight.Mode`."""
    babbling: Probability = 0.0
    """How often any action is taken, each as likely; see `foresight.Mode`."""


class OptimizerSection(Section, frozen=True, kw_only=True):
    """`[optimizer]`: the operation cycle's exploration and its bounded waits."""

    random_iterations: Annotated[int, Meta(ge=0)] = 0
    """Exploration is forced before this iteration (paper, section 3: 200)."""
    command_patience_s: Seconds = 2.0
    """How long a teacher who is there may take for a command before the brain acts on its own."""
    feedback_patience_s: Seconds = 2.0
    feedback_window: Annotated[int, Meta(ge=1, le=2000)] = 100
    """Feedback that comes so many iterations late is still credited to the iteration it names, or that it is for."""
    most_late: Annotated[int, Meta(ge=0, le=20)] = 6
    """So many iterations late, at the most, is feedback that names no iteration, and less than the window."""
    praise_window: Annotated[int, Meta(ge=0, le=LATELY)] = 30
    """Praise is measured by the best of so many judged iterations in a row, within 200; 0: by full praise, always."""
    word: Word = "first"
    """Of several teachers: "first", who comes first is obeyed; "all", whoever speaks first each time."""
    lockstep_patience_s: Seconds = 60.0
    """How long a lockstep run waits for a model before it goes on with the one it has."""
    resend_s: Seconds = 0.5
    """An action without effect, or a pair without acknowledgement, is sent again after this."""
    action_valid_s: Seconds = 1.0


class EarSection(Section, frozen=True, kw_only=True):
    """`[ear]`: teachers may sound their notes; how the ear tells them. Without the section there is no ear."""

    notes_hz: Annotated[tuple[Annotated[float, Meta(ge=40, le=3500)], ...], Meta(min_length=1, max_length=128)] = (
        261.63, 293.66, 329.63, 349.23, 392.00, 440.00, 493.88,
    )  # fmt: skip
    """The scale, rising: note 0 is the first. C4 to B4, the white keys."""
    detector: Literal["template", "swift-f0"] = "template"
    """A comb of harmonics laid over the spectrum, or the network of the swift-f0 package (extra `sound`)."""
    window_s: Annotated[float, Meta(ge=0.03, le=1)] = 0.128
    """Sound that is looked at together: the longer, the finer the pitch and the better in noise."""
    hop_s: Annotated[float, Meta(ge=0.005, le=1)] = 0.032
    stable_windows: Annotated[int, Meta(ge=1, le=100)] = 3
    """So many windows in a row must agree on a note, at the least."""
    tonality: Probability = 0.5
    """How much a window must be its pitch alone: 1 is nothing else, and noise is near 0."""
    certainty: Annotated[float, Meta(ge=0, le=100)] = 0.9
    """What the agreeing windows must have together of tonality beyond that: a clear note is certain sooner."""
    rise_db: Annotated[float, Meta(ge=0, le=60)] = 6.0
    """How much louder than of late a note must be to have been played."""
    quiet_db: Annotated[float, Meta(ge=-120, le=0)] = -60.0
    """What is not as loud as this, below full scale, is silence."""
    tolerance_cents: Annotated[float, Meta(gt=0, le=600)] = 45.0
    """How far from a note of the scale a pitch may be."""

    def __post_init__(self) -> None:
        gap_hz = min((high - low for low, high in pairwise(self.notes_hz)), default=math.inf)
        if gap_hz * self.window_s < 1.0 or self.notes_hz[0] * self.window_s < 4.0:
            raise ValueError(
                f"notes_hz is {list(self.notes_hz)}; expected rising notes from {4.0 / self.window_s:.1f} Hz on, at "
                f"least {1.0 / self.window_s:.1f} Hz apart; a longer window_s tells lower and closer ones"
            )
        if self.detector == "swift-f0" and not (SWIFT_HZ[0] < self.notes_hz[0] and self.notes_hz[-1] < SWIFT_HZ[1]):
            raise ValueError(
                f"notes_hz is {list(self.notes_hz)}; swift-f0 hears from {SWIFT_HZ[0]} to {SWIFT_HZ[1]} Hz"
            )
        if self.hop_s > self.window_s:
            raise ValueError(f"hop_s is {self.hop_s}; expected at most window_s, {self.window_s}")


class EvolverSection(Section, frozen=True, kw_only=True):
    """`[evolver]`: what holds for every evolver."""

    checkpoint_every: Annotated[int, Meta(ge=1, le=10_000)] = 20
    """Memory versions between two checkpoints: so many are learnt again, at most, after a crash."""


class LogSection(Section, frozen=True, kw_only=True):
    """`[log]`: how much of the run log is kept; figures and replays are then of what is left."""

    keep_mb: Annotated[float, Meta(ge=1, le=1e9)] | None = None
    """The newest so many megabytes (1e6 bytes); without it all, about 17 a thousand iterations of the paper's."""

    @property
    def keep_bytes(self) -> int | None:
        """The same in bytes."""
        return None if self.keep_mb is None else int(self.keep_mb * 1e6)


class StoreSection(Section, frozen=True, kw_only=True):
    """`[store]`: how safe the memory store's file and the robot's state are."""

    durability: Durability = "process"
    """"process": what is acknowledged survives the death of every process; "power": also a loss of power."""
    when_full: Literal["stop", "act"] = "stop"
    """While pairs cannot be stored, the robot waits, or goes on acting and what it does is not learnt."""
    learns_until: Annotated[int, Meta(ge=0)] | None = None
    """From this iteration on pairs are stored and acknowledged, but enter no memory: nothing more is learnt."""
