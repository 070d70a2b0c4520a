"""The emulator: protocol, books (energy, KPIs), refusals. Against the real plant: test_embedded_fidelity."""

from __future__ import annotations

import copy
import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from one_zone_kpis import compute_kpis

from benchmarks.plant.plants_together import advance_together
from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.boundary.weather import synthetic_weather
from thermoforce_mpc.data import DAY_S
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.embedded import EmbeddedPlant, emulator, heat_pump
from thermoforce_mpc.plants.embedded.exposure import build_exposure
from thermoforce_mpc.plants.embedded.houses import HEAT_PUMP_HOUSE
from thermoforce_mpc.plants.embedded.kernel import integrals
from thermoforce_mpc.protocols import Plant


@pytest.fixture(scope="module")
def weather():
    return synthetic_weather()


@pytest.fixture
def plant(weather):
    return EmbeddedPlant(weather)


def test_it_is_a_plant_that_says_what_it_is(plant):
    assert isinstance(plant, Plant)
    assert plant.info.kind == "embedded"
    assert "synthetic" in plant.info.weather


def test_plants_of_one_year_and_house_share_what_the_weather_does_to_it(weather):
    facade = HEAT_PUMP_HOUSE.facade
    first = build_exposure(weather, facade)
    assert build_exposure(synthetic_weather(), facade) is first
    assert not first.flags.writeable
    warm = weather.T_dry_C.copy()
    warm[100] += 1e-9
    others = [replace(weather, T_dry_C=warm), replace(weather, longitude_deg=weather.longitude_deg + 1e-6)]
    assert all((build_exposure(other, facade) != first).any() for other in others)
    assert (build_exposure(weather, replace(facade, roof_is_south=not facade.roof_is_south)) != first).any()


def test_the_heat_pump_meets_the_published_operating_point():
    # Operating point of the test case's own model: P 2504.02 W, Q 7196.24 W.
    power, to_water, from_air = heat_pump.heat_pump(269.065, 305.560, 0.73375)
    assert power == pytest.approx(2504.02, rel=1e-4)
    assert to_water == pytest.approx(7196.24, rel=1e-4)
    assert to_water == pytest.approx(from_air + power)


@pytest.mark.parametrize(("T", "pressure"), [(233.15, 1.75e5), (273.15, 7.98e5), (313.15, 2.42e6)])
def test_saturation_pressure_of_r410a(T, pressure):
    assert heat_pump.saturation_pressure(T) == pytest.approx(pressure, rel=0.02)


def test_the_network_holds_the_published_node_capacities():
    net = HEAT_PUMP_HOUSE.envelope
    pipe, slab = net.heated
    top = net.capacity[pipe - 2 : pipe + 1] / 1e6
    np.testing.assert_allclose(top, [1.693, 6.129, 4.717], atol=1e-3)
    np.testing.assert_allclose(net.coupling[pipe - 2 : pipe + 1], [26880.0, 2304.0, 57.6])
    assert net.capacity[slab] / 1e6 == pytest.approx(12.70 + 16.32, abs=0.01)


def test_any_control_step_gives_the_same_bytes(weather):
    finals = []
    for step_s in (30.0, 60.0, 900.0, 3600.0):
        plant = EmbeddedPlant(weather)
        plant.reset(3 * DAY_S, DAY_S)
        for _ in range(int(6 * 3600 / step_s)):
            last = plant.advance(0.4, step_s)
        finals.append((last.T_zone_C[0], plant.kpis()))
    assert all(final == finals[0] for final in finals)


@pytest.mark.slow
@pytest.mark.parametrize("pieces", [[1.0], [7.5], [45.0], [59.0], [1.0, 7.5, 45.0, 3601.0, 0.25, 29.0]])
@pytest.mark.parametrize("u", [None, 0.0, 0.6])
def test_odd_steps_give_the_same_trajectory(weather, pieces, u):
    """To what a first-order step of 30 s leaves: a millikelvin or two, with the house emptying at 07:00 inside.

    Native control closes its PI loop at the samples, which leaves more than twice as much.
    """
    loop = 2.5 if u is None else 1.0
    whole, parts = EmbeddedPlant(weather), EmbeddedPlant(weather)
    for plant in (whole, parts):
        plant.reset(20.2 * DAY_S, DAY_S)
    for _ in range(12):
        whole.advance(u, 900.0)
    for i in itertools.count():
        left_s = whole.now_s - parts.now_s
        if left_s <= 0.0:
            break
        parts.advance(u, min(pieces[i % len(pieces)], left_s))
    assert parts.now_s == whole.now_s
    a, b = whole.past(900.0), parts.past(900.0)
    np.testing.assert_array_equal(a.time_s, b.time_s)
    np.testing.assert_allclose(b.T_zone_C, a.T_zone_C, atol=2.5e-3 * loop)
    # A step that ends beside 07:00 sees the house empty up to half its length too early or too late.
    for name, tolerance in (("u", 1e-3 * loop), ("power_W", 3.0 * loop), ("heat_W", 10.0 * loop)):
        assert getattr(b, name)[-12:].mean() == pytest.approx(getattr(a, name)[-12:].mean(), abs=tolerance), name
    ours, theirs = whole.kpis(), parts.kpis()
    for name, tolerance in (("ener_tot", 2e-4), ("cost_tot", 5e-5), ("emis_tot", 4e-5), ("tdis_tot", 1e-2)):
        assert theirs[name] == pytest.approx(ours[name], abs=tolerance * loop), name


def test_an_advance_is_sampled_evenly_and_at_its_end(plant):
    plant.reset(20 * DAY_S, 45.0)
    assert plant.begin_s == 20 * DAY_S - 45.0
    for step_s, n in ((45.0, 1), (100.0, 3), (7.5, 1), (3601.0, 120)):
        before_s = plant.now_s
        plant.advance(0.5, step_s)
        assert plant.now_s == before_s + step_s
        time_s = plant.recorded(before_s, plant.now_s)["time"]
        np.testing.assert_allclose(np.diff(time_s), step_s / n, rtol=1e-6)
        assert (time_s[0], time_s[-1], time_s.size) == (before_s, plant.now_s, n + 1)


def test_branches_of_a_snapshot_share_the_past_to_the_bit(plant):
    plant.reset(3 * DAY_S, DAY_S)
    plant.advance(0.5, 3600)
    here, other = plant.snapshot(), copy.deepcopy(plant)
    a = [plant.advance(0.0, 900).T_zone_C[0] for _ in range(8)]
    plant.restore(here)
    b = [plant.advance(1.0, 900).T_zone_C[0] for _ in range(8)]
    plant.restore(here)
    again = [plant.advance(0.0, 900).T_zone_C[0] for _ in range(8)]
    assert a == again
    assert b[-1] > a[-1]
    assert [other.advance(0.0, 900).T_zone_C[0] for _ in range(8)] == a, "a copy goes on by itself"


@pytest.mark.slow
def test_plants_stepped_together_are_plants_stepped_alone(weather):
    levels = [0.0, 0.3, None, 1.0]

    def run(executor) -> list:
        plants = [EmbeddedPlant(weather) for _ in levels]
        for plant in plants:
            plant.reset(3 * DAY_S, DAY_S)
        measured = [advance_together(plants, levels, 900, executor) for _ in range(8)]
        return [measured, [plant.kpis() for plant in plants]]

    with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(4) as four:
        assert run(one) == run(four)
        alone = EmbeddedPlant(weather)
        alone.reset(3 * DAY_S, DAY_S)
        expected = [alone.advance(0.3, 900) for _ in range(8)]
        assert [step[1] for step in run(four)[0]] == expected


def test_together_wants_one_level_each_and_no_plant_twice(weather):
    plant = EmbeddedPlant(weather)
    with ThreadPoolExecutor(1) as executor:
        with pytest.raises(InputError, match="2 levels for 1 plants"):
            advance_together([plant], [0.0, 1.0], 900, executor)
        with pytest.raises(InputError, match="given twice"):
            advance_together([plant, plant], [0.0, 1.0], 900, executor)


def test_more_heat_is_never_colder(plant):
    plant.reset(10 * DAY_S, DAY_S)
    here = plant.snapshot()
    ends = []
    for u in (0.0, 0.25, 0.5, 0.75, 1.0):
        plant.restore(here)
        ends.append(plant.advance(u, 6 * 3600).T_zone_C[0])
    assert ends == sorted(ends)
    assert ends[-1] - ends[0] > 0.5


def test_the_fixed_part_of_the_power_does_not_scale(plant):
    plant.reset(10 * DAY_S, DAY_S)
    here = plant.snapshot()
    power = []
    for u in (0.1, 1.0):
        plant.restore(here)
        power.append(plant.advance(u, 3600).power_W[0])
    assert power[0] > 0.4 * power[1]


def test_kpis_count_from_the_end_of_the_warm_up_and_add_up(plant):
    plant.reset(10 * DAY_S, 2 * DAY_S, "dynamic")
    parts = [plant.advance(None, 900) for _ in range(96)]
    kpis = plant.kpis()
    energy = sum(part.power_W[0] * 900 / 3.6e6 for part in parts) / HEAT_PUMP_HOUSE.area_m2
    assert kpis["ener_tot"] == pytest.approx(energy, rel=2e-3)
    assert kpis["emis_tot"] == pytest.approx(0.167 * kpis["ener_tot"])
    assert 0.2383 < kpis["cost_tot"] / kpis["ener_tot"] < 0.2666
    assert kpis["pele_tot"] >= max(part.power_W[0] for part in parts) / 1e3 / HEAT_PUMP_HOUSE.area_m2 * 0.99


def test_kpis_asked_at_every_step_are_those_of_the_whole_record(weather, monkeypatch):
    """Steps of any length, another tariff in between, back to a moment; the work of an answer does not grow."""
    plant = EmbeddedPlant(weather)
    plant.reset(30 * DAY_S + 10.0, 3600.0)
    read = []

    def counting(time_s, rows, price):
        read.append(time_s.size)
        return integrals(time_s, rows, price)

    monkeypatch.setattr(emulator, "integrals", counting)

    def check(price):
        record = plant.recorded(30 * DAY_S + 10.0, 1e9)
        lower, upper = plant.case.schedule.bounds_C(record["time"])
        expected = compute_kpis(
            record["time"],
            power_W=record["P_heat_pump"] + record["P_fan"] + record["P_pump"],
            T_operative_C=record["T_operative"] - 273.15,
            lower_C=lower,
            upper_C=upper,
            co2_ppm=record["CO2"],
            co2_limit_ppm=894.0,
            price_per_kWh=plant.tariff(price)(record["time"]),
            emission_kg_per_kWh=np.full(record["time"].size, 0.167),
            area_m2=HEAT_PUMP_HOUSE.area_m2,
        )
        assert plant.kpis() == pytest.approx(expected, rel=1e-9, abs=1e-12)

    rng = np.random.default_rng(4)

    def run(steps, price="constant"):
        for _ in range(steps):
            samples = int(rng.integers(1, 45))
            plant.advance(float(rng.random()), 30.0 * samples)
            read.clear()
            check(price)
            assert sum(read) <= samples + 63, "of the samples before only those of the last two quarters"

    assert plant.kpis() == dict.fromkeys(plant.kpis(), 0.0)
    run(60)
    here = plant.snapshot()
    plant.use("dynamic", None)
    check("dynamic")
    run(20, "dynamic")
    plant.use("constant", None)
    check("constant")
    plant.restore(here)
    check("constant")
    run(10)
    plant.reset(40 * DAY_S, 0.0)
    plant.advance(1.0, 600.0)
    check("constant")
    for step_s in (45.0, 100.0, 7.0, 1234.5, 900.0):  # samples need not lie on the ends of quarters
        for _ in range(30):
            plant.advance(float(rng.random()), step_s)
            check("constant")


def test_the_past_holds_the_warm_up_and_continues(plant):
    plant.reset(10 * DAY_S, 2 * DAY_S)
    past = plant.past(3600)
    assert past.n_steps == 48
    assert past.time_s[-1] == 10 * DAY_S
    last = plant.advance(1.0, 3600)
    now = plant.past(3600)
    assert now.n_steps == 49
    assert (now.u[0, -1], now.T_zone_C[0, -1]) == (last.u[0], last.T_zone_C[0])
    assert now.power_W[0, -1] == pytest.approx(last.power_W[0], rel=1e-12)


def test_the_forecast_carries_bounds_as_the_test_case_samples_them(plant):
    plant.reset(7 * DAY_S, 0)  # day 7 of the year is a Tuesday
    boundary = plant.forecast(DAY_S, 3600)
    np.testing.assert_array_equal(boundary.lower_C[0], [21] * 8 + [15] * 12 + [21] * 5)
    np.testing.assert_array_equal(boundary.upper_C[0], [24] * 8 + [30] * 12 + [24] * 5)
    assert boundary.T_out_C[0] == pytest.approx(plant.advance(0.0, 30).T_out_C, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("level", ["low", "medium", "high"])
def test_forecast_errors_are_seeded_and_leave_the_plant_alone(weather, level):
    def forecast(seed):
        plant = EmbeddedPlant(weather, forecast_error=ForecastError(level, level, seed))
        plant.reset(100 * DAY_S, 0)
        return plant.forecast(DAY_S, 3600), plant.advance(0.0, 3600)

    truth = EmbeddedPlant(weather)
    truth.reset(100 * DAY_S, 0)
    exact = truth.forecast(DAY_S, 3600)
    (a, after), (again, _), (other, _) = forecast(1), forecast(1), forecast(2)
    np.testing.assert_array_equal(a.T_out_C, again.T_out_C)
    assert not np.array_equal(a.T_out_C, other.T_out_C)
    assert 0.1 < np.abs(a.T_out_C - exact.T_out_C).mean() < 6.0
    day = exact.solar_W_m2 > 60
    share = a.solar_W_m2[day] / exact.solar_W_m2[day]
    assert (share > 0.19).all()
    assert (share < 2.01).all()
    assert after == truth.advance(0.0, 3600)


def test_a_long_horizon_is_refused_under_uncertainty(weather):
    plant = EmbeddedPlant(weather, forecast_error=ForecastError("low", "low", 1))
    plant.reset(100 * DAY_S, 0)
    plant.advance(0.0, 900.0)
    assert plant.forecast(48 * 3600, 900.0).n_steps == 192, "48 h from now, whatever the minute"
    with pytest.raises(InputError, match="beyond 48 h"):
        plant.forecast(72 * 3600, 3600)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"oveHeaPumY": float("nan")}, "oveHeaPumY"),
        ({"oveHeaPumY": 1.2}, "expected a number from 0 to 1"),
        ({"oveHeaPumY": "on"}, "expected a number"),
        ({"oveHeatPump": 1.0}, "known: oveHeaPumY"),
        ({"oveTSet": 21.0}, "from 278.15 to 308.15"),
    ],
)
def test_a_bad_input_is_refused_and_nothing_moves(plant, overrides, message):
    before = plant.past(900).time_s[-1]
    with pytest.raises(InputError, match=message):
        plant.advance_points(overrides, 900)
    assert plant.past(900).time_s[-1] == before


@pytest.mark.slow
@pytest.mark.parametrize("duration", [0, -900, 1e-4, float("nan"), float("inf"), 365 * DAY_S, "900"])
def test_a_bad_step_is_refused(plant, duration):
    with pytest.raises(InputError, match="step of"):
        plant.advance(0.0, duration)


@pytest.mark.slow
@pytest.mark.parametrize(("start", "warmup"), [(-1.0, 0), (float("nan"), 0), (365 * DAY_S, 0), (0, -5.0), ("0", 0)])
def test_a_bad_start_is_refused(plant, start, warmup):
    with pytest.raises(InputError):
        plant.reset(start, warmup)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["peak", "-1", "365", "nan"])
def test_a_bad_period_is_refused(plant, name):
    with pytest.raises(InputError, match="period"):
        plant.period(name)


def test_the_other_overwrites_act(plant):
    plant.reset(10 * DAY_S, DAY_S)
    here = plant.snapshot()
    warm = plant.advance_points({"oveTSet": 297.15}, 6 * 3600).T_zone_C
    plant.restore(here)
    cool = plant.advance_points({"oveTSet": 288.15}, 6 * 3600)
    assert warm > cool.T_zone_C
    assert cool.points["reaPHeaPum_y"] == 0.0
    pumped = plant.advance_points({"oveHeaPumY": 0.0, "ovePum": 1.0, "oveFan": 1.0}, 900)
    assert pumped.points["reaPPumEmi_y"] == pytest.approx(20.4986)
    assert pumped.points["reaPFan_y"] == pytest.approx(510.204)


def test_the_machine_runs_at_the_first_sample(plant):
    """Operative 20 °C against a set-point of 21.2 °C: y = 0.6 · 1.2, as in the real test case."""
    first = plant.reset(0.0, 0.0).points
    assert plant.recorded(0.0, 0.0)["level"][0] == pytest.approx(0.72)
    assert first["reaPHeaPum_y"] == pytest.approx(2444.4, abs=0.1)
    assert first["reaPFan_y"] + first["reaPPumEmi_y"] == pytest.approx(530.7, abs=0.1)
    second = plant.advance(0.0, 30).points
    assert second["reaPHeaPum_y"] == 0.0
    watts = 2444.4 + 530.7
    assert plant.kpis()["pele_tot"] == pytest.approx(watts / 2 / 1e3 / 192.0, rel=1e-3), "trapezoid, first sample on"


def test_native_control_follows_the_clock_at_the_very_sample(plant):
    plant.reset(7 * DAY_S + 6.5 * 3600, DAY_S)  # day 7 of the year is a Tuesday
    plant.advance(None, 15 * 3600)
    samples = plant.recorded(7 * DAY_S, 1e9)
    hour = (samples["time"] - 7 * DAY_S) / 3600
    occupied = (hour < 7) | (hour >= 20)
    np.testing.assert_allclose(samples["T_setpoint"], np.where(occupied, 294.35, 293.65))
    jump = np.diff(samples["level"])
    at_seven, at_eight = np.flatnonzero(np.isclose(hour[1:], 7)), np.flatnonzero(np.isclose(hour[1:], 20))
    assert jump[at_seven] < -0.3
    assert jump[at_eight] > 0.3


def test_sensors_in_standing_water_show_the_mean_of_either_side(plant):
    plant.reset(10 * DAY_S, DAY_S)
    running = plant.advance(0.7, 3600).points
    off = plant.advance_points({"oveHeaPumY": 0.0}, 30).points
    vessel, condenser, floor = 293.15, running["reaTSup_y"], running["reaTRet_y"]
    # The half minute after the last sample that ran moves the water by less than 0.1 K.
    assert off["reaTSup_y"] == pytest.approx((condenser + vessel) / 2, abs=0.1)
    assert off["reaTRet_y"] == pytest.approx((floor + condenser) / 2, abs=0.1)
    assert plant.advance_points({"oveHeaPumY": 0.0}, 3600).points["reaTSup_y"] == off["reaTSup_y"], "it stands still"
    flowing = plant.advance_points({"oveHeaPumY": 0.0, "ovePum": 1.0}, 600).points
    assert flowing["reaTSup_y"] == pytest.approx(flowing["reaTRet_y"], abs=2.0), "water goes round again"


def test_with_the_pump_overwritten_off_the_machine_heats_its_own_water_until_it_is_stopped(plant):
    plant.reset(10 * DAY_S, DAY_S)
    stuck = {"oveHeaPumY": 1.0, "ovePum": 0.0}
    plant.advance_points(stuck, 3600)
    samples = plant.recorded(10 * DAY_S + 30, 1e9)
    condenser = 2 * samples["T_supply"] - 293.15
    on = samples["P_heat_pump"] > 0
    assert 5 * 60 < 30 * on.sum() < 15 * 60
    assert not on[on.sum() :].any(), "standing water does not cool, so it does not start again"
    assert (samples["Q_floor"] == 0).all()
    warmed_J = 30 * 4184.0 * np.diff(condenser)
    np.testing.assert_allclose(warmed_J, 30.0 * samples["Q_condenser"][:-1], rtol=1e-6, atol=1e-3)
    # The refrigerant condenses above the standing water by its heat over the condenser's own conductance; at 340.25 K
    # it is stopped.
    refrigerant_K = condenser[1:] + samples["Q_condenser"][:-1] / 55_857.415
    stopped = on.sum() - 1
    assert refrigerant_K[stopped - 1] <= 340.25 < refrigerant_K[stopped]


def test_the_record_between_any_two_times_is_the_part_of_the_whole_in_between(plant):
    plant.reset(20 * DAY_S, 3600)
    rng = np.random.default_rng(0)
    for _ in range(10):
        plant.advance(float(rng.random()), float(rng.choice([1.0, 30.0, 45.0])) * int(rng.integers(1, 50)))
    whole = plant.recorded(0.0, 1e9)
    assert whole["time"][0] == plant.begin_s
    assert whole["time"][-1] == plant.now_s
    for start_s, end_s in rng.uniform(plant.begin_s - 2000, plant.now_s + 2000, (200, 2)):
        part = plant.recorded(start_s, end_s)
        inside = (whole["time"] >= start_s) & (whole["time"] <= end_s)
        for name in ("time", "T_operative", "Q_evaporator"):
            np.testing.assert_array_equal(part[name], whole[name][inside])
