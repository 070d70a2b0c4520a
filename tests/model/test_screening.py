"""Readings that cannot be are not believed; unusual ones are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from simple_house import simple_model

import thermoforce_mpc as tf
from thermoforce_mpc.data import HOUR_S, Measurement, Record
from thermoforce_mpc.data.limits import RULES, jumps
from thermoforce_mpc.model.machine.load import MachineLoad
from thermoforce_mpc.model.operator.heat_input import HeatInput
from thermoforce_mpc.model.screening import ReadingLimits, limits_of, screened, screened_history
from thermoforce_mpc.model.thermal_model import ThermalModel

NAN = float("nan")
NOW_S = 30 * HOUR_S
GOOD = Measurement(NOW_S + 900.0, 21.0, 5.0, 100.0, 0.5, 1000.0, 2500.0, 30.0)
HOUSE = ReadingLimits.of(None, floor_area_m2=100.0)


def past(T_zone_C=21.0, n: int = 30) -> Record:
    at = np.ones(n + 1)
    return Record(HOUR_S * np.arange(n + 1), at * T_zone_C, 5 * at, 0 * at, *(0 * at[1:],) * 3)


@pytest.mark.parametrize(
    "reading",
    [
        {},
        {"T_zone_C": 9.3},  # the air of `bestest_air` under its fan coil, 11.7 K in 15 min
        {"T_out_C": -45.0},
        {"T_out_C": 48.0},
        {"solar_W_m2": -8.0},  # a pyranometer at night
        {"solar_W_m2": 1390.0},
        {"u": 1.0 + 1e-9},
        {"power_W": -20.0},
        {"heat_W": -40e3},
        {"heat_W": NAN, "power_W": NAN, "T_return_C": NAN, "u": NAN},  # not metered here
    ],
)
def test_what_can_be_stays_as_it_is_without_a_word(reading):
    measurement = replace(GOOD, **reading)
    found, notes = screened(measurement, HOUSE, past())
    np.testing.assert_equal(vars(found), vars(measurement))
    assert notes == ()


@pytest.mark.parametrize(
    ("signal", "value", "why"),
    [
        ("T_zone_C", 294.15, "T_zone_C of 294.15 °C is not a number between -30 and 60 °C"),
        ("T_zone_C", 38.0, "T_zone_C of 38 °C is more than 16.2 K from 21.00 °C 900 s before"),
        ("T_out_C", -273.15, "T_out_C of -273.15 °C is not a number between -60 and 60 °C"),
        ("solar_W_m2", 9999.0, "solar_W_m2 of 9999 W/m² is not a number between -30 and 1500 W/m²"),
        ("u", 1.02, "u of 1.02 is not a number between"),
        ("u", -1.0, "u of -1 is not a number between"),
        ("power_W", 1e9, "power_W of 1e+09 W is not a number between -5e+04 and 5e+04 W"),
        ("heat_W", np.inf, "heat_W of inf W is not"),
        ("T_return_C", 1e3, "T_return_C of 1000 °C is not"),
    ],
)
def test_what_cannot_be_is_not_measured_and_said(signal, value, why):
    found, (note,) = screened(replace(GOOD, **{signal: value}), HOUSE, past())
    assert np.isnan(getattr(found, signal))
    assert note.startswith(why)
    assert note.endswith(": taken as not measured")
    np.testing.assert_equal({**vars(found), signal: 0.0}, {**vars(GOOD), signal: 0.0})


@pytest.mark.parametrize("signal", ["T_zone_C", "T_out_C", "solar_W_m2"])
def test_a_silent_sensor_that_every_plant_has_is_said(signal):
    _, notes = screened(replace(GOOD, **{signal: NAN}), HOUSE, past())
    assert notes == (f"{signal} was not measured",)


def test_a_sensor_that_was_moved_is_believed_again_after_some_hours():
    history, hours = past(), 0
    while True:
        hours += 1
        moved, notes = screened(replace(GOOD, time_s=NOW_S + hours * HOUR_S, T_zone_C=43.0), HOUSE, history)
        if not notes:
            break
        history = history.extended(moved)
    assert hours == 2


def test_limits_of_a_model_are_multiples_of_what_its_machine_can_do():
    model = simple_model()
    power_W = float(model.only.power(np.array(1.0), 0.0))
    assert ReadingLimits.of(model).heat_W == (-np.inf, np.inf)  # its operator is driven by u: nothing is known of heat
    assert ReadingLimits.of(model, 100.0).heat_W == (-50e3, 50e3)
    np.testing.assert_allclose(ReadingLimits.of(model, 100.0).power_W, [-0.05 * power_W, 3 * power_W])
    for sign, expected in ((1, (-12e3, 36e3)), (-1, (-36e3, 12e3))):
        heat = HeatInput(MachineLoad((2e3, 0.0, 8e3, 200.0), (-10.0, 10.0)))
        one = model.only.operator
        operator = replace(one, heat_input=heat, gains=sign * one.gains, sign=sign)
        np.testing.assert_allclose(ReadingLimits.of(ThermalModel.single(operator, model.only.power)).heat_W, expected)


def test_limits_come_from_the_model_that_a_controller_plans_with():
    class Planner:
        model = simple_model()

    assert limits_of(Planner(), 100.0) == ReadingLimits.of(simple_model(), 100.0)
    assert limits_of(object(), 100.0) == HOUSE
    assert limits_of(object()).power_W == (-np.inf, np.inf)


def test_a_record_is_screened_like_its_readings_one_by_one():
    rng = np.random.default_rng(3)
    history = past(21.0 + np.cumsum(rng.normal(0, 0.3, 31)))
    T, heat = np.array(history.T_zone_C[0]), np.array(history.heat_W[0])
    T[4], T[12:14], T[20], heat[7] = 99.0, -7.0, NAN, 1e7
    record = replace(history, T_zone_C=T, heat_W=heat)
    found, notes = screened_history(record, HOUSE)
    assert np.flatnonzero(np.isnan(found.T_zone_C[0])).tolist() == [4, 12, 13, 20]
    assert np.flatnonzero(np.isnan(found.heat_W[0])).tolist() == [7]
    assert [note.split(" at ")[0] for note in notes] == ["T_zone_C", "heat_W"]
    assert "heat_W at 1 of 30 places" in notes[1]
    assert "first 1e+07 W at 25200 s" in notes[1]
    grown = record.slice(0, 0)
    for t in range(30):
        values = {name: getattr(record, name)[..., t + 1] for name in ("time_s", "T_zone_C", "T_out_C", "solar_W_m2")}
        values |= {name: getattr(record, name)[:, t] for name in ("u", "power_W", "heat_W", "T_return_C")}
        grown = grown.extended(screened(Measurement(**values), HOUSE, grown)[0])
    np.testing.assert_equal(vars(grown), vars(found))
    assert screened_history(history, HOUSE) == (history, ())


def test_power_that_is_only_a_curve_is_believed():
    model = simple_model()
    load = MachineLoad((0.0, 0.0, 1e-3, 0.0), (-10.0, 20.0), curve_W=1200.0)
    curved = replace(model, power=tuple(replace(power, load=load) for power in model.power))
    low, high = ReadingLimits.of(curved).range("power_W")
    assert low < 0.0
    assert high > 1200.0


def faulty(signal: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Hourly readings (n,) with an excursion, a leap and a frozen stretch; which are wrong, and by what rule."""
    n = 30 * 24
    rng = np.random.default_rng(5)
    day = 2 * np.pi * np.arange(n) / 24
    usual = {
        "T_zone_C": 21 + 0.5 * np.sin(day), "T_out_C": 4 + 3 * np.sin(day),
        "solar_W_m2": 400 * np.clip(np.sin(day), 0, None),
    }[signal]  # fmt: skip
    values, wrong = usual + rng.normal(0.0, 0.05, n), np.zeros(n, dtype=bool)
    rules = []
    if signal != "solar_W_m2":
        values[100:103] += 12.0  # out and back within three hours
        wrong[100:103] = True
        rules.append("jump")
    still = slice(300, 360) if signal != "solar_W_m2" else slice(341, 350)  # from noon on
    values[still], wrong[still] = values[still.start], True
    rules.append("frozen")
    return values, wrong, rules


@pytest.mark.parametrize("signal", ["T_zone_C", "T_out_C", "solar_W_m2"])
def test_tables_and_running_controllers_refuse_the_same_readings(signal):
    values, wrong, by_rule = faulty(signal)
    n = values.size
    time_s = HOUR_S * np.arange(n)
    as_before = {name: faulty(name)[0] for name in ("T_zone_C", "T_out_C", "solar_W_m2")}
    for name, series in as_before.items():
        if name != signal:
            series[:] = np.where(faulty(name)[1], NAN, series)
    nothing = np.full(n - 1, NAN)
    found, notes = screened_history(
        Record(time_s=time_s, u=nothing, power_W=nothing, heat_W=nothing, **as_before), HOUSE
    )
    np.testing.assert_array_equal(np.isnan(np.atleast_2d(getattr(found, signal))[0]), wrong)
    assert [" does not move " in note for note in notes if note.startswith(signal)] == [r == "frozen" for r in by_rule]

    table = pd.DataFrame(
        {"T": as_before["T_zone_C"], "out": as_before["T_out_C"], "sun": as_before["solar_W_m2"]},
        index=pd.date_range("2025-01-01", periods=n, freq="1h", tz="UTC"),
    )
    read = tf.read_measurements(table, {"outdoor": "out", "sun": "sun", "zones": {"room": {"temperature": "T"}}})
    key = {"T_zone_C": "zones.room.temperature", "T_out_C": "outdoor", "solar_W_m2": "sun"}[signal]
    flags = next(one.flags for one in read.understood.signals if one.key == key)
    assert [flag.rule for flag in flags] == by_rule
    assert sum(flag.count for flag in flags) == wrong.sum()


def test_air_that_is_heated_and_cooled_at_full_power_does_not_jump():
    """As in BOPTEST's bestest_air under probing: 9 K within a step, and back, many times."""
    time_s = 900.0 * np.arange(960)
    T = 20.0 + 9.0 * (np.arange(960) // 4 % 5 == 0) + np.random.default_rng(1).normal(0.0, 0.1, 960)
    assert not jumps(time_s, T, RULES["T_zone_C"]).any()
    calm = 20.0 + np.random.default_rng(1).normal(0.0, 0.1, 960)
    calm[400:404] += 9.0
    assert np.flatnonzero(jumps(time_s, calm, RULES["T_zone_C"])).tolist() == [400, 401, 402, 403]


def test_what_follows_something_that_moves_is_frozen_sooner():
    rule = RULES["T_out_C"]
    assert rule.is_frozen(3.0, moved=2.5)
    assert not rule.is_frozen(2.9, moved=2.5)
    assert not rule.is_frozen(30.0, moved=1.0), "its forecast says that nothing happened"
    assert rule.is_frozen(30.0), "nothing is known of what it follows"
    assert not rule.is_frozen(20.0)
