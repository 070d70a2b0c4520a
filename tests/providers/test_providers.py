"""Services of weather and prices: what their documented layouts give, and what is done with what cannot be."""

from __future__ import annotations

import json
import re
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from price_services import entsoe, met_norway, open_meteo, service

from thermoforce_mpc.connections.registry import build_connection
from thermoforce_mpc.errors import ConfigError, PlantError
from thermoforce_mpc.providers.outlook import Outlook, OutlookConfig
from thermoforce_mpc.providers.registry import REGISTRY, build_provider

NOW = pd.Timestamp("2026-01-20 10:07", tz="UTC")
DAY = pd.Timedelta("1D")


def prices_of(name, answer, now=NOW, **options):
    with service(answer) as url:
        return build_provider(name, {"url": url, **options}).answer(now, {})


def at(answer, when, zone="UTC"):
    """Price in force at an instant."""
    table = answer.table["price_per_kWh"]
    place = table.index.searchsorted(pd.Timestamp(when, tz=zone), side="right") - 1
    assert pd.Timestamp(when, tz=zone) < table.index[place] + pd.Timedelta(seconds=answer.holds_s)
    return table.iloc[place]


def stamp(when):
    return f"{when:%Y-%m-%dT%H:%M:%SZ}"


def test_entsoe_repeats_what_its_curve_leaves_out(monkeypatch):
    monkeypatch.setenv("ENTSOE_TOKEN", "secret")
    asked = []

    def answer(path, parameters, headers, body):
        asked.append(parameters)
        prices = {1: 100.0, 2: 110.0, 5: 90.0, 96: -5.0}
        return 200, entsoe([("2026-01-19T23:00Z", "2026-01-20T23:00Z", "PT15M", prices)])

    found = prices_of("entsoe", answer, area="10Y1001A1001A82H")
    assert asked[0]["documentType"] == "A44"
    assert asked[0]["periodStart"] == "202601190000"
    assert found.holds_s == 900.0
    assert len(found.table) == 96
    quarters = [at(found, f"2026-01-19 23:{m:02d}") for m in (0, 15, 30, 45)]
    assert quarters == pytest.approx([0.100, 0.110, 0.110, 0.110])
    assert at(found, "2026-01-20 22:30") == pytest.approx(0.090)
    assert at(found, "2026-01-20 22:45") == pytest.approx(-0.005)


@pytest.mark.parametrize(
    ("day", "end", "hours"),
    [("2026-03-28T23:00Z", "2026-03-29T22:00Z", 23), ("2026-10-24T22:00Z", "2026-10-25T23:00Z", 25)],
)
def test_entsoe_days_of_23_and_25_hours(day, end, hours, monkeypatch):
    monkeypatch.setenv("ENTSOE_TOKEN", "secret")
    hourly = {p: 50.0 + p for p in range(1, hours + 1)}
    now = pd.Timestamp(day) + pd.Timedelta("5h")
    found = prices_of("entsoe", lambda *_: (200, entsoe([(day, end, "PT60M", hourly)])), now, area="10YBE----------2")
    assert len(found.table) == hours
    assert (found.table.index[-1] - found.table.index[0]) == pd.Timedelta(hours=hours - 1)


def test_entsoe_takes_the_finest_of_several_series_and_hours_where_there_is_no_finer(monkeypatch):
    monkeypatch.setenv("ENTSOE_TOKEN", "secret")
    both = [
        ("2026-01-19T23:00Z", "2026-01-20T23:00Z", "PT60M", {p: 1000.0 for p in range(1, 25)}),
        ("2026-01-20T11:00Z", "2026-01-20T12:00Z", "PT15M", {1: 10.0, 2: 20.0, 3: 30.0, 4: 40.0}),
    ]
    found = prices_of("entsoe", lambda *_: (200, entsoe(both)), area="10Y1001A1001A82H")
    quarters = [at(found, f"2026-01-20 11:{m}") for m in ("00", "15", "30", "45")]
    assert quarters == pytest.approx([0.01, 0.02, 0.03, 0.04])
    assert at(found, "2026-01-20 13:45") == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<Acknowledgement_MarketDocument><Reason><code>999</code><text>No matching data found</text></Reason>"
         "</Acknowledgement_MarketDocument>", "No matching data"),
        ("<html>", "no XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "entities"),
        (entsoe([("2026-01-19T23:00Z", "2026-01-20T23:00Z", "PT60M", {99: 1.0})]), "positions"),
        (entsoe([("2026-01-19T23:00", "2026-01-20T23:00", "PT60M", {1: 1.0})]), "offset"),
        (entsoe([("2026-01-19T23:00Z", "2026-01-20T23:00Z", "P1Y", {1: 1.0})]), "resolution"),
        (entsoe([("2026-01-19T23:00Z", "2026-01-20T23:00Z", "PT60M", {1: 1.0})], unit="KWT"), "per KWT"),
    ],
)  # fmt: skip
def test_entsoe_answers_that_are_none(text, said, monkeypatch):
    monkeypatch.setenv("ENTSOE_TOKEN", "my-secret")
    with pytest.raises(PlantError, match=said) as problem:
        prices_of("entsoe", lambda *_: (200, text), area="10Y1001A1001A82H")
    assert "my-secret" not in repr(problem.value)
    with pytest.raises(PlantError, match="status 503") as problem:
        prices_of("entsoe", lambda *_: (503, ""), area="10Y1001A1001A82H")
    assert "my-secret" not in repr(problem.value)


def test_awattar():
    def answer(path, parameters, headers, body):
        assert path == "/v1/marketdata"
        start = int(parameters["start"])
        rows = [
            {"start_timestamp": start + 3600000 * h, "end_timestamp": start + 3600000 * (h + 1),
             "marketprice": 10.0 * h, "unit": "Eur/MWh"} for h in range(48)
        ]  # fmt: skip
        return 200, json.dumps({"object": "list", "data": rows, "url": path})

    found = prices_of("awattar", answer)
    assert at(found, "2026-01-20 10:07") == pytest.approx(0.34)
    assert found.holds_s == 3600.0


def test_tibber_asks_with_its_token_and_takes_offsets(monkeypatch):
    monkeypatch.setenv("TIBBER_TOKEN", "mine")

    def answer(path, parameters, headers, body):
        assert headers["Authorization"] == "Bearer mine"
        assert "QUARTER_HOURLY" in json.loads(body)["query"]
        day = pd.Timestamp("2026-01-20", tz="Europe/Oslo")
        begins = [(day + pd.Timedelta(minutes=15 * k)).isoformat() for k in range(96)]
        rows = [{"total": 0.2 + 0.001 * k, "startsAt": begin} for k, begin in enumerate(begins)]
        info = {"today": rows, "tomorrow": []}
        return 200, json.dumps({"data": {"viewer": {"homes": [{"currentSubscription": {"priceInfo": info}}]}}})

    found = prices_of("tibber", answer)
    assert at(found, "2026-01-20 01:00", "Europe/Oslo") == pytest.approx(0.204)
    with pytest.raises(PlantError, match="invalid token"):
        prices_of("tibber", lambda *_: (200, json.dumps({"errors": [{"message": "invalid token"}], "data": None})))
    with pytest.raises(PlantError, match="no home 1"):
        prices_of("tibber", answer, home=1)


def test_nord_pool_asks_day_by_day_and_tomorrow_may_not_be_there_yet():
    def answer(path, parameters, headers, body):
        if parameters["date"] == "2026-01-21":
            return 204, ""
        day = pd.Timestamp(parameters["date"], tz="Europe/Brussels").tz_convert("UTC")
        entries = [
            {"deliveryStart": stamp(day + pd.Timedelta(minutes=15 * k)),
             "deliveryEnd": stamp(day + pd.Timedelta(minutes=15 * k + 15)),
             "entryPerArea": {"SE3": float(k)}} for k in range(96)
        ]  # fmt: skip
        return 200, json.dumps({"currency": "EUR", "multiAreaEntries": entries})

    found = prices_of("nord-pool", answer, area="SE3")
    assert len(found.table) == 192
    assert at(found, "2026-01-20 00:15", "Europe/Brussels") == pytest.approx(0.001)
    with pytest.raises(PlantError, match="in EUR, not in SEK"):
        prices_of("nord-pool", answer, area="SE3", currency="SEK")


def test_energyzero():
    def answer(path, parameters, headers, body):
        assert parameters["inclBtw"] == "true"
        day = pd.Timestamp("2026-01-20", tz="Europe/Amsterdam").tz_convert("UTC")
        rows = [{"price": 0.1 + 0.01 * h, "readingDate": stamp(day + pd.Timedelta(hours=h))} for h in range(24)]
        return 200, json.dumps({"Prices": rows, "intervalType": 4, "average": 0.2})

    assert at(prices_of("energyzero", answer), "2026-01-20 03:30", "Europe/Amsterdam") == pytest.approx(0.13)


def test_octopus_goes_through_its_pages_and_stays_on_its_host():
    def rows(begin):
        halves = [stamp(begin + pd.Timedelta(minutes=30 * k)) for k in range(49)]
        return [
            {"value_exc_vat": 20.0, "value_inc_vat": 21.0, "valid_from": one, "valid_to": other}
            for one, other in pairwise(halves)
        ]

    def answer(path, parameters, headers, body):
        assert path.startswith("/v1/products/AGILE-24-10-01/electricity-tariffs/E-1R-AGILE-24-10-01-C/")
        second = parameters.get("page") == "2"
        following = None if second else f"https://elsewhere.invalid{path}?page=2"
        day = pd.Timestamp("2026-01-20" if second else "2026-01-21", tz="UTC")
        return 200, json.dumps({"count": 96, "next": following, "results": rows(day)})

    found = prices_of("octopus", answer, product="AGILE-24-10-01", tariff="E-1R-AGILE-24-10-01-C")
    assert len(found.table) == 96
    assert at(found, "2026-01-20 10:15") == pytest.approx(0.21)


@pytest.mark.parametrize("name", ["awattar", "energyzero"])
def test_answers_of_another_layout_are_no_crash(name):
    for text, said in (
        ("[]", "layout"),
        ("{}", "layout"),
        ("nothing", "no JSON"),
        ('{"data": [{}], "Prices": [{}]}', "layout"),
    ):
        with pytest.raises(PlantError, match=said):
            prices_of(name, lambda *_, text=text: (200, text))


def test_open_meteo_asks_for_quarters_in_utc():
    def answer(path, parameters, headers, body):
        assert parameters["minutely_15"] == "temperature_2m,shortwave_radiation_instant"
        assert (parameters["timezone"], parameters["latitude"]) == ("GMT", "52.1235")
        return 200, json.dumps(open_meteo(NOW.floor("1D") - DAY, 96))

    found = prices_of("open-meteo", answer, latitude=52.123456, longitude=13.0)
    assert found.table.loc["2026-01-20 10:00+00:00", "temperature_C"] == pytest.approx(2.0 + 0.01 * 4 * 34)
    for changes, said in (
        ({"utc_offset_seconds": 3600}, "another zone"),
        ({"minutely_15_units": {"temperature_2m": "°F"}}, "°F"),
        ({"minutely_15": {}}, "layout"),
    ):
        with pytest.raises(PlantError, match=said):
            prices_of(
                "open-meteo", lambda *_, changes=changes: (200, json.dumps(open_meteo(NOW, 48, **changes))),
                latitude=52.0, longitude=13.0,
            )  # fmt: skip


def test_met_norway_says_who_asks_and_does_not_ask_again_before_it_expires(tmp_path):
    asked, clock = [], [NOW]

    def answer(path, parameters, headers, body):
        asked.append(headers)
        assert parameters == {"lat": "52.1235", "lon": "13.0000"}
        told = {
            "Expires": (clock[0] + pd.Timedelta("40min")).strftime("%a, %d %b %Y %H:%M:%S GMT"),
            "Last-Modified": "Tue, 20 Jan 2026 10:00:00 GMT",
        }
        if "If-Modified-Since" in headers:
            return 304, "", told
        return 200, json.dumps(met_norway(NOW.floor("1h"))), told

    with service(answer) as url:
        options = {"url": url, "latitude": 52.123456, "longitude": 13.0, "contact": "me@example.org"}
        outlook = Outlook(OutlookConfig(weather={"name": "met-norway", "options": options}), tmp_path, lambda: clock[0])
        first = outlook.now()
        clock[0] = NOW + pd.Timedelta("35min")
        outlook.now()
        assert len(asked) == 1
        assert "me@example.org" in asked[0]["User-Agent"]
        clock[0] = NOW + pd.Timedelta("45min")
        again = outlook.now()
        assert [one.get("If-Modified-Since") for one in asked] == [None, "Tue, 20 Jan 2026 10:00:00 GMT"]
    assert (again["temperature_C"] == 3.0).sum() > 100
    noon, night = first.loc["2026-01-20 11:15+00:00"], first.loc["2026-01-20 23:00+00:00"]
    assert 50.0 < noon["solar_W_m2"] < 300.0
    assert night["solar_W_m2"] == 0.0
    with pytest.raises(ConfigError, match="contact"):
        build_provider("met-norway", {"latitude": 52.0, "longitude": 13.0})


class Weather:
    """A server of Open-Meteo and aWATTar whose answers can be changed; counts what it is asked."""

    def __init__(self):
        self.weather = (200, json.dumps(open_meteo(NOW.floor("1D") - DAY, 96)))
        self.prices = self.hourly(NOW.floor("1D") - DAY, 72)
        self.asked = []

    @staticmethod
    def hourly(begin, hours, left_out=(), unit="Eur/MWh", factor=1.0):
        rows = [
            {"start_timestamp": int((begin + pd.Timedelta(hours=h)).timestamp() * 1000),
             "end_timestamp": int((begin + pd.Timedelta(hours=h + 1)).timestamp() * 1000),
             "marketprice": factor * (100.0 + h), "unit": unit} for h in range(hours) if h not in left_out
        ]  # fmt: skip
        return 200, json.dumps({"data": rows})

    def __call__(self, path, parameters, headers, body):
        self.asked.append(path)
        return self.weather if path == "/v1/forecast" else self.prices


@pytest.fixture
def outlook(tmp_path):
    """An outlook from that server, the server and the clock."""
    server, clock = Weather(), [NOW]
    with service(server) as url:
        place = {"url": url, "latitude": 52.0, "longitude": 13.0}
        config = OutlookConfig(
            weather={"name": "open-meteo", "options": place},
            prices={"name": "awattar", "options": {"url": url}, "factor": 1.19, "add_per_kWh": 0.15},
        )
        yield lambda: Outlook(config, tmp_path, lambda: clock[0]), server, clock


def test_one_table_of_weather_and_prices(outlook):
    make, server, _ = outlook
    table = make().now()
    assert list(table.columns) == ["temperature_C", "solar_W_m2", "price_per_kWh"]
    assert str(table.index.tz) == "UTC"
    # Hour 34 of yesterday and today: 134 EUR/MWh, with tax and fees.
    assert table.loc["2026-01-20 10:45+00:00", "price_per_kWh"] == pytest.approx(1.19 * 0.134 + 0.15)
    assert len(server.asked) == 2


def test_an_hour_that_is_missing_stays_missing_and_what_is_unknown_yet_too(outlook):
    make, server, _ = outlook
    server.prices = Weather.hourly(NOW.floor("1D") - DAY, 48, left_out=(40,))
    price = make().now()["price_per_kWh"]
    assert price.loc["2026-01-20 16:00+00:00":"2026-01-20 16:45+00:00"].isna().all()
    assert np.isfinite(price.loc["2026-01-20 17:00+00:00"])
    assert price.loc["2026-01-21 00:00+00:00":].isna().all()


def test_the_last_good_answer_stands_in_also_after_a_restart(outlook, caplog):
    make, server, clock = outlook
    first = make()
    good = first.now()
    server.weather, server.prices = (500, ""), (200, "<html>")
    clock[0] = NOW + pd.Timedelta("2h")
    for one in (first, make()):
        table = one.now()
        both = good.index.intersection(table.index)
        assert np.array_equal(table.loc[both].to_numpy(), good.loc[both].to_numpy(), equal_nan=True)
    assert "the answer of 2.0 h ago stands in" in caplog.text
    clock[0] = NOW + pd.Timedelta("50h")
    with pytest.raises(PlantError, match="no answer of open-meteo"):
        make().now()


def test_prices_that_fail_for_days_take_no_weather_down(outlook, caplog):
    make, server, clock = outlook
    one = make()
    one.now()
    clock[0] = NOW + pd.Timedelta("50h")
    server.weather = (200, json.dumps(open_meteo(clock[0].floor("1D") - DAY, 96)))
    server.prices = (500, "")
    table = one.now()
    assert np.isfinite(table.loc[clock[0] :, "temperature_C"]).all()
    assert table["price_per_kWh"].isna().all()
    assert "no answer of awattar" in caplog.text
    with pytest.raises(PlantError, match="no answer of awattar"):
        make().now()


def test_a_service_that_fails_is_not_asked_again_at_once(outlook):
    make, server, clock = outlook
    one = make()
    one.now()
    server.weather = server.prices = (503, "")
    clock[0] = NOW + pd.Timedelta("2h")
    one.now()
    count = len(server.asked)
    clock[0] += pd.Timedelta("2min")
    one.now()
    assert len(server.asked) == count
    clock[0] += pd.Timedelta("4min")
    one.now()
    assert len(server.asked) == count + 2


@pytest.mark.parametrize(
    ("weather", "prices", "said"),
    [
        (None, Weather.hourly(NOW.floor("1D") - 3 * DAY, 24), "not of now"),  # those of some day before
        (None, Weather.hourly(NOW.floor("1D") - DAY, 72, unit="ct/kWh"), "ct/kWh"),
        (None, Weather.hourly(NOW.floor("1D") - DAY, 72, factor=1000.0), "per MWh"),
        (json.dumps(open_meteo(NOW.floor("1D") - 4 * DAY, 48)), None, "not of now"),
        (json.dumps(open_meteo(NOW + DAY, 48)), None, "not of now"),
        (json.dumps(open_meteo(NOW.floor("1D"), 96)).replace("2.0,", "280.0,"), None, "cannot be"),
    ],
)
def test_an_answer_that_cannot_be_does_not_replace_the_last_good_one(outlook, weather, prices, said, caplog):
    make, server, clock = outlook
    was = server.weather, server.prices
    server.weather = server.weather if weather is None else (200, weather)
    server.prices = server.prices if prices is None else prices
    with pytest.raises(PlantError, match=said):
        make().now()
    server.weather, server.prices = was
    one = make()
    one.now()
    server.weather = server.weather if weather is None else (200, weather)
    server.prices = server.prices if prices is None else prices
    clock[0] = NOW + pd.Timedelta("90min")
    caplog.clear()
    assert np.isfinite(one.now()["price_per_kWh"].loc[clock[0].floor("15min")])
    assert said in caplog.text


def test_an_answer_in_local_summer_time_of_23_hours_is_complete(outlook):
    make, server, clock = outlook
    clock[0] = pd.Timestamp("2026-03-29 00:30", tz="UTC")
    server.weather = (200, json.dumps(open_meteo(pd.Timestamp("2026-03-28", tz="UTC"), 96)))
    day = pd.Timestamp("2026-03-29", tz="Europe/Berlin").tz_convert("UTC")
    server.prices = Weather.hourly(day, 23)
    price = make().now()["price_per_kWh"]
    assert price.loc[day : day + pd.Timedelta("22h45min")].notna().all()
    assert price.loc[day + pd.Timedelta("23h") :].isna().all()


@pytest.mark.parametrize(
    "url", ["http://localhost.example.org", "http://127.0.0.1.example.org:80", "https://", "http://[::1"]
)
def test_what_only_begins_like_this_machine_is_asked_over_https(url):
    with pytest.raises(ConfigError, match="expected https"):
        build_provider("awattar", {"url": url})


def test_services_are_asked_over_https_and_where_a_redirect_leads_nobody_is(tmp_path):
    with pytest.raises(ConfigError, match="https"):
        build_provider("awattar", {"url": "http://api.awattar.de"})
    with pytest.raises(PlantError, match="status 302"):
        prices_of("awattar", lambda *_: (302, "", {"Location": "http://127.0.0.1:9/"}))


def test_every_provider_says_whose_data_it_gives():
    for name in REGISTRY.own:
        assert REGISTRY.find(name).attribution


def test_a_damaged_cache_is_asked_anew(outlook, tmp_path):
    make, server, _ = outlook
    make().now()
    for file in tmp_path.glob("*.json"):
        file.write_text("{")
    assert make().now()["price_per_kWh"].notna().any()
    assert len(server.asked) == 4


def test_what_is_wrong_with_services_is_said_of_their_keys():
    """Not of the file that could stand in their place, nor by names of our classes."""
    for wrong, said in (
        ({"prices": {"name": "awattar"}}, "forecast.weather: missing"),
        ({"weather": {"nme": "x"}}, "forecast.weather.nme: unknown key, did you mean 'name'?"),
    ):
        with pytest.raises(ConfigError, match=re.escape(said)) as error:
            build_connection("files", {"forecast": wrong})
        assert "valid string" not in str(error.value)
        assert "OutlookConfig" not in str(error.value)
