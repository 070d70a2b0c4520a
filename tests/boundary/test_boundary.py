from __future__ import annotations

import gzip

import numpy as np
import pytest

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.periods import NAMES, heating_windows, kept_windows
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError
from thermoforce_mpc.files import DoubtfulInput
from thermoforce_mpc.plants.embedded import EmbeddedPlant


def test_the_dynamic_tariff_is_dear_from_seven_to_the_sample_of_twenty_two():
    hours = np.array([6.75, 7.0, 21.75, 22.0, 22.25])
    np.testing.assert_allclose(tariffs.dynamic(hours * HOUR_S), [0.2383, 0.2666, 0.2666, 0.2666, 0.2383])


def test_the_synthetic_spot_is_deterministic_hourly_and_near_its_mean():
    a, b = tariffs.synthetic_spot(), tariffs.synthetic_spot()
    time_s = np.arange(8760) * HOUR_S
    np.testing.assert_array_equal(a(time_s), b(time_s))
    np.testing.assert_array_equal(a(time_s), a(time_s + 1800))
    assert a(time_s).mean() == pytest.approx(0.24, abs=0.01)
    assert a(np.array([365 * DAY_S])) == a(np.array([0.0]))


def test_a_tariff_of_ones_own_is_held_forward(tmp_path):
    path = tmp_path / "prices.csv"
    path.write_text("time,price\n0,0.1\n3600,-0.2\n7200,0.3\n")
    tariff = tariffs.tariff_from_file(path)
    np.testing.assert_allclose(tariff(np.array([0, 3599, 3600, 7200, 9000])), [0.1, 0.1, -0.2, 0.3, 0.3])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n", "columns 'time'"),
        ("time,price\n0,x\n", r"line 2, column 'price': 'x' is not a finite number"),
        ("time,price\n0,1\n60,nan\n", r"line 3, column 'price': 'nan'"),
        ("time,price\n0,1\n60\n", r"line 3, column 'price': '' is not"),
        ("time,cost\n0,1\n60,1\n", "PriceElectricPowerHighlyDynamic"),
        ("time,price\n0,1\n", "only one price"),
        ("time,price\n3600,1\n7200,1\n", "start at 0"),
        ("time,price\n0,1\n0,2\n", "must rise"),
        ("time,price\n-1e308,1\n1e308,2\n", "a year ends at"),
        ("time,price\n0,1\n34560000,2\n", "to 3.456e\\+07 s; a year ends at 3.1536e\\+07 s: give the prices of one"),
        ("time,price\n0,1\n60,1e308\n", "a price of 1e\\+308 per kWh"),
        ("time,price\n0,1\n60," + "9" * 200_000 + "\n", "line 3: not CSV"),
        ("time,price\n" + "0,1\n" * 600_100, "more than 600,000 prices"),
        ("", "columns 'time'"),
    ],
)
def test_a_tariff_file_that_cannot_be_used_is_refused(tmp_path, text, message):
    path = tmp_path / "prices.csv"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        tariffs.tariff_from_file(path)


def test_a_packed_file_of_any_length_is_read_no_further_than_its_bound(tmp_path):
    path = tmp_path / "prices.csv.gz"
    with gzip.open(path, "wb") as file:
        for _ in range(40):
            file.write(b"\n" * 1_000_000)
    with pytest.raises(ConfigError, match="more than 20,000,000 bytes when unpacked"):
        tariffs.tariff_from_file(path)


def test_prices_per_MWh_are_doubted(tmp_path):
    path = tmp_path / "prices.csv"
    path.write_text("time,price\n0,250\n3600,260\n")
    with pytest.warns(DoubtfulInput, match=r"prices\.csv: prices of 255 per kWh .* are they per MWh, or in cents"):
        tariffs.tariff_from_file(path)


def test_the_year_of_a_tariff_file_has_365_days(tmp_path):
    path = tmp_path / "prices.csv"
    year = "time,price\n" + "".join(f"{day * DAY_S},{0.1 if day < 364 else 0.2}\n" for day in range(365))
    for closing in ("", f"{365 * DAY_S},0.9\n"):
        path.write_text(year + closing)
        tariff = tariffs.tariff_from_file(path)
        np.testing.assert_allclose(tariff(np.array([364.5, 365, 365.5]) * DAY_S), [0.2, 0.1, 0.1])
    path.write_text(year + f"{365 * DAY_S},0.9\n{366 * DAY_S},0.9\n")
    with pytest.warns(DoubtfulInput, match=r"has prices until day 366; those after day 365 are not used"):
        tariffs.tariff_from_file(path)


def test_a_tariff_file_cut_short_serves_until_then_and_no_further(tmp_path):
    path = tmp_path / "prices.csv.gz"
    with gzip.open(path, "wt") as file:
        file.write("time,PriceElectricPowerHighlyDynamic\n0,0.1\n3600,0.2\n")
    tariff = tariffs.tariff_from_file(path)
    np.testing.assert_allclose(tariff(np.array([7199.0, 365 * DAY_S])), [0.2, 0.1])
    with pytest.raises(ConfigError, match=r"prices\.csv\.gz: has prices until day 0\.08.*asked for day 2;"):
        tariff(np.array([0.0, 2 * DAY_S]))
    path.write_bytes(path.read_bytes()[:-12])
    with pytest.raises(ConfigError, match="cannot be read"):
        tariffs.tariff_from_file(path)


def test_the_plant_pays_the_prices_of_the_file(tmp_path):
    path = tmp_path / "prices.csv"
    path.write_text("time,price\n" + "\n".join(f"{hour * 3600},{0.1 if hour % 2 else 0.5}" for hour in range(8760)))
    plant = EmbeddedPlant(synthetic_weather(), highly_dynamic=tariffs.tariff_from_file(path))
    plant.reset(20 * DAY_S, 0.0, "highly_dynamic")
    np.testing.assert_allclose(plant.forecast(3 * HOUR_S, HOUR_S).price_per_kWh, [[0.5, 0.1, 0.5, 0.1]])
    energy = [plant.advance(u, HOUR_S) and plant.kpis()["ener_tot"] for u in (1.0, 0.0)]
    assert plant.kpis()["cost_tot"] == pytest.approx(0.5 * energy[0] + 0.1 * (energy[1] - energy[0]), rel=0.01)


def test_windows_follow_the_rule():
    highest = np.zeros(365)
    highest[20:60] = np.linspace(1000, 3000, 40)  # days 20 to 59, rising
    highest[5] = 9000.0  # too early in the year for a window with its warm-up
    power = np.zeros((365, 96))
    power[:, 40] = highest
    windows = heating_windows(power.ravel())
    assert windows["peak_heat_day"].start_s == (59 - 7) * DAY_S
    # 41 heating days; the median is the 21st, which is day 40.
    assert windows["typical_heat_day"].start_s == (40 - 7) * DAY_S


def test_windows_of_a_year_are_found_once_and_anew_where_what_is_kept_is_no_days(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    power = np.tile(np.linspace(1000.0, 2000.0, 96), 365)
    power[40 * 96] = 5000.0
    found = []

    def windows(*depends_on: str):
        def find():
            found.append(depends_on)
            return heating_windows(power)

        return kept_windows(depends_on, NAMES, find)

    first = windows("case", "weather")
    assert windows("case", "weather") == first == heating_windows(power)
    assert windows("case", "other weather") == first
    assert found == [("case", "weather"), ("case", "other weather")]
    for damaged in ("", "{", '{"peak_heat_day": 38}', '{"peak_heat_day": 3, "typical_heat_day": 38}', "[1]"):
        for file in tmp_path.rglob("*.json"):
            file.write_text(damaged)
        found.clear()
        assert [windows("case", "weather"), windows("case", "weather")] == [first, first]
        assert len(found) == 1
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert windows("case", "weather") == first, "where nothing can be kept it is found each time"
