"""The robot's configuration refuses what no body could do, however it is made."""

import msgspec
import pytest

from mdb_sim.body import RobotConfig


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("advance_m", -0.1),
        ("turns_deg", (0.0,)),
        ("turns_deg", (0.0, 400.0)),
        ("sonar_dropout", 1.0),
        ("physics_hz", 10),
        ("sonar_rays", 0),
        ("capture_distance_m", "near"),
    ],
)
def test_a_value_out_of_bounds_is_refused_by_name(field, value):
    with pytest.raises(ValueError, match=field):
        RobotConfig(**{field: value})
    with pytest.raises(ValueError, match=field):
        msgspec.convert({field: value}, RobotConfig)


def test_contradicting_values_are_refused():
    with pytest.raises(ValueError, match=r"place_min_m=2.0 exceeds place_max_m=1.5"):
        RobotConfig(place_min_m=2.0)
    with pytest.raises(ValueError, match="no room for an object"):
        RobotConfig(arena_m=3.0)


def test_unknown_fields_are_refused_and_whole_configs_survive_a_round_trip():
    with pytest.raises(msgspec.ValidationError, match="unknown field `wheels`"):
        msgspec.convert({"wheels": 3}, RobotConfig)
    config = RobotConfig(advance_m=0.1, turns_deg=(0.0, 10.0, -10.0))
    assert msgspec.json.decode(msgspec.json.encode(config), type=RobotConfig) == config
