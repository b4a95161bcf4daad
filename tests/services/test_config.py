"""The experiment file: overrides, defaults, and errors that name the place and the mend."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_protocol.errors import ConfigError
from mdb_services.experiment.brain import brain_config
from mdb_services.experiment.reading import read_file
from mdb_services.mechanism.memories.context import ContextConfig
from mdb_services.mechanism.memories.ltm import LongTermConfig
from mdb_services.mechanism.settings import AdamConfig, RidgeConfig
from tests.services.small import CONTENT, config, content

PAPER = Path(__file__).parents[2] / "deploy" / "experiments" / "paper.toml"


def models(**first: Any) -> dict[str, Any]:
    """The small brain with its first model changed."""
    return CONTENT | {"model": [CONTENT["model"][0] | first, *CONTENT["model"][1:]]}


def modes(**first: Any) -> dict[str, Any]:
    return CONTENT | {"mode": [CONTENT["mode"][0] | first, *CONTENT["mode"][1:]]}


def channels(**changed: Any) -> dict[str, Any]:
    return content(channels={name: CONTENT["channels"].get(name, {}) | fields for name, fields in changed.items()})


SUPPORTED_BY_MUCH = channels(note={"size": 20}) | {
    "model": models(capacity=100_000)["model"],
    "mode": modes(reach=0.3)["mode"],
}


def test_the_papers_file_is_valid() -> None:
    brain = brain_config(read_file(PAPER), PAPER)
    assert [model.name for model in brain.model] == ["communication", "object", "induced"]
    assert not brain.lockstep


@pytest.mark.parametrize(
    ("override", "path", "value"),
    [
        ("evolution.population=400", ["evolution", "population"], 400),
        ("experiment.pace=lockstep", ["experiment", "pace"], "lockstep"),
        ('experiment.pace="lockstep"', ["experiment", "pace"], "lockstep"),
        ("model.object.hidden=[12, 3]", ["model", 1, "hidden"], [12, 3]),
        ("learner.name=ga", ["learner", "name"], "ga"),
        ("model.object.learner.name=de", ["model", 1, "learner", "name"], "de"),
        ("model.induced.evolution.mutation_rate=0.5", ["model", 2, "evolution", "mutation_rate"], 0.5),
        ("teacher.phase.second teacher.start=7", ["teacher", "phase", 2, "start"], 7),
        ("optimizer.feedback_patience_s = 3.5", ["optimizer", "feedback_patience_s"], 3.5),
        ("new.section.name=true", ["new", "section", "name"], True),
        ("experiment.name=", ["experiment", "name"], ""),
    ],
)
def test_overrides_reach_their_place(override: str, path: list[Any], value: Any) -> None:
    place: Any = read_file(PAPER, [override])
    for step in path:
        place = place[step]
    assert place == value


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("evolution.population", "expected SECTION.NAME=VALUE"),
        ("=3", "expected SECTION.NAME=VALUE"),
        ("evolution..population=3", "expected SECTION.NAME=VALUE"),
        ("model.objekt.hidden=[1]", "no entry named 'objekt'; there are communication, object, induced"),
        ("model.object=3", "name the entry"),
        ("experiment.name.first=3", "experiment.name is a value, not a section"),
        ("channels.action.values.first=3", "is a list of values, not of named entries"),
        ("channels.action.values.first.second=3", "is a list of values, not of named entries"),
    ],
)
def test_overrides_that_fit_nowhere_say_so(override: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_file(PAPER, [override])
    assert said in str(caught.value)


@settings(derandomize=True, deadline=None, max_examples=150)
@given(
    st.lists(
        st.sampled_from(["model", "mode", "object", "channels", "action", "values", "evolution", "x", "", " ", "0"]),
        min_size=1,
        max_size=5,
    ).map(".".join),
    st.sampled_from(["=1", "=", "=[1,", '="a"', "={a=1}", "", "=nan", "=1\nb=2"]),
)
def test_any_override_is_taken_or_a_config_error(path: str, value: str) -> None:
    with suppress(ConfigError):
        brain_config(read_file(PAPER, [path + value]), PAPER)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (content(optimizer={"acions": 3}), "acions"),
        (content(experiment={"seeed": 3}), "seeed"),
        (content(evolution={"populaton": 3}), "did you mean 'population'?"),
        (models(evolution={"elit": 1}), "model communication: unknown setting 'elit'; did you mean 'elite'?"),
        (models(learner={"name": "adm"}), "learner of model communication: name is 'adm'; did you mean 'adam'?"),
        (models(learner={"name": ["de"]}), "learner of model communication: name is \"['de']\""),
        (models(learner={"steps": 20}), "learner of model communication: name is ''; there are adam, cma"),
        (models(learner={"name": "adam", "step": 2}), "unknown setting 'step'; did you mean 'steps'?"),
        (models(learner={"name": "adam", "steps": 0}), "learner of model communication: steps is 0"),
        (models(learner={"name": "ga", "elite": 2}), "'elite': the settings of 'ga' are in 'evolution'"),
        (content(learner={"name": "pgba"}), "learner of model communication: name is 'pgba'; did you mean 'pbga'?"),
        (models(memory={"recencey": 1.0}), "unknown setting 'recencey'; did you mean 'recency'?"),
        (models(context={"treshold": 2.0}), "context of model communication: unknown setting 'treshold'; did you"),
        (models(long_term={"capacty": 2}), "long_term of model communication: unknown setting 'capacty'; did you"),
        (content(context={"threshold": 0.5}), "context of model communication: threshold is 0.5; expected more than"),
        (content(context={"enabled": 1}), "context of model communication"),
        (content(long_term={"newest": 1}), "long_term of model communication: newest is 1; expected fit_pairs = 2"),
        (content(long_term={"capacity": 2.5}), "long_term of model communication"),
        (models(inputs=["note", "acton"]), "no channel for 'acton'; did you mean 'action'?"),
        (models(outputs=["next.distanc"]), "did you mean 'next.distance'?"),
        (models(outputs=["note"]), "outputs must be scalar"),
        (models(name="object"), "two models have the same name"),
        (models(name="a/b"), "name"),
        (models(name="communication\n"), "name"),
        (modes(world="comunication"), "no world model 'comunication'; did you mean 'communication'?"),
        (modes(satisfaction="feedbak"), "satisfaction 'feedbak' is neither"),
        (content(evolution={"population": 0}), "elite is 1"),
        (content(evolution={"population": "many"}), "population"),
        (content(memory={"recency": 0.0}), "label weights"),
        (channels(distance={"low": 2.0}), "channels.distance"),
        (channels(distance={"low": float("-inf")}), "channels.distance"),
        (channels(distance={"high": float("inf")}), "channels.distance"),
        (channels(distance={"change": float("inf")}), "distance"),
        (channels(distance={"encoding": "rank"}), "a rank channel needs"),
        (channels(action={"values": [0.0, float("nan")]}), "channels.action"),
        (channels(note={"size": 0}), "a one_hot channel needs"),
        (channels(distance={"lo": 1.0}), "lo"),
        (channels(action={"values": [0, 1]}), "optimizer.actions is 3, but channels.action has 2 values"),
        (content(optimizer={"actions": 4}), "optimizer.actions is 4, but channels.action has 3 values"),
        (channels(action={"encoding": "one_hot", "size": 2}), "but channels.action has 2 values"),
        (channels(turn={"encoding": "value", "of": "action", "values": [0, 1]}), "but channels.turn has 2 values"),
        (channels(turn={"of": "acton"}), "channels.turn: of = 'acton' is no channel; did you mean 'action'?"),
        ({k: v for k, v in CONTENT.items() if k != "optimizer"}, "optimizer"),
        (CONTENT | {"model": []}, "model"),
        (CONTENT | {"mode": []}, "mode"),
        (modes(reach=0), "reach"),
        (modes(reach=101), "reach"),
        (modes(curiosity=-0.1), "curiosity"),
        (modes(curiosity=11), "curiosity"),
        (models(members=0), "members"),
        (models(members=64, hidden=[128, 128]), "choose fewer 'members', 'hidden' units or pairs"),
        (SUPPORTED_BY_MUCH, "numbers support it; expected at most"),
        (content(optimizer={"praise_window": 201}), "praise_window"),
        (models(memory={"outcome": -1.0}), "outcome is -1.0; expected 0, or a positive number"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_a_config_error_that_says_where(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        brain_config(changed, "small.toml")
    assert str(caught.value).startswith("small.toml: ")
    assert said in str(caught.value)


def test_files_that_cannot_be_read_are_config_errors(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot read the experiment file"):
        read_file(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="cannot read the experiment file"):
        read_file(tmp_path)
    broken = tmp_path / "broken.toml"
    broken.write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="not valid TOML"):
        read_file(broken)


def test_a_models_settings_go_before_the_files_defaults() -> None:
    changed = models(evolution={"population": 33}, memory={"distance": 2.0})
    brain = brain_config(changed | {"memory": {"recency": 0.5}}, "small.toml")
    first, second = brain.model
    assert (brain.evolution_of(first).population, brain.evolution_of(second).population) == (33, 20)
    assert (brain.evolution_of(first).generations, brain.evolution_of(second).generations) == (2, 2)
    assert (brain.memory_of(first).recency, brain.memory_of(first).distance) == (0.5, 2.0)
    assert (brain.memory_of(second).recency, brain.memory_of(second).distance) == (0.5, 0.0)


def test_the_model_that_tells_a_modes_satisfaction_is_weighed_by_its_support_where_the_mode_has_reach() -> None:
    def supported(*overrides: str) -> set[str]:
        brain = brain_config(read_file(PAPER, overrides), PAPER)
        return {model.name for model in brain.model if brain.is_supported(model.name)}

    assert supported() == {"communication", "induced"}, (
        "the object model's world is wide, and it tells no satisfaction"
    )
    without = 'mode=[{name="taught", world="communication", satisfaction="feedback"}]'
    assert supported(without) == set()


def test_a_models_context_and_long_term_memory_go_before_the_files() -> None:
    changed = models(context={"threshold": 4.0}, long_term={"sample": 7})
    brain = brain_config(changed | {"context": {"margin": 0.3}, "long_term": {"capacity": 2}}, "small.toml")
    first, second = (brain.context_of(model) for model in brain.model)
    assert (first.threshold, first.margin) == (4.0, 0.3)
    assert second == replace(first, threshold=ContextConfig().threshold)
    one, other = (brain.long_term_of(model) for model in brain.model)
    assert (one.sample, one.capacity) == (7, 2)
    assert other == replace(one, sample=LongTermConfig().sample)


def test_what_a_model_reads_is_said_by_name_inputs_before_outputs() -> None:
    brain = config()
    communication, object_model = (list(brain.reads(model).items()) for model in brain.model)
    assert communication == [
        ("note", "one_hot of 3"), ("action", "rank of 0, -20, 20"), ("feedback", "scalar -1 to 1"),
    ]  # fmt: skip
    assert object_model == [
        ("distance", "scalar 0 to 2"), ("action", "rank of 0, -20, 20"), ("next.distance", "scalar 0 to 2"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    "changed",
    [
        channels(note={"size": 4}),
        channels(note={"encoding": "scalar"}),
        channels(action={"values": [0, 20, -20]}),
        channels(action={"encoding": "value"}),
        channels(feedback={"high": 2.0}),
        models(inputs=["action", "note"]),
        models(outputs=["feedback", "next.distance"]),
    ],
)
def test_brains_whose_models_read_other_numbers_can_be_told_apart(changed: dict[str, Any]) -> None:
    other = brain_config(changed, "other.toml")
    assert list(other.reads(other.model[0]).items()) != list(config().reads(config().model[0]).items())


def test_brains_that_differ_in_what_a_model_does_not_read_are_the_same_to_it() -> None:
    other = brain_config(channels(distance={"high": 3.0}), "other.toml")
    assert other.reads(other.model[0]) == config().reads(config().model[0])


def test_a_models_learner_is_instead_of_the_files() -> None:
    changed = models(learner={"name": "adam", "steps": 7}, evolution={"elite": 3})
    for default, second in (({}, "pbga"), ({"name": "ridge", "features": 9}, "ridge")):
        brain = brain_config(changed | {"learner": default}, "small.toml")
        names, settings = zip(*(brain.learner_of(model) for model in brain.model), strict=True)
        assert names == ("adam", second)
        assert settings[0] == AdamConfig(steps=7)
    assert settings[1] == RidgeConfig(features=9)


@pytest.mark.parametrize("name", ["pbga", "ga"])
def test_what_evolves_a_population_has_its_settings_from_evolution(name: str) -> None:
    brain = brain_config(models(learner={"name": name}, evolution={"elite": 3}), "small.toml")
    assert brain.learner_of(brain.model[0]) == (name, brain.evolution_of(brain.model[0]))


def test_variables_have_their_derived_channels() -> None:
    variables = config().variables()
    assert set(variables) == {
        "distance", "next.distance", "covered.distance", "note", "next.note", "action", "next.action", "feedback",
        "next.feedback",
    }  # fmt: skip
    covered = variables["covered.distance"]
    assert (covered.low, covered.high) == (-0.5, 0.5)


def test_a_model_that_is_not_there_is_named_with_those_that_are() -> None:
    assert config().model_named("object").capacity == 4
    with pytest.raises(ConfigError, match="no model 'subject'; the file has communication, object"):
        config().model_named("subject")
