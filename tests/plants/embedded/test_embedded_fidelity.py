"""The emulator against trajectories of the real test case (needs the reference data)."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from thermoforce_mpc.boundary.periods import heating_windows
from thermoforce_mpc.boundary.weather import load_weather
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.plants.embedded import EmbeddedPlant


@pytest.fixture(scope="module")
def plant(shared):
    return EmbeddedPlant(load_weather(shared / "boptest_hp" / "Brussels.mos"))


def replay(plant, trajectory: pd.DataFrame, warmup_days: float) -> tuple[np.ndarray, np.ndarray]:
    start = float(trajectory.time.iloc[0]) - 900
    plant.reset(start, min(warmup_days * DAY_S, start))
    out = [plant.advance(float(u), 900) for u in trajectory.oveHeaPumY_u]
    return np.array([m.T_zone_C[0] for m in out]), np.array([m.power_W[0] for m in out])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "warmup_days", "rmse_K"),
    [("excite_jan", 5, 0.02), ("excite_mar", 5, 0.02), ("excite_apr", 5, 0.02), ("off_d20_6d", 7, 0.01)],
)
def test_open_loop_replay(plant, shared, name, warmup_days, rmse_K):
    real = pd.read_csv(shared / "boptest_hp" / f"{name}.csv.gz")
    T, power = replay(plant, real, warmup_days)
    assert np.sqrt(np.mean((T - real.reaTZon_y) ** 2)) < rmse_K
    electric = real.reaPHeaPum_y + real.reaPFan_y + real.reaPPumEmi_y
    if electric.sum():
        assert power.sum() == pytest.approx(electric.sum(), rel=0.001)


@pytest.mark.slow
def test_water_temperatures_are_what_the_real_sensors_show(plant, shared):
    real = pd.read_csv(shared / "boptest_hp" / "excite_jan.csv.gz")
    start = float(real.time.iloc[0]) - 900
    plant.reset(start, 5 * DAY_S)
    points = [plant.advance(float(u), 900).points for u in real.oveHeaPumY_u]
    for name in ("reaTSup_y", "reaTRet_y"):
        ours = np.array([point[name] for point in points]) - 273.15
        assert np.sqrt(np.mean((ours - real[name]) ** 2)) < 0.05, f"{name}, running or not"


def test_native_control_switches_at_the_sample_at_which_the_real_one_does(plant, shared):
    """In the quarters that end at 07:00 and 20:00 of working days the last of 30 samples has the new set-point."""
    real = pd.read_csv(shared / "boptest_hp" / "native_d7_28d.csv.gz")
    plant.reset(7 * DAY_S, 7 * DAY_S)
    plant.advance(None, 28 * DAY_S)
    record = plant.recorded(7 * DAY_S + 30, 1e9)
    ours = pd.DataFrame({name: record[name].reshape(-1, 30).mean(axis=1) for name in ("P_fan", "level")})
    hour = real.time % DAY_S / 3600
    edge = hour.isin([7.0, 20.0]) & ~(real.time // DAY_S % 7).isin([4, 5])
    assert edge.sum() == 40
    np.testing.assert_allclose(ours.level[edge], real.oveHeaPumY_u[edge], atol=0.005)
    samples = (ours.P_fan - real.reaPFan_y)[edge] / 510.204 * 30
    assert samples.abs().max() < 0.5, "as many of the thirty samples are on"


def test_the_air_holds_as_much_CO2_as_the_real_sensor_shows(plant, shared):
    real = pd.read_csv(shared / "boptest_hp" / "native_d7_28d.csv.gz")
    plant.reset(7 * DAY_S, 7 * DAY_S)
    plant.advance(None, 28 * DAY_S)
    record = plant.recorded(7 * DAY_S, 1e9)
    ours = np.interp(real.time, record["time"], record["CO2"])
    np.testing.assert_allclose(ours, real.reaCO2RooAir_y, rtol=1e-5)


def test_native_control_on_the_peak_window(plant):
    period = plant.period("peak_heat_day")
    assert period.start_s == 16 * DAY_S
    plant.reset(period.start_s, period.warmup_s)
    plant.advance(None, period.scored_s)
    kpis = plant.kpis()
    assert kpis["ener_tot"] == pytest.approx(3.478, rel=0.002)
    assert kpis["tdis_tot"] == pytest.approx(8.381, rel=0.02)
    assert kpis["pele_tot"] == pytest.approx(0.018913, rel=0.002)


@pytest.mark.slow
def test_the_windows_are_the_published_ones_in_whatever_form_the_weather_comes(plant, shared, tmp_path):
    lines = (shared / "boptest_hp" / "Brussels.mos").read_text().splitlines()
    other_form = tmp_path / "other.mos"
    other_form.write_text("\r\n".join(line + "\t" if line[0].isdigit() else line for line in lines))
    for name, start_day in (("peak_heat_day", 16), ("typical_heat_day", 108)):
        assert EmbeddedPlant(load_weather(other_form)).period(name).start_s == start_day * DAY_S


@pytest.mark.slow
def test_the_rule_itself_finds_the_published_peak_day(plant):
    assert heating_windows(plant.native_powers_W()["P_heat_pump"])["peak_heat_day"].start_s == 16 * DAY_S


def test_the_boundary_is_the_test_cases_own(plant, shared):
    real = pd.read_csv(shared / "boptest_hp" / "boundary_hourly.csv.gz").iloc[: 24 * 30]
    plant.reset(0, 0, "dynamic")
    ours = plant.forecast(float(real.time.iloc[-1]), 3600)
    pairs = {
        "TDryBul": ours.T_out_C, "HGloHor": ours.solar_W_m2, "Occupancy[1]": ours.occupancy[0],
        "LowerSetp[1]": ours.lower_C[0], "UpperSetp[1]": ours.upper_C[0],
        "PriceElectricPowerDynamic": ours.price_per_kWh[0],
        "EmissionsElectricPower": ours.emission_kg_per_kWh[0],
    }  # fmt: skip
    for column, values in pairs.items():
        np.testing.assert_allclose(values, real[column], atol=2e-5, err_msg=column)
