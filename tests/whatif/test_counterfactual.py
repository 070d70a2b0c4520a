"""Forecast and counterfactual of a past day, against a house whose other day can be run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from simple_house import GAIN_K, POLE, SimpleHouse, outdoor_C, simple_model

from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import DAY_S, HOUR_S, Array, Names, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.card import ModelCard
from thermoforce_mpc.model.machine.other_load import OtherLoad
from thermoforce_mpc.model.operator.building import BuildingOperator
from thermoforce_mpc.model.thermal_model import ThermalModel
from thermoforce_mpc.whatif.counterfactual import counterfactual

_ORIGIN = pd.Timestamp("2026-01-01", tz="UTC")
_DAYS, _FIRST = 6, 4 * 24


def _levels(seed: int) -> Array:
    return np.repeat(np.random.default_rng(seed).uniform(0.0, 1.0, _DAYS * 6), 4)


def _run(u: Array) -> Record:
    """The simple house under `u` (hours,), with a visitor who warms it on the fifth day, which no model knows."""
    T = np.full(u.size + 1, 20.0)
    time_s = np.arange(u.size + 1) * HOUR_S
    for k, level in enumerate(u):
        guest = 0.15 if _FIRST + 6 <= k < _FIRST + 12 else 0.0
        T[k + 1] = POLE * T[k] + (1 - POLE) * float(outdoor_C(time_s[k])) + GAIN_K * level + guest
    power = 1600.0 * (u > 0) + 2700.0 * u
    return Record(time_s, T, outdoor_C(time_s), 0 * time_s, u, power, 2.5 * power, origin=_ORIGIN)


@pytest.fixture(scope="module")
def model() -> ThermalModel:
    exact = simple_model()
    hours = (1, 2, 4, 8, 12, 24, 48)
    steady = GAIN_K / (1 - POLE)
    uncertainty = {f"step_response_{h}h_K": steady * (1 - POLE**h) for h in hours}
    uncertainty |= {f"step_response_{h}h_sd_K": 0.1 * steady * (1 - POLE**h) for h in hours}
    return replace(exact, cards=(ModelCard("exact", uncertainty=uncertainty),))


def _changed(u: Array, levels: Array) -> Array:
    other = u.copy()
    other[_FIRST : _FIRST + levels.size] = levels
    return other


@pytest.mark.parametrize("levels", [np.zeros(24), np.ones(24), np.repeat([0.0, 1.0, 0.2, 0.8], 6)])
def test_the_other_day_is_that_of_the_house(model: ThermalModel, levels: Array) -> None:
    u = _levels(1)
    record, other = _run(u), _run(_changed(u, levels))
    found = counterfactual(model, record, levels, start="2026-01-05 00:00")
    truth = other.T_zone_C[:, _FIRST + 1 : _FIRST + 25]
    assert np.abs(found.other_C - truth).max() < 1e-6
    # The visitor is in both days, so the effect is free of him.
    assert np.abs(found.effect_K - (truth - record.T_zone_C[:, _FIRST + 1 : _FIRST + 25])).max() < 1e-6
    assert (found.certified_low_K - 1e-9 <= found.effect_K).all()
    assert (found.effect_K <= found.certified_high_K + 1e-9).all()
    # At part load the machine of the model cycles at its lowest level, and its law misses what the house takes there.
    kWh = 1.6 * (levels > 0).sum() + 2.7 * levels.sum()
    assert found.energy_low_kWh[0] <= kWh <= found.energy_high_kWh[0]
    assert found.energy_kWh[0] == pytest.approx(record.power_W[0, _FIRST : _FIRST + 24].sum() / 1000.0)


@pytest.mark.parametrize(("less", "width"), [(1.0, 0.03), (0.8, 0.55)])
def test_energy_is_known_as_well_as_the_law_holds_on_the_days_of_the_record(
    model: ThermalModel, less: float, width: float
) -> None:
    """Of a law that says too little of all days nobody knows whether it does of the other levels."""
    run = _run(_levels(1))
    record = replace(run, power_W=model.power_by_law(0, run.u, run.T_out_C[:-1])[None] / less)
    found = counterfactual(model, record, np.repeat([0.0, 1.0], 12), start="2026-01-05 00:00")
    kWh = 4.3 * 12.0
    assert found.energy_low_kWh[0] - 1e-6 <= kWh
    assert found.energy_high_kWh[0] + 1e-6 >= kWh / less
    assert found.energy_high_kWh[0] - found.energy_low_kWh[0] < width * kWh


def test_what_the_law_missed_on_a_day_it_misses_under_other_levels_too(model: ThermalModel) -> None:
    run = _run(_levels(1))
    power_W = model.power_by_law(0, run.u, run.T_out_C[:-1])[None].copy()
    power_W[:, _FIRST : _FIRST + 24] *= 0.9
    found = counterfactual(model, replace(run, power_W=power_W), np.repeat([0.0, 1.0], 12), start="2026-01-05 00:00")
    assert found.energy_other_kWh[0] == pytest.approx(0.9 * 4.3 * 12.0, rel=0.03)
    assert found.energy_low_kWh[0] < found.energy_other_kWh[0] < found.energy_high_kWh[0]


def test_hot_water_on_the_meter_is_in_no_energy_and_stands_beside_them(model: ThermalModel) -> None:
    """Half an hour in each of two hours, so that a step holds twice the mean of the hour or nothing."""
    run, levels = _run(_levels(1)), np.repeat([0.0, 1.0], 12)
    water = OtherLoad((0.0,) * 6 + (900.0, 600.0) + (0.0,) * 16, 0.0, 5.0, (-20.0, 30.0), 800.0, (6, 7))
    of_day = water(run.time_s[:-1], run.T_out_C[:-1])
    comes_and_goes = of_day * np.where(np.arange(run.n_steps) // 24 % 2, 2.0, 0.0)
    with_water = replace(model, power=(replace(model.power[0], foreign=water),))
    alone = counterfactual(model, run, levels, start="2026-01-05 00:00")
    found = counterfactual(with_water, replace(run, power_W=run.power_W + of_day), levels, start="2026-01-05 00:00")
    assert (alone.beside_kWh[0], found.beside_kWh[0]) == (0.0, pytest.approx(1.5))
    for name in ("energy_kWh", "energy_other_kWh", "energy_low_kWh", "energy_high_kWh"):
        assert getattr(found, name)[0] == pytest.approx(getattr(alone, name)[0])
    unsteady = replace(run, power_W=run.power_W + comes_and_goes)
    of_two = [counterfactual(with_water, unsteady, levels, start=f"2026-01-0{day} 00:00") for day in (4, 5)]
    own = [counterfactual(model, run, levels, start=f"2026-01-0{day} 00:00") for day in (4, 5)]
    mean = [sum(float(one.energy_kWh[0]) for one in days) for days in (of_two, own)]
    assert mean[0] == pytest.approx(mean[1])  # right over days, which own_W by steps is not


def test_energy_that_follows_the_rooms_demand_has_a_band_that_says_so(model: ThermalModel) -> None:
    # Levels rise with the cold, and so does power; what the levels do by themselves was never tried.
    record = _run(_levels(1))
    noise = np.random.default_rng(4).normal(0.0, 0.1, record.n_steps)
    cold = np.clip((15.0 - record.T_out_C[:-1]) / 20.0 + noise, 0.0, 1.0)
    record = _run(cold)
    asked_W = 200.0 * (record.T_zone_C[0, :-1] - record.T_out_C[:-1])
    record = replace(record, power_W=asked_W[None])
    found = counterfactual(model, record, 0.2, start="2026-01-05 00:00")
    truth_kWh = 0.2 * float((found.other_C[0] - record.T_out_C[_FIRST + 1 : _FIRST + 25]).sum())
    scale = found.energy_kWh[0] / float(asked_W[_FIRST : _FIRST + 24].sum() / 1000.0)  # as the law has it
    assert found.energy_low_kWh[0] <= truth_kWh * scale <= 1.02 * found.energy_high_kWh[0]
    assert found.energy_high_kWh[0] - found.energy_low_kWh[0] > 0.4 * found.energy_other_kWh[0]


def test_the_band_is_the_uncertainty_of_the_effect(model: ThermalModel) -> None:
    u = np.full(_DAYS * 24, 0.5)
    found = counterfactual(model, _run(u), 1.0, start=_FIRST * HOUR_S, hours=24)
    # One change in one direction: the relative error of the step response is that of the effect.
    assert found.sd_K == pytest.approx(0.1 * np.abs(found.effect_K), rel=1e-6)
    without = replace(model, cards=(ModelCard("exact"),))
    assert np.isnan(counterfactual(without, _run(u), 1.0, start=_FIRST * HOUR_S).sd_K).all()


_TWO = Names(("hall", "bath"), ("one", "other"), ("pump",))


def _two_valves(model: ThermalModel) -> ThermalModel:
    """Two rooms such as the simple house, on the water of one machine."""
    pair = model.operator.of_actuator(0)
    return ThermalModel(
        BuildingOperator(_TWO.zones, _TWO.actuators, ((pair, None), (None, pair)), (0, 1)),
        model.power,
        (None, None),
        model.cards * 2,
        _TWO.machines,
        (0, 0),
        (0.5, 0.5),
    )


def _two_rooms(run: Record) -> Record:
    both = {name: np.repeat(getattr(run, name), 2, axis=0) for name in ("T_zone_C", "u", "heat_W")}
    return replace(run, **both, names=_TWO)


def test_valves_held_at_half_of_their_level_take_more_than_half(model: ThermalModel) -> None:
    """Emitters of valves that are less open are colder: by the linear law half of the levels was half of the energy."""
    u = np.repeat([0.3, 0.9, 0.6, 0.45, 0.75, 0.6], 24)  # means of days, which are held
    run = _run(u)
    by_law = replace(run, power_W=model.powers_by_law(run.u, run.T_out_C[:-1]))
    found = counterfactual(_two_valves(model), _two_rooms(by_law), 0.5 * u[_FIRST], start="2026-01-05 00:00")
    was, other = float(found.energy_kWh[0]), float(found.energy_other_kWh[0])
    assert 0.55 * was < other < 0.7 * was
    assert float(found.energy_low_kWh[0]) < 0.55 * was
    assert float(found.energy_high_kWh[0]) > 0.7 * was


def test_a_valve_that_is_little_open_in_the_record_leaves_its_energy_unknown(model: ThermalModel) -> None:
    u, hour = np.repeat([0.4, 0.9, 0.6, 0.5, 0.75, 0.6], 24), np.arange(_DAYS * 24)
    two, widths = _two_valves(model), []
    for hours in (48, 6):  # that the other valve was open
        record = replace(_two_rooms(_run(u)), u=np.array([u, np.where(hour < hours, 0.6, 0.0)]))
        record = replace(record, power_W=two.powers_by_law(record.u, record.T_out_C[:-1]))
        found = counterfactual(two, record, np.full((2, 24), 0.6), start="2026-01-05 00:00")
        widths.append(float((found.energy_high_kWh - found.energy_low_kWh)[0] / found.energy_other_kWh[0]))
    assert widths[1] > widths[0] + 0.1, widths


@pytest.mark.parametrize(("held", "asked", "known"), [(False, 0.4, False), (True, 0.4, True), (False, 1.0, True)])
def test_energy_of_valves_that_were_never_held_between_is_not_told(
    model: ThermalModel, held: bool, asked: float, known: bool
) -> None:
    """Rooms whose valves only open and close: 0.4 was 9.8 kWh (9.8 to 9.9) by the law, and 17.3 in the house."""
    u = np.where(np.random.default_rng(2).random(_DAYS * 24) < 0.5, 0.4 if held else 1.0, 0.0)
    u = np.repeat(u[::3], 3)
    found = counterfactual(_two_valves(model), _two_rooms(_run(u)), asked, start="2026-01-05 00:00")
    assert np.isfinite(found.energy_kWh).all()
    assert (found.energy_high_kWh[0] < 2.0 * found.energy_other_kWh[0]) == known


def test_a_gap_in_the_day_stays_a_gap(model: ThermalModel) -> None:
    u = _levels(2)
    record = _run(u)
    T = record.T_zone_C.copy()
    T[0, _FIRST + 3 : _FIRST + 6] = np.nan
    found = counterfactual(model, replace(record, T_zone_C=T), 0.0, start="2026-01-05")
    assert np.isnan(found.other_C[0, 2:5]).all()
    assert np.isfinite(found.effect_K).all()
    whole = counterfactual(model, record, 0.0, start="2026-01-05")
    assert found.effect_K == pytest.approx(whole.effect_K)


def test_levels_that_were_not_measured_are_not_invented(model: ThermalModel) -> None:
    record = _run(_levels(2))
    u = record.u.copy()
    u[0, _FIRST + 20 : _FIRST + 24] = np.nan
    gap = replace(record, u=u)
    with pytest.raises(DataError, match="u was not measured in 4 of the 24 steps from 2026-01-05 on"):
        counterfactual(model, gap, 0.0, start="2026-01-05")
    assert np.isfinite(counterfactual(model, gap, 0.0, start="2026-01-05", hours=20).effect_K).all()


@pytest.mark.parametrize(
    ("start", "levels", "message"),
    [
        ("2026-02-01", 0.5, "not inside the record, which goes from 2026-01-01"),
        ("noon", 0.5, "'noon' is not a time stamp"),
        ("05.01.2026", 0.5, "'05.01.2026': is its day or its month first"),
        ("1/5/26 12:00", 0.5, "'1/5/26 12:00': is its day or its month first"),
        ("2026-01-05", np.full(24, 1.5), r"inside \[0, 1\]"),
        ("2026-01-05", np.full(24, np.nan), r"inside \[0, 1\]"),
    ],
)
def test_what_cannot_be_asked_says_why(model: ThermalModel, start: str, levels: Array, message: str) -> None:
    with pytest.raises(DataError, match=message):
        counterfactual(model, _run(_levels(3)), levels, start=start)


@pytest.fixture
def house(tmp_path: Path, model: ThermalModel) -> Path:
    """A folder with a model, a table of measurements and its map."""
    model.save(tmp_path / "model")
    _measured(tmp_path, _ORIGIN)
    return tmp_path


def _measured(folder: Path, origin: pd.Timestamp) -> None:
    """Write six days from `origin` on, in its zone, as a table of measurements and a map."""
    record = replace(_run(_levels(4)), origin=origin)
    table = pd.DataFrame(
        {
            "at": [at.isoformat() for at in record.stamps()],
            "room": record.T_zone_C[0],
            "out": record.T_out_C,
            "valve": np.append(record.u[0], np.nan),
            "power": np.append(record.power_W[0], np.nan),
        }
    )
    table.to_csv(folder / "data.csv", index=False)
    zone = f", zone: {origin.tz}" if origin.tz is not None else ""
    (folder / "map.yaml").write_text(
        f"time: {{column: at{zone}}}\n"
        "outdoor: out\nstep: 60min\nzones: {zone: {temperature: room}}\n"
        "actuators: {actuator: {zone: zone, level: valve}}\nmachines: {machine: {power: power}}\n"
    )


def _tf(folder: Path, *words: str) -> tuple[int, str]:
    given = ["--model", str(folder / "model"), "--data", str(folder / "data.csv"), "--map", str(folder / "map.yaml")]
    said = CliRunner().invoke(cli, [words[0], *given, *words[1:]])
    if said.exception is not None and not isinstance(said.exception, SystemExit):
        return -1, str(said.exception)
    return said.exit_code, said.output


@pytest.mark.parametrize("words", [("forecast",), ("counterfactual", "--level", "0.3")])
def test_a_map_in_which_an_actuator_does_something_else_is_refused(house: Path, words: tuple[str, ...]) -> None:
    rules = (house / "map.yaml").read_text()
    (house / "map.yaml").write_text(rules.replace("zone: zone,", "zone: zone, mode: cooling,"))
    code, said = _tf(house, *words, "--start", "2026-01-05")
    assert code != 0
    assert f"actuator is heating zone, fed by machine, by the map {house / 'map.yaml'} cooling zone" in said


def test_counterfactual_command(house: Path) -> None:
    (house / "other.csv").write_text("time,u\n2026-01-05 00:00,0\n2026-01-05 06:00,1\n")
    code, said = _tf(house, "counterfactual", "--start", "2026-01-05", "--schedule", str(house / "other.csv"),
                     "--out", str(house / "cf.json"), "--plot", str(house / "cf.png"))  # fmt: skip
    assert code == 0, said
    assert "Energy of machine" in said
    assert "other loads" not in said
    assert json.loads((house / "cf.json").read_text())["energy_kWh"]["machine"]["beside"] == 0.0
    rows = json.loads((house / "cf.json").read_text())["rows"]
    assert [row["u_other"] for row in rows] == [0.0] * 6 + [1.0] * 18
    u = _levels(4)
    truth = _run(_changed(u, np.repeat([0.0, 1.0], [6, 18]))).T_zone_C[0, _FIRST + 1 : _FIRST + 25]
    assert [row["T_other_C"] for row in rows] == pytest.approx(truth.tolist(), abs=0.02)
    assert (house / "cf.png").stat().st_size > 5000


@pytest.mark.slow
def test_forecast_of_a_past_day_beside_what_was_measured(house: Path) -> None:
    code, said = _tf(house, "forecast", "--start", "2026-01-05", "--out", str(house / "fc.csv"), "--plot",
                     str(house / "fc.svg"))  # fmt: skip
    assert code == 0, said
    assert "RMSE" in said
    table = pd.read_csv(house / "fc.csv")
    assert len(table) == 24
    assert table["T_zone_C"].between(table["T_low_C"], table["T_high_C"]).all()
    assert np.abs(table["T_zone_C"] - table["measured_C"]).max() < 2.0


@pytest.mark.slow
def test_forecast_beside_a_hole_in_what_was_measured(house: Path) -> None:
    table = pd.read_csv(house / "data.csv")
    table.loc[table["at"].between("2026-01-05T12", "2026-01-05T20"), "room"] = None
    whole = (house / "data.csv").read_bytes()
    table.to_csv(house / "data.csv", index=False)
    code, said = _tf(house, "forecast", "--start", "2026-01-05")
    (house / "data.csv").write_bytes(whole)
    assert code == 0, said
    assert "–" in said
    assert "nan" not in said


@pytest.mark.slow
def test_forecast_of_the_coming_day_needs_only_weather(house: Path) -> None:
    time_s = _DAYS * DAY_S + np.arange(30) * HOUR_S
    ahead = pd.DataFrame({"at": _ORIGIN + pd.to_timedelta(time_s, unit="s"), "out": outdoor_C(time_s)})
    ahead.to_csv(house / "ahead.csv", index=False)
    answers = []
    for level in ("0", "1"):
        code, said = _tf(house, "forecast", "--forecast", str(house / "ahead.csv"), "--level", level, "--out",
                         str(house / f"{level}.csv"))  # fmt: skip
        assert code == 0, said
        answers.append(pd.read_csv(house / f"{level}.csv")["T_zone_C"].to_numpy())
    steady = GAIN_K / (1 - POLE)
    assert answers[1] - answers[0] == pytest.approx(steady * (1 - POLE ** np.arange(1, 25)), abs=1e-3)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("forecast",), "give --forecast FILE"),
        (("forecast", "--forecast", "x.csv"), "give the levels ahead"),
        (("forecast", "--start", "2027-01-01"), "are not in the record"),
        (("counterfactual", "--start", "2026-01-05"), "either --level or --schedule"),
        (
            ("counterfactual", "--start", "2026-01-05", "--level", "0", "--out", "x.txt"),
            "end the name in .csv or .json",
        ),
        (("counterfactual", "--start", "2026-01-05", "--schedule", "nowhere.csv"), "nowhere.csv: cannot be read"),
        (("counterfactual", "--start", "2026-01-05", "--level", "0", "--hours", "inf"), "'--hours': inf is not in"),
        (("forecast", "--start", "2026-01-05", "--hours", "nan"), "'--hours': nan is no number"),
        (("forecast", "--start", "2026-01-05", "--level", "nan"), "'--level'"),
    ],
)
def test_commands_say_what_is_missing(house: Path, words: tuple[str, ...], message: str) -> None:
    code, said = _tf(house, *words)
    assert code != 0
    assert message in said


def test_a_schedule_that_begins_too_late_or_lacks_a_column(house: Path) -> None:
    file = house / "late.csv"
    for text, message in (
        ("time,u\n2026-01-06 00:00,0\n", "after the stretch"),
        ("time,valve\n2026-01-05 00:00,0\n", "no column 'actuator'"),
        ("when,u\n2026-01-05 00:00,0\n", "no column 'time'"),
        ("time,u\n2026-01-05 00:00,0\n2026-01-05 00:00,1\n", "row 3 is not later"),
        ("time,u\n2026-01-05 00:00,0\n,1\n", "row 3, time 'nan' is not a time stamp"),
        ("time,u\n05.01.2026 00:00,0\n05.01.2026 01:00,1\n", "row 2, time '05.01.2026 00:00': is its day or its"),
        ("time,u\n", "no rows"),
        ("time,u\n2026-01-05 00:00,0\n2026-01-05 06:00,50\n", "late.csv: row 3, u is 50: give one from 0 to 1"),
        ("time,u\n2026-01-05 00:00,n/a\n", "late.csv: row 2, u is nan: give one"),
    ):
        file.write_text(text)
        _, said = _tf(house, "counterfactual", "--start", "2026-01-05", "--schedule", str(file))
        assert message in said


@pytest.mark.parametrize(
    ("origin", "start", "schedule", "levels"),
    [
        # Rows of a plan of `tf-mpc plan` have the offset of their time.
        (
            "2026-03-25 00:00+01:00",
            "2026-03-29 00:00",
            "2026-03-29 00:00:00+01:00,0.5\n2026-03-29 01:00:00+01:00,0.2\n2026-03-29 03:00:00+02:00,0.7\n",
            [0.5, 0.2, 0.7, 0.7],
        ),
        # Of two hours with one name the first is meant.
        (
            "2026-10-21 00:00+02:00",
            "2026-10-25 02:00",
            "2026-10-25 01:00,0\n2026-10-25 03:00,1\n",
            [0.0, 0.0, 1.0, 1.0],
        ),
    ],
)
def test_a_stretch_over_a_change_of_the_clock(
    house: Path, origin: str, start: str, schedule: str, levels: list[float]
) -> None:
    _measured(house, pd.Timestamp(origin).tz_convert("Europe/Brussels"))
    (house / "other.csv").write_text("time,u\n" + schedule)
    code, said = _tf(house, "counterfactual", "--start", start, "--hours", "4", "--schedule", str(house / "other.csv"),
                     "--out", str(house / "cf.json"))  # fmt: skip
    assert code == 0, said
    assert [row["u_other"] for row in json.loads((house / "cf.json").read_text())["rows"]] == levels


@pytest.mark.parametrize(
    ("origin", "start", "message"),
    [
        ("2026-01-01", "2026-01-05T00:00Z", "--start '2026-01-05T00:00Z' has a time zone and the record has none"),
        ("2026-03-25 00:00+01:00", "2026-03-29 02:30", "does not exist in Europe/Brussels, where summer time begins"),
        ("2026-01-01", "", "--start '' is not a time stamp"),
        ("2026-01-01", "noon", "--start 'noon' is not a time stamp"),
    ],
)
@pytest.mark.parametrize("command", [("counterfactual", "--level", "0"), ("forecast",)])
def test_a_start_that_is_no_time_of_the_record_says_why(
    house: Path, origin: str, start: str, message: str, command: tuple[str, ...]
) -> None:
    at = pd.Timestamp(origin)
    _measured(house, at if at.tz is None else at.tz_convert("Europe/Brussels"))
    code, said = _tf(house, *command, "--start", start)
    assert code != 0
    assert message in said


def test_one_step_is_drawn(house: Path) -> None:
    code, said = _tf(house, "counterfactual", "--start", "2026-01-05", "--hours", "1", "--level", "0", "--plot",
                     str(house / "cf.png"))  # fmt: skip
    assert code == 0, said
    assert (house / "cf.png").stat().st_size > 5000


def test_the_exact_house_is_the_plant() -> None:
    """The loop above is `SimpleHouse`."""
    plant = SimpleHouse()
    plant.reset(0.0, 0.0)
    u = _levels(5)[:48]
    for level in u:
        last = plant.advance(float(level), HOUR_S)
    T = 21.0
    for k, level in enumerate(u):
        T = POLE * T + (1 - POLE) * float(outdoor_C(k * HOUR_S)) + GAIN_K * level
    assert float(last.T_zone_C[0]) == pytest.approx(T)
