"""The brain's part of an experiment file: its sections together, checked against one another.

Sections of others (`robot`, `teacher`) pass through.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from mdb_protocol.errors import ConfigError
from mdb_protocol.keys import MODEL_BYTES
from mdb_protocol.messages import VALUE_BOUND
from mdb_services.experiment.reading import convert, make, nearest
from mdb_services.experiment.sections import (
    ActuatorSection,
    ChannelSection,
    ChoiceSection,
    EarSection,
    EvolverSection,
    ExperimentSection,
    LogSection,
    ModelSection,
    ModeSection,
    Name,
    OptimizerSection,
    SearchSection,
    StoreSection,
)
from mdb_services.mechanism.actions.foresight import Mode
from mdb_services.mechanism.actions.spaces import Choices, Ranges, Space
from mdb_services.mechanism.memories.context import ContextConfig
from mdb_services.mechanism.memories.ltm import LongTermConfig
from mdb_services.mechanism.memories.stm import MemoryConfig
from mdb_services.mechanism.networks.encoding import DERIVED, NOT_SENSED, Channel, Codebook
from mdb_services.mechanism.settings import LEARNER_CONFIGS, EvolutionConfig, LearnerConfig, RidgeConfig

NUMBER_BYTES = 4
"""Of a weight in a message."""
BESIDE = 1024
"""Room for so many numbers is left for all else in the message of a current model."""


class BrainConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The brain's part of an experiment file; other top-level sections are left to their owners."""

    experiment: ExperimentSection
    channels: dict[str, ChannelSection]
    actuators: Annotated[dict[Name, ActuatorSection], Meta(min_length=1, max_length=256)]
    choice: Annotated[tuple[ChoiceSection, ...], Meta(max_length=1024)] = ()
    search: SearchSection = msgspec.field(default_factory=SearchSection)
    model: Annotated[tuple[ModelSection, ...], Meta(min_length=1)]
    mode: Annotated[tuple[ModeSection, ...], Meta(min_length=1)]
    optimizer: OptimizerSection = msgspec.field(default_factory=OptimizerSection)
    evolver: EvolverSection = msgspec.field(default_factory=EvolverSection)
    store: StoreSection = msgspec.field(default_factory=StoreSection)
    log: LogSection = msgspec.field(default_factory=LogSection)
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
            raise ConfigError(f"learner of model {model.name}: name is {name!r}{nearest(name, LEARNER_CONFIGS)}")
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
            fields = {k: getattr(section, k) for k in section.__struct_fields__ if k not in ("change", "by")}
            if section.by is not None:
                fields["values"] = tuple(choice.values[section.by] for choice in self.choice)
            channel = make(Channel, fields, f"channels.{name}")
            found[name] = found[f"next.{name}"] = channel
            if section.change is not None:
                change = {"low": -section.change, "high": section.change, "numbers": section.numbers}
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
        self._check_actions()
        variables = self.variables()
        for model in self.model:
            for name in (*model.inputs, *model.outputs):
                if name not in variables:
                    raise ConfigError(f"model {model.name}: no channel for {name!r}{nearest(name, variables)}")
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
            self._check_channel(name, section, variables[name].indices)
        if self.ear is not None:
            self._check_ear(self.ear, variables["note"].indices if "note" in variables else None)
        models = {model.name: model for model in self.model}
        if len(models) < len(self.model):
            raise ConfigError("two models have the same name; give each its own")
        for mode in self.mode:
            if mode.world not in models:
                raise ConfigError(f"mode {mode.name}: no world model {mode.world!r}{nearest(mode.world, models)}")
            if mode.satisfaction not in models and mode.satisfaction not in models[mode.world].outputs:
                raise ConfigError(
                    f"mode {mode.name}: satisfaction {mode.satisfaction!r} is neither a model nor an output "
                    f"of {mode.world}{nearest(mode.satisfaction, models)}"
                )
        for model in self.model:
            self._check_size(model)

    def _check_size(self, model: ModelSection) -> None:
        """Refuse a model whose current model is too large for a message."""
        codebook = Codebook(self.variables(), model.inputs, model.outputs)
        width = codebook.width
        layers = [width, *self.reported_hidden(model), codebook.output_width]
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

    def _check_channel(self, name: str, section: ChannelSection, indices: int | None) -> None:
        if name == "action" and (not self.choice or indices not in (None, len(self.choice))):
            raise ConfigError(
                f"channels.action has {indices or 'no'} values, and there are {len(self.choice)} [[choice]] entries; "
                "expected as many of each (encoding 'rank' with by = ACTUATOR, or 'one_hot' with size), or no such "
                "channel"
            )
        if name in self.actuators and section.encoding != "scalar":
            raise ConfigError(f"channels.{name}: encoding is {section.encoding!r}; an actuator's is 'scalar'")

    def _check_actions(self) -> None:
        for name, actuator in self.actuators.items():
            if name in NOT_SENSED or name.startswith(DERIVED):
                raise ConfigError(f"actuators.{name}: the name means something else already; choose another")
            if not -VALUE_BOUND <= actuator.low < actuator.high <= VALUE_BOUND:
                raise ConfigError(
                    f"actuators.{name}: low {actuator.low} and high {actuator.high}; expected low < high, both "
                    f"within ±{VALUE_BOUND:g}"
                )
        if len(self.choice) == 1:
            raise ConfigError("there is one [[choice]]; expected two or more, or none to search in the ranges")
        if len({choice.name for choice in self.choice}) < len(self.choice):
            raise ConfigError("two [[choice]] entries have the same name; give each its own")
        for choice in self.choice:
            if set(choice.values) != set(self.actuators):
                raise ConfigError(
                    f"choice {choice.name!r} has values for {', '.join(choice.values) or 'nothing'}; expected one "
                    f"for each of {', '.join(self.actuators)}"
                )
            for name, value in choice.values.items():
                low, high = self.actuators[name].low, self.actuators[name].high
                if not low <= value <= high:
                    raise ConfigError(f"choice {choice.name!r}: {name} = {value}; expected {low} to {high}")
        for name, section in self.channels.items():
            if section.by is not None and (section.by not in self.actuators or not self.choice or name != "action"):
                raise ConfigError(
                    f"channels.{name}: by = {section.by!r}; expected an actuator, in channels.action, where there "
                    "are [[choice]] entries"
                )

    def space(self) -> Space:
        """Return which actions there are to choose from."""
        if self.choice:
            return Choices([{name: choice.values[name] for name in self.actuators} for choice in self.choice])
        ranges = {name: (actuator.low, actuator.high) for name, actuator in self.actuators.items()}
        return Ranges(ranges, self.search.method, self.search.evaluations)

    def allows(self, action: Mapping[str, float], choice: int | None) -> bool:
        """Whether this brain could have taken an action."""
        if self.choice:
            return choice is not None and choice < len(self.choice) and dict(action) == self.choice[choice].values
        ranges = self.actuators
        return (
            choice is None
            and set(action) == set(ranges)
            and all(ranges[name].low <= value <= ranges[name].high for name, value in action.items())
        )


def brain_config(content: Mapping[str, Any], source: object) -> BrainConfig:
    """Return the brain's part of an experiment file's content, checked."""
    config = convert(content, BrainConfig, source)
    try:
        config.check()
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from error
    return config
