"""Plant of a generated house, see `draw.House` and docs/how-it-works/random-buildings.md."""

from __future__ import annotations

import functools
import re

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.weather.solar import sun_position
from thermoforce_mpc.boundary.weather.synthetic import synthetic_weather
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import YEAR_S, ZERO_C_K, Array, Boundary, Measurement, Record
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.drawn_houses.envelope import (
    AIR_WH_M3_K,
    AZIMUTH_DEG,
    FACADES,
    GRID_S,
    HEIGHT_M,
    MEAN_WIND_M_S,
    STEP_S,
    WIND_SHARE,
    on_facade,
)
from thermoforce_mpc.plants.drawn_houses.occupants import PERSON_W, at_home
from thermoforce_mpc.plants.drawn_houses.plant import THERMOSTAT_ABOVE_K, DrawnHousePlant
from thermoforce_mpc.plants.kpis import Supply, Violation, building_kpis, excess
from thermoforce_mpc.plants.people import live
from thermoforce_mpc.plants.random_houses import physics, schedule
from thermoforce_mpc.plants.random_houses.draw import House, draw_house
from thermoforce_mpc.plants.records import acting_means, interval_means, measurement, past_record
from thermoforce_mpc.plants.shell import CLOCK_S
from thermoforce_mpc.scenario.testcase import Actuator, Measurements, TestCase

_NAME = re.compile(r"generated:(\d{1,9}):(\d{1,9})")
_COLUMN = {name: i for i, name in enumerate(physics.RECORD)}
# Full sun on the sensor, W/m² on its facade.
_FULL_SUN_W_M2 = 800.0


def generated_house(name: str) -> House:
    """Return the house `generated:SEED:INDEX`: number INDEX of the population SEED.

    Raises:
        InputError: `name` has another form.
    """
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
        measurements=Measurements(
            zone_temperature="T_measured",
            outdoor_temperature="T_out",
            solar="solar",
            electric_power=("P_billed",),
            heat=("Q_machine",) if house.heat_metered else (),
            return_water="T_return" if house.heat_metered else None,
        ),
        thermostat_C=house.lower_C + THERMOSTAT_ABOVE_K,
        plant="generated",
    )


def named_testcase(name: str) -> TestCase:
    """Return the test case of `generated:SEED:INDEX`; raises `InputError` for another name."""
    return house_testcase(generated_house(name))


class GeneratedHousePlant(DrawnHousePlant):
    """A generated house behind the `Plant` protocol. Deterministic: same house and inputs, same bytes.

    Comfort is judged by the true operative temperature; records and measurements hold what the sensor reads.
    """

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
        self.house = house
        by_name = tariffs.by_name(highly_dynamic)
        self._tariffs = {name: _gas if house.machine == "boiler" else by_name[name] for name in by_name}
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

    def _boundary(self, time_s: Array) -> Boundary:
        lower, upper = schedule.bounds_C(self.house, time_s)
        price, emission = self._prices(time_s)
        return Boundary(
            time_s=time_s,
            T_out_C=self.weather.at("T_dry_C", time_s),
            solar_W_m2=self.weather.at("global_W_m2", time_s),
            occupancy=self.house.people * at_home(self.house.pattern, time_s).astype(np.float64),
            lower_C=lower,
            upper_C=upper,
            price_per_kWh=price,
            emission_kg_per_kWh=emission,
        )

    def _past(self, edges: Array) -> Record:
        record = self.recorded(self._begin_s, self._now_s)
        return past_record(record, self._points, interval_means(record, ["level"], edges)[None], edges)

    def kpis(self) -> dict[str, float]:
        """Return BOPTEST's KPIs since the end of the warm-up; discomfort is that of the true temperature."""
        if self._now_s - self._start_s < CLOCK_S:
            return dict.fromkeys(("ener_tot", "cost_tot", "emis_tot", "tdis_tot"), 0.0)
        record = self.recorded(self._start_s, self._now_s)
        time_s = record["time"]
        lower, upper = schedule.bounds_C(self.house, time_s)
        price, emission = self._prices(time_s)
        carrier = "GasPower" if self.house.machine == "boiler" else "ElectricPower"
        power_W = record["P_billed"]
        supply = Supply(carrier, power_W, price, emission)
        return building_kpis(
            time_s,
            supplies=[supply],
            thermal=[Violation("1", excess(record["T_operative"] - ZERO_C_K, lower, upper))],
            air_quality=[],
            area_m2=self.house.floor_area_m2,
        )

    def recorded(self, start_s: float, final_s: float) -> dict[str, Array]:
        """Return the samples between two times, both included: 'time' s and the columns of `physics.RECORD`."""
        times, rows = self._samples.between(start_s, final_s)
        return {"time": times} | {name: rows[:, i] for name, i in _COLUMN.items()}

    def _prices(self, time_s: Array) -> tuple[Array, Array]:
        """Price per kWh and emissions, kg/kWh, of the billed energy at each time."""
        gas = self.house.machine == "boiler"
        emission = tariffs.GAS_EMISSION_KG_PER_KWH if gas else tariffs.EMISSION_KG_PER_KWH
        return self._tariffs[self._price](time_s), np.full(time_s.shape, emission)

    def _simulate(self, forced: Array, before_s: float, dt_s: float, rows: Array) -> None:
        level = float(forced[0])
        physics.advance(self._state, before_s, len(rows), dt_s, level, self._grid, self._noise, self._parameters, rows)

    def _measured(self, before_s: float) -> Measurement:
        points, acting = self._points, None
        if before_s < self._now_s:
            edges = np.array([before_s, self._now_s])
            record = self.recorded(before_s, self._now_s)
            acting = acting_means(record, points, interval_means(record, ["level"], edges)[None], edges)
        return measurement(self._now_s, self._values(), points, acting)

    def _values(self) -> dict[str, float]:
        """Measured points of the latest sample by name, K and W."""
        p = self._points
        names = (*p.temperatures, p.outdoor_temperature, p.solar, *p.flows)
        return {name: float(self._samples.rows[-1, _COLUMN[name]]) for name in names}

    def _first_row(self) -> Array:
        self._state = np.zeros(physics.N_STATES)
        self._state[: physics.INTEGRAL] = self.house.lower_C
        row = np.zeros(len(physics.RECORD))
        now = np.array([self._now_s])
        T = self.house.lower_C
        reading = physics.measured_C(self._parameters, T, self._noise[int(self._now_s / STEP_S)])
        row[_COLUMN["T_operative"]], row[_COLUMN["T_measured"]] = T + ZERO_C_K, reading + ZERO_C_K
        row[_COLUMN["T_return"]] = row[_COLUMN["T_supply"]] = T + ZERO_C_K
        row[_COLUMN["T_out"]] = float(self.weather.at("T_dry_C", now)[0]) + ZERO_C_K
        row[_COLUMN["solar"]] = float(self.weather.at("global_W_m2", now)[0])
        row[_COLUMN["stored_J"]] = physics.stored_J(self._parameters, self._state)
        return row


def _gas(time_s: Array) -> Array:
    return np.full(np.shape(time_s), tariffs.GAS)


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
    time_s = np.arange(0.0, YEAR_S + GRID_S, GRID_S)
    sun = sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)
    grid = np.zeros((time_s.size, physics.N_COLUMNS))
    grid[:, physics.T_OUT] = weather.at("T_dry_C", time_s)
    grid[:, physics.GLOBAL] = weather.at("global_W_m2", time_s)
    for facade, area_m2 in zip(FACADES, house.windows_m2, strict=True):
        passing, irradiance = on_facade(weather, sun, time_s, AZIMUTH_DEG[facade])
        grid[:, physics.SUN_IN] += house.unshaded * house.g_value * area_m2 * passing
        if facade == house.sun_facade:
            grid[:, physics.SUN_ON_SENSOR] = np.minimum(irradiance / _FULL_SUN_W_M2, 1.0)
    wind = weather.at("wind_m_s", time_s) / MEAN_WIND_M_S
    grid[:, physics.VENTILATION] = house.ventilation_W_K * (1.0 - WIND_SHARE + WIND_SHARE * wind)
    grid[:, physics.GAINS] = schedule.gains_W(house, time_s)
    grid[:, physics.SETPOINT] = schedule.native_setpoint_C(house, time_s)
    grid.setflags(write=False)
    return grid


def _with_people(grid: Array, house: House, seed: int) -> Array:
    """Return the grid of a house whose people do not keep to the schedule."""
    usual = at_home(house.pattern, np.arange(0.0, YEAR_S + GRID_S, GRID_S))
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
