"""KPIs on cases one can work out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.kpis import compute_kpis, peak_power

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
    power = np.where((TIME > 900) & (TIME <= 1350), 4000.0, 0.0)  # half of the second quarter
    assert peak_power(TIME, power) == pytest.approx(2000.0, rel=0.04)


def test_prices_are_weighted_by_power():
    price = np.where(TIME < 3600, 0.1, 0.3)
    power = np.where(TIME < 3600, 0.0, 1000.0)
    found = kpis(price_per_kWh=price, power_W=power)
    assert found["cost_tot"] / found["ener_tot"] == pytest.approx(0.3, rel=0.01)


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
