"""A kind of command that the package does not know: a class, and all the rest goes by it."""

from __future__ import annotations

import copy
from typing import ClassVar, Literal

import numpy as np
import pytest
from home_by_curve import ROOMS, RULES, HomeByCurve, curve_model

from controllers.mpc.config import MPCConfig
from controllers.mpc.controller import ThermoForceMPC
from thermoforce_mpc.commands.command import Command
from thermoforce_mpc.commands.kinds import KINDS, told_apart
from thermoforce_mpc.commands.loop import command_rows
from thermoforce_mpc.data import Observation
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.live import LiveBuilding
from thermoforce_mpc.live.commissioning import read_house
from thermoforce_mpc.live.trial import planned_trials, tried
from thermoforce_mpc.measurements.forecast import read_forecast
from thermoforce_mpc.measurements.load import learned_commands, read_measurements
from thermoforce_mpc.measurements.map.mapping import MappedMachine, MeasurementMap
from thermoforce_mpc.measurements.points import read_points
from thermoforce_mpc.scenario.settings import validate

WORDS = {-3.0: "economy", 0.0: "normal", 3.0: "boost"}


class Programme(Command):
    """The programme of a heat pump, of which each has an offset of the curve."""

    name_in_words: ClassVar[str] = "the programme"

    kind: Literal["programme"]

    def values(self, low, high):
        return np.array([one for one in WORDS if low <= one <= high])

    def allows(self, value):
        return value in WORDS

    def tried(self, before, T_zone_C, bounds_C):
        return 0.0 if before == 3.0 else 3.0

    def limits(self, lower_C, upper_C, usual):
        return np.full(lower_C.shape, -3.0), np.full(upper_C.shape, 3.0)

    def in_words(self, value):
        return f"programme {WORDS.get(round(value), 'unknown')}"


class Machine(MappedMachine):
    command: told_apart((*KINDS, Programme)) | None = None


class Map(MeasurementMap):
    machines: dict[str, Machine]


PROGRAMME = {"kind": "programme", "column": "offset", "usual": 0}
OF_PROGRAMME = RULES | {"machines": {"heat_pump": RULES["machines"]["heat_pump"] | {"command": PROGRAMME}}}


@pytest.fixture(scope="module")
def home():
    return HomeByCurve(days=7)


def test_a_new_kind_is_read_learned_planned_and_told(home):
    rules = validate(Map, OF_PROGRAMME, "map.yaml")
    measured = read_measurements(home.measurements(), rules, step_s=3600.0).served()
    commands = learned_commands(measured)
    for one in commands.values():
        assert one.loop.level(3.0, 20.0, 3.0, 0.3) - one.loop.level(-3.0, 20.0, 3.0, 0.3) > 0.05
    options = {"step_s": 3600.0, "horizon_h": 12.0, "free_response": {"name": "persistence"}}
    options |= {"gate": {"enabled": False}, "watch": {"enabled": False}}
    mpc = ThermoForceMPC(curve_model(home), MPCConfig.model_validate(options), commands=commands)
    plan = mpc.plan(Observation(measured.record, read_forecast(home.forecast(), measured)))
    rows = command_rows(plan, commands)
    assert {row["actuator"] for row in rows} == {"heat_pump"}
    assert {row["text"] for row in rows} <= {f"programme {word}" for word in WORDS.values()}
    assert any(row["value"] != 0.0 for row in rows)


def test_a_new_kind_is_tried_and_put_back(home, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    rules = validate(Map, OF_PROGRAMME, "map.yaml")
    home = copy.deepcopy(home)
    building = LiveBuilding(home, rules, 900.0)
    found = read_house(building, rules, home.now())
    (plan,) = planned_trials(building, found.points, found.bounds_C, {})
    outcome = tried(building, plan, read=lambda now: read_points(building.table(), rules, now), clock=home, sets="home")
    assert (outcome.status, outcome.doubts) == ("answered", ()), outcome.words
    assert plan.actuators == ROOMS
    assert outcome.words.startswith("the programme ")
    assert [value for *_, value in home.written] == [plan.value, None]


def test_an_unknown_kind_is_refused_with_those_that_are_known():
    with pytest.raises(ConfigError, match="expected setpoint, curve_offset, flow_temperature, sg_ready or enable"):
        validate(MeasurementMap, OF_PROGRAMME, "map.yaml")
