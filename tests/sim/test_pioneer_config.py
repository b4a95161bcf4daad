"""The Pioneer's options refuse what no body could do, however it is made."""

import msgspec
import pytest

from mdb_sim.bodies.pioneer.world import PioneerConfig, config_of
from mdb_sim.body import BodyError


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("advance_m", -0.1),
        ("sonar_dropout", 1.0),
        ("physics_hz", 10),
        ("sonar_rays", 0),
        ("capture_distance_m", "near"),
    ],
)
def test_a_value_out_of_bounds_is_refused_by_name(field, value):
    with pytest.raises(ValueError, match=field):
        PioneerConfig(**{field: value})
    with pytest.raises(ValueError, match=field):
        msgspec.convert({field: value}, PioneerConfig)
    with pytest.raises(BodyError, match=rf"robot\.options: .*{field}"):
        config_of({field: value})


def test_contradicting_values_are_refused():
    with pytest.raises(ValueError, match=r"place_min_m=2.0 exceeds place_max_m=1.5"):
        PioneerConfig(place_min_m=2.0)
    with pytest.raises(ValueError, match=r"sonar_min_m=6.0 exceeds sonar_max_m=5.0"):
        PioneerConfig(sonar_min_m=6.0)
    with pytest.raises(ValueError, match="no room for an object"):
        PioneerConfig(arena_m=3.0)


def test_unknown_fields_are_refused_and_whole_configs_survive_a_round_trip():
    with pytest.raises(msgspec.ValidationError, match="unknown field `wheels`"):
        msgspec.convert({"wheels": 3}, PioneerConfig)
    with pytest.raises(BodyError, match="unknown field `wheels`"):
        config_of({"wheels": 3})
    config = PioneerConfig(advance_m=0.1, lost_readings=5)
    assert config_of({"advance_m": 0.1, "lost_readings": 5}) == config
    assert msgspec.json.decode(msgspec.json.encode(config), type=PioneerConfig) == config
