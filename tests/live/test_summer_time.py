"""Days of 23 and 25 hours at a building: schedules, habits and prices go by the clock of the house, seconds go on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from connected_home import HOUR, SENSORS, rules_of
from home_by_setpoint import HomeBySetpoint, own_setpoint_C, price
from simple_house import outdoor_C

from thermoforce_mpc.boundary.tariffs import by_name
from thermoforce_mpc.data import Block, Plan, PlanStatus
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.live import LiveBuilding, control
from thermoforce_mpc.measurements.forecast import prices_over_steps, read_forecast
from thermoforce_mpc.measurements.load import learned_commands, read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap
from thermoforce_mpc.measurements.tables.forms import TimeStampRules

ZONE = "Europe/Berlin"
SPRING, AUTUMN = pd.Timestamp("2026-03-29", tz=ZONE), pd.Timestamp("2026-10-25", tz=ZONE)
COMFORT = "6:00-22:00 20-23, else 17-24"


def rules(**more) -> dict:
    """The map of the house, with comfort and prices by its clock."""
    base = rules_of({name: name for name in SENSORS})
    del base["zones"]["zone"]["lower"], base["zones"]["zone"]["upper"]
    return base | {"time": {"zone": ZONE}, "comfort": COMFORT} | more


class LocalHome(HomeBySetpoint):
    """The house on the clock of a zone: its people, prices and, with `bare`, stamps of its logger go by it."""

    def __init__(self, until: pd.Timestamp, days: int, bare: bool = False) -> None:
        self.bare = bare
        self.at, self.T, self.rows, self.told, self.written = until - pd.Timedelta(days=days), 21.0, [], None, []
        self.wait_until(until)

    def measurements(self) -> pd.DataFrame:
        table = super().measurements()
        return table.assign(time=table["time"].dt.tz_localize(None)) if self.bare else table

    def forecast(self) -> pd.DataFrame:
        index = pd.date_range(self.at.tz_convert("UTC").floor("1h"), periods=49, freq="1h", name="time")
        index = index.tz_convert(ZONE)
        out = outdoor_C((index - pd.Timestamp("2025-01-01", tz="UTC")).total_seconds().to_numpy())
        table = pd.DataFrame({"out": out, "price": [price(at) for at in index]}, index=index)
        return table.set_axis(index.tz_localize(None).rename("time"), axis=0) if self.bare else table


def lower_C(at: pd.DatetimeIndex) -> np.ndarray:
    return np.where((at.hour >= 6) & (at.hour < 22), 20.0, 17.0)


class Looks:
    """A controller that leaves the house alone and keeps what it was given."""

    name, step_s, horizon_s = "looks", 1800.0, 86400.0

    def __init__(self) -> None:
        self.seen = []

    def plan(self, observation, state=None):
        self.seen.append(observation)
        return Plan((Block.native(1, self.step_s),), PlanStatus.NATIVE, "left alone")


@pytest.mark.slow
@pytest.mark.parametrize("bare", [False, True])
@pytest.mark.parametrize("changes", [SPRING, AUTUMN])
def test_a_controller_over_the_change_of_the_clock(changes, bare):
    """No step is left out or made twice, and what lies ahead has the bounds and prices of the clock on the wall."""
    begin, steps = changes - pd.Timedelta(hours=2), 16
    home, controller, decisions = LocalHome(begin, 3, bare), Looks(), []
    building = LiveBuilding(home, MeasurementMap.model_validate(rules()), 1800.0)
    control(building, controller, clock=home, steps=steps, delay_s=0.0, told=decisions.append)
    assert [one.instant for one in decisions] == [begin + k * HOUR / 2 for k in range(steps)]
    assert len(controller.seen) == steps
    origin = pd.Timestamp(f"{begin.year}-01-01", tz=ZONE)
    for decision, seen in zip(decisions, controller.seen, strict=True):
        ahead, measured = seen.boundary, seen.history
        at = pd.DatetimeIndex(origin + pd.to_timedelta(ahead.time_s, unit="s"))
        assert at[0] == decision.instant
        np.testing.assert_array_equal(ahead.lower_C[0], lower_C(at))
        assert np.isfinite(ahead.T_out_C).all()
        np.testing.assert_allclose(ahead.price_per_kWh[0], [price(one) for one in at])
        assert np.isfinite(measured.T_zone_C[0, -12:]).all()
        assert np.isfinite(measured.u[0, -12:]).all()


@pytest.mark.parametrize("changes", [SPRING, AUTUMN])
def test_what_is_guessed_from_days_before_is_of_the_same_hour_of_the_clock(changes):
    """Bounds of a column and prices that end before the horizon: those of the same hour of the clock on days before."""
    home = LocalHome(changes, 9)
    columns = rules_of({name: name for name in SENSORS}) | {"time": {"zone": ZONE}}
    columns["zones"]["zone"] |= {"lower": "low", "upper": "high"}
    columns["machines"]["machine"]["price"] = "price"
    table = home.measurements()
    local = pd.DatetimeIndex(table["time"])
    table = table.assign(low=lower_C(local), high=24.0, price=[price(at) for at in local])
    measured = read_measurements(table, columns, step_s=3600.0, at=changes, now=changes)
    weather = home.forecast()[["out"]].iloc[:48].assign(low=np.nan, high=24.0, price=np.nan)
    weather.iloc[:2, 1:] = weather.iloc[:2].assign(low=17.0, price=0.2)[["low", "high", "price"]]
    ahead = read_forecast(weather, measured, now=changes)
    at = pd.DatetimeIndex(measured.record.origin + pd.to_timedelta(ahead.time_s, unit="s"))
    known = np.isfinite(ahead.lower_C[0]) & np.isfinite(ahead.price_per_kWh[0])
    assert known.sum() > 40, known
    np.testing.assert_array_equal(ahead.lower_C[0][known], lower_C(at)[known])
    np.testing.assert_allclose(ahead.price_per_kWh[0][known], [price(one) for one in at[known]])


def test_habits_of_weeks_of_winter_time_hold_on_the_clock_of_summer():
    home = LocalHome(SPRING, 8)
    learned = learned_commands(read_measurements(home.measurements(), rules(), step_s=3600.0, now=home.at).served())
    summer = pd.date_range("2026-06-01", periods=48, freq="1h", tz=ZONE)
    at_s = (summer - pd.Timestamp("2026-01-01", tz=ZONE)).total_seconds().to_numpy()
    assert learned["actuator"].usual_at(at_s, 0.0 * at_s).tolist() == [own_setpoint_C(at) for at in summer]
    elsewhere = learned["actuator"].from_origin_s(at_s + 3600.0, pd.Timestamp("2026-01-01", tz="UTC"))
    np.testing.assert_array_equal(elsewhere, at_s + 7200.0)


def test_a_named_tariff_goes_by_the_clock_of_the_house():
    origin, july = pd.Timestamp("2026-01-01", tz=ZONE), pd.Timestamp("2026-07-06", tz=ZONE)
    at = pd.date_range(july, periods=24, freq="1h")
    grid_s = (at - origin).total_seconds().to_numpy()
    found, _ = prices_over_steps(Path("dynamic"), TimeStampRules(zone=ZONE), origin, grid_s, 3600.0)
    of_the_year_s = (at.tz_localize(None) - pd.Timestamp("2026-01-01")).total_seconds().to_numpy()
    np.testing.assert_array_equal(found, by_name()["dynamic"](of_the_year_s))


@pytest.mark.parametrize(("changes", "said"), [(SPRING, "does not exist in"), (AUTUMN, "1 rows in the hour that")])
def test_a_table_of_24_prices_of_a_day_that_has_fewer_or_more_costs_an_hour_and_no_forecast(tmp_path, changes, said):
    """What people's scripts write each day; a plan that is asked for once refuses it."""
    file, origin = tmp_path / "prices.csv", pd.Timestamp("2026-01-01", tz=ZONE)
    day = pd.date_range(changes.tz_localize(None), periods=24, freq="1h")
    file.write_text("time,price\n" + "".join(f"{at},{0.1 + 0.01 * at.hour:.2f}\n" for at in day))
    at = pd.date_range(changes, changes + pd.DateOffset(days=1), freq="1h", inclusive="left")
    over = file, TimeStampRules(zone=ZONE), origin, (at - origin).total_seconds().to_numpy(), 3600.0
    found, words = prices_over_steps(*over, now=changes - 9 * HOUR)
    right = np.isclose(found, 0.1 + 0.01 * at.hour)
    assert right[at.hour != 2].all()
    assert said in words
    assert "left out" in words
    with pytest.raises(DataError, match="where summer time"):
        prices_over_steps(*over)
