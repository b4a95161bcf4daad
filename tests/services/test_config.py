"""The experiment file: overrides, defaults, and errors that name the place and the mend."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdb_protocol import codec, keys, messages
from mdb_protocol.errors import ConfigError
from mdb_protocol.messages import VALUE_BOUND
from mdb_services.experiment.brain import brain_config
from mdb_services.experiment.reading import read_file
from mdb_services.mechanism.actions.foresight import Foreseen
from mdb_services.mechanism.feedback.praise import LATELY
from mdb_services.mechanism.memories.context import ContextConfig
from mdb_services.mechanism.memories.ltm import LongTermConfig
from mdb_services.mechanism.networks.encoding import Facts
from mdb_services.mechanism.settings import AdamConfig, RidgeConfig
from tests.services.small import CONTENT, TURNS, config, config_of_vectors, content, done, in_ranges, pair, without

PAPER = Path(__file__).parents[2] / "deploy" / "experiments" / "paper.toml"


def models(**first: Any) -> dict[str, Any]:
    """The small brain with its first model changed."""
    return CONTENT | {"model": [CONTENT["model"][0] | first, *CONTENT["model"][1:]]}


def modes(**first: Any) -> dict[str, Any]:
    return CONTENT | {"mode": [CONTENT["mode"][0] | first, *CONTENT["mode"][1:]]}


def channels(**changed: Any) -> dict[str, Any]:
    return content(channels={name: CONTENT["channels"].get(name, {}) | fields for name, fields in changed.items()})


def choice(**values: Any) -> dict[str, Any]:
    """The small brain whose last choice is another action."""
    return CONTENT | {"choice": [*CONTENT["choice"][:-1], {"name": "last", "values": values}]}


def actuators(**changed: dict[str, Any]) -> dict[str, Any]:
    """The small brain without choices, and with other actuators besides its own."""
    ranges = in_ranges()
    return ranges | {"actuators": ranges["actuators"] | changed}


READS_TURN = in_ranges()["channels"]
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
        ("choice.left 45.values.turn=40", ["choice", 5, "values", "turn"], 40),
        ("search.method=cma", ["search", "method"], "cma"),
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
        (
            "model.objekt.hidden=[1]",
            "no entry named 'objekt'; there are communication, object, induced; did you mean 'object'?",
        ),
        ("model.object=3", "name the entry"),
        ("experiment.name.first=3", "experiment.name is a value, not a section"),
        ("robot.ends.first=3", "is a list of values, not of named entries"),
        ("robot.ends.first.second=3", "is a list of values, not of named entries"),
        ("choice.left.values=3", "no entry named 'left'; there are ahead, right 20"),
    ],
)
def test_overrides_that_fit_nowhere_say_so(override: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_file(PAPER, [override])
    assert said in str(caught.value)


@settings(derandomize=True, deadline=None, max_examples=150)
@given(
    st.lists(
        st.sampled_from(
            [
                "model",
                "mode",
                "object",
                "channels",
                "action",
                "values",
                "actuators",
                "choice",
                "turn",
                "x",
                "",
                " ",
                "0",
            ]
        ),
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
        (content(evolution={"population": 0}), "population is 0; expected 2 or more"),
        (content(evolution={"population": "many"}), "population"),
        (content(memory={"recency": 0.0}), "label weights"),
        (channels(distance={"low": 2.0}), "channels.distance"),
        (channels(distance={"low": float("-inf")}), "channels.distance"),
        (channels(distance={"high": float("inf")}), "channels.distance"),
        (channels(distance={"change": float("inf")}), "distance"),
        (channels(distance={"encoding": "rank"}), "a rank channel needs"),
        (channels(action={"by": None, "values": [0.0, float("nan")]}), "channels.action"),
        (channels(note={"size": 0}), "a one_hot channel needs"),
        (channels(distance={"lo": 1.0}), "lo"),
        (
            channels(action={"by": None, "values": [0, 1]}),
            "channels.action has 2 values, and there are 3 [[choice]] entries; expected as many of each",
        ),
        (channels(action={"by": None}), "values (): a rank channel needs"),
        (channels(action={"encoding": "one_hot", "by": None, "size": 2}), "channels.action has 2 values, and there"),
        (
            channels(action={"encoding": "one_hot", "by": None, "size": 3}) | {"choice": CONTENT["choice"][:2]},
            "channels.action has 3 values, and there are 2 [[choice]] entries",
        ),
        (
            in_ranges(channels=READS_TURN | {"action": {"encoding": "one_hot", "size": 3}}),
            "channels.action has 3 values, and there are 0 [[choice]] entries; expected as many of each "
            "(encoding 'rank' with by = ACTUATOR, or 'one_hot' with size), or no such channel",
        ),
        (in_ranges(channels=READS_TURN | {"action": {}}), "channels.action has no values, and there are 0"),
        (channels(action={"encoding": "value"}), "Invalid enum value 'value'"),
        (channels(turn={"of": "action"}), "`of`"),
        (content(optimizer={"actions": 3}), "`actions`"),
        (without("actuators"), "`actuators`"),
        (CONTENT | {"actuators": {}}, "actuators"),
        (content(actuators={"turn": {"low": -90.0}}), "`high`"),
        (content(actuators={"turn": {"low": -90.0, "high": 90.0, "step": 1.0}}), "`step`"),
        (actuators(speed={"low": 1.0, "high": 1.0}), "actuators.speed: low 1.0 and high 1.0; expected low < high"),
        (actuators(speed={"low": 1.0, "high": -1.0}), "actuators.speed: low 1.0 and high -1.0; expected low < high"),
        (actuators(speed={"low": float("nan"), "high": 1.0}), "actuators.speed: low nan and high 1.0"),
        (actuators(speed={"low": 0.0, "high": float("nan")}), "actuators.speed: low 0.0 and high nan"),
        (actuators(speed={"low": 0.0, "high": float("inf")}), "actuators.speed"),
        (actuators(speed={"low": float("-inf"), "high": 0.0}), "actuators.speed"),
        (actuators(speed={"low": 0.0, "high": 2 * VALUE_BOUND}), "actuators.speed"),
        *((actuators(**{name: {"low": 0.0, "high": 1.0}}), f"actuators.{name}: the name means something else already")
          for name in ("note", "action", "feedback")),
        *((actuators(**{name: {"low": 0.0, "high": 1.0}}), "actuators")
          for name in ("next.turn", "covered.turn", "a/b", "", "x" * 65)),
        (channels(turn={"encoding": "one_hot", "size": 3}), "channels.turn: encoding is 'one_hot'; an actuator's"),
        (channels(turn={"encoding": "rank", "values": TURNS}), "channels.turn: encoding is 'rank'; an actuator's"),
        (CONTENT | {"choice": CONTENT["choice"][:1]}, "there is one [[choice]]; expected two or more, or none"),
        (
            CONTENT | {"choice": [*CONTENT["choice"], CONTENT["choice"][1]]},
            "two [[choice]] entries have the same name; give each its own",
        ),
        (
            content(actuators={"speed": {"low": 0.0, "high": 1.0}}),
            "choice 'turn 0' has values for turn; expected one for each of turn, speed",
        ),
        (choice(), "choice 'last' has values for nothing; expected one for each of turn"),
        (choice(trun=20.0), "choice 'last' has values for trun; expected one for each of turn"),
        (choice(turn=20.0, speed=1.0), "choice 'last' has values for turn, speed; expected one for each of turn"),
        (choice(turn=90.5), "choice 'last': turn = 90.5; expected -90.0 to 90.0"),
        (choice(turn=-91), "choice 'last': turn = -91.0; expected -90.0 to 90.0"),
        (choice(turn=float("nan")), "choice 'last': turn = nan; expected -90.0 to 90.0"),
        (choice(turn="left"), "`$.choice[2].values"),
        (CONTENT | {"choice": [{"values": done(0)}, *CONTENT["choice"][1:]]}, "`name`"),
        (channels(action={"by": "trun"}), "channels.action: by = 'trun'; expected an actuator, in channels.action"),
        (channels(note={"encoding": "rank", "by": "turn"}), "channels.note: by = 'turn'; expected an actuator"),
        (channels(distance={"by": "turn"}), "channels.distance: by = 'turn'; expected an actuator, in"),
        (
            in_ranges(channels=READS_TURN | CONTENT["channels"]),
            "channels.action: by = 'turn'; expected an actuator, in channels.action, where there are [[choice]]",
        ),
        (in_ranges(search={"method": "grid"}), "Invalid enum value 'grid'"),
        (in_ranges(search={"evaluations": 1}), "evaluations"),
        (in_ranges(search={"evaluation": 64}), "`evaluation`"),
        (channels(distance={"numbers": 0}), "numbers"),
        (channels(note={"numbers": 2}), "channels.note: numbers 2: expected 1, or more for a scalar channel"),
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
    with pytest.raises(ConfigError, match="is a folder, and is not read; expected a file: an experiment in TOML"):
        read_file(tmp_path)
    broken = tmp_path / "broken.toml"
    broken.write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="not text in UTF-8"):
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
        channels(action={"by": None, "values": [0, 20, -20]}),
        choice(turn=45.0),
        channels(action={"encoding": "one_hot", "by": None, "size": 3}),
        channels(feedback={"numbers": 2}),
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


def test_a_vectors_derived_channels_have_as_many_numbers() -> None:
    variables = brain_config(channels(sonar={"high": 4.0, "numbers": 8, "change": 0.5}), "small.toml").variables()
    assert [variables[name].numbers for name in ("sonar", "next.sonar", "covered.sonar")] == [8, 8, 8]
    assert (variables["covered.sonar"].low, variables["covered.sonar"].high) == (-0.5, 0.5)


def test_the_size_of_a_model_counts_all_numbers_of_a_vector() -> None:
    wide = channels(sonar={"numbers": 1000}, lidar={"numbers": 1000})
    reads = {"inputs": ["sonar", "lidar", "action"], "outputs": ["next.distance", "next.sonar"]}

    def with_hidden(units: int) -> dict[str, Any]:
        return wide | {"model": [CONTENT["model"][0], CONTENT["model"][1] | reads | {"hidden": [units]}]}

    assert brain_config(with_hidden(3), "small.toml").model[1].hidden == (3,)
    with pytest.raises(ConfigError, match=r"model object: .* in layers \[2001, 512, 1001\]"):
        brain_config(with_hidden(512), "small.toml")


def test_the_longest_vector_that_a_file_may_ask_for_fits_in_the_messages() -> None:
    """Or else the robot, or the optimizer, dies of it at its first message."""

    def is_allowed(numbers: int) -> bool:
        try:
            config_of_vectors(channels={"sonar": {"numbers": numbers}})
        except ConfigError:
            return False
        return True

    longest = max(numbers for numbers in (2**power for power in range(13)) if is_allowed(numbers))
    reading: dict[str, Any] = {"sonar": [0.1] * longest}
    meant = messages.Intention(
        before=reading, note=1, teacher=None, holder=None, mode="alone", explored=False, predicted=0.1, versions={}
    )
    action = messages.Action(iteration=1, action=done(0), choice=0, valid_for_s=1.0, intention=meant)
    one = pair(1, before=reading, after=reading)
    perception = messages.Perception(iteration=1, outcome=reading, reading=reading, done=action)
    many = dict.fromkeys(("notes", "choices", "iterations"), np.zeros(0, np.int64))
    progress = messages.Progress(iteration=400, versions={}, judged=[one] * LATELY, unjudged=[one] * 100, **many)
    sent = ((keys.ACTION, action), (keys.PERCEPTION, perception), (keys.PAIR, one), (keys.PROGRESS, progress))
    for row, message in sent:
        payload = codec.encode(message)
        assert len(payload) < row.most_bytes, row.path
        codec.decode(type(message), payload, codec.encoding_of(type(message)))


# ---- what can be done ----


def test_the_space_of_choices_has_them_in_the_files_order() -> None:
    space = config().space()
    looked = space.look(lambda actions: Foreseen(*[np.zeros(len(actions["turn"]))] * 3), np.random.default_rng(0))
    assert looked is not None
    actions, _ = looked
    assert [space.values(actions, place) for place in range(len(TURNS))] == [done(i) for i in range(len(TURNS))]
    assert [space.choice(actions, place) for place in range(len(TURNS))] == [0, 1, 2]


def test_without_choices_the_ranges_are_searched_as_the_file_says() -> None:
    settings = in_ranges(search={"method": "refine", "evaluations": 20})
    settings["actuators"] = settings["actuators"] | {"speed": {"low": 0.0, "high": 0.25}}
    space, asked = brain_config(settings, "small.toml").space(), []

    def foresee(actions: Facts) -> Foreseen:
        asked.append(actions)
        return Foreseen(*[np.zeros(len(actions["turn"]))] * 3)

    assert space.look(foresee, np.random.default_rng(0)) is not None
    turns, speeds = (np.concatenate([actions[name] for actions in asked]) for name in ("turn", "speed"))
    assert 2 <= len(turns) <= 20
    assert -90 <= turns.min() < -45
    assert 45 < turns.max() <= 90
    assert 0 <= speeds.min() < 0.1 < speeds.max() <= 0.25


@pytest.mark.parametrize(
    ("action", "index", "allowed"),
    [
        (done(0), 0, True),
        (done(2), 2, True),
        ({"turn": -20}, 1, True),
        (done(0), 1, False),
        (done(0), None, False),
        (done(0), 3, False),
        ({"turn": 0.5}, 0, False),
        ({}, 0, False),
        ({"turn": 0.0, "speed": 0.0}, 0, False),
        ({"trun": 0.0}, 0, False),
    ],
)
def test_of_choices_only_those_of_the_file_are_allowed(action: dict, index: int | None, allowed: bool) -> None:
    assert config().allows(action, index) is allowed


@pytest.mark.parametrize(
    ("action", "index", "allowed"),
    [
        ({"turn": 12.3, "speed": 0.1}, None, True),
        ({"speed": 0.25, "turn": -90}, None, True),
        ({"turn": 90.0, "speed": 0.0}, None, True),
        ({"turn": 90.001, "speed": 0.0}, None, False),
        ({"turn": 0.0, "speed": -0.1}, None, False),
        ({"turn": 0.0, "speed": 0.1}, 0, False),
        ({"turn": 0.0}, None, False),
        ({"turn": 0.0, "speed": 0.1, "lift": 0.0}, None, False),
        ({"turn": 0.0, "lift": 0.1}, None, False),
        ({}, None, False),
    ],
)
def test_of_ranges_every_point_is_allowed_and_no_choice(action: dict, index: int | None, allowed: bool) -> None:
    assert brain_config(actuators(speed={"low": 0.0, "high": 0.25}), "small.toml").allows(action, index) is allowed


tenths = st.integers(-40, 40).map(lambda value: value / 10)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    st.lists(st.tuples(tenths, tenths).map(sorted).filter(lambda ends: ends[0] < ends[1]), min_size=1, max_size=3),
    st.integers(0, 99),
)
def test_what_is_chosen_is_always_allowed(ranges: list[list[float]], seed: int) -> None:
    """What is best at the end of a range, too: a brain whose own action is not allowed would never store it."""
    named = {f"joint{i}": {"low": low, "high": high} for i, (low, high) in enumerate(ranges)}
    brain = brain_config(without("choice", "model", "channels", "mode") | {
        "actuators": named,
        "search": {"evaluations": 32},
        "channels": {"joint0": {"low": -1e6, "high": 1e6}, "feedback": {}},
        "model": [CONTENT["model"][0] | {"inputs": ["joint0"]}],
        "mode": CONTENT["mode"][:1],
    }, "ranges.toml")  # fmt: skip
    space, rng = brain.space(), np.random.default_rng(seed)

    def the_more_the_better(actions: Facts) -> Foreseen:
        promises = np.sum([actions[name] for name in named], axis=0)
        return Foreseen(promises, np.ones(len(promises)), np.zeros(len(promises)))

    looked = space.look(the_more_the_better, rng)
    assert looked is not None
    for actions in (looked[0], space.random(rng)):
        for place in range(len(actions["joint0"])):
            assert brain.allows(space.values(actions, place), space.choice(actions, place))


def test_a_model_that_is_not_there_is_named_with_those_that_are() -> None:
    assert config().model_named("object").capacity == 4
    with pytest.raises(ConfigError, match="no model 'subject'; the file has communication, object"):
        config().model_named("subject")
