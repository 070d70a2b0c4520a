"""Prices as they are billed: fees by the clock, peaks of months, and a bill that adds up to them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from thermoforce_mpc.cli import cli
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.plants.registry import tariff_of
from thermoforce_mpc.scenario.bill import Bill, Peak, read_bill

BILLS = Path(__file__).parents[2] / "configs" / "bills"


def quarters(begin, days):
    return pd.date_range(begin, periods=96 * days, freq="15min", tz="Europe/Berlin")


@pytest.mark.parametrize("path", sorted(BILLS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_example_is_a_bill_with_its_source_and_bills_a_month(path):
    bill = read_bill(path)
    at = quarters("2025-01-01", 31)
    energy = np.full(at.size, bill.energy if isinstance(bill.energy, float) else 0.1)
    items = bill.of_month(energy, np.full(at.size, 2.0), at)
    assert items["energy"] == pytest.approx(2.0 * 744 * energy[0] * (1 + bill.vat))
    assert sum(items.values()) > items["energy"]


def test_grid_fees_follow_the_clock_of_the_building_in_the_quarters_that_have_them():
    """EWW Anfried 2025: 3.45 ct from 1 to 4, 10.84 from 17 to 19, else 8.62 ct; from April on 8.62 throughout."""
    bill = read_bill(BILLS / "germany_module_3.yaml")

    def fee(begin):
        at = quarters(begin, 1)
        price = bill.at(np.zeros(96), at) / 1.19 - bill.supplier_per_kWh - bill.levies_per_kWh
        return dict(zip(at.strftime("%H:%M"), np.round(price, 4), strict=True))

    winter, summer = fee("2025-02-05"), fee("2025-05-05")
    got = [winter[at] for at in ("00:45", "01:00", "03:45", "04:00", "16:45", "17:00", "19:00")]
    assert got == [0.0862, 0.0345, 0.0345, 0.0862, 0.0862, 0.1084, 0.0862]
    assert set(summer.values()) == {0.0862}


def test_a_bill_adds_up_to_price_times_energy_and_what_does_not_depend_on_it():
    bill = read_bill(BILLS / "germany_module_3.yaml")
    at = quarters("2025-03-01", 31)
    rng = np.random.default_rng(1)
    energy, power = rng.uniform(-0.05, 0.4, at.size), rng.uniform(0.0, 3.0, at.size)
    items = bill.of_month(energy, power, at)
    by_price = float((bill.at(energy, at) * power).sum()) / 4.0
    assert sum(items.values()) == pytest.approx(by_price + 5.0 * 1.19)


def test_the_peak_of_a_month_is_its_highest_quarter_hour_but_counts_at_least():
    """Fluvius: 40.4 EUR per kW and year, at least 2.5 kW."""
    bill = read_bill(BILLS / "flanders.yaml")
    at = quarters("2025-11-01", 30)
    power = np.full(at.size, 0.4)
    low = bill.of_month(np.zeros(at.size), power, at)["peak"]
    power[1000] = 6.0
    high = bill.of_month(np.zeros(at.size), power, at)["peak"]
    assert low == pytest.approx(2.5 * 40.4 / 12 * 1.06)
    assert high == pytest.approx(6.0 * 40.4 / 12 * 1.06)


def test_three_hours_count_only_of_distinct_days():
    """Glitre Nett: the mean of the three highest daily hours, in steps."""
    bill = read_bill(BILLS / "norway.yaml")
    at = quarters("2025-11-01", 30)
    power = np.full(at.size, 1.0)
    power[:96] = 14.0  # one day alone: (14 + 1 + 1) / 3 = 5.3 kW
    assert bill.of_month(np.zeros(at.size), power, at)["peak"] == pytest.approx(335.0)
    power[5 * 96 + 4 : 5 * 96 + 8] = 14.0  # an hour of another day: (14 + 14 + 1) / 3 = 9.7 kW
    assert bill.of_month(np.zeros(at.size), power, at)["peak"] == pytest.approx(335.0)
    power[9 * 96 + 4 : 9 * 96 + 8] = 14.0
    assert bill.of_month(np.zeros(at.size), power, at)["peak"] == pytest.approx(690.0)


def test_a_kilowatt_more_costs_what_the_next_step_does():
    peak = read_bill(BILLS / "norway.yaml").peak
    assert peak.per_kW(3.0) == pytest.approx((335 - 195) / 3.0)
    assert peak.per_kW(7.0) == pytest.approx((690 - 335) / 5.0)
    assert Peak.model_validate({"of": "highest", "steps": [{"per_month": 9.0}]}).per_kW(7.0) == 0.0, "one fee for all"


def test_a_simulated_building_pays_by_the_same_bill(tmp_path):
    (tmp_path / "prices.csv").write_text("time,price\n0,0.10\n43200,0.30\n31536000,0.10\n")
    bill = (BILLS / "germany_module_3.yaml").read_text().replace("energy: null", "energy: prices.csv")
    (tmp_path / "bill.yaml").write_text(bill)
    hours = np.array([2.0, 5.0, 18.0]) * 3600.0
    known = Bill.model_validate(read_bill(tmp_path / "bill.yaml").model_dump())
    expected = known.per_kWh(np.array([0.1, 0.1, 0.3]), np.ones(3), np.ones(3), hours / 3600.0)
    assert tariff_of(tmp_path / "bill.yaml")(hours) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"peak": {"of": "highest"}}, "per_kW_year, or steps"),
        ({"peak": {"of": "highest", "steps": [{"up_to_kW": 2, "per_month": 1}]}}, "the last none"),
        ({"grid": {"windows": [{"hours": "25:00-26:00", "per_kWh": 0.1}]}}, "hours"),
        ({"grid": {"windows": [{"hours": "7:00-7:00", "per_kWh": 0.1}]}}, "different times"),
        ({"vat": 19}, "vat"),
        ({"energy": -0.2}, "energy: -0.2 is no price of every kWh"),
        ({"levy": 0.1}, "levy"),
        ({"energy": None, "export_only_from": 0.0}, "needs export_per_kWh"),
        ({"export_per_kWh": 0.08, "export_only_from": 0.0}, "prices of energy that change"),
    ],
)
def test_what_is_no_bill_is_refused_with_its_key(tmp_path, change, says):
    import yaml

    path = tmp_path / "bill.yaml"
    path.write_text(yaml.safe_dump({"source": "a contract", "energy": 0.2} | change))
    with pytest.raises(ConfigError, match=says) as error:
        read_bill(path)
    assert str(path) in str(error.value)


def test_peak_of_no_day_is_none():
    assert Peak(of="three_days", per_kW_year=40.0).of_days(np.array([np.nan])) == 0.0


@pytest.mark.parametrize("path", sorted(BILLS.glob("*.yaml")), ids=lambda path: path.stem)
def test_a_bill_is_validated_as_one(path, tmp_path):
    assert CliRunner().invoke(cli, ["validate", str(path)]).output == f"{path}: valid bill\n"
    wrong = tmp_path / "bill.yaml"
    wrong.write_text(path.read_text(encoding="utf-8").replace("energy:", "enrgy:"), encoding="utf-8")
    said = str(CliRunner().invoke(cli, ["validate", str(wrong)]).exception)
    assert "enrgy: unknown key, did you mean 'energy'?" in said
    assert "testcase" not in said
