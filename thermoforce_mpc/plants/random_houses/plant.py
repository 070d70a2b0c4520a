"""Plant of a generated house, see `draw.House` and docs/how-it-works/random-buildings.md."""

from __future__ import annotations

import functools
import re

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.weather.synthetic import synthetic_weather
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import HOUR_S, YEAR_S, ZERO_C_K, Array, Measurement, Record
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.drawn_houses import (
    AIR_WH_M3_K,
    FACADES,
    HEIGHT_M,
    STEP_S,
    DrawnHousePlant,
    air_change,
    on_facades,
    year,
)
from thermoforce_mpc.plants.people import PERSON_W, at_home, live, set_back, varying
from thermoforce_mpc.plants.points import acting_means, interval_means, measurement, past_record
from thermoforce_mpc.plants.random_houses import physics
from thermoforce_mpc.plants.random_houses.draw import House, draw_house
from thermoforce_mpc.scenario.comfort import THERMOSTAT_INSIDE_K
from thermoforce_mpc.scenario.testcase import Actuator, MeasuredPoints, TestCase

# Native set-point above the lower bound while at home, K; set-back below it, K, and preheating, h, by emitter.
NATIVE_ABOVE_K = 0.6
SET_BACK_K = {"floor": 1.0, "radiator": 2.0, "air": 3.0}
PREHEAT_H = {"floor": 4.0, "radiator": 3.0, "air": 2.0}


def bounds_C(house: House, time_s: Array) -> tuple[Array, Array]:
    """Return lower and upper comfort bound at `time_s`, °C."""
    home = at_home(house.pattern, time_s)
    return (np.where(home, house.lower_C, house.empty_lower_C), np.where(home, house.upper_C, house.empty_upper_C))


def native_setpoint_C(house: House, time_s: Array) -> Array:
    """Return the set-point of the house's own control, °C: set back while nobody is home, preheating before they come.

    As installers set it: slow emitters are set back little and preheated early, and the set-back shrinks to nothing
    between a machine of 1.3 and one of 0.8 times the design load, which could not recover from it.
    """
    away = set_back(lambda t: at_home(house.pattern, t), time_s, lead_s=PREHEAT_H[house.emitter] * HOUR_S)
    day_C = house.lower_C + NATIVE_ABOVE_K
    back_K = SET_BACK_K[house.emitter] * min(max((house.sizing - 0.8) / 0.5, 0.0), 1.0)
    return np.where(away, day_C - back_K, day_C)


def gains_W(house: House, time_s: Array) -> Array:
    """Return internal heat gains on an equally spaced grid `time_s`, W: people, and appliances (see `varying`)."""
    home = at_home(house.pattern, time_s)
    varied = varying(np.random.default_rng([house.seed, house.index, 1]), time_s, house.gains_sd)
    appliances = np.where(home, house.gains_home_W_m2, house.gains_empty_W_m2) * house.floor_area_m2
    return np.asarray(np.where(home, house.people * PERSON_W, 0.0) + varied * appliances)


_NAME = re.compile(r"generated:(\d{1,9}):(\d{1,9})", re.ASCII)
_COLUMN = {name: i for i, name in enumerate(physics.RECORD)}
# Full sun on the sensor, W/m² on its facade.
_FULL_SUN_W_M2 = 800.0


def generated_house(name: str) -> House:
    """Return house INDEX of the population SEED, `generated:SEED:INDEX`; raises `InputError` for another name."""
    match = _NAME.fullmatch(name)
    if match is None:
        raise InputError(f"house '{name}': expected generated:SEED:INDEX, such as generated:2026:0")
    return draw_house(int(match[1]), int(match[2]))


def house_testcase(house: House) -> TestCase:
    """Return the test case of a house: point names, floor area and the baseline thermostat's set-point; no defaults."""
    return TestCase(
        name=f"generated:{house.seed}:{house.index}",
        description=house.words,
        floor_area_m2=house.floor_area_m2,
        mode="heating",
        actuator=Actuator(point="level"),
        measurements=MeasuredPoints(
            zone_temperature="T_measured",
            outdoor_temperature="T_out",
            solar="solar",
            electric_power=("P_billed",),
            heat=("Q_machine",) if house.heat_metered else (),
            return_water="T_return" if house.heat_metered else None,
        ),
        thermostat_C=house.lower_C + THERMOSTAT_INSIDE_K,
        plant="generated",
    )


def named_testcase(name: str) -> TestCase:
    """Return the test case of `generated:SEED:INDEX`; raises `InputError` for another name."""
    return house_testcase(generated_house(name))


class GeneratedHousePlant(DrawnHousePlant):
    """A generated house behind the `Plant` protocol; records and measurements hold what the sensor reads."""

    house: House
    _kind = "generated"
    _changing = (*DrawnHousePlant._changing, "_state")

    def __init__(self, house: House, highly_dynamic: tariffs.Tariff | None = None, people: int | None = None) -> None:
        """Build the house.

        Args:
            house: what was drawn.
            highly_dynamic: replaces the synthetic tariff of that name. Gas costs the same in all.
            people: seed of people who do not keep to the schedule, see `plants.people`; default: they keep to it.
        """
        self.house, self._tariffs = house, tariffs.by_name(highly_dynamic)
        self._carrier = "GasPower" if house.machine == "boiler" else "ElectricPower"
        self.testcase = house_testcase(house)
        self._points = self.testcase.points
        self.weather, self._scheduled, self._noise = year_of(house)
        self._grid = self._scheduled if people is None else _with_people(self._scheduled, house, people)
        self._parameters = physics.parameters(house)
        self.reset(0.0, 0.0)

    def _heat_year(self) -> tuple[Array, Array, Array]:
        grid = self._scheduled
        T_out_C = grid[:, physics.T_OUT]
        gains_W = grid[:, physics.GAINS] + grid[:, physics.SUN_IN]
        return T_out_C, grid[:, physics.GLOBAL], self.house.loss_W_K * (20.0 - T_out_C) - gains_W

    def _bounds_C(self, time_s: Array) -> tuple[Array, Array]:
        return bounds_C(self.house, time_s)

    def _people(self, time_s: Array) -> Array:
        return np.asarray(self.house.people * at_home(self.house.pattern, time_s).astype(np.float64))

    def _bought(self, time_s: Array) -> tuple[Array, Array]:
        if self.house.machine != "boiler":
            return super()._bought(time_s)
        return np.full(time_s.shape, tariffs.GAS), np.full(time_s.shape, tariffs.GAS_EMISSION_KG_PER_KWH)

    def _power_and_rooms(self, rows: Array) -> tuple[Array, Array]:
        return rows[:, _COLUMN["P_billed"]], rows[:, _COLUMN["T_operative"]][None] - ZERO_C_K

    def _scored(self) -> dict[str, float]:
        return self._kpis_between(self._start_s, self._now_s, True)

    def _past(self, edges: Array) -> Record:
        record = self.recorded(self._begin_s, self._now_s)
        return past_record(record, self._points, interval_means(record, ["level"], edges)[None], edges)

    def recorded(self, start_s: float, final_s: float) -> dict[str, Array]:
        """Return the samples between two times, both included: 'time' s and the columns of `physics.RECORD`."""
        times, rows = self._samples.between(start_s, final_s)
        return {"time": times} | {name: rows[:, i] for name, i in _COLUMN.items()}

    def _simulate(self, forced: Array, before_s: float, dt_s: float, rows: Array) -> None:
        level = float(forced[0])
        physics.advance(self._state, before_s, len(rows), dt_s, level, self._grid, self._noise, self._parameters, rows)

    def _measured(self, before_s: float) -> Measurement:
        points, acting = self._points, None
        if before_s < self._now_s:
            edges = np.array([before_s, self._now_s])
            record = self.recorded(before_s, self._now_s)
            acting = acting_means(record, points, interval_means(record, ["level"], edges)[None], edges)
        row = self._samples.rows[-1]
        names = (*points.temperatures, points.outdoor_temperature, points.solar, *points.flows)
        return measurement(self._now_s, {name: float(row[_COLUMN[name]]) for name in names}, points, acting)

    def _first_row(self) -> Array:
        self._state = np.zeros(physics.N_STATES)
        T = self._state[: physics.INTEGRAL] = self.house.lower_C
        T_out_C, solar_W_m2 = self._weather_now()
        row = np.zeros(len(physics.RECORD))
        row[[_COLUMN[name] for name in ("T_operative", "T_return", "T_supply")]] = T + ZERO_C_K
        reading = physics.measured_C(self._parameters, T, self._noise[int(self._now_s / STEP_S)])
        row[_COLUMN["T_measured"]], row[_COLUMN["T_out"]] = reading + ZERO_C_K, T_out_C + ZERO_C_K
        row[_COLUMN["solar"]], row[_COLUMN["stored_J"]] = solar_W_m2, physics.stored_J(self._parameters, self._state)
        return row


@functools.lru_cache(maxsize=2)
def year_of(house: House) -> tuple[Weather, Array, Array]:
    """Weather, `build_grid`, and noise of the sensor (see `physics.advance`) of a house, the same in all its runs.

    Kept for those that follow one another in a process: they take about 0.2 s to make and 10 MB.
    """
    weather = synthetic_weather(house.weather_seed, warmer_K=house.warmer_K, clearer=house.clearer)
    noise = np.random.default_rng([house.seed, house.index, 2]).standard_normal(round(YEAR_S / STEP_S))
    noise.setflags(write=False)
    return weather, build_grid(house, weather), noise


def build_grid(house: House, weather: Weather) -> Array:
    """Return weather, sun through the windows and schedules of a year every 15 min, shape (35041, 7), see `physics`."""
    time_s = year()
    grid = np.zeros((time_s.size, physics.N_COLUMNS))
    grid[:, physics.T_OUT] = weather.at("T_dry_C", time_s)
    grid[:, physics.GLOBAL] = weather.at("global_W_m2", time_s)
    lights = on_facades(weather, time_s)
    for facade, area_m2, (passing, irradiance) in zip(FACADES, house.windows_m2, lights, strict=True):
        grid[:, physics.SUN_IN] += house.unshaded * house.g_value * area_m2 * passing
        if facade == house.sun_facade:
            grid[:, physics.SUN_ON_SENSOR] = np.minimum(irradiance / _FULL_SUN_W_M2, 1.0)
    grid[:, physics.VENTILATION] = house.ventilation_W_K * air_change(weather, time_s)
    grid[:, physics.GAINS] = gains_W(house, time_s)
    grid[:, physics.SETPOINT] = native_setpoint_C(house, time_s)
    grid.setflags(write=False)
    return grid


def _with_people(grid: Array, house: House, seed: int) -> Array:
    """Return the grid of a house whose people do not keep to the schedule."""
    usual = at_home(house.pattern, year())
    life = live(
        [seed, house.seed, house.index],
        usual,
        house.people,
        T_out_C=grid[:, physics.T_OUT],
        solar_W_m2=grid[:, physics.GLOBAL],
    )
    lived = grid.copy()
    lived[:, physics.GAINS] += PERSON_W * (life.present - house.people * usual) + life.cooking_W
    lived[:, physics.VENTILATION] += AIR_WH_M3_K * HEIGHT_M * house.floor_area_m2 * life.windows_1_h[0]
    lived[:, physics.SUN_IN] *= life.sun[0]
    lived.setflags(write=False)
    return lived
