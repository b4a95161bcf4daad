"""Whether an experiment file fits its body and its policy: each difference is told, and nothing when all fits."""

from collections.abc import Sequence
from typing import Any

import msgspec
import pytest

from mdb_services.experiment.brain import BrainConfig, brain_config
from mdb_sim.body import Actuator, Sensor, Spec
from mdb_sim.runs.experiment import ChangeSection, RobotSection
from mdb_sim.runs.machine import differences
from mdb_sim.teaching.policies.pioneer import Reach
from mdb_sim.teaching.policies.plain import Named
from mdb_sim.teaching.policy import Policy

SPEC = Spec(
    sensors=(Sensor(name="distance", low=0.0, high=2.0), Sensor(name="rows", low=0.0, high=1.0, numbers=4)),
    actuators=(Actuator(name="turn", low=-90.0, high=90.0, unit="deg"),),
    events=("won", "hit"),
    scene=("x_m", "y_m"),
)
POLICY = Named(["come", "go", "stay"])


def brain(**sections: Any) -> BrainConfig:
    """A brain that fits the body, with some sections in the place of its own."""
    plain = {
        "experiment": {"name": "small", "iterations": 5},
        "channels": {
            "distance": {"low": 0.0, "high": 2.0, "change": 0.5},
            "note": {"encoding": "one_hot", "size": 3},
            "turn": {"low": -90.0, "high": 90.0},
            "feedback": {},
        },
        "actuators": {"turn": {"low": -90.0, "high": 90.0}},
        "choice": [{"name": f"turn {turn:g}", "values": {"turn": turn}} for turn in (0.0, -20.0, 20.0)],
        "model": [
            {"name": "m", "role": "world", "inputs": ["note", "turn"], "outputs": ["feedback"], "hidden": [3],
             "capacity": 4}
        ],
        "mode": [{"name": "taught", "world": "m", "satisfaction": "feedback"}],
    }  # fmt: skip
    models = sections.pop("model", None)
    return brain_config(plain | sections | ({"model": models} if models else {}), "small.toml")


def found(
    own: BrainConfig | None = None,
    spec: Spec = SPEC,
    *,
    policy: Policy | None = POLICY,
    successes: Sequence[str] = ("won",),
    ends: Sequence[str] = ("won", "hit"),
    change: Sequence[ChangeSection] = (),
) -> list[str]:
    robot = RobotSection(successes=tuple(successes), ends=tuple(ends), change=tuple(change))
    return differences(own or brain(), robot, spec, policy)


def spec(**changes: Any) -> Spec:
    return msgspec.structs.replace(SPEC, **changes)


def channels(**changes: Any) -> dict[str, Any]:
    """The channels with others, or without those that are None."""
    plain = {name: msgspec.to_builtins(section) for name, section in brain().channels.items()} | changes
    return {name: section for name, section in plain.items() if section is not None}


def test_where_all_fits_nothing_is_found() -> None:
    assert found() == []
    assert found(policy=None) == []
    assert found(brain(choice=[])) == [], "a body that can do anything in its ranges may be searched"
    assert found(successes=["timeout"], ends=["timeout"]) == [], "of any body"
    assert found(brain(actuators={"turn": {"low": -45.0, "high": 30.0}})) == [], "a part of what it can do"
    assert found(brain(channels=channels(rows={"numbers": 4}))) == []


def test_sensors_that_are_not_used_are_no_difference() -> None:
    more = (*SPEC.sensors, Sensor(name="light", low=0.0, high=1.0))
    assert found(spec=spec(sensors=more)) == []


# ---- actions ----


def test_actuators_that_one_of_both_lacks_are_named() -> None:
    arm = Actuator(name="arm", low=0.0, high=1.0)
    assert found(spec=spec(actuators=(arm,))) == [
        "it has no actuator 'turn' (there are arm)",
        "its actuator 'arm' is not in the file; add [actuators.arm] with low and high",
    ]
    assert found(spec=spec(actuators=(*SPEC.actuators, arm))) == [
        "its actuator 'arm' is not in the file; add [actuators.arm] with low and high"
    ]
    assert found(spec=spec(actuators=()))[0] == "it has no actuator 'turn' (there are none)"


@pytest.mark.parametrize(("low", "high"), [(-91.0, 90.0), (-90.0, 90.5), (100.0, 200.0)])
def test_a_range_beyond_the_bodys_is_told_with_both(low: float, high: float) -> None:
    turns = [low, (low + high) / 2, high]
    choices = [{"name": f"{turn:g}", "values": {"turn": turn}} for turn in turns]
    assert found(brain(actuators={"turn": {"low": low, "high": high}}, choice=choices)) == [
        f"actuators.turn goes from {low:g} to {high:g}, the body's from -90 to 90 deg"
    ]


def test_a_body_that_can_do_some_things_only_needs_choices_among_them() -> None:
    two = spec(choices=({"turn": -20.0}, {"turn": 20.0}))
    assert found(brain(choice=[]), two) == ["it can do 2 things only; add a [[choice]] for each"]
    assert found(spec=two) == ["choice 'turn 0' is none of the 2 things that it can do"]
    turns = [{"name": f"{turn}", "values": {"turn": turn}} for turn in (20, -20)]
    assert found(brain(choice=turns), two) == []


# ---- sensors ----


def test_channels_of_sensors_that_it_has_not_are_named() -> None:
    own = brain(channels=channels(light={"low": 0.0, "high": 1.0}))
    assert found(own) == ["channels.light: it has no such sensor or actuator (there are distance, rows)"]
    assert found(spec=spec(sensors=())) == ["channels.distance: it has no such sensor or actuator (there are none)"]


def test_a_vector_of_another_length_is_told_with_both() -> None:
    own = brain(channels=channels(rows={"numbers": 3}))
    assert found(own) == ["channels.rows: the sensor gives 4 numbers, not 3"]
    own = brain(channels=channels(distance={"low": 0.0, "high": 2.0, "numbers": 2}))
    assert found(own) == ["channels.distance: the sensor gives 1 numbers, not 2"]


# ---- events ----


def test_events_that_are_not_its_own_are_named() -> None:
    assert found(successes=["capture"], ends=["won", "bump", "hit"]) == [
        "robot.successes has 'capture', which is none of its events (there are hit, timeout, won)",
        "robot.ends has 'bump', which is none of its events (there are hit, timeout, won)",
    ]
    assert found(spec=spec(events=()), successes=["won"], ends=[]) == [
        "robot.successes has 'won', which is none of its events (there are timeout)"
    ]


def test_an_event_after_which_it_can_do_nothing_more_must_end_an_episode() -> None:
    assert found(spec=spec(final=("hit",)), ends=["won"]) == ["its event 'hit' ends an episode; add it to robot.ends"]
    assert found(spec=spec(final=("hit",)), ends=["hit"]) == []


# ---- changes ----


def test_what_cannot_be_changed_is_named_once() -> None:
    change = [ChangeSection(at=at, set={"wind": 1.0, "light": 2.0}) for at in (5, 9)]
    assert found(change=change) == [
        "robot.change sets 'light', which cannot be changed (there are none)",
        "robot.change sets 'wind', which cannot be changed (there are none)",
    ]
    assert found(spec=spec(changes=("wind", "light")), change=change) == []


# ---- the teacher ----


def test_what_the_policy_looks_at_must_be_in_the_scene() -> None:
    reach = Reach([0.0, -20.0, 20.0])
    assert found(policy=reach) == [
        f"the teacher's policy looks at '{name}', which its scene does not have (there are x_m, y_m)"
        for name in ("heading_rad", "object_x_m", "object_y_m")
    ]
    assert found(spec=spec(scene=reach.needs), policy=reach) == []


def test_there_must_be_a_note_for_each_command() -> None:
    expected = ["the teacher's policy has 2 commands, but channels.note 3 notes"]
    assert found(policy=Named(["come", "go"])) == expected
    scalar = brain(channels=channels(note={"low": 0.0, "high": 2.0}))
    assert found(scalar, policy=Named(["come", "go"])) == [], "one number can be any note"


def test_every_difference_is_told_at_once() -> None:
    other = Spec(sensors=(), actuators=(Actuator(name="arm", low=0.0, high=1.0),), final=("end",), events=("end",))
    assert len(found(spec=other, policy=Reach())) == 2 + 1 + 1 + 2 + 1 + 5 + 1
