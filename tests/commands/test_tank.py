"""Hot water of the rooms' own machine: what a record tells of a tank, and what it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from thermoforce_mpc.commands.tank import follow_tank
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.data.series import means_between
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.measurements.load import learned_tank, read_measurements
from thermoforce_mpc.plants.rooms import house_of_rooms, physics
from thermoforce_mpc.plants.rooms.device import TANK_J_K, TANK_LOSS, draw_device

_BEGIN_S, _DAYS = 10 * DAY_S, 14
TANK = {
    "temperature": "tank",
    "comfort": "6:00-9:00 42-58, else 38-58",
    "command": {"kind": "tank_target", "column": "target"},
}


def house(seed: int = 903):
    plant = house_of_rooms(f"house:2rooms:{seed}")
    plant.device = draw_device(plant.house)
    plant.reset(_BEGIN_S, DAY_S)
    plant.advance(None, _DAYS * DAY_S)
    return plant


def table(plant, minutes: float = 5.0) -> pd.DataFrame:
    """What a logger has: means of the power until its rows, readings at them, the tank to half a kelvin."""
    at_s = np.arange(_BEGIN_S, _BEGIN_S + _DAYS * DAY_S + 1.0, 60.0 * minutes)
    time_s, rows = plant.recorded(at_s[0], at_s[-1])
    sampled = {
        name: np.interp(at_s, time_s, rows[:, k]) for name, k in (("tank", physics.TANK), ("out", physics.OUTDOOR))
    }
    power = means_between(time_s, rows[1:, physics.POWER], at_s)
    valve = means_between(time_s, rows[1:, physics.ROOMS + 2], at_s)
    charged = np.interp(at_s, time_s[1:], (np.diff(rows[:, physics.TANK]) > 0.02).astype(float))
    return pd.DataFrame(
        {
            "time": pd.Timestamp("2027-01-01", tz="UTC") + pd.to_timedelta(at_s, unit="s"),
            "out": sampled["out"],
            "tank": np.round(2.0 * sampled["tank"]) / 2.0,
            "target": plant.device.tank_C,
            "power": np.append(power, power[-1]),
            "valve": np.append(valve, valve[-1]),
            "room": np.interp(at_s, time_s, rows[:, physics.ROOMS]),
            "charged": (charged > 0.5) * 1.0,
        }
    )


def a_map(**of_tank) -> dict:
    return {
        "time": {"zone": "UTC", "marks": "start"},
        "outdoor": "out",
        "zones": {"room": {"temperature": "room"}},
        "actuators": {"valve": {"level": "valve"}},
        "machines": {"heat_pump": {"power": "power"}},
        "hot_water": TANK | of_tank,
    }


@pytest.fixture(scope="module")
def lived():
    plant = house()
    return plant, table(plant)


@pytest.mark.parametrize("charging", [None, "charged"])
def test_a_record_tells_loss_draw_off_and_what_a_charge_takes(lived, charging):
    plant, rows = lived
    measured = read_measurements(rows, a_map(**({} if charging is None else {"charging": charging})), step_s=HOUR_S)
    tank = learned_tank(measured)
    J_K = plant.device.parameters[TANK_J_K]
    first, days = round(_BEGIN_S / 900.0), _DAYS
    drawn_K = plant.device.draw_W[first : first + 96 * days].sum() * 900.0 / J_K / days
    assert tank.draws_K.sum(axis=1).mean() == pytest.approx(drawn_K, rel=0.12)
    assert tank.loss_1_h == pytest.approx(plant.device.parameters[TANK_LOSS] * HOUR_S / J_K, rel=0.25)
    assert tank.band_K == pytest.approx(6.0, abs=0.6)
    assert tank.usual_C == pytest.approx(np.full(24, plant.device.tank_C))
    # What it took in all charges is what they would take by its law, with what was drawn and lost meanwhile.
    time_s, at = plant.recorded(_BEGIN_S, _BEGIN_S + days * DAY_S)
    dT = np.diff(at[:, physics.TANK])
    charged, T_C = dT > 0.02, at[1:, physics.TANK]
    drawn_W = plant.device.draw_W[(time_s[:-1] // 900.0).astype(int)]
    gross_K = dT + (drawn_W + plant.device.parameters[TANK_LOSS] * (T_C - 18.0)) * 30.0 / J_K
    took_Wh = at[1:, physics.POWER][charged].sum() * 30.0 / HOUR_S
    by_law = (tank.Wh_per_K(T_C, at[1:, physics.OUTDOOR]) * gross_K)[charged].sum()
    assert by_law == pytest.approx(took_Wh, rel=0.15)
    assert "charges in 14 days" in tank.in_words


@pytest.mark.parametrize("days", [4, 5])
def test_standing_loss_is_known_from_five_days_on_that_show_it(lived, days):
    """Elsewhere the sensor is read beside charges only: many hours of one day err together."""
    _, rows = lived
    near = rows.charged.rolling(13, center=True, min_periods=1).max() > 0.0
    whole = np.arange(len(rows)) < 288 * days
    tank = learned_tank(read_measurements(rows.assign(tank=rows.tank.where(near | whole)), a_map(), step_s=HOUR_S))
    if days < 5:
        assert (tank.loss_1_h, tank.loss_sd) == (0.0, 0.1)
    else:
        assert 0.0 < tank.loss_1_h < 0.05
        assert 0.0 < tank.loss_sd < 0.02


@pytest.mark.slow
def test_a_charge_takes_what_its_kelvins_take_at_the_temperatures_that_it_goes_through(lived):
    """Dearer the warmer the tank is and the colder it is outdoors."""
    tank = learned_tank(read_measurements(lived[1], a_map(), step_s=HOUR_S))
    still = replace(tank, loss_1_h=0.0)
    n, T_out_C = 6, np.array([-8.0, -8.0, 0.0, 0.0, 8.0, 8.0])
    course = follow_tank(
        still, 35.0, False, np.full((1, n), 55.0), np.ones((1, n), dtype=bool), np.zeros((1, n)), T_out_C, 900.0
    )
    before_C, T_C = np.append(35.0, course.T_C[0, 0, :-1]), course.T_C[0, 0]
    assert T_C[1] > T_C[0] > 36.0, "it is charged"
    expected_Wh = (T_C - before_C) * still.Wh_per_K(0.5 * (before_C + T_C), T_out_C)
    np.testing.assert_allclose(course.Wh[0, 0], expected_Wh, rtol=1e-6)
    # A law that says nothing at some temperature: a tenth of the usual.
    free = replace(still, energy=np.array([10.0, -100.0, 0.0]))
    course = follow_tank(
        free, 52.0, False, np.full((1, n), 55.0), np.ones((1, n), dtype=bool), np.zeros((1, n)), T_out_C, 900.0
    )
    assert course.Wh.sum() == pytest.approx(course.T_C[0, 0, -1] - 52.0)


def test_the_meter_of_the_rooms_is_without_the_tank(lived):
    _, rows = lived
    with_tank = read_measurements(rows, a_map(), step_s=HOUR_S)
    without = read_measurements(rows, {k: v for k, v in a_map().items() if k != "hot_water"}, step_s=HOUR_S)
    assert without.tank is None
    masked = np.isnan(with_tank.record.power_W[0]) & ~np.isnan(without.record.power_W[0])
    share = with_tank.tank.share_of(with_tank.record.time_s)
    np.testing.assert_array_equal(masked, share > 0.02)
    assert 0.03 < masked.mean() < 0.4
    assert learned_tank(without) is None


def _dead_meter(rows):
    return rows.assign(power=np.random.default_rng(0).normal(0.0, 300.0, len(rows)).clip(-1000, 1000))


def _nothing_charged(rows):
    return rows.assign(tank=45.0 + 0.5 * (np.arange(len(rows)) % 2))


@pytest.mark.parametrize(
    ("spoilt", "why"),
    [
        (lambda rows: rows.iloc[: 3 * 288], "3.0 days"),
        (lambda rows: rows.iloc[::12], "log the power more often"),
        (_nothing_charged, "0 charges"),
        (_dead_meter, "does not tell what a charge costs"),
        (lambda rows: rows.assign(power=rows.power.iloc[::12]), "read every 60 min"),
    ],
)
def test_what_a_record_does_not_tell_is_refused_with_the_reason(lived, spoilt, why):
    _, rows = lived
    with pytest.raises(DataError, match=why):
        learned_tank(read_measurements(spoilt(rows), a_map(), step_s=HOUR_S))


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"machine": "boiler"}, "there is no 'boiler'"),
        ({"temperature": "room"}, "column of a zone"),
        ({"comfort": "6:00-9:00 42-95, else 38-58"}, "20 to 80"),
        ({"command": {"kind": "boost", "column": "x"}}, "tank_target or tank_charge"),
        ({"command": {"kind": "tank_target", "column": "x", "minimum": 60, "maximum": 50}}, "below maximum"),
    ],
)
def test_a_wrong_map_is_refused_by_its_key(lived, wrong, why):
    with pytest.raises(ConfigError, match=why):
        read_measurements(lived[1], a_map(**wrong))
    if "machine" in wrong:
        twice = a_map() | {"machines": {"heat_pump": {"power": "power", "hot_water": "charged"}}}
        with pytest.raises(ConfigError, match=r"hot_water\.charging is the place of machines\.heat_pump\.hot_water"):
            read_measurements(lived[1], twice)
