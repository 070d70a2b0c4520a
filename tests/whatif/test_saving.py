"""Verified saving on made days whose truth is known, the command, and cases of the bench."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from benchmarks.operation import saving as bench
from thermoforce_mpc.cli import cli
from thermoforce_mpc.data import DAY_S, Names, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.whatif.days import days_of
from thermoforce_mpc.whatif.saving import verified_saving

_BEFORE, _AFTER = 28, 21


def _record(seed: int, less: float, scatter: float = 0.06) -> Record:
    """Hourly record of 49 days in which, from day 28 on, `less` of the energy is not used."""
    rng = np.random.default_rng(seed)
    n = 24 * (_BEFORE + _AFTER)
    hours = np.arange(n + 1)
    fronts = np.cumsum(rng.normal(0.0, 0.5, n + 1))
    T_out = 3.0 + 3.0 * np.sin(2 * np.pi * (hours - 9) / 24) + fronts - np.linspace(0, fronts[-1], n + 1)
    sun = np.maximum(0.0, 300.0 * np.sin(2 * np.pi * (hours - 6) / 24)) * rng.uniform(0.3, 1.0, 50).repeat(24)[: n + 1]
    demand = 150.0 * (20.0 - T_out[:-1]) - 2.0 * sun[:-1]
    of_day = 1.0 + scatter * rng.normal(size=_BEFORE + _AFTER)
    power = np.maximum(demand, 0.0) * of_day.repeat(24)
    power[24 * _BEFORE :] *= 1.0 - less
    nothing = np.full(n, np.nan)
    time_s = 3600.0 * hours
    return Record(time_s, np.full(n + 1, 20.5), T_out, sun, nothing, power, nothing, origin=pd.Timestamp("2026-01-01"))


def _halves(record: Record) -> tuple[Record, Record]:
    return record.slice(0, 24 * _BEFORE), record.slice(24 * _BEFORE, record.n_steps)


@pytest.mark.slow
def test_the_interval_holds_the_truth_and_claims_what_is_there() -> None:
    held = claimed = 0
    for seed in range(12):
        record = _record(seed, 0.2)
        found = verified_saving(*_halves(record))
        truth = found.measured_kWh * 0.2 / 0.8
        held += found.low_kWh <= truth <= found.high_kWh
        claimed += found.claimed
    assert held >= 10
    assert claimed >= 10


@pytest.mark.slow
def test_nothing_is_claimed_where_nothing_was_saved() -> None:
    found = [verified_saving(*_halves(_record(seed, 0.0))) for seed in range(12)]
    assert sum(f.claimed for f in found) <= 1
    assert "no saving" in next(f for f in found if not f.claimed).in_words()


def test_a_colder_month_after_is_no_loss() -> None:
    # A fifth less is used than the old operation would, although it is 6 K colder and more is used than before.
    record = _record(3, 0.0)
    T_out = record.T_out_C.copy()
    T_out[24 * _BEFORE :] -= 6.0
    power = record.power_W.copy()
    power[0, 24 * _BEFORE :] += 150.0 * 6.0
    power[0, 24 * _BEFORE :] *= 0.8
    found = verified_saving(*_halves(replace(record, T_out_C=T_out, power_W=power)))
    assert found.after.energy_kWh.mean() > found.before.energy_kWh.mean()
    assert found.claimed
    assert any("extrapolated" in note for note in found.notes)


def test_days_with_gaps_are_left_out() -> None:
    record = _record(4, 0.2)
    power = record.power_W.copy()
    power[0, 24 * 5 : 24 * 8] = np.nan
    found = verified_saving(*_halves(replace(record, power_W=power)))
    assert found.before.n == _BEFORE - 3
    assert any("3 days before" in note for note in found.notes)


@pytest.mark.parametrize(
    ("days", "change", "message"),
    [
        (8, {}, "before: 8 whole days"),
        (
            28,
            {"power_W": np.full((1, 28 * 24), np.nan)},
            "neither power nor heat.*no power_W before and no heat_W before",
        ),
    ],
)
def test_what_cannot_be_verified_says_why(days: int, change: dict[str, object], message: str) -> None:
    before, after = _halves(_record(5, 0.2))
    with pytest.raises(DataError, match=message):
        verified_saving(replace(before.slice(before.n_steps - 24 * days, before.n_steps), **change), after)  # type: ignore[arg-type]


def test_cold_is_energy_like_heat() -> None:
    record = _record(7, -0.3)
    by_heat = replace(record, power_W=np.full_like(record.power_W, np.nan), heat_W=record.power_W)
    by_cold = replace(by_heat, heat_W=-record.power_W)
    heat, cold = (verified_saving(*_halves(r)) for r in (by_heat, by_cold))
    assert cold.measured_kWh > 0.0
    assert (cold.saved_kWh, cold.low_kWh, cold.high_kWh) == (heat.saved_kWh, heat.low_kWh, heat.high_kWh)
    assert cold.in_words().startswith("no saving: more was used; -")
    assert "kWh of heat (" in cold.in_words()


@pytest.mark.parametrize("wrong", ["all", "some days"])
def test_energy_below_0_is_no_saving(wrong: str) -> None:
    record = _record(13, 0.0)
    power = record.power_W.copy()
    if wrong == "all":
        power *= -1.0
    else:
        power[0, 24 * 40 : 24 * 42] *= -1.0  # sunny days on which more was fed in than used
    part, day = ("before", "2026-01-01") if wrong == "all" else ("after", "2026-02-10")
    with pytest.raises(DataError, match=rf"{part}: the energy of the day from {day} 00:00:00 is -.*check the meter"):
        verified_saving(*_halves(replace(record, power_W=power)))


def test_a_meter_that_reads_a_little_below_0_while_all_is_off_is_no_error() -> None:
    record = _record(15, 0.0)
    power = record.power_W.copy()
    power[0, 24 * _BEFORE :] = -0.5
    assert verified_saving(*_halves(replace(record, power_W=power))).claimed


def test_a_reading_without_end_is_a_gap() -> None:
    record = _record(14, 0.2)
    power = record.power_W.copy()
    power[0, 24 * 40 + 3] = np.inf
    found = verified_saving(*_halves(replace(record, power_W=power)))
    assert np.isfinite([found.low_kWh, found.high_kWh, found.measured_kWh]).all()


def test_before_and_after_are_metered_alike() -> None:
    # The heat pump's power meter came with the change: heat, of which there is three times as much, is all that is
    # known of both.
    record = _record(8, 0.0)
    power = record.power_W.copy()
    power[0, : 24 * _BEFORE] = np.nan
    found = verified_saving(*_halves(replace(record, power_W=power, heat_W=3.0 * record.power_W)))
    assert found.meter == "heat_W"
    assert not found.claimed
    assert found.measured_kWh == pytest.approx(3.0 * np.nansum(power) / 1000.0)
    with pytest.raises(DataError, match="there is no power_W before and no heat_W before, heat_W after; map a meter"):
        verified_saving(*_halves(replace(record, power_W=power)))


@pytest.mark.parametrize("apart_days", [365, _BEFORE])
def test_records_of_two_years_are_on_one_calendar(apart_days: int) -> None:
    # The first of a year and the next; then before and after that adjoin over new year's night.
    before, after = _halves(replace(_record(10, 0.1), origin=pd.Timestamp("2025-01-01")))
    start_s = (365 - apart_days) * DAY_S
    before = replace(before, time_s=before.time_s + start_s)
    in_its_year = replace(after, time_s=after.time_s - after.time_s[0], origin=pd.Timestamp("2026-01-01"))
    one_clock = replace(in_its_year, time_s=in_its_year.time_s + 365 * DAY_S, origin=before.origin)
    found, expected = (verified_saving(before, r) for r in (in_its_year, one_clock))
    assert found.after.number[0] - found.before.number[0] == apart_days
    assert found.to_json() == expected.to_json()


def test_records_that_overlap_are_refused() -> None:
    before, after = _halves(_record(10, 0.1))
    for origin in (None, before.origin):
        of_next_year = replace(after, time_s=after.time_s - 20 * DAY_S, origin=origin)
        with pytest.raises(DataError, match="records overlap: before is from"):
            verified_saving(replace(before, origin=origin), of_next_year)
    with pytest.raises(DataError, match="time zones: the record after has one"):
        verified_saving(before, replace(after, origin=pd.Timestamp("2026-01-01", tz="UTC")))


@pytest.mark.parametrize("zone", ["UTC", "Europe/Brussels", "Australia/Sydney"])
def test_a_weekend_is_one_on_both_hemispheres(zone: str) -> None:
    record = _record(11, 0.0)
    # Monday, 1 June 2026, where the clock is not that of 1 January.
    june = replace(record, time_s=record.time_s + 151 * DAY_S, origin=pd.Timestamp("2026-01-01", tz=zone))
    assert days_of(june, "power_W", "june").weekend.tolist() == 7 * (5 * [False] + 2 * [True])


def test_days_without_sun_are_left_out_where_it_is_metered() -> None:
    record = _record(12, 0.2)
    sun = record.solar_W_m2.copy()
    sun[24 * 5 : 24 * 8 + 1] = np.nan
    assert verified_saving(*_halves(replace(record, solar_W_m2=sun))).before.n == _BEFORE - 3
    assert verified_saving(*_halves(replace(record, solar_W_m2=0.0 * sun + np.nan))).before.n == _BEFORE
    silent_at_night = np.where(record.solar_W_m2 > 0.0, record.solar_W_m2, np.nan)
    assert verified_saving(*_halves(replace(record, solar_W_m2=silent_at_night))).before.n == _BEFORE


def test_a_machine_without_a_meter_is_named() -> None:
    record = _record(9, 0.2)
    names = Names(("room",), ("valve", "fan"), ("boiler", "chiller"))
    nothing = np.full((2, record.n_steps), np.nan)
    power = np.concatenate([record.power_W, nothing[:1]])
    two = Record(
        record.time_s, record.T_zone_C, record.T_out_C, record.solar_W_m2, nothing, power, nothing, names=names
    )  # fmt: skip
    with pytest.raises(DataError, match=r"no power_W\[chiller\] before, power_W\[chiller\] after and no heat_W"):
        verified_saving(*_halves(two))


def test_the_command(tmp_path: Path) -> None:
    record = _record(6, 0.25)
    spiked = record.T_out_C + 40.0 * (np.arange(record.T_out_C.size) == 300)
    pd.DataFrame(
        {"at": record.stamps(), "room": record.T_zone_C[0], "out": spiked, "sun": record.solar_W_m2,
         "power": np.append(record.power_W[0], np.nan)}
    ).to_csv(tmp_path / "d.csv", index=False)  # fmt: skip
    (tmp_path / "map.yaml").write_text(
        "time: {column: at}\noutdoor: out\nsun: {column: sun}\nstep: 60min\nzones: {room: {temperature: room}}\n"
        "machines: {boiler: {power: power}}\n"
    )
    words = ["saving", "--data", str(tmp_path / "d.csv"), "--map", str(tmp_path / "map.yaml"), "--changed"]
    said = CliRunner().invoke(
        cli, [*words, "2026-01-29", "--out", str(tmp_path / "s.json"), "--plot", str(tmp_path / "s.png")]
    )
    assert said.exit_code == 0, said.output
    assert said.output.startswith("saved +")
    assert "flagged in outdoor: 1 by rule 'jump'" in said.output
    kept = json.loads((tmp_path / "s.json").read_text())
    assert kept["claimed"]
    assert kept["meter"] == "power_W"
    assert (kept["days_before"], kept["days_after"]) == (28, 21)
    assert kept["low_kWh"] < kept["measured_kWh"] * 0.25 / 0.75 < kept["high_kWh"]
    late = CliRunner().invoke(cli, [*words, "2027-01-01"])
    assert isinstance(late.exception, DataError)
    assert "not inside the measurements (2026-01-01" in str(late.exception)
    for option, at in (("--until", "2025-06-01"), ("--from", "2027-06-01")):
        none_left = CliRunner().invoke(cli, [*words, "2026-01-29", option, at])
        assert f"{option} {at}: leaves nothing of the measurements (2026-01-01" in str(none_left.exception)
    with_zone = CliRunner().invoke(cli, [*words, "2026-01-29T00:00Z"])
    assert isinstance(with_zone.exception, DataError)
    assert "--changed '2026-01-29T00:00Z' has a time zone and the record has none" in str(with_zone.exception)


@pytest.mark.slow
def test_a_case_of_the_bench_knows_the_truth() -> None:
    case = replace(bench.cases(5, 7, before_days=10, after_days=7)[4], change="2 K lower on weekdays", number=4)
    row = bench.run_case(case)
    assert row["true_kWh"] > 0.0
    assert row["low_kWh"] < row["saved_kWh"] < row["high_kWh"]
    idle = bench.run_case(replace(case, change="nothing"))
    assert idle["true_kWh"] == 0.0


def test_targets_of_the_bench_count_false_claims_and_misses() -> None:
    row = {"true_kWh": 0.0, "low_kWh": 1.0, "high_kWh": 3.0, "saved_kWh": 2.0, "baseline_kWh": 10.0}
    rows = [row | {"holds": False, "claimed": True}, row | {"true_kWh": 2.0, "holds": True, "claimed": True}]
    found = bench.targets(rows)
    assert found[0].value == 0.5
    assert not found[0].holds
    claims = next(t for t in found if "without one" in t.name)
    assert (claims.value, claims.holds) == (1, False)
