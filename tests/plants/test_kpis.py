"""KPIs on cases one can work out by hand, and on a record of the real test case."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from one_zone_kpis import compute_kpis

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.plants.embedded.cases import HEAT_PUMP
from thermoforce_mpc.plants.kpis import (
    EnergySupply,
    Violation,
    building_kpis,
    peak_power,
    window_means,
    zone_kpis,
)

TIME = np.arange(0, 7200 + 1, 30.0)


def kpis(**changes):
    n = TIME.size
    series = {
        "power_W": np.full(n, 2000.0),
        "T_operative_C": np.full(n, 22.0),
        "lower_C": np.full(n, 21.0),
        "upper_C": np.full(n, 24.0),
        "co2_ppm": np.full(n, 600.0),
        "price_per_kWh": np.full(n, 0.25),
        "emission_kg_per_kWh": np.full(n, 0.167),
    }
    return compute_kpis(TIME, co2_limit_ppm=894.0, area_m2=100.0, **(series | changes))


def test_constant_power_for_two_hours():
    found = kpis()
    assert found["ener_tot"] == pytest.approx(4.0 / 100)
    assert found["cost_tot"] == pytest.approx(1.0 / 100)
    assert found["emis_tot"] == pytest.approx(4 * 0.167 / 100)
    assert found["pele_tot"] == pytest.approx(2.0 / 100)
    assert found["tdis_tot"] == found["idis_tot"] == 0.0


def test_discomfort_counts_both_sides_and_nothing_inside():
    T = np.where(TIME < 3600, 20.5, 25.0)
    # Half a kelvin too cold for an hour, one too warm for an hour; the jump is half a sample of each.
    assert kpis(T_operative_C=T)["tdis_tot"] == pytest.approx(1.5, abs=0.01)


def test_a_ramp_is_integrated_by_the_trapezoid():
    T = 21.0 - TIME / 7200  # down to 20 °C: the mean violation is half a kelvin
    assert kpis(T_operative_C=T)["tdis_tot"] == pytest.approx(1.0, rel=1e-9)


def test_air_quality_counts_above_the_limit_only():
    assert kpis(co2_ppm=np.full(TIME.size, 994.0))["idis_tot"] == pytest.approx(200.0)


def test_the_peak_is_a_quarter_hour_mean():
    power = np.where((TIME >= 900) & (TIME < 1350), 4000.0, 0.0)  # half of the second quarter
    assert peak_power(TIME, power) == pytest.approx(2000.0)


def test_the_last_window_counts_for_the_peak_as_at_the_service_however_short():
    power = np.where(TIME[-1] <= TIME, 3000.0, np.where(TIME < 900, 1000.0, 0.0))
    assert peak_power(TIME, power) == pytest.approx(3000.0), "the last sample begins a window"
    assert peak_power(TIME, power, open_end=False) == pytest.approx(1000.0)
    assert peak_power(TIME[:5], power[-5:]) == pytest.approx(600.0), "samples of one window"


def test_prices_are_weighted_by_power():
    price = np.where(TIME < 3600, 0.1, 0.3)
    power = np.where(TIME < 3600, 0.0, 1000.0)
    found = kpis(price_per_kWh=price, power_W=power)
    assert found["cost_tot"] / found["ener_tot"] == pytest.approx(0.3, rel=0.01)


def test_power_of_steps_counts_with_the_price_at_their_begin_and_in_their_own_quarter():
    """15 min on before the price jumps, in steps of 5 min; the step that ends at the first sample does not count."""
    time_s = np.arange(0, 7200 + 1, 300.0)
    price = np.where(time_s < 3600, 0.1, 0.3)
    power = np.where((time_s > 2700) & (time_s <= 3600) | (time_s == 0), 4000.0, 0.0)
    supply = EnergySupply("ElectricPower", power, price, np.ones(time_s.size), of_steps=True)
    found = building_kpis(time_s, supplies=[supply], thermal=[], air_quality=[], area_m2=100.0)
    assert found["ener_tot"] == pytest.approx(1.0 / 100)
    assert found["cost_tot"] == pytest.approx(0.1 / 100)
    assert found["emis_tot"] == pytest.approx(1.0 / 100)
    assert found["pele_tot"] == pytest.approx(4.0 / 100)
    assert peak_power(time_s[:2], power[9:11], of_steps=True) == pytest.approx(4000.0)


@pytest.mark.parametrize(
    ("time_s", "power"),
    [(TIME, TIME[:-1]), (TIME[::-1], TIME), (TIME[:1], TIME[:1])],
    ids=["length", "order", "single"],
)
def test_series_that_do_not_fit_are_refused(time_s, power):
    ones = np.ones_like(time_s)
    with pytest.raises(DataError):
        compute_kpis(
            time_s, power_W=power, T_operative_C=ones, lower_C=ones, upper_C=ones, co2_ppm=ones, co2_limit_ppm=1.0,
            price_per_kWh=ones, emission_kg_per_kWh=ones, area_m2=1.0,
        )  # fmt: skip


@pytest.mark.parametrize(
    ("first_day", "ener", "cost_constant", "cost_dynamic", "pele", "tdis"),
    [(16, 3.478024, 0.881679, 0.882847, 0.0189128, 8.38137), (21, 3.578110, 0.907051, 0.909285, 0.0189141, 8.61647)],
)
def test_a_recorded_trajectory_has_the_kpis_published_for_it(
    shared, first_day, ener, cost_constant, cost_dynamic, pele, tdis
):
    real = pd.read_csv(shared / "boptest_hp" / "native_d7_28d.csv.gz")
    time_s = np.arange(first_day * DAY_S, (first_day + 14) * DAY_S + 1, 30.0)
    # Recorded at 15 min: temperatures at the end of each step, powers as means over it.
    step_end = np.searchsorted(real.time, time_s)
    power = (real.reaPHeaPum_y + real.reaPFan_y + real.reaPPumEmi_y).to_numpy()[step_end]
    T = np.interp(time_s, real.time, real.reaTZon_y)
    lower, upper = HEAT_PUMP.schedule.bounds_C(time_s)
    for tariff, cost in ((tariffs.constant, cost_constant), (tariffs.dynamic, cost_dynamic)):
        found = compute_kpis(
            time_s, power_W=power, T_operative_C=T, lower_C=lower, upper_C=upper,
            co2_ppm=np.interp(time_s, real.time, real.reaCO2RooAir_y), co2_limit_ppm=894.0,
            price_per_kWh=tariff(time_s), emission_kg_per_kWh=np.full(time_s.shape, 0.167), area_m2=192.0,
        )  # fmt: skip
        assert found["ener_tot"] == pytest.approx(ener, rel=1e-3)
        assert found["emis_tot"] == pytest.approx(0.167 * ener, rel=1e-3)
        assert found["cost_tot"] == pytest.approx(cost, rel=1e-3)
        assert found["pele_tot"] == pytest.approx(pele, rel=2e-3)
        assert found["tdis_tot"] == pytest.approx(tdis, rel=1e-2)
        assert found["idis_tot"] == 0.0


def test_comfort_bounds_are_held_until_the_next_quarter_of_an_hour(shared):
    """A thermostat that sets back at 06:30 had 0.24 K·h on the real plant, most of it from 07:00 to 07:15."""
    record = pd.read_csv(shared / "boptest_hp" / "thermostat_setback_peak.csv.gz")
    time_s = np.arange(record.time.iloc[0], record.time.iloc[-1] + 1.0, 30.0)
    T = np.interp(time_s, record.time, record.Top_C)
    discomfort = np.trapezoid(excess(T, *HEAT_PUMP.schedule.bounds_C(time_s)), time_s / 3600.0)
    assert discomfort == pytest.approx(0.24, abs=0.01)


def test_carriers_add_up_and_zones_are_averaged():
    """One hour: 2 kW of electricity and 6 kW of gas over 100 m2; zones 1 K and 3 K too cold, one of them stuffy."""
    time_s = np.arange(0.0, 3601.0, 30.0)
    flat = np.ones(time_s.shape)
    kpis = building_kpis(
        time_s,
        supplies=[
            EnergySupply("ElectricPower", 2000 * flat, 0.3 * flat, 0.2 * flat),
            EnergySupply("GasPower", 6000 * flat, 0.05 * flat, 0.1 * flat),
            EnergySupply("BiomassPower", 0 * flat, flat, flat),
        ],
        thermal=[
            Violation("a", excess(19 * flat, 20 * flat, 24 * flat)),
            Violation("b", excess(27 * flat, flat, 24 * flat)),
        ],
        air_quality=[Violation("a", 50 * flat)],
        area_m2=100.0,
    )
    assert kpis == pytest.approx(
        {
            "ener_tot": 0.08,
            "cost_tot": 0.02 * 0.3 + 0.06 * 0.05,
            "emis_tot": 0.02 * 0.2 + 0.06 * 0.1,
            "tdis_tot": 2.0,
            "tdis_tot[a]": 1.0,
            "tdis_tot[b]": 3.0,
            "idis_tot": 50.0,
            "pele_tot": 0.02,
            "pgas_tot": 0.06,
        }
    )
    assert zone_kpis(kpis) == pytest.approx({"a": 1.0, "b": 3.0})
    assert zone_kpis({"tdis_tot": 2.0}) == {}


def test_a_hole_in_a_series_is_no_kpi():
    time_s = np.array([0.0, 30.0, 60.0])
    power = np.array([1.0, np.nan, 1.0])
    with pytest.raises(DataError, match="power_W of GasPower is not a finite number at 30 s"):
        building_kpis(
            time_s,
            supplies=[EnergySupply("GasPower", power, np.ones(3), np.ones(3))],
            thermal=[],
            air_quality=[],
            area_m2=1.0,
        )


def test_means_are_over_whole_windows_whatever_the_instants():
    time_s = np.array([0.0, 300.0, 1200.0, 1800.0, 2000.0])
    np.testing.assert_allclose(window_means(time_s, np.array([3.0, 6.0, 0.0, 9.0]), 900.0), [5.0, 2.0])
