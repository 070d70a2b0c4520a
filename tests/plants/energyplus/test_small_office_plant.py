"""The DOE small office as a plant: five zones, a heating and a cooling set-point each, native schedules."""

import os
import signal

import numpy as np
import pytest
from waiting import children

from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError, InputError, PlantError
from thermoforce_mpc.plants.energyplus.engine import Wiring, is_available, run_engine, weather_file
from thermoforce_mpc.plants.energyplus.office import (
    STEPS_PER_HOUR,
    WEATHER,
    ZONES,
    SmallOfficePlant,
    office_model,
    office_schedules,
)
from thermoforce_mpc.plants.testcases import load_testcase

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not is_available(), reason="EnergyPlus (extra [energyplus]) is not installed"),
]

AREAS_M2 = np.array([149.66, 113.45, 67.30, 113.45, 67.30])
NAMES = ("core", "south", "east", "north", "west")


def office(**options):
    return SmallOfficePlant(load_testcase("energyplus:small_office"), **options)


def told(plant, duration_s, **rooms):
    """Advance with (level, heating, cooling set-point) of rooms by name, the others under native control."""
    levels = [rooms[name][0] if name in rooms else None for name in NAMES]
    bands = [rooms[name][1:] if name in rooms else None for name in NAMES]
    return plant.advance(levels, duration_s, bands)


class Watching:
    """Driver that leaves the building alone and keeps what it reads."""

    def __init__(self, steps):
        self._steps, self.readings = steps, []

    @property
    def done(self):
        return len(self.readings) >= self._steps

    def begin(self, warming_up):
        return {}

    def end(self, warming_up, read):
        if not (warming_up or self.done):
            self.readings.append(read())
        return self.done


def watch(first_day, days, sensors, means=None):
    """Run the building with sensors of our own and return each of them, one value a step."""
    model = office_model(first_day, days + 1, STEPS_PER_HOUR)
    driver = Watching(288 * days)
    wiring = Wiring(sensors, {}, dict, suffix="idf", means=means or {})
    run_engine(model, weather_file(WEATHER), driver, wiring)
    return {name: np.array([reading[name] for reading in driver.readings]) for name in driver.readings[0]}


# Martin Luther King Day on a Monday; daylight saving time begins; it ends, and Veterans Day; Christmas and New Year.
@pytest.mark.parametrize(("first_day", "days"), [(13, 3), (68, 3), (306, 10), (356, 12)])
def test_forecast_schedules_are_those_that_the_engine_follows(first_day, days):
    seen = watch(
        first_day,
        days,
        {
            "heating": ("Zone Thermostat Heating Setpoint Temperature", "Core_ZN"),
            "cooling": ("Zone Thermostat Cooling Setpoint Temperature", "Core_ZN"),
            "people": ("People Occupant Count", "Perimeter_ZN_2 People"),
        },
    )
    time_s = first_day * DAY_S + 300.0 * np.arange(288 * days)
    heating, cooling = office_schedules().setpoints_C(time_s)
    assert seen["heating"].tolist() == heating.tolist()
    assert seen["cooling"].tolist() == cooling.tolist()
    # East: 67.3 m² at 18.58 m² a person, also in what the plant forecasts.
    assert seen["people"] == pytest.approx(67.30 / 18.58 * office_schedules().occupancy(time_s), rel=1e-3)


def test_means_are_taken_over_the_system_steps_of_a_step():
    air, of_zone = ("Zone Air Temperature", "Core_ZN"), ("Zone Mean Air Temperature", "Core_ZN")
    seen = watch(28, 1, {"mean": of_zone, "last": air}, {"ours": air})
    assert seen["ours"] == pytest.approx(seen["mean"], abs=1e-9)  # the engine's own mean
    assert np.abs(seen["last"] - seen["mean"]).max() > 0.1, "the engine divided no step"


@pytest.fixture(scope="module")
def cold():
    """Native control from Monday 29 January, a day of warm-up and a day scored: plant, record, forecast, KPIs."""
    with office() as plant:
        first = plant.reset(29 * DAY_S, DAY_S)
        nothing = plant.kpis()
        boundary = plant.forecast(DAY_S, 300.0)
        last = plant.advance(None, DAY_S)
        yield plant, first, nothing, boundary, last, plant.past(300.0)


def test_native_control_keeps_the_schedules_and_the_record_has_the_shapes_of_its_names(cold):
    plant, first, nothing, boundary, last, record = cold
    assert record.names.zones == NAMES
    n = 2 * 288
    assert record.time_s[[0, -1]].tolist() == [28 * DAY_S, 30 * DAY_S]
    assert record.T_zone_C.shape == (5, n + 1)
    assert record.u.shape == record.heat_W.shape == record.power_W.shape == (5, n)
    assert (first.time_s, last.time_s) == (29 * DAY_S, 30 * DAY_S)
    assert np.isnan(first.u).all()
    assert last.T_zone_C.tolist() == record.T_zone_C[:, -1].tolist()
    assert last.power_W == pytest.approx(record.power_W[:, 288:].mean(axis=1))
    at_work = (boundary.time_s % DAY_S > 8 * HOUR_S) & (boundary.time_s % DAY_S < 20 * HOUR_S)
    assert record.T_zone_C[:, 288:][:, at_work].min() > 20.9
    assert nothing == dict.fromkeys(plant.kpis(), 0.0), "nothing counts before the warm-up is over"


def test_level_heat_and_power_are_those_of_burner_coil_and_fan(cold):
    _, _, _, _, _, record = cold
    sizes_W = np.array([zone.heating_W for zone in ZONES])[:, None]
    assert record.u == pytest.approx(np.minimum(record.heat_W / sizes_W, 1.0))
    fan_W = record.power_W - np.maximum(record.heat_W, 0.0) / 0.8  # the burners' efficiency
    hour = record.time_s[:-1] % DAY_S / HOUR_S
    on = (hour >= 6) & (hour < 22)
    assert fan_W[:, on].min(axis=1) == pytest.approx(fan_W.max(axis=1), abs=20.0)  # ventilation by the clock
    assert (np.abs(fan_W[:, ~on]) < 1e-6).any()  # at night it cycles


def test_the_forecast_is_the_weather_that_comes_and_bounds_are_tight_while_people_are_there(cold):
    _, _, _, boundary, _, record = cold
    assert boundary.T_out_C == pytest.approx(record.T_out_C[288:], abs=0.5)
    assert np.abs(boundary.solar_W_m2 - record.solar_W_m2[288:]).max() < 60.0
    hour = boundary.time_s % DAY_S / HOUR_S
    busy = (hour >= 6) & (hour < 20)
    for bound, tight, wide in ((boundary.lower_C, 21.0, 14.6), (boundary.upper_C, 24.0, 27.7)):
        assert bound == pytest.approx(np.tile(np.where(busy, tight, wide), (5, 1)))
    assert boundary.occupancy[:, 120] == pytest.approx(AREAS_M2 / 18.58 * 0.95)
    assert (boundary.heating_price_per_kWh == 0.07).all()
    assert (boundary.price_per_kWh == 0.2535).all()


def test_gas_electricity_and_every_zone_count(cold):
    plant, _, _, boundary, _, record = cold
    total, kWh_m2 = plant.kpis(), 1.0 / 12 / 1e3 / AREAS_M2.sum()
    gas = np.maximum(record.heat_W[:, 288:], 0.0).sum() / 0.8 * kWh_m2
    energy = record.power_W[:, 288:].sum() * kWh_m2
    assert total["ener_tot"] == pytest.approx(energy)
    assert total["cost_tot"] == pytest.approx(0.07 * gas + 0.2535 * (energy - gas))
    T = record.T_zone_C[:, 288:]
    outside = np.maximum(np.maximum(boundary.lower_C - T, T - boundary.upper_C), 0)
    K_h = np.trapezoid(outside, boundary.time_s / HOUR_S, axis=1)
    assert [total[f"tdis_tot[{name}]"] for name in NAMES] == pytest.approx(K_h)
    assert total["tdis_tot"] == pytest.approx(K_h.mean())
    assert K_h.min() > 0.2, "the native schedule begins to heat when people come"


def test_a_steps_record_is_the_mean_of_its_parts(cold):
    plant, _, _, _, _, fine = cold
    coarse = plant.past(1800.0)
    assert coarse.T_zone_C.tolist() == fine.T_zone_C[:, ::6].tolist()
    assert coarse.power_W == pytest.approx(fine.power_W.reshape(5, 96, 6).mean(axis=2))
    with pytest.raises(InputError, match="multiple of EnergyPlus' step of 300 s"):
        plant.past(400.0)


def test_a_told_set_point_acts_in_its_zone_and_gives_back_control_when_it_is_silent():
    with office() as plant:
        plant.reset(28 * DAY_S + 4 * HOUR_S, 4 * HOUR_S)
        driven = told(plant, 1200.0, south=(1.0, 35.0, 35.0))  # at night a unit pauses 5 min in 35
        south, record = NAMES.index("south"), plant.past(300.0)
        assert record.T_zone_C[south, -4:].max() > 19.0
        assert np.delete(driven.T_zone_C, south).max() < 17.5
        assert record.heat_W[south].max() == pytest.approx(ZONES[south].heating_W, rel=1e-3), "the burner at its size"
        assert record.u.max() == pytest.approx(1.0, abs=1e-3)
        told(plant, 1200.0, north=(1.0, 20.0, 20.0))
        assert plant.past(300.0).T_zone_C[3, -3:].max() == pytest.approx(20.0, abs=0.1)
        assert plant.past(300.0).heat_W[south, -3:].max() < 0.1 * ZONES[south].heating_W


def test_cooling_has_its_sign_and_its_price():
    with office() as plant:
        plant.reset(196 * DAY_S + 14 * HOUR_S, 8 * HOUR_S, "dynamic")
        full = told(plant, 900.0, **dict.fromkeys(NAMES, (-0.5, 10.0, 10.0)))
        sizes_W = np.array([zone.cooling_W for zone in ZONES])
        assert (full.heat_W < -0.75 * sizes_W).all()
        assert (full.heat_W > -sizes_W).all()
        assert (full.power_W > 1000.0).all()
        assert plant.kpis()["pgas_tot"] == 0.0
        assert plant.kpis()["cost_tot"] == pytest.approx(0.2666 * plant.kpis()["ener_tot"])


def test_the_same_actions_give_the_same_bits_and_an_uncertain_forecast_keeps_bounds_and_prices():
    def run(plant):
        plant.reset(98 * DAY_S, 6 * HOUR_S)
        assert plant.past(900.0).power_W.shape == (5, 24)
        for rooms in ({"core": (1.0, 22.0, 24.0)}, {}, {"west": (-0.5, 18.0, 18.0)}):
            told(plant, 900.0, **rooms)
        return plant.past(900.0), plant.forecast(DAY_S, HOUR_S)

    with office() as plant, office(forecast_error=ForecastError("medium", "medium", 1)) as erring:
        (a, exact), (b, uncertain) = run(plant), run(erring)
    for name in ("T_zone_C", "heat_W", "power_W", "u"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
    assert np.abs(uncertain.T_out_C - exact.T_out_C).max() > 0.1
    assert uncertain.lower_C.tolist() == exact.lower_C.tolist()


def test_what_cannot_be_done_is_refused_by_name_and_the_process_ends_with_the_plant():
    others = children()  # of the shared fixture
    plant = office()
    for ask in (lambda: plant.advance(None, 900.0), lambda: plant.forecast(DAY_S, HOUR_S), plant.kpis):
        with pytest.raises(InputError, match="call reset"):
            ask()
    with pytest.raises(InputError, match="peak_heat_day, cold_day, mix_day, peak_cool_day"):
        plant.period("monsoon")
    assert plant.period("peak_cool_day").start_s == 196 * DAY_S
    with pytest.raises(InputError, match="unknown tariff"):
        plant.reset(0.0, 0.0, "free")
    with pytest.raises(InputError, match="warm-up of 400 s: expected a multiple"):
        plant.reset(DAY_S, 400.0)
    plant.reset(0.0, 0.0)
    with pytest.raises(InputError, match=r"core_thermostat.*heating set-point not above"):
        told(plant, 900.0, core=(1.0, 24.0, 22.0))
    with pytest.raises(InputError, match="step of 300 s"):
        plant.advance(None, 450.0)
    (process,) = children() - others
    os.kill(process, signal.SIGKILL)
    with pytest.raises(PlantError, match="EnergyPlus' process was ended by signal SIGKILL at day 0"):
        plant.advance(None, 900.0)
    with pytest.raises(PlantError, match="reset the plant"):
        plant.advance(None, 900.0)
    plant.reset(0.0, 0.0)
    plant.close()
    plant.close()
    assert children() == others


def test_without_the_engine_it_says_what_to_install(monkeypatch):
    from thermoforce_mpc.plants.energyplus import engine

    office_schedules.cache_clear()
    monkeypatch.setattr(engine.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"small_office.*pip install 'thermoforce-mpc\[energyplus\]'"):
        office()
