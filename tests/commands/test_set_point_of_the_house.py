"""One thermostat for the house, in one of its rooms: learned by that room, planned for all, and lived."""

from __future__ import annotations

import copy

import numpy as np
import pandas as pd
import pytest
from home_by_curve import HOUSE_RULES, ROOMS, HomeByCurve, curve_model, rules_by

from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.data import Observation
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.live import LiveBuilding
from thermoforce_mpc.live.commissioning import read_house
from thermoforce_mpc.live.trial import planned_trials, tried
from thermoforce_mpc.measurements.checks import command_remarks
from thermoforce_mpc.measurements.forecast import read_forecast
from thermoforce_mpc.measurements.load import learned_commands, read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.measurements.points import read_points
from thermoforce_mpc.scenario.settings import validate
from thermoforce_mpc.whatif.identified_house import IdentifiedHouse

OPTIONS = {"step_s": 3600.0, "horizon_h": 24.0, "free_response": {"name": "persistence"}}
CONFIG = MPCConfig.model_validate(OPTIONS | {"gate": {"enabled": False}, "watch": {"enabled": False}})


@pytest.fixture(scope="module")
def home():
    return HomeByCurve(days=10, set_by="setpoint", swing_K=2.0)


@pytest.fixture(scope="module")
def measured(home):
    return read_measurements(home.measurements(), HOUSE_RULES, step_s=3600.0).served()


@pytest.fixture(scope="module")
def learned(measured):
    return learned_commands(measured)


def test_the_map_says_in_which_room_the_thermostat_is():
    def refused(rules, text):
        with pytest.raises(ConfigError, match=text):
            validate(MeasurementMap, rules, "map.yaml")

    unsaid = r"machines\.heat_pump\.command\.reference: say in which room the thermostat is, of living, bedroom, or"
    refused(rules_by("setpoint", "set"), unsaid)
    refused(rules_by("setpoint", "set", reference="hall"), "it heats no room 'hall'; it heats living, bedroom")
    valve = HOUSE_RULES["actuators"]["living"] | {
        "command": {"kind": "setpoint", "column": "set_living", "reference": "bedroom"}
    }
    own = rules_by("curve_offset", "offset")
    del own["machines"]["heat_pump"]["command"]
    of_valve = own | {"actuators": HOUSE_RULES["actuators"] | {"living": valve}}
    refused(of_valve, r"actuators\.living\.command\.reference: of the command of a machine")


def test_what_it_brings_to_each_room_is_learned_by_the_room_of_the_thermostat(measured, learned):
    assert {name: one.reference for name, one in learned.items()} == {"living": "", "bedroom": "living"}
    cold, warm = (float(learned["bedroom"].loop.level(21.0, T_C, 3.0, 0.0)) for T_C in (20.0, 22.0))
    assert cold > 0.6
    assert warm < 0.05
    each = rules_by("setpoint", "set", reference="each")
    by_own = learned_commands(read_measurements(measured_table(measured), each, step_s=3600.0).served())
    assert {one.reference for one in by_own.values()} == {""}
    assert by_own["bedroom"].loop.r2 < learned["bedroom"].loop.r2
    with pytest.raises(DataError, match="the room 'living' is not among those"):
        learned_commands(measured.of_zones(["bedroom"]))


def measured_table(measured):
    """The record as a table again."""
    r = measured.record
    T = {f"T_{name}": T_C[:-1] for name, T_C in zip(ROOMS, r.T_zone_C, strict=True)}
    u = {f"valve_{name}": u for name, u in zip(ROOMS, r.u, strict=True)}
    rest = {"out": r.T_out_C[:-1], "sun": 0.0, "P": r.power_W[0], "price": 0.2, "flow": 40.0}
    return pd.DataFrame({"time": r.stamps()[:-1], **T, **u, **rest, "set": measured.commands["living"].mean})


def test_a_plan_is_one_set_point_that_saves_what_it_says_with_all_rooms_warm(home, measured, learned):
    mpc = ThermoForceMPC(curve_model(home), CONFIG, commands=learned)
    plan = mpc.plan(Observation(measured.record, read_forecast(home.forecast(), measured)))
    living, bedroom = plan.settings
    assert living == bedroom
    assert all(18.5 <= one.value <= 24.5 for one in living)  # the thermostat's room may be 20.5 to 22.5 °C
    (cost, rooms), (cost_alone, _) = lived(home, living), lived(home)
    assert plan.saving.low < cost_alone - cost < plan.saving.high
    assert cost_alone - cost == pytest.approx(plan.saving.saved, abs=0.02 * cost_alone)
    assert cost < 0.95 * cost_alone
    np.testing.assert_allclose(rooms[:, 12:300:12], plan.T_zone_C, atol=0.4)
    assert rooms[0].min() > 20.2
    assert rooms[1].min() > 18.0


def lived(home, settings=()):
    """What commands cost, or none, with the day after them, and the rooms, °C."""
    other, n, begin = copy.deepcopy(home), len(home.rows), home.now()
    for one in settings:
        other.told = one.value
        other.wait_until(begin + pd.Timedelta(seconds=one.end_s - settings[0].start_s))
    other.told = None
    other.wait_until(begin + pd.Timedelta("48h"))
    cost = sum(row["P"] * row["price"] for row in other.rows[n:]) / 12000.0
    return cost, np.array([[row[f"T_{name}"] for row in other.rows[n:]] for name in ROOMS])


def test_a_record_that_is_lived_again_answers_by_the_room_of_the_thermostat(home, measured, learned):
    house = IdentifiedHouse(curve_model(home), measured.record, measured.conditions, commands=learned)
    start_s = float(measured.record.time_s[48])
    for told in (19.0, 23.0):
        now = house.reset(start_s, 0.0)
        answer = house.advance(None, 3600.0, (told, told))
        by_living = float(learned["bedroom"].loop.level(told, now.T_zone_C[0], now.T_out_C, 0.0))
        assert answer.u[1] == pytest.approx(by_living, abs=1e-6)


def test_it_is_tried_near_the_bounds_of_its_own_room(home, measured, tmp_path, monkeypatch):
    """The bedroom's bounds, 18 to 20 °C, are not the thermostat's: from 21.5 °C on they allow nothing above 22 °C."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    rules = validate(MeasurementMap, HOUSE_RULES, "map.yaml")
    other = copy.deepcopy(home)
    other.wait_until(other.now() + pd.Timedelta("12h"))
    building = LiveBuilding(other, rules, 900.0)
    found = read_house(building, rules, other.now())
    (plan,) = planned_trials(building, found.points, found.bounds_C, {})
    assert not plan.refused
    assert plan.actuators == ROOMS
    outcome = tried(building, plan, read=lambda now: read_points(building.table(), rules, now), clock=other, sets="it")
    assert (outcome.status, outcome.doubts) == ("answered", ()), outcome.words
    assert [value for *_, value in other.written] == [plan.value, None]
    commands = {name: rules.command_of(name)[1] for name in ROOMS}
    assert command_remarks(measured.record, measured.layout, measured.commands, commands) == []
