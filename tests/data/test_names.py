"""Names of a building: at least one of each kind, each once, none empty."""

from __future__ import annotations

import pytest

from thermoforce_mpc.data import Layout, Names
from thermoforce_mpc.data.layout import check_same_layout
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.measurements.map.mapping import MeasurementMap


@pytest.mark.parametrize("zones", [(), ("bath", "bath"), ("bath", ""), (" ",)])
def test_a_building_whose_zones_cannot_be_told_apart_is_refused(zones):
    with pytest.raises(DataError, match="zones are"):
        Names(zones)


@pytest.mark.parametrize("kind", ["zones", "actuators", "machines"])
def test_an_empty_name_in_a_map_is_refused(kind):
    rules = {
        "time": {"column": "time"},
        "outdoor": "out",
        "zones": {"bath": {"temperature": "T", "lower": 20, "upper": 24}},
        "actuators": {"valve": {"level": "u"}},
        "machines": {"pump": {"power": "P"}},
    }
    MeasurementMap.model_validate(rules)
    with pytest.raises(ValueError, match=rf"{kind} are \[''\]: one has no name"):
        MeasurementMap.model_validate(rules | {kind: {"": next(iter(rules[kind].values()))}})


def test_what_is_said_of_several_actuators_is_said_once_with_their_names():
    names = Names(("a", "b", "c"), ("radiator", "floor", "towel"))
    told = names.of_actuators({0: "on/off", 1: "modulating", 2: "on/off"})
    assert told == ["radiator, towel: on/off", "floor: modulating"]
    assert Names().of_actuators({0: "on/off"}) == ["on/off"]


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (
            {"home": (1, 0)},
            r"by the model radiator is heating a, fed by pump, by map\.yaml heating b, fed by pump: which",
        ),
        ({"machine_of": (0, 0)}, r"floor is heating b, fed by boiler, by map\.yaml heating b, fed by pump"),
        ({"signs": (1, -1)}, r"floor is heating b, .* cooling b, fed by boiler"),
        (
            {"names": Names(("b", "a"), ("radiator", "floor"), ("pump", "boiler"))},
            "is of zones a, b, .* another building",
        ),
    ],
)
def test_a_map_that_has_an_actuator_serve_another_room_than_the_model_is_refused(other, words):
    """Names alone are the same in both."""
    two = {"signs": (1, 1), "u_min": (0.0, 0.0), "shares": (0.0, 0.0), "floor_area_m2": (20.0, 20.0)}
    names = Names(("a", "b"), ("radiator", "floor"), ("pump", "boiler"))
    model = {"names": names, "home": (0, 1), "machine_of": (0, 1), **two}
    check_same_layout("the model", Layout(**model), "map.yaml", Layout(**model | {"floor_area_m2": (30.0, 30.0)}))
    with pytest.raises(DataError, match=words):
        check_same_layout("the model", Layout(**model), "map.yaml", Layout(**model | other))
