"""The DOE small office as a plant: five zones, a heating and a cooling set-point each, native schedules."""

import multiprocessing

import numpy as np
import pytest

from thermoforce_mpc.boundary.forecast_error import ForecastError
from thermoforce_mpc.data import DAY_S, HOUR_S
from thermoforce_mpc.errors import ConfigError, InputError, PlantError
from thermoforce_mpc.plants.energyplus.engine import is_available, weather_file
from thermoforce_mpc.plants.energyplus.office import SmallOffice
from thermoforce_mpc.plants.energyplus.office_model import WEATHER, ZONES, OfficeRun, office_schedules
from thermoforce_mpc.plants.energyplus.simulate import Wiring, run_engine

pytestmark = pytest.mark.slow

pytestmark = pytest.mark.skipif(not is_available(), reason="EnergyPlus (extra [energyplus]) is not installed")

HEATING, COOLING = slice(0, 5), slice(5, 10)


def told(**setpoints):
    values = np.full(10, np.nan)
    for name, value in setpoints.items():
        values[SmallOffice.actuators.index(name)] = value
    return values


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
    run = OfficeRun(first_day, days + 1)
    driver = Watching(288 * days)
    wiring = Wiring(sensors, {}, dict, suffix="idf", means=means or {})
    run_engine(run.model(), weather_file(WEATHER), driver, wiring)
    return {name: np.array([reading[name] for reading in driver.readings]) for name in driver.readings[0]}


# Martin Luther King Day on a Monday; daylight saving time begins; it ends, and Veterans Day; Christmas and New Year.
@pytest.mark.slow
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


@pytest.mark.slow
def test_means_are_taken_over_the_system_steps_of_a_step():
    air, of_zone = ("Zone Air Temperature", "Core_ZN"), ("Zone Mean Air Temperature", "Core_ZN")
    seen = watch(28, 1, {"mean": of_zone, "last": air}, {"ours": air})
    assert seen["ours"] == pytest.approx(seen["mean"], abs=1e-9)  # the engine's own mean
    assert np.abs(seen["last"] - seen["mean"]).max() > 0.1, "the engine divided no step"


@pytest.fixture(scope="module")
def cold():
    """Native control from Monday 29 January, a day of warm-up and a day scored: plant, record, forecast, KPIs."""
    with SmallOffice() as plant:
        first = plant.reset(29 * DAY_S, DAY_S)
        nothing = plant.kpis()
        boundary = plant.forecast(DAY_S, 300.0)
        last = plant.advance(None, DAY_S)
        yield plant, first, nothing, boundary, last, plant.past(300.0)


@pytest.mark.slow
def test_native_control_keeps_the_schedules_and_the_record_has_the_shapes_of_its_names(cold):
    plant, first, nothing, boundary, last, record = cold
    assert (len(plant.zones), len(plant.actuators), len(plant.machines)) == (5, 10, 10)
    assert plant.actuators[0] == "core_heating"
    assert plant.actuators[5] == "core_cooling"
    assert plant.floor_area_m2.sum() == pytest.approx(511.16)
    n = 2 * 288
    assert record.time_s[[0, -1]].tolist() == [28 * DAY_S, 30 * DAY_S]
    assert record.T_zone_C.shape == (5, n + 1)
    assert record.T_out_C.shape == record.solar_W_m2.shape == (n + 1,)
    for values in (record.setpoint_C, record.level, record.heat_W, record.power_W):
        assert values.shape == (10, n)
    assert record.supply_W.shape == record.fan_W.shape == (5, n)
    assert (first.time_s, last.time_s) == (29 * DAY_S, 30 * DAY_S)
    assert np.isnan(first.level).all()
    assert last.T_zone_C.tolist() == record.T_zone_C[:, -1].tolist()
    assert last.power_W == pytest.approx(record.power_W[:, 288:].mean(axis=1))
    heating, cooling = office_schedules().setpoints_C(record.time_s[:-1])
    assert (record.setpoint_C[HEATING] == heating).all()
    assert (record.setpoint_C[COOLING] == cooling).all()
    at_work = (boundary.time_s % DAY_S > 8 * HOUR_S) & (boundary.time_s % DAY_S < 20 * HOUR_S)
    assert record.T_zone_C[:, 288:][:, at_work].min() > 20.9
    assert nothing == dict.fromkeys(plant.kpis(), 0.0), "nothing counts before the warm-up is over"


def test_heat_and_power_are_those_of_burner_coil_and_fan(cold):
    plant, _, _, _, _, record = cold
    assert record.power_W[HEATING] == pytest.approx(record.heat_W[HEATING] / 0.8)  # the burners' efficiency
    assert (record.heat_W[HEATING] >= 0).all()
    assert (record.heat_W[COOLING] <= 0).all()
    assert record.power_W[COOLING] == pytest.approx(record.fan_W, abs=20.0)  # no cooling in January but for a touch
    hour = record.time_s[:-1] % DAY_S / HOUR_S
    on = (hour >= 6) & (hour < 22)
    assert record.fan_W[:, on].min(axis=1) == pytest.approx(record.fan_W.max(axis=1))  # ventilation by the clock
    assert (record.fan_W[:, ~on] == 0.0).any()  # at night it cycles
    assert record.level == pytest.approx(np.minimum(record.heat_W / plant.capacity_W[:, None], 1.0))
    # From 07:00 on outdoor air is heated too: burners give more than the room receives; at night there is none.
    noon = (hour >= 10) & (hour < 12)
    assert (record.heat_W[HEATING, noon].mean(axis=1) > record.supply_W[:, noon].mean(axis=1) + 300.0).all()
    early = (hour >= 6.2) & (hour < 6.9)
    assert record.supply_W[:, early] == pytest.approx(record.heat_W[HEATING, early] + record.fan_W[:, early], rel=0.05)


def test_the_forecast_is_the_weather_that_comes_and_bounds_are_tight_while_people_are_there(cold):
    plant, _, _, boundary, _, record = cold
    assert boundary.T_out_C == pytest.approx(record.T_out_C[288:], abs=0.5)
    assert np.abs(boundary.solar_W_m2 - record.solar_W_m2[288:]).max() < 60.0
    for values in (boundary.occupancy, boundary.lower_C, boundary.upper_C):
        assert values.shape == (5, 289)
    hour = boundary.time_s % DAY_S / HOUR_S
    busy = (hour >= 6) & (hour < 20)
    for bound, tight, wide in ((boundary.lower_C, 21.0, 14.6), (boundary.upper_C, 24.0, 27.7)):
        assert bound == pytest.approx(np.tile(np.where(busy, tight, wide), (5, 1)))
    assert boundary.occupancy[:, 120] == pytest.approx(plant.floor_area_m2 / 18.58 * 0.95)
    assert boundary.price_per_kWh.shape == boundary.emission_kg_per_kWh.shape == (10, 289)
    assert (boundary.price_per_kWh[HEATING] == 0.07).all()
    assert (boundary.price_per_kWh[COOLING] == 0.2535).all()


def test_zones_and_the_building_are_scored_per_floor_area_of_the_building(cold):
    plant, _, _, boundary, _, record = cold
    total, zones = plant.kpis(), plant.zone_kpis()
    gas, electric = (record.power_W[which, 288:].sum() / 12 / 1e3 / 511.16 for which in (HEATING, COOLING))
    assert total["ener_tot"] == pytest.approx(gas + electric)
    assert total["cost_tot"] == pytest.approx(0.07 * gas + 0.2535 * electric)
    assert tuple(zones) == plant.zones
    for name in ("ener_tot", "cost_tot", "emis_tot"):
        assert sum(zone[name] for zone in zones.values()) == pytest.approx(total[name])
    outside = np.maximum(
        np.maximum(boundary.lower_C - record.T_zone_C[:, 288:], record.T_zone_C[:, 288:] - boundary.upper_C), 0
    )
    K_h = np.trapezoid(outside, boundary.time_s / HOUR_S, axis=1)
    assert [zone["tdis_tot"] for zone in zones.values()] == pytest.approx(K_h)
    assert total["tdis_tot"] == pytest.approx(K_h.mean())
    assert K_h.min() > 0.2, "the native schedule begins to heat when people come"


def test_a_steps_record_is_the_mean_of_its_parts(cold):
    plant, _, _, _, _, fine = cold
    coarse = plant.past(1800.0)
    assert coarse.T_zone_C.tolist() == fine.T_zone_C[:, ::6].tolist()
    assert coarse.power_W == pytest.approx(fine.power_W.reshape(10, 96, 6).mean(axis=2))
    with pytest.raises(InputError, match="multiple of EnergyPlus' step of 300 s"):
        plant.past(400.0)


@pytest.mark.slow
def test_a_told_set_point_acts_in_its_zone_and_gives_back_control_when_it_is_silent():
    with SmallOffice() as plant:
        plant.reset(28 * DAY_S + 4 * HOUR_S, 4 * HOUR_S)
        driven = plant.advance(told(south_heating=35.0), 1200.0)  # at night a unit pauses 5 min in 35
        south, record = plant.zones.index("south"), plant.past(300.0)
        assert record.T_zone_C[south, -4:].max() > 19.0
        assert np.delete(driven.T_zone_C, south).max() < 17.5
        assert record.heat_W[south].max() == pytest.approx(ZONES[south].heating_W, rel=1e-3), "the burner at its size"
        assert record.level.max() == pytest.approx(1.0, abs=1e-3)
        # The other set-point of the zone gives way, those of the other zones stay.
        assert driven.setpoint_C == pytest.approx([15.6, 35.0, 15.6, 15.6, 15.6, 26.7, 35.0, 26.7, 26.7, 26.7])
        native = plant.advance(None, 900.0)
        assert native.setpoint_C == pytest.approx([15.6] * 5 + [26.7] * 5)
        cooled = plant.advance(told(core_cooling=10.0, north_heating=20.0, north_cooling=20.0), 300.0)
        assert cooled.setpoint_C[[0, 5, 3, 8]].tolist() == [10.0, 10.0, 20.0, 20.0]
        plant.advance(told(north_heating=20.0, north_cooling=20.0), 900.0)
        assert plant.past(300.0).T_zone_C[3, -3:].max() == pytest.approx(20.0, abs=0.1)


@pytest.mark.slow
def test_cooling_has_its_sign_and_its_price():
    with SmallOffice() as plant:
        plant.reset(196 * DAY_S + 14 * HOUR_S, 8 * HOUR_S, "dynamic")
        full = plant.advance(np.full(10, 10.0), 900.0)
        assert (full.heat_W[COOLING] < 0.75 * plant.capacity_W[COOLING]).all()
        assert (full.heat_W[COOLING] > plant.capacity_W[COOLING]).all()
        assert (full.power_W[HEATING] == 0.0).all()
        assert (full.power_W[COOLING] > full.fan_W + 1000.0).all()
        assert plant.kpis()["pgas_tot"] == 0.0
        assert plant.kpis()["cost_tot"] == pytest.approx(0.2666 * plant.kpis()["ener_tot"])
        assert plant.forecast(HOUR_S, HOUR_S).price_per_kWh[:, 0].tolist() == [0.07] * 5 + [0.2666] * 5


@pytest.mark.slow
def test_the_same_actions_give_the_same_bits():
    def run(plant):
        plant.reset(98 * DAY_S, 6 * HOUR_S)
        for values in (told(core_heating=22.0), None, told(west_cooling=18.0)):
            plant.advance(values, 900.0)
        return plant.past(900.0)

    with SmallOffice() as plant:
        a, b = run(plant), run(plant)
        for name in ("T_zone_C", "heat_W", "power_W", "setpoint_C"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes()


@pytest.mark.slow
def test_a_forecast_with_errors_keeps_bounds_and_prices():
    with SmallOffice(forecast_error=ForecastError("medium", 1)) as plant, SmallOffice() as exact:
        for one in (plant, exact):
            one.reset(28 * DAY_S, 0.0)
        a, b = plant.forecast(DAY_S, HOUR_S), exact.forecast(DAY_S, HOUR_S)
        assert np.abs(a.T_out_C - b.T_out_C).max() > 0.1
        assert a.lower_C.tolist() == b.lower_C.tolist()
        assert exact.past(900.0).power_W.shape == (10, 0)


@pytest.mark.slow
def test_what_cannot_be_done_is_refused_by_name_and_the_process_ends_with_the_plant():
    others = set(multiprocessing.active_children())  # of the shared fixture
    plant = SmallOffice()
    with pytest.raises(InputError, match="call reset"):
        plant.advance(None, 900.0)
    with pytest.raises(InputError, match="peak_heat_day, cold_day, mix_day, peak_cool_day"):
        plant.period("monsoon")
    assert plant.period("peak_cool_day").start_s == 196 * DAY_S
    with pytest.raises(InputError, match="unknown tariff"):
        plant.reset(0.0, 0.0, "free")
    with pytest.raises(InputError, match="warm-up of 400 s: expected a multiple"):
        plant.reset(DAY_S, 400.0)
    plant.reset(0.0, 0.0)
    for values, message in (
        (np.full(9, 20.0), r"shape \(9,\).*core_heating"),
        (told(east_heating=40.0), "set-point of east_heating: 40 °C"),
        (told(west_heating=24.0, west_cooling=22.0), "zone west: its heating set-point of 24 °C"),
        (["warm"] * 10, "expected 10 numbers"),
    ):
        with pytest.raises(InputError, match=message):
            plant.advance(values, 900.0)
    with pytest.raises(InputError, match="step of 300 s"):
        plant.advance(None, 450.0)
    (process,) = set(multiprocessing.active_children()) - others
    process.kill()
    with pytest.raises(PlantError, match=r"day 0.*reset the plant"):
        plant.advance(None, 900.0)
    with pytest.raises(PlantError, match="reset the plant"):
        plant.advance(None, 900.0)
    plant.reset(0.0, 0.0)
    plant.close()
    plant.close()
    assert set(multiprocessing.active_children()) == others


def test_without_the_engine_it_says_what_to_install(monkeypatch):
    from thermoforce_mpc.plants.energyplus import engine

    office_schedules.cache_clear()
    monkeypatch.setattr(engine.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"small_office.*pip install 'thermoforce-mpc\[energyplus\]'"):
        SmallOffice()
