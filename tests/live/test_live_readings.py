"""What a running controller makes of tables that are torn, ahead of its clock, in another unit, or end early."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import yaml
from simulated_building import RULES, START, SimulatedBuilding, mpc

from thermoforce_mpc.cli.live.control import in_words
from thermoforce_mpc.data.notes import NotesTold
from thermoforce_mpc.errors import DataError, NoForecast
from thermoforce_mpc.live import LiveBuilding, control
from thermoforce_mpc.measurements.load import read_measurements
from thermoforce_mpc.measurements.map.mapping import MeasurementMap

HOUR = pd.Timedelta("1h")


def controlled(house, steps, rules=RULES):
    told = []
    control(
        LiveBuilding(house, MeasurementMap.model_validate(rules), 3600.0),
        mpc(),
        clock=house,
        steps=steps,
        told=told.append,
    )
    return told


def changed(house, change):
    live = house.measurements
    house.measurements = lambda: change(live())
    return house


def ahead(by, from_h=0):
    """Stamps that are `by` ahead of the clock, from an hour of the run on."""
    house = SimulatedBuilding()
    return changed(
        house, lambda table: table.assign(time=table["time"] + by) if house.at >= START + from_h * HOUR else table
    )


@pytest.mark.parametrize("by", ["10h", "1h", "30min"])
def test_readings_of_times_to_come_are_refused_with_the_zone_named(by):
    house = ahead(pd.Timedelta(by))
    with pytest.raises(DataError, match=r"after the clock \(00:00 UTC\): probably time\.zone of the map, UTC"):
        controlled(house, 2)
    assert not house.written


def test_a_clock_that_goes_ahead_meanwhile_gives_the_building_back():
    house = ahead(pd.Timedelta("10min"), from_h=2)
    told = controlled(house, 3)
    assert [decision.plan.status for decision in told] == ["solved"] * 2 + ["native"]
    assert "one of the clocks is wrong" in told[2].plan.why
    assert {levels["actuator"] for at, levels, _ in house.written if at >= START + 2 * HOUR} == {None}


def test_clocks_that_differ_by_minutes_are_a_note():
    told = controlled(ahead(pd.Timedelta("3min")), 2)
    assert [decision.plan.status for decision in told] == ["solved"] * 2
    assert any("2.5 min after the clock" in note or "3 min after the clock" in note for note in told[0].notes)


def an_hour_behind(table, at):
    return table.assign(time=table["time"] - HOUR)


def of_each_hour(table, at):
    return table[table["time"].dt.minute == 0]


def silent_for_two_hours(table, at):
    return table[table["time"] < START + HOUR] if START + HOUR <= at < START + 3 * HOUR else table


@pytest.mark.parametrize(
    ("change", "said"), [(an_hour_behind, [3, 4, 5, 6, 7, 8]), (of_each_hour, []), (silent_for_two_hours, [])]
)
def test_a_logger_that_keeps_winter_time_in_summer_is_said(change, said):
    """A plan bridges the hour for ever, and says only how old the last reading is, as of a logger that stands."""
    house = SimulatedBuilding()
    building = LiveBuilding(
        changed(house, lambda table: change(table, house.at)), MeasurementMap.model_validate(RULES), 900.0
    )
    found = []
    for k in range(9):
        house.wait_until(START + k * HOUR / 4)
        building.record(house.at)
        notes = [note for note in building.left_out if "is not the zone of the stamps, or they are late" in note]
        found += [k] * len(notes)
    assert found == said


def test_a_row_of_nonsense_stops_nothing():
    def torn(table):
        table = table.astype({"T": object, "time": object})
        table.iloc[-5, table.columns.get_loc("T")] = "ERR"
        table.iloc[-9, table.columns.get_loc("time")] = pd.Timestamp("1970-01-01", tz="UTC")
        return table.iloc[[*range(len(table) - 20), -18, -19, *range(-17, 0), -1]]

    told = controlled(changed(SimulatedBuilding(), torn), 3)
    assert [decision.plan.status for decision in told] == ["solved"] * 3
    said = " ".join(told[0].notes)
    for words in ("'ERR'", "a time far from those of the rows around", "sorted", "such rows"):
        assert words in said


def test_a_torn_forecast_is_used_without_what_is_torn():
    house = SimulatedBuilding()
    live = house.forecast

    def torn():
        table = live().reset_index().astype({"out": object, "time": object})
        table.loc[5, "out"] = "n.v."
        table.loc[7, "time"] = "2025-01-12 0"
        return table

    house.forecast = torn
    told = controlled(house, 1)
    assert told[0].plan.status == "bridged"
    assert "T_out_C at 2 of 13 instants by interpolation" in told[0].plan.why
    assert any("'n.v.'" in note for note in told[0].notes)
    assert any("no time stamp" in note for note in told[0].notes)


@pytest.mark.slow
def test_a_room_in_kelvin_is_left_to_its_own_control_and_the_unit_is_named():
    house = SimulatedBuilding()

    def kelvin(table):
        late = table["time"] >= START + HOUR
        return table.assign(T=table["T"] + 273.15 * late)

    told = controlled(changed(house, kelvin), 9)
    assert told[0].plan.status == "solved"
    assert any("zones.zone.temperature (column T)" in note and "in K they were usual" in note for note in told[2].notes)
    assert told[-1].plan.status in ("native", "thermostat")


def test_outdoors_in_another_unit_is_said_and_the_forecast_stands_in():
    house = SimulatedBuilding()
    told = controlled(changed(house, lambda table: table.assign(out=table["out"] + 273.15)), 2)
    assert [decision.plan.status for decision in told] == ["solved"] * 2 or "bridged" in told[0].plan.status
    assert any("outdoor (column out)" in note and "set unit: 'K'" in note for note in told[0].notes)


@pytest.mark.parametrize("source", ["measured", "in the forecast"])
def test_outdoors_in_fahrenheit_is_seen_beside_the_forecast(source):
    house = SimulatedBuilding()
    if source == "measured":
        changed(house, lambda table: table.assign(out=table["out"] * 1.8 + 32))
    else:
        live = house.forecast
        house.forecast = lambda: live().assign(out=lambda table: table["out"] * 1.8 + 32)
    told = controlled(house, 1)
    assert any(f"°F {source}? set unit" in note for note in told[0].notes)
    assert not any("°F" in note for note in controlled(SimulatedBuilding(), 1)[0].notes)


def test_a_logger_between_the_steps_is_believed():
    """Rows at 20 and 50 minutes past, decisions at the hour: no reading stands at the instant of one."""
    house = SimulatedBuilding()
    told = controlled(changed(house, lambda table: table[table["time"].dt.minute.isin([20, 50])]), 8)
    assert [decision.plan.status for decision in told] == ["solved"] * 8


def test_prices_that_end_first_are_said_with_their_share():
    rules = {
        **RULES,
        "machines": {"machine": {"power": "P"}},
        "forecast": {"price": {"column": "spot", "unit": "per MWh"}},
    }
    house = SimulatedBuilding()
    live = house.forecast
    house.forecast = lambda: live().assign(spot=lambda f: np.where(np.arange(len(f)) < 8, 80.0, np.nan))
    told = controlled(house, 2, rules)
    assert told[0].plan.status == "bridged"
    assert "price_per_kWh at 5 of 13 instants by the value before" in in_words(told[0])


def of_files(folder):
    """A house whose weather and hourly prices of today and tomorrow, 0.1 to 0.33, are files; the map has no price."""
    house = SimulatedBuilding()
    of_house = house.forecast

    def forecast():
        if (broken := folder / "weather is broken").exists():
            return broken
        return of_house()

    house.forecast = forecast
    at = pd.date_range(START, periods=48, freq="1h", name="time")
    pd.Series(0.1 + at.hour / 100, index=at, name="price").to_csv(folder / "prices.csv")
    return house, RULES | {"machines": {"machine": {"power": "P"}}}


@pytest.mark.parametrize("broken", ["prices.csv", "weather is broken"])
def test_a_broken_file_takes_no_other_source_down(tmp_path, caplog, broken):
    house, rules = of_files(tmp_path)
    given, told = [], []

    def break_it(decision):
        told.append(decision)
        if len(told) == 2:
            (tmp_path / broken).write_text("<html>502 Bad Gateway</html>\n")

    live = LiveBuilding(house, MeasurementMap.model_validate(rules), 3600.0, tmp_path / "prices.csv")
    of_building = live.forecast

    def forecast(*asked):
        try:
            given.append(of_building(*asked))
        except NoForecast as error:
            given.append(error.known)
            raise
        return given[-1]

    live.forecast = forecast
    control(live, mpc(), clock=house, steps=5, told=break_it)
    assert [one.plan.status for one in told] == ["solved"] * 2 + ["bridged"] * 3
    said = caplog.text + " ".join(told[-1].notes)
    assert broken in said
    last = given[-1]
    assert np.isfinite(last.T_out_C).all() == (broken == "prices.csv")
    assert np.isfinite(last.price_per_kWh).all() == (broken != "prices.csv")
    if broken != "prices.csv":
        assert last.price_per_kWh[0, 0] == pytest.approx(0.14), "as the file says, of hours that come too"
    else:
        assert "price_per_kWh at 13 of 13 instants by the last forecast (3 h old)" in told[-1].plan.why


def test_prices_that_were_never_read_are_an_error(tmp_path):
    house, rules = of_files(tmp_path)
    (tmp_path / "prices.csv").write_text("<html>502 Bad Gateway</html>\n")
    live = LiveBuilding(house, MeasurementMap.model_validate(rules), 3600.0, tmp_path / "prices.csv")
    with pytest.raises(NoForecast, match=r"prices\.csv"):
        control(live, mpc(), clock=house, steps=2)


def in_order(table):
    return table.sort_values("time", kind="stable", ignore_index=True)


def a_dozen_of_tomorrow(table):
    """A logger's clock was a day ahead for twelve minutes."""
    of_then = table["time"].between(START + HOUR, START + HOUR + pd.Timedelta("11min"))
    return table.assign(time=table["time"].where(~of_then, table["time"] + pd.Timedelta("1D")))


@pytest.mark.parametrize("order", [in_order, lambda table: table], ids=["in order of time", "as they came"])
def test_rows_of_a_clock_that_was_a_day_ahead_for_minutes_are_put_aside(order):
    house = changed(SimulatedBuilding(), lambda table: order(a_dozen_of_tomorrow(table)))
    building = LiveBuilding(house, MeasurementMap.model_validate(RULES), 900.0)
    told = {}
    for hours in (2, 12, 24, 24.75, 25, 25.25):  # the last of them: the clock comes to those rows, and beyond
        house.wait_until(START + hours * HOUR)
        record = building.record(house.at)
        assert np.isfinite(record.T_zone_C[0, -1])
        told[hours] = [note for note in building.left_out if "clock" in note or "far from" in note]
    assert all(told[hours] for hours in (2, 12, 24))
    if order is in_order:
        note = told[12][0]
        assert note.startswith("column 'T': 12 readings stamped 2025-01-13 01:00:00+00:00 to 2025-01-13 01:11:00+00:00")
    assert not told[25.25]


@pytest.mark.parametrize("by", ["1h", "1D"])
def test_one_logger_of_three_whose_clock_is_ahead_costs_its_room(tmp_path, by):
    """Each room has a file of its own; where two of three are ahead, the clock is in doubt."""
    at = pd.date_range(START - pd.Timedelta("3D"), START, freq="5min")
    now = START + pd.Timedelta("30s")
    rules = {
        **{key: RULES[key] for key in ("time", "machines")},
        "step": "15min",
        "outdoor": "out",
        "zones": {name: {"temperature": name, "lower": 20.0, "upper": 24.0} for name in ("a", "b", "c")},
        "actuators": {"heater": {"level": "u", "zone": "a"}},
    }
    pd.DataFrame({"time": at, "out": np.arange(at.size) % 7.0, "u": 0.5, "P": 900.0}).to_csv(
        tmp_path / "house.csv", index=False
    )

    def read(wrong):
        for name in ("a", "b", "c"):
            shift = pd.Timedelta(by) * int(name in wrong)
            table = pd.DataFrame({"time": at + shift, name: 21.0 + np.sin(np.arange(at.size) / 9.0)})
            table.to_csv(tmp_path / f"room_{name}.csv", index=False)
        return read_measurements(str(tmp_path / "*.csv"), rules, at=START, now=now)

    def now_C(measured):
        return measured.record.T_zone_C[:, measured.record.stamps().get_loc(START)]

    good, one, two = read(""), read("c"), read("bc")
    assert good.left_out == ()
    (note,) = one.left_out
    assert note.startswith("column 'c': ")
    np.testing.assert_array_equal(now_C(one), [*now_C(good)[:2], np.nan])
    assert one.newest_s() == good.newest_s()
    assert two.newest_s() > good.newest_s()


def test_a_matter_is_told_once_and_again_where_there_is_twice_as_much_of_it():
    """A sensor writes ERR in the first minute of each hour from the second on, and another is late in each batch."""

    def torn(table):
        table = table.astype({"T": object})
        since = table["time"] >= START + HOUR
        table.loc[since & (table["time"].dt.minute == 1), "T"] = "ERR"
        late = table[since & (table["time"].dt.minute % 10 == 5)]
        return pd.concat([table.drop(late.index), late.assign(time=late["time"])]).reset_index(drop=True)

    house = changed(SimulatedBuilding(), torn)
    building, told, said = LiveBuilding(house, MeasurementMap.model_validate(RULES), 3600.0), NotesTold(86400.0), []
    for hours in range(1, 10):
        house.wait_until(START + hours * HOUR + pd.Timedelta("2min"))
        building.record(house.at)
        said += [(hours, "ERR" in note) for note in building.left_out if told.is_news(note, 3600.0 * hours)]
    # One row from the first hour on, two in the next, then four and eight.
    assert [hours for hours, of_sensor in said if of_sensor] == [1, 2, 4, 8]
    assert 1 <= sum(not of_sensor for _, of_sensor in said) <= 6


def test_a_column_in_the_middle_of_a_log_is_named_where_it_ends_with_it(tmp_path):
    """A logger that got a sensor goes on with more cells than its header has: it runs, and nothing of it is read."""
    at = pd.date_range(START - pd.Timedelta("4D"), START, freq="5min")
    new = at > START - pd.Timedelta("2D")
    rows = [f"{one:%Y-%m-%dT%H:%M}Z,21.{k % 7},{'55,' * int(new[k])}3.{k % 5},0,1,900" for k, one in enumerate(at)]
    (tmp_path / "house.csv").write_text("\n".join(["time,T,out,sun,u,P", *rows]) + "\n")
    house = SimulatedBuilding()
    house.measurements = lambda: str(tmp_path / "house.csv")
    zones = {"zones": {"zone": {"temperature": "T", "lower": 20.0, "upper": 24.0}}}
    building = LiveBuilding(house, MeasurementMap.model_validate(RULES | zones), 3600.0)
    with pytest.raises(DataError, match=r"(?s)does the logger run\?\n.*7 cells, the header has 6, .*576 such lines"):
        building.record(START)


def logged(table, folder, at):
    (folder / "house.csv").write_text(table.to_csv(index=False))


def without_outdoors(table, folder, at):
    logged(table.rename(columns={"out": "outdoor"} if at >= START + 2 * HOUR else {}), folder, at)


def begun_anew(table, folder, at):
    """As by logrotate: the old log has another name, the new one has no row in its first hour."""
    of_now = table[table["time"] >= START + 2 * HOUR] if at >= START + 2 * HOUR else table
    logged(of_now[:0] if START + 2 * HOUR <= at < START + 3 * HOUR else of_now, folder, at)


def a_file_a_day(table, folder, at):
    for day, rows in table.groupby(table["time"].dt.date):
        rows.to_csv(folder / f"house-{day}.csv", index=False)
    if at >= START + 2 * HOUR:
        (folder / "house-2025-01-13.csv").write_text("")


@pytest.mark.parametrize(
    ("log", "statuses", "said"),
    [
        (without_outdoors, ["solved"] * 5, "column 'out' is not there any more, did you mean 'outdoor'?"),
        (begun_anew, ["solved", "solved", "bridged", "solved", "solved"], "what was read before it until"),
        (a_file_a_day, ["solved"] * 5, "house-2025-01-13.csv: the file is empty: left out"),
    ],
)
def test_a_log_that_loses_what_it_had_costs_no_more_than_that(tmp_path, log, statuses, said):
    house = SimulatedBuilding()
    live = house.measurements

    def measurements():
        log(live(), tmp_path, house.at)
        return str(tmp_path / ("house-*.csv" if log is a_file_a_day else "house.csv"))

    house.measurements = measurements
    building = LiveBuilding(house, MeasurementMap.model_validate(RULES), 3600.0)
    told = []
    control(building, mpc(), clock=house, steps=5, told=told.append)
    assert [decision.plan.status for decision in told] == statuses
    assert any(said in note for note in told[-1].notes)
    record = building.record(house.at, (), house.at)
    assert record.n_steps == 77, "its history is as long as if nothing had happened"
    assert np.isfinite(record.T_zone_C).all()
    assert np.isfinite(record.T_out_C).all() == (log is not without_outdoors)


def test_a_column_that_was_never_there_is_an_error(tmp_path):
    house = changed(SimulatedBuilding(), lambda table: table.rename(columns={"out": "outdoor"}))
    with pytest.raises(DataError, match="no column 'out', did you mean 'outdoor'"):
        controlled(house, 2)


@pytest.mark.parametrize("broken", ["bill.yaml", "prices.csv"])
def test_a_bill_that_cannot_be_read_in_a_step_is_that_of_before(tmp_path, broken):
    """As while it is being edited: the limit of a dimmed machine holds, and what a kWh costs and earns."""
    house, rules = of_files(tmp_path)
    bill = {"source": "a test", "energy": "prices.csv", "export_per_kWh": 0.08, "levies_per_kWh": 0.1}
    (tmp_path / "bill.yaml").write_text(yaml.safe_dump(bill | {"dimming": {"kW": 0.7}}))
    live = LiveBuilding(house, MeasurementMap.model_validate(rules), 3600.0, tmp_path / "bill.yaml")
    found = []
    for step in range(3):
        house.wait_until(START + step * HOUR)
        live.record(house.at)
        if step == 1:
            (tmp_path / broken).write_text("dimming: {kW: 0.7, hou\n")
        found.append(live.forecast(12 * 3600.0, 3600.0))
    for one in found:
        assert (one.limit_W[:12] == 700.0).all()
        assert (one.export_per_kWh == 0.08).all()
    held = broken == "bill.yaml"
    np.testing.assert_allclose(found[2].price_per_kWh[0, 0], 0.22 if held else np.nan)
    said = "the bill is that which was read before" if held else "prices are those that were read before"
    assert any(said in note for note in live.left_out)


def test_prices_of_today_from_now_on_are_neither_those_of_the_night_nor_forgotten():
    """Tomorrow's come at 13:00 or later; what was paid today tells them, and not the last price of the evening."""
    house = SimulatedBuilding()
    live = house.forecast

    def of_today():
        table = live()
        return table.assign(spot=np.where(table.index < START + 24 * HOUR, 0.1 + table.index.hour / 100, np.nan))

    house.forecast = of_today
    rules = RULES | {"machines": {"machine": {"power": "P"}}, "forecast": {"price": {"column": "spot"}}}
    building = LiveBuilding(house, MeasurementMap.model_validate(rules), 3600.0)
    for hour in range(24):
        house.wait_until(START + hour * HOUR)
        building.record(house.at)
        ahead = building.forecast(12 * 3600.0, 3600.0)
        hours = (hour + np.arange(13)) % 24
        np.testing.assert_allclose(ahead.price_per_kWh[0, :12], 0.1 + hours[:12] / 100)
        guessed = ahead.guessed.get("price_per_kWh", np.zeros((1, 13), dtype=bool))[0]
        assert (guessed[:12] == (hour + np.arange(12) >= 24)).all()
