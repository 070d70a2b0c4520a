"""Prices as billed in plans: own generation, what is fed in, dimming and peaks of a month."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from click.testing import CliRunner
from home_by_setpoint import RULES, HomeBySetpoint
from simple_house import simple_model

from controllers.mpc.config import MPCConfig, objective_of
from controllers.mpc.controller import ThermoForceMPC
from controllers.mpc.state import MPCState, highest_of_days_W
from thermoforce_mpc.cli import cli
from thermoforce_mpc.cli.options import billed_objective
from thermoforce_mpc.commands.loop import saving_in_words
from thermoforce_mpc.data import Observation
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.measurements.forecast import read_forecast
from thermoforce_mpc.measurements.load import learned_commands, read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.scenario.bill import read_bill

BILLS = Path(__file__).parents[3] / "configs" / "bills"
AT_METER = {"load": "load", "generation": "pv"}
PLAIN = RULES | {"actuators": {"actuator": {"level": "u"}}, "forecast": AT_METER}
BILL = {"source": "a contract", "energy": 0.3, "export_per_kWh": 0.05}


@pytest.fixture(scope="module")
def home():
    return HomeBySetpoint(days=14)


def forecast(home):
    table = home.forecast()
    noon = (table.index.hour >= 11) & (table.index.hour < 14)
    return table.assign(load=400.0, pv=np.where(noon, 3400.0, 0.0))


def made(objective, commands=None):
    options = {"step_s": 3600.0, "horizon_h": 24.0, "free_response": {"name": "persistence"}, "objective": objective}
    options |= {
        "gate": {"enabled": False},
        "watch": {"enabled": False},
        "actuation": {"mode": "modulating", "lowest_level": 0},
    }
    return ThermoForceMPC(simple_model(), MPCConfig.model_validate(options), commands=commands or {})


def seen(home, path, bill, rules=PLAIN):
    path.write_text(yaml.safe_dump(bill))
    measured = read_measurements(home.measurements(), rules, step_s=3600.0).served()
    return Observation(measured.record, read_forecast(forecast(home), measured, prices=path).head(24))


def planned(home, path, bill, *, used=1.0, **objective):
    observation = seen(home, path, bill)
    record = replace(observation.history, power_W=used * observation.history.power_W)
    plan = made(objective).plan(replace(observation, history=record))
    assert plan.u.size, plan.why
    return plan, observation.boundary


def test_what_the_sun_leaves_over_is_used_before_energy_is_bought(home, tmp_path):
    with_sun, ahead = planned(home, tmp_path / "bill.yaml", BILL, at_the_meter=True)
    without, _ = planned(home, tmp_path / "bill.yaml", BILL)
    spare_W = np.maximum(-ahead.others_W[:-1], 0.0)
    assert set(np.round(spare_W)) == {0.0, 3000.0}

    def bought_kWh(plan):
        return np.maximum(plan.power_W.sum(axis=0) - spare_W, 0.0).sum() / 1000.0

    assert bought_kWh(with_sun) < bought_kWh(without) - 2.0
    assert with_sun.solver_status == without.solver_status


def test_the_cost_of_a_plan_is_that_of_what_is_bought_and_not_sold(home, tmp_path):
    path = tmp_path / "bill.yaml"
    path.write_text(yaml.safe_dump(BILL))
    simple_model().save(tmp_path / "model")
    home.measurements().to_csv(tmp_path / "house.csv", index=False)
    forecast(home).to_csv(tmp_path / "tomorrow.csv")
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(PLAIN))
    words = ["plan", "--model", "model", "--map", "map.yaml", "--data", "house.csv", "--forecast", "tomorrow.csv"]
    words = [str(tmp_path / word) if "." in word or word == "model" else word for word in words]
    words += ["--hours", "24", "--prices", str(path), "--out", str(tmp_path / "plan.csv")]
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == 0, result.output
    assert "a contract" in result.output
    table = pd.read_csv(tmp_path / "plan.csv")
    spare_kW, used_kW = np.maximum(-table["others_W"], 0.0) / 1000.0, table["power_W"] / 1000.0
    cost = 0.3 * np.maximum(used_kW - spare_kW, 0.0) + 0.05 * np.minimum(used_kW, spare_kW)
    assert (np.minimum(used_kW, spare_kW) > 0.5).any()
    assert table["cost"].to_numpy() == pytest.approx(cost.to_numpy(), abs=1e-4)


def test_what_is_fed_in_earns_nothing_while_the_spot_price_is_negative(home):
    """The example of the German feed-in: what a surplus costs to use, hour by hour, and what is bought."""
    path = BILLS / "germany_solar.yaml"
    table = forecast(home)
    table.loc[table.index.hour == 12, "price"] = -0.01
    measured = read_measurements(home.measurements(), PLAIN, step_s=3600.0).served()
    ahead = read_forecast(table, measured, prices=path).head(24)
    assert billed_objective(path, measured.map) == {"at_the_meter": True}
    controller = made(billed_objective(path, measured.map))
    observation = Observation(measured.record, ahead)
    problem = controller.instance(controller.predictor.context(observation), measured.record)
    hour = ahead.time_s[:-1] % 86400.0 / 3600.0
    bought = 1.19 * (table["price"].to_numpy()[:24] + 0.018 + 0.0205 + 0.0862)
    surplus = problem.price_per_kWh[0] + problem.exchange.dearer_per_kWh
    assert surplus == pytest.approx(bought)
    assert problem.price_per_kWh[0, hour == 11] == pytest.approx(0.0794)
    assert problem.price_per_kWh[0, hour == 12] == pytest.approx(0.0)
    assert problem.price_per_kWh[0, hour == 18] == pytest.approx(bought[hour == 18])


def test_a_dimmed_machine_takes_no_more_than_the_grid_lets_it(home, tmp_path):
    bill = BILL | {"dimming": {"kW": 1.0, "hours": "4:00-8:00"}}
    plan, ahead = planned(home, tmp_path / "bill.yaml", bill, at_the_meter=True)
    dimmed = np.isfinite(ahead.limit_W[:-1])
    assert dimmed.sum() == 4
    assert plan.power_W[0, dimmed].max() <= 1000.0 + 1e-3
    assert plan.power_W[0, ~dimmed].max() > 1000.0


def test_a_dear_peak_spreads_power_down_to_what_is_billed_at_least(home, tmp_path):
    peaks = {"peak_price_per_kW": 50.0, "peak_of": "month"}
    plain, _ = planned(home, tmp_path / "bill.yaml", BILL, used=0.3)
    flat, _ = planned(home, tmp_path / "bill.yaml", BILL, used=0.3, **peaks)
    kept, _ = planned(home, tmp_path / "bill.yaml", BILL, used=0.3, peak_least_kW=1.6, **peaks)
    record = read_measurements(home.measurements(), PLAIN, step_s=3600.0).served().record
    so_far_W = 0.3 * record.power_W.sum(axis=0).max()
    highest_W = [plan.power_W.sum(axis=0).max() for plan in (plain, flat, kept)]
    assert highest_W[0] > 1700.0
    assert highest_W[1] == pytest.approx(so_far_W, rel=0.02)
    assert highest_W[2] == pytest.approx(1600.0, rel=0.02)


def test_peaks_are_those_of_this_month_and_three_of_distinct_days(home):
    record = read_measurements(home.measurements(), PLAIN, step_s=3600.0).served().record
    assert f"{record.stamps()[-1]:%d %b}" == "29 Jan"
    power_W = np.full((1, record.n_steps), 500.0)
    power_W[0, -30:-27] = 4000.0  # three hours of one day
    power_W[0, -60], power_W[0, -100] = 3000.0, 2000.0
    observation = Observation(
        replace(record, power_W=power_W),
        read_forecast(forecast(home), read_measurements(home.measurements(), PLAIN, step_s=3600.0).served()),
    )
    state = MPCState(0.0)
    assert state.peak_after(observation, "month") == 4000.0
    assert state.peak_after(observation, "three_days") == 2000.0
    evening_W = np.full((1, record.n_steps), 500.0)
    evening_W[0, -3:], evening_W[0, -60], evening_W[0, -100] = 4000.0, 3000.0, 2000.0
    hour_s = 3600.0 * record.stamps()[-1].hour
    midnight = replace(record, power_W=evening_W, time_s=record.time_s - hour_s)
    now = replace(observation.boundary, time_s=observation.boundary.time_s - hour_s)
    assert state.peak_after(Observation(midnight, now), "three_days") == 2000.0, "today has none yet"
    to_noon_s, noon_W = 12 * 3600.0 - hour_s, power_W.copy()
    noon_W[0, -2] = 3500.0
    noon = replace(record, power_W=noon_W, time_s=record.time_s + to_noon_s)
    then = replace(observation.boundary, time_s=observation.boundary.time_s + to_noon_s)
    assert state.peak_after(Observation(noon, then), "three_days") == 3500.0, "as high as today was"
    later = replace(record, power_W=power_W, time_s=record.time_s + 4 * 86400.0)  # 2 February
    ahead = replace(observation.boundary, time_s=observation.boundary.time_s + 4 * 86400.0)
    assert state.peak_after(Observation(later, ahead), "month") == 500.0


def test_steps_of_a_fee_are_priced_where_the_peaks_of_the_record_are(home, tmp_path):
    bill = read_bill(BILLS / "norway.yaml")
    observation, controller = seen(home, tmp_path / "bill.yaml", BILL), made(objective_of(bill))
    context, record = controller.predictor.context(observation), observation.history
    for highest_kW, per_kW in ((1.0, (195 - 155) / 2.0), (3.0, (335 - 195) / 3.0), (7.0, (690 - 335) / 5.0)):
        power_W = np.full((1, record.n_steps), 500.0)
        power_W[0, [-30, -60, -100]] = 1000.0 * highest_kW
        problem = controller.instance(context, replace(record, power_W=power_W))
        assert 3000.0 * problem.weights.peak == pytest.approx(per_kW)


def test_a_fee_has_one_price():
    with pytest.raises(ValueError, match="greater than or equal to 0"):
        MPCConfig.model_validate({"objective": {"peak_price_per_kW": -1.0}})
    with pytest.raises(ValueError, match="the last none"):
        MPCConfig.model_validate({"objective": {"peak_price_per_kW": [{"up_to_kW": 2.0, "per_month": 1.0}]}})


METERED = PLAIN | {"meter": {"column": "grid", "unit": "kW"}}


class MeteredHome(HomeBySetpoint):
    """The house takes 0.6 kW beside the machine in one hour of the month, and else 0.4."""

    def measurements(self):
        table = super().measurements()
        of_house = np.where(table["time"].between("2025-01-27 10:00", "2025-01-27 10:59"), 600.0, 400.0)
        return table.assign(grid=(0.3 * table["P"] + of_house) / 1000.0, P=0.3 * table["P"])


def test_the_peak_so_far_is_what_the_meter_read_where_other_loads_are_behind_it(tmp_path):
    home = MeteredHome(days=14)
    observation = seen(home, tmp_path / "bill.yaml", BILL, METERED)
    record = observation.history
    of_house_W = record.meter_W - record.power_W[0]
    assert np.nanmax(of_house_W) == pytest.approx(600.0)
    assert np.nanmedian(of_house_W) == pytest.approx(400.0)
    state, whole_W = MPCState(0.0), np.nanmax(record.meter_W)
    assert state.peak_after(observation, "month", at_the_meter=True) == pytest.approx(whole_W)
    assert state.peak_after(observation, "month") == pytest.approx(np.nanmax(record.power_W))
    last_W = state.peak_after(observation, "run", at_the_meter=True)
    assert last_W == pytest.approx(record.meter_W[-1])

    peaks = {"peak_price_per_kW": 50.0, "peak_of": "month", "at_the_meter": True}
    plan = made(peaks).plan(observation)
    of_plan_W = plan.power_W.sum(axis=0) + observation.boundary.others_W[:-1]
    assert of_plan_W.max() == pytest.approx(whole_W, rel=0.02), "what the house takes is no peak that is free"
    norway = made(objective_of(read_bill(BILLS / "norway.yaml")) | {"at_the_meter": True})
    problem = norway.instance(norway.predictor.context(observation), record)
    three_kW = np.mean(sorted(highest_of_days_W(record, record.meter_W).values())[-3:]) / 1000.0
    assert 3000.0 * problem.weights.peak == pytest.approx(read_bill(BILLS / "norway.yaml").peak.per_kW(three_kW))

    halves = record.slice(10, 30).resample(2)
    assert halves.meter_W == pytest.approx(record.meter_W[10:30].reshape(-1, 2).mean(axis=1))


def test_a_peak_behind_whose_meter_others_are_needs_what_it_read(home, tmp_path):
    observation = seen(home, tmp_path / "bill.yaml", BILL)
    with pytest.raises(DataError, match="what the meter read"):
        made({"peak_price_per_kW": 50.0, "peak_of": "month", "at_the_meter": True}).plan(observation)
    rules = MeasurementMap.model_validate(PLAIN)
    with pytest.raises(ConfigError, match=r"norway\.yaml: its peak .* name the key meter"):
        billed_objective(BILLS / "norway.yaml", rules)
    assert billed_objective(BILLS / "norway.yaml", MeasurementMap.model_validate(METERED))["at_the_meter"]
    with pytest.raises(ValueError, match=r"meter: needs forecast\.load"):
        MeasurementMap.model_validate(METERED | {"forecast": {"generation": "pv"}})


def test_a_load_that_is_not_forecast_is_as_on_days_before_and_said(home):
    table, notes = forecast(home), []
    table.loc[table.index[20] :, "load"] = np.nan
    measured = read_measurements(home.measurements(), PLAIN, step_s=3600.0).served()
    ahead = read_forecast(table, measured, left_out=notes)
    assert ahead.others_W[0] == 400.0
    assert np.isnan(ahead.others_W[21])
    assert "load and generation are not known from 2025-01-29 20:00:00+00:00 on: taken as 0 W" in notes[-1]
    metered = read_measurements(MeteredHome(days=14).measurements(), METERED, step_s=3600.0).served()
    ahead = read_forecast(table, metered, left_out=notes)
    assert ahead.others_W[21:24] == pytest.approx(400.0), "as the meter had it"
    assert "20:00:00+00:00 on: as on days before" in notes[-1]


def test_hot_water_on_the_same_machine_is_in_the_peak_so_far(home):
    table = home.measurements()
    charged = table["time"].between("2025-01-27 10:00", "2025-01-27 10:59")
    table = table.assign(P=np.where(charged, 6000.0, table["P"]), dhw=charged.astype(float))
    rules = {key: value for key, value in PLAIN.items() if key != "forecast"}
    rules |= {"machines": {"machine": {"power": "P", "price": "price", "hot_water": "dhw"}}}
    measured = read_measurements(table, rules, step_s=3600.0).served()
    assert np.nanmax(measured.record.power_W) < 5000.0, "it says nothing of the rooms"
    ahead = read_forecast(home.forecast(), measured).head(24)
    assert MPCState(0.0).peak_after(Observation(measured.record, ahead), "month") == pytest.approx(6000.0)


def test_commands_that_lower_the_peak_of_the_month_alone_are_worth_it(home, tmp_path):
    """Energy costs nothing: what is saved is the peak of the morning's set-point."""
    free = BILL | {"energy": 0.0, "export_per_kWh": 0.0}
    peaks = {"peak_price_per_kW": 50.0, "peak_of": "month", "peak_least_kW": 1.5}
    observation = seen(home, tmp_path / "bill.yaml", free, RULES)
    record = replace(observation.history, power_W=0.3 * observation.history.power_W)
    commands = learned_commands(read_measurements(home.measurements(), RULES, step_s=3600.0).served())
    plan = made(peaks, commands).plan(replace(observation, history=record))
    saving = plan.saving
    assert saving.peak_alone > 50.0
    assert saving.peak < 0.7 * saving.peak_alone
    assert saving.saved == pytest.approx(saving.peak_alone - saving.peak, rel=0.3)
    assert saving.gain > 0.0
    assert any(one.value is not None for one in plan.settings[0])
    assert f"(of which a higher peak {saving.peak:.2f}, {saving.peak_alone:.2f})" in saving_in_words(saving)


def test_a_bill_without_energy_adds_its_fees_to_the_prices_of_the_map(home, tmp_path):
    path = tmp_path / "bill.yaml"
    windows = [{"hours": "17:00-19:30", "per_kWh": 0.10}]
    bill = {"source": "a contract", "grid": {"per_kWh": 0.02, "windows": windows}, "vat": 0.5}
    path.write_text(yaml.safe_dump(bill))
    measured = read_measurements(home.measurements(), PLAIN, step_s=3600.0).served()
    ahead = read_forecast(forecast(home), measured, prices=path)
    price = dict(zip(ahead.time_s[:24] % 86400.0 / 3600.0, ahead.price_per_kWh[0, :24], strict=True))
    assert price[2.0] == pytest.approx(1.5 * 0.22)
    assert price[17.0] == pytest.approx(1.5 * 0.50)
    assert price[19.0] == pytest.approx(1.5 * (0.40 + 0.06))  # the window ends within the step
    assert ahead.heating_price_per_kWh[0, 17] == pytest.approx(1.5 * 0.50)


def test_a_bill_in_cents_is_refused(home, tmp_path):
    path = tmp_path / "bill.yaml"
    path.write_text(yaml.safe_dump({"source": "a contract", "energy": 30.0}))
    measured = read_measurements(home.measurements(), PLAIN, step_s=3600.0).served()
    with pytest.raises(DataError, match=r"bill\.yaml: with fees and tax .* in cents"):
        read_forecast(forecast(home), measured, prices=path)
