"""What an experiment file says of the brain: channels, models, modes, memory, evolution, pace.

Owns the sections that the services read and the way a file becomes them: TOML, then overrides
(`--set evolution.population=400`), then checked. Sections of others (`robot`, `teacher`) pass through.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import Meta

from mdb_protocol.errors import ConfigError
from mdb_protocol.keys import MODEL_BYTES
from mdb_protocol.messages import MOST_SUPPORT
from mdb_services.acting.teachers import Word
from mdb_services.mechanism.choice import Mode
from mdb_services.mechanism.feedback.praise import LATELY
from mdb_services.mechanism.memories.context import ContextConfig
from mdb_services.mechanism.memories.ltm import LongTermConfig
from mdb_services.mechanism.memories.stm import MemoryConfig
from mdb_services.mechanism.networks.encoding import Channel, Codebook, Encoding
from mdb_services.mechanism.settings import LEARNER_CONFIGS, EvolutionConfig, LearnerConfig, RidgeConfig

T = TypeVar("T")

EXPERIMENT_FILE = "experiment.toml"
"""The resolved experiment in a run folder, its seed in it."""
MEMORY_FILE = "memory.sqlite"
"""The memory store's database in a run folder."""
BEGINNING_FILE = "memory.beginning.sqlite"
"""The same before the first pair, where a run begins with models of another one: what a replay begins with."""

NUMBER_BYTES = 4
"""Of a weight in a message."""
BESIDE = 1024
"""Room for so many numbers is left for all else in the message of a current model."""
SWIFT_HZ = 47.0, 2093.0
"""Lowest and highest pitch of the swift-f0 network."""

Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]{1,64}\Z")]
Seconds = Annotated[float, Meta(gt=0, le=3600)]
Durability = Literal["process", "power"]
Probability = Annotated[float, Meta(ge=0, le=1)]


class Section(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all sections of an experiment file: immutable, unknown names refused."""


class ExperimentSection(Section, frozen=True, kw_only=True):
    """`[experiment]`: what is run."""

    name: Name
    brain: Name = "pioneer"
    """All keys lie below `mdb/<brain>/`."""
    iterations: Annotated[int, Meta(ge=1, le=10_000_000)]
    seed: Annotated[int, Meta(ge=0, le=2**62)] = 1
    pace: Literal["concurrent", "lockstep"] = "concurrent"


class ChannelSection(Section, frozen=True, kw_only=True):
    """`[channels.NAME]`: how a variable is scaled; `change` scales `covered.NAME` to ±change.

    `of` makes it a second reading of another variable, as the turn is of the action; it takes its `values`.
    """

    encoding: Encoding = "scalar"
    low: float = -1.0
    high: float = 1.0
    size: Annotated[int, Meta(ge=0, le=128)] = 0
    values: tuple[float, ...] = ()
    change: Annotated[float, Meta(gt=0)] | None = None
    of: str | None = None


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
    """How far around a pair a model is believed, in scaled units; see `choice.Mode`."""
    curiosity: Annotated[float, Meta(ge=0, le=10)] = 0.0


class OptimizerSection(Section, frozen=True, kw_only=True):
    """`[optimizer]`: the operation cycle's exploration and its bounded waits."""

    actions: Annotated[int, Meta(ge=2, le=1024)]
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
    """Of several teachers: "first", who comes first holds the word; "all", whoever speaks first each time."""
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


class StoreSection(Section, frozen=True, kw_only=True):
    """`[store]`: how safe the memory store's file and the robot's state are."""

    durability: Durability = "process"
    """"process": what is acknowledged survives the death of every process; "power": also a loss of power."""
    when_full: Literal["stop", "act"] = "stop"
    """While pairs cannot be stored, the robot waits, or goes on acting and what it does is not learnt."""


class BrainConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The brain's part of an experiment file; other top-level sections are left to their owners."""

    experiment: ExperimentSection
    channels: dict[str, ChannelSection]
    model: Annotated[tuple[ModelSection, ...], Meta(min_length=1)]
    mode: Annotated[tuple[ModeSection, ...], Meta(min_length=1)]
    optimizer: OptimizerSection
    evolver: EvolverSection = msgspec.field(default_factory=EvolverSection)
    store: StoreSection = msgspec.field(default_factory=StoreSection)
    ear: EarSection | None = None
    learner: dict[str, Any] = {}
    evolution: dict[str, Any] = {}
    memory: dict[str, Any] = {}
    context: dict[str, Any] = {}
    long_term: dict[str, Any] = {}

    @property
    def lockstep(self) -> bool:
        """Whether acting waits for learning, so that a seed gives the same run every time."""
        return self.experiment.pace == "lockstep"

    def model_named(self, name: str) -> ModelSection:
        """Return a model's section; ConfigError when there is none."""
        for model in self.model:
            if model.name == name:
                return model
        raise ConfigError(f"no model {name!r}; the file has {', '.join(m.name for m in self.model)}")

    def evolution_of(self, model: ModelSection) -> EvolutionConfig:
        """Return the file's evolution settings with what the model changes."""
        return make(EvolutionConfig, self.evolution | model.evolution, f"evolution of model {model.name}")

    def learner_of(self, model: ModelSection) -> tuple[str, LearnerConfig]:
        """Return the name and the settings of a model's learner: its own, or else the file's, or else the PBGA."""
        settings = dict(model.learner or self.learner or {"name": "pbga"})
        name = str(settings.pop("name", ""))
        if name not in LEARNER_CONFIGS:
            raise ConfigError(f"learner of model {model.name}: name is {name!r}{_nearest(name, LEARNER_CONFIGS)}")
        if LEARNER_CONFIGS[name] is not EvolutionConfig:
            return name, make(LEARNER_CONFIGS[name], settings, f"learner of model {model.name}")
        if settings:
            known = ", ".join(map(repr, sorted(settings)))
            raise ConfigError(f"learner of model {model.name}: {known}: the settings of {name!r} are in 'evolution'")
        return name, self.evolution_of(model)

    def memory_of(self, model: ModelSection) -> MemoryConfig:
        """Return the file's memory settings with what the model changes."""
        return make(MemoryConfig, self.memory | model.memory, f"memory of model {model.name}")

    def context_of(self, model: ModelSection) -> ContextConfig:
        """Return the file's settings for changes of context with what the model changes."""
        return make(ContextConfig, self.context | model.context, f"context of model {model.name}")

    def long_term_of(self, model: ModelSection) -> LongTermConfig:
        """Return the file's long-term memory settings with what the model changes."""
        return make(LongTermConfig, self.long_term | model.long_term, f"long_term of model {model.name}")

    def reads(self, model: ModelSection) -> dict[str, str]:
        """Return what each input and output of a model is as numbers: two brains in which it is the same can swap."""
        variables = self.variables()
        return {name: variables[name].describe() for name in (*model.inputs, *model.outputs)}

    def variables(self) -> dict[str, Channel]:
        """Return the channel of each variable a model may use, `next.` and `covered.` ones included."""
        found: dict[str, Channel] = {}
        for name, section in self.channels.items():
            fields = {k: getattr(section, k) for k in section.__struct_fields__ if k != "change"}
            if section.of in self.channels and not section.values:
                fields["values"] = self.channels[section.of].values
            channel = make(Channel, fields, f"channels.{name}")
            found[name] = found[f"next.{name}"] = channel
            if section.change is not None:
                change = {"low": -section.change, "high": section.change}
                found[f"covered.{name}"] = make(Channel, change, f"channels.{name}.change")
        return found

    def reported_hidden(self, model: ModelSection) -> list[int]:
        """Return the hidden units of the networks that a model's learners report, see `learners.committee`."""
        settings = self.learner_of(model)[1]
        *first, last = model.hidden
        last = max(last, settings.features) if isinstance(settings, RidgeConfig) else last
        return [*first, last] if model.members == 1 else [model.members * units for units in (*first, last + 1)]

    def is_supported(self, model: str) -> bool:
        """Whether a mode weighs what this model foresees by the pairs that it was learnt from."""
        outputs = {section.name: section.outputs for section in self.model}
        return any(mode.reach is not None and mode.valued_by(outputs[mode.world]) == model for mode in self.modes())

    def modes(self) -> list[Mode]:
        """Return the modes in order of precedence."""
        return [Mode(**msgspec.structs.asdict(mode)) for mode in self.mode]

    def check(self) -> None:
        """Raise ConfigError unless every name that a section uses exists and all settings hold together."""
        variables = self.variables()
        for model in self.model:
            for name in (*model.inputs, *model.outputs):
                if name not in variables:
                    raise ConfigError(f"model {model.name}: no channel for {name!r}{_nearest(name, variables)}")
            try:
                Codebook(variables, model.inputs, model.outputs)
            except ValueError as error:
                raise ConfigError(f"model {model.name}: {error}") from error
            self.evolution_of(model)
            self.learner_of(model)
            self.memory_of(model)
            self.context_of(model)
            self.long_term_of(model)
        for name, section in self.channels.items():
            self._check_channel(name, section.of, variables[name].indices)
        if self.ear is not None:
            self._check_ear(self.ear, variables["note"].indices if "note" in variables else None)
        models = {model.name: model for model in self.model}
        if len(models) < len(self.model):
            raise ConfigError("two models have the same name; give each its own")
        for mode in self.mode:
            if mode.world not in models:
                raise ConfigError(f"mode {mode.name}: no world model {mode.world!r}{_nearest(mode.world, models)}")
            if mode.satisfaction not in models and mode.satisfaction not in models[mode.world].outputs:
                raise ConfigError(
                    f"mode {mode.name}: satisfaction {mode.satisfaction!r} is neither a model nor an output "
                    f"of {mode.world}{_nearest(mode.satisfaction, models)}"
                )
        for model in self.model:
            self._check_size(model)

    def _check_size(self, model: ModelSection) -> None:
        """Refuse a model whose current model is too large for a message."""
        width = Codebook(self.variables(), model.inputs, model.outputs).width
        layers = [width, *self.reported_hidden(model), len(model.outputs)]
        weights = sum((before + 1) * after for before, after in pairwise(layers))
        support = model.capacity * width if self.is_supported(model.name) else 0
        most = MODEL_BYTES // NUMBER_BYTES - BESIDE
        if weights + support > most:
            raise ConfigError(
                f"model {model.name}: its current model has {weights} weights in layers {layers}, and {support} "
                f"numbers support it; expected at most {most} together: choose fewer 'members', 'hidden' units or "
                "pairs"
            )

    def _check_ear(self, ear: EarSection, notes: int | None) -> None:
        if len(ear.notes_hz) != notes:
            raise ConfigError(
                f"ear.notes_hz has {len(ear.notes_hz)} notes, but channels.note has {notes}; expected as many of each"
            )

    def _check_channel(self, name: str, of: str | None, indices: int | None) -> None:
        if of is not None and of not in self.channels:
            raise ConfigError(f"channels.{name}: of = {of!r} is no channel{_nearest(of, self.channels)}")
        if "action" in (name, of) and indices not in (None, self.optimizer.actions):
            raise ConfigError(
                f"optimizer.actions is {self.optimizer.actions}, but channels.{name} has {indices} values; "
                "expected as many of each"
            )


def read_file(path: Path, overrides: Iterable[str] = ()) -> dict[str, Any]:
    """Return the plain content of an experiment file with `NAME.NAME=VALUE` overrides applied.

    A model's, mode's or phase's name picks it from its list: `model.object.evolution.population=400`.
    Raises ConfigError when the file cannot be read or an override cannot be applied.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read the experiment file {path}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from error
    for override in overrides:
        _override(content, override)
    return content


def convert(section: Mapping[str, Any], cls: type[T], source: object) -> T:
    """Return the checked section; ConfigError names the source and the path of what is wrong."""
    try:
        return msgspec.convert(section, cls, strict=True)
    except (msgspec.ValidationError, ValueError) as error:
        raise ConfigError(f"{source}: {error}") from error


def brain_config(content: Mapping[str, Any], source: object) -> BrainConfig:
    """Return the brain's part of an experiment file's content, checked."""
    config = convert(content, BrainConfig, source)
    try:
        config.check()
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from error
    return config


def make(cls: type[T], fields: Mapping[str, Any], what: str) -> T:
    """Return a dataclass of the mechanism from plain fields; ConfigError on unknown names or bad values."""
    known = cls.__dataclass_fields__  # type: ignore[attr-defined]
    for name in fields:
        if name not in known:
            raise ConfigError(f"{what}: unknown setting {name!r}{_nearest(name, known)}")
    try:
        return msgspec.convert(dict(fields), cls, strict=True)
    except (msgspec.ValidationError, ValueError) as error:
        raise ConfigError(f"{what}: {error}") from error


def _override(content: dict[str, Any], override: str) -> None:
    path, equals, text = override.partition("=")
    names = path.strip().split(".")
    if not equals or not all(names):
        raise ConfigError(f"--set {override!r}: expected SECTION.NAME=VALUE, as in evolution.population=400")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    place: Any = content
    for i, name in enumerate(names[:-1]):
        place = place.setdefault(name, {}) if isinstance(place, dict) else _by_name(place, name, override)
        here = ".".join(names[: i + 1])
        if not isinstance(place, dict | list):
            raise ConfigError(f"--set {override!r}: {here} is a value, not a section")
        if isinstance(place, list) and not all(isinstance(entry, dict) for entry in place):
            raise ConfigError(f"--set {override!r}: {here} is a list of values, not of named entries; give it whole")
    if not isinstance(place, dict):
        raise ConfigError(f"--set {override!r}: name the entry, as in model.object.hidden=[12]")
    place[names[-1]] = value


def _by_name(entries: list[Any], name: str, override: str) -> Any:
    for entry in entries:
        if entry.get("name") == name:
            return entry
    names = [str(entry.get("name")) for entry in entries]
    raise ConfigError(f"--set {override!r}: no entry named {name!r}; there are {', '.join(names)}")


def _nearest(name: str, known: Iterable[str]) -> str:
    names = sorted(known)
    close = difflib.get_close_matches(name, names, 1)
    return f"; did you mean {close[0]!r}?" if close else f"; there are {', '.join(names)}"
