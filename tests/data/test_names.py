"""Names of a building: at least one of each kind, each once, none empty."""

from __future__ import annotations

import pytest

from thermoforce_mpc.data import Names
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
