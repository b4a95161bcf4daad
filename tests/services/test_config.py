"""The experiment file: overrides, defaults, and errors that name the place and the mend."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_protocol.errors import ConfigError
from mdb_services.config import brain_config, read_file
from tests.services.small import CONTENT, config, content

PAPER = Path(__file__).parents[2] / "deploy" / "experiments" / "paper.toml"


def models(**first: Any) -> dict[str, Any]:
    """The small brain with its first model changed."""
    return CONTENT | {"model": [CONTENT["model"][0] | first, *CONTENT["model"][1:]]}


def modes(**first: Any) -> dict[str, Any]:
    return CONTENT | {"mode": [CONTENT["mode"][0] | first, *CONTENT["mode"][1:]]}


def channels(**changed: Any) -> dict[str, Any]:
    return content(channels={name: CONTENT["channels"].get(name, {}) | fields for name, fields in changed.items()})


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
        (models(memory={"recencey": 1.0}), "unknown setting 'recencey'; did you mean 'recency'?"),
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
