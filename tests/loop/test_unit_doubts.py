"""A plant that answers in another unit than is expected: it is said at once, with the unit and what to do."""

from __future__ import annotations

import logging
import re
from dataclasses import replace

import numpy as np
import pytest
from simple_house import OutdoorResponse, SimpleHouse, simple_model
from simulated_building import RULES, SimulatedBuilding, mpc

from controllers import ThermoForceMPC
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import DAY_S, ZERO_C_K, Layout, Names, Period, Record
from thermoforce_mpc.data.prices import price_doubt
from thermoforce_mpc.live import LiveBuilding, control
from thermoforce_mpc.loop.closed_loop import run_closed_loop
from thermoforce_mpc.loop.inputs import UnitDoubts
from thermoforce_mpc.measurements.map.mapping import MeasurementMap

# Day 10 to 12 with three days before it.
PERIOD = Period("test", 10 * DAY_S, 2 * DAY_S, 3 * DAY_S)
LAYOUT = Layout.single("heating", floor_area_m2=100.0)

# How notes begin that are about units.
DOUBTS = ("unit of", "prices of", "zones.")


class WrongHouse(SimpleHouse):
    """The simple house with signals times a factor, plus an offset, from a day on."""

    def __init__(self, factor=1.0, offset=0.0, from_day=0.0, signals=()):
        super().__init__()
        self.change = factor, offset, from_day * DAY_S, signals

    def wrong(self, answer):
        factor, offset, from_s, signals = self.change
        if answer.time_s.flat[0] < from_s if hasattr(answer.time_s, "flat") else answer.time_s < from_s:
            return answer
        return replace(
            answer, **{name: getattr(answer, name) * factor + offset for name in signals if hasattr(answer, name)}
        )

    def advance(self, u, duration_s):
        return self.wrong(super().advance(u, duration_s))

    def past(self, step_s):
        return self.wrong(super().past(step_s))

    def forecast(self, horizon_s, interval_s):
        return self.wrong(super().forecast(horizon_s, interval_s))


def noted(model, currency="EUR", **changes) -> dict[int, str]:
    """What is said of a run of that house about units, by the number of the step."""
    options = {"step_s": 3600.0, "horizon_h": 12.0, "gate": {"enabled": False}}
    controller = ThermoForceMPC(model, MPCConfig.model_validate(options), free_response=OutdoorResponse())
    result = run_closed_loop(WrongHouse(**changes), controller, PERIOD, units=UnitDoubts(LAYOUT, model, currency))
    notes = {step.index: [note for note in step.notes if note.startswith(DOUBTS)] for step in result.steps}
    return {index: "; ".join(found) for index, found in notes.items() if found}


PRICES = ("price_per_kWh", "heating_price_per_kWh")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("says", "changes"),
    [
        (r"73 readings of 21\.\d+: °C where the protocol says K\?", {"offset": -ZERO_C_K, "signals": ["T_zone_C"]}),
        (
            r"T_out_C: 73 readings of \d.*: °C where the protocol says K\?",
            {"offset": -ZERO_C_K, "signals": ["T_out_C"]},
        ),
        (r"K where °C is expected\?", {"offset": ZERO_C_K, "signals": ["T_zone_C"]}),
        ("prices of 25 per kWh", {"factor": 100.0, "signals": PRICES}),
        ("prices of 0.0025 per kWh", {"factor": 0.01, "signals": PRICES}),
        (r"power_W: never above \d.* W; kW is likelier", {"factor": 1e-3, "signals": ["power_W"]}),
        (r"heat_W: never above \d.* W; kW is likelier", {"factor": 1e-3, "signals": ["heat_W"]}),
    ],
)
def test_a_wrong_unit_from_the_start_is_said_in_the_first_step(says, changes, caplog):
    found = noted(simple_model(), **changes)
    assert list(found) == [0], found
    assert re.search(says, found[0])
    assert any(record.levelno == logging.WARNING and re.search(says, record.getMessage()) for record in caplog.records)


@pytest.mark.slow
def test_prices_in_another_currency_are_not_judged():
    """30 yen per kWh are usual. The controller compares them with its weight of comfort, see `test_comfort_weight`."""
    assert noted(simple_model(), currency="JPY", factor=120.0, signals=PRICES) == {}
    assert "where 0.01 to 2 EUR are usual" in noted(simple_model(), factor=120.0, signals=PRICES)[0]


def test_gas_may_be_a_tenth_as_dear_as_electricity_at_least():
    """That of BOPTEST's `bestest_air` costs 0.0029 USD per kWh."""
    assert noted(simple_model(), factor=0.02, signals=["heating_price_per_kWh"]) == {}
    assert "too low by a factor" in noted(simple_model(), factor=0.002, signals=["heating_price_per_kWh"])[0]
    assert "too low by a factor" in noted(simple_model(), factor=0.02, signals=PRICES)[0]


def test_a_night_of_an_exchange_may_cost_next_to_nothing():
    """The dearest hour says whether prices are in their unit, not the mean of some hours."""
    cheap = np.array([0.001] * 20 + [0.03])
    assert price_doubt(cheap) == ""
    assert "too low by a factor" in price_doubt(cheap / 10.0)
    assert "are they per MWh, or in cents" in price_doubt(cheap * 1000.0)


def test_a_meter_that_changes_its_unit_is_said_within_a_day():
    found = noted(simple_model(), factor=1e-3, signals=["power_W"], from_day=10.1)
    assert list(found) == [24], found
    assert "of what the model expects at these levels; kW is likelier than W" in found[24]


@pytest.mark.slow
def test_nothing_is_said_of_right_units():
    assert noted(simple_model()) == {}


def told_by(house, rules=RULES):
    told = []
    building = LiveBuilding(house, MeasurementMap.model_validate(rules), 3600.0)
    control(building, mpc(), clock=house, steps=2, told=told.append)
    return [[note for note in decision.notes if note.startswith(DOUBTS)] for decision in told]


class WrongBuilding(SimulatedBuilding):
    """The simulated building with a column times a factor, plus an offset."""

    def __init__(self, column, factor, offset=0.0):
        self.change = column, factor, offset
        super().__init__()

    def measurements(self):
        (column, factor, offset), table = self.change, super().measurements()
        table[column] = table[column] * factor + offset
        return table


def test_in_live_operation_too():
    assert told_by(SimulatedBuilding()) == [[], []]
    first, second = told_by(WrongBuilding("P", 1e-3))
    assert "kW is likelier than W" in first[0]
    assert not second, "said once"
    dear = {**RULES, "machines": {"machine": {"power": "P", "price": 25.0}}}
    assert "per MWh, or in cents, or in another currency?" in told_by(SimulatedBuilding(), dear)[0][0]
    (in_kelvin, *_), _ = told_by(WrongBuilding("T", 1.0, ZERO_C_K))
    assert "in K they were usual: set unit: 'K'" in in_kelvin, "and the building is left to its own control"


def test_rooms_that_a_map_exchanged_are_said_at_the_begin():
    """Also where the model is of another map, and nobody checks the one that was edited."""
    rng, n = np.random.default_rng(3), 3 * 96
    u = rng.integers(0, 2, (2, n // 4)).repeat(4, axis=1).astype(float)
    T = np.full((2, n + 1), 20.0)
    for k in range(n):
        T[:, k + 1] = 20.0 + 0.97 * (T[:, k] - 20.0) + 0.3 * (u[:, k] - 0.5)
    names = Names(("living", "bath"), ("living", "bath"))
    layout = Layout(names, (1, 1), (0, 1), (0, 0), (0.0, 0.0), (0.5, 0.5), (20.0, 10.0))
    unknown = np.full((1, n), np.nan)
    record = Record(
        900.0 * np.arange(n + 1), T, 0.0 * T[0], 0.0 * T[0], u, unknown, np.full((2, n), np.nan), names=names
    )
    assert UnitDoubts(layout).now(record) == ()
    (said,) = UnitDoubts(layout).now(replace(record, T_zone_C=T[::-1]))
    assert said.startswith("rooms swapped: living and bath: each is warmed by the level of the other")
