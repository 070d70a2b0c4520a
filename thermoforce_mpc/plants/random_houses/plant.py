"""Plant of a generated house, see `draw.House` and docs/how-it-works/generated-houses.md."""

from __future__ import annotations

import functools
import math
import re
from types import TracebackType

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.weather.solar import sun_position
from thermoforce_mpc.boundary.weather.synthetic import synthetic_weather
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import YEAR_S, ZERO_C_K, Array, Boundary, Levels, Measurement, Period, PlantInfo, Record
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.checks import (
    check_levels,
    check_record_step,
    check_start,
    forecast_times,
)
from thermoforce_mpc.plants.envelope import MEAN_WIND_M_S, WIND_SHARE
from thermoforce_mpc.plants.glazing import AZIMUTH_DEG, FACADES, on_facade
from thermoforce_mpc.plants.kpis import Supply, Violation, building_kpis, excess
from thermoforce_mpc.plants.occupants import at_home
from thermoforce_mpc.plants.random_houses import physics, schedule
from thermoforce_mpc.plants.random_houses.draw import House, draw_house
from thermoforce_mpc.plants.records import acting_means, interval_means, measurement, past_record
from thermoforce_mpc.plants.weeks import week_or_day
from thermoforce_mpc.scenario.testcase import Actuator, Measurements, TestCase
from thermoforce_mpc.version import VERSION

# The baseline thermostat's set-point above the tightest lower bound, K, as in the shipped test case (21.3 for 21 °C).
THERMOSTAT_ABOVE_K = 0.3

_NAME = re.compile(r"generated:(\d{1,9}):(\d{1,9})")

_CLOCK_S = 1e-6
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


class GeneratedHousePlant:
    """A generated house behind the `Plant` protocol. Deterministic: same house and inputs, same bytes.

    Comfort is judged by the true operative temperature; records and measurements hold what the sensor reads.
    """

    def __init__(self, house: House, highly_dynamic: tariffs.Tariff | None = None) -> None:
        """Build the house; `highly_dynamic` replaces the synthetic tariff of that name. Gas costs the same in all."""
        self.house = house
        by_name = tariffs.by_name(highly_dynamic)
        self._tariffs = {name: _gas if house.machine == "boiler" else by_name[name] for name in by_name}
        self.testcase = house_testcase(house)
        self._points = self.testcase.points
        self.weather, self._grid, self._noise = year_of(house)
        self._parameters = physics.parameters(house)
        self.reset(0.0, 0.0)

    @property
    def info(self) -> PlantInfo:
        """Plant, weather and version."""
        return PlantInfo(
            kind="generated",
            testcase=self.house.name,
            description=self.house.words,
            weather=self.weather.name,
            version=VERSION,
        )

    def period(self, name: str) -> Period:
        """Return the week 'cold_week' or 'sunny_week', or two weeks from a start day, see `week_or_day`.

        Raises:
            InputError: `name` is neither of these nor a day of the year.
        """
        grid, house = self._grid, self.house
        return week_or_day(
            name,
            T_out_C=grid[:, physics.T_OUT],
            global_W_m2=grid[:, physics.GLOBAL],
            load_W=house.loss_W_K * (20.0 - grid[:, physics.T_OUT])
            - (grid[:, physics.GAINS] + grid[:, physics.SUN_IN]),
            design_load_W=house.design_load_W,
            grid_s=physics.GRID_S,
        )

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> Measurement:
        """Start at `start_s` after `warmup_s` of native control, shortened at the beginning of the year.

        Raises:
            InputError: a time is not a finite nonnegative number inside the year, or the tariff is unknown.
        """
        check_start(start_s, warmup_s)
        if price not in self._tariffs:
            raise InputError(f"tariff '{price}': expected one of {', '.join(self._tariffs)}")
        self._price = price
        self._state = np.zeros(physics.N_STATES)
        self._state[: physics.INTEGRAL] = self.house.lower_C
        self._start_s = float(start_s)
        self._begin_s = self._now_s = float(max(start_s - warmup_s, 0.0))
        self._n = 1
        self._rows, self._times = np.zeros((1, len(physics.RECORD))), np.array([self._begin_s])
        self._rows[0] = self._first_row()
        if self._start_s > self._now_s:
            self._advance(math.nan, self._start_s - self._now_s)
        return measurement(self._now_s, self._values(), self._points)

    def advance(self, u: Levels, duration_s: float) -> Measurement:
        """Apply the level `u` in [0, 1] (None: the house's own control) for `duration_s`.

        Raises:
            InputError: `u` or `duration_s` is out of range.
        """
        block = check_levels(u, duration_s)
        before_s = self._now_s
        self._advance(float(block.as_array()[0]), block.duration_s)
        edges = np.array([before_s, self._now_s])
        record = self.recorded(before_s, self._now_s)
        points = self._points
        acting = acting_means(record, points, interval_means(record, ["level"], edges)[None], edges)
        return measurement(self._now_s, self._values(), points, acting)

    def forecast(self, horizon_s: float, interval_s: float) -> Boundary:
        """Return boundary conditions from now to `horizon_s` ahead every `interval_s`: a perfect weather forecast.

        Raises:
            InputError: horizon or interval is not positive, or the horizon is shorter than the interval.
        """
        time_s = forecast_times(self._now_s, horizon_s, interval_s)
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

    def past(self, step_s: float) -> Record:
        """Return the record since the start of the warm-up at `step_s`; the oldest partial step is dropped.

        Raises:
            InputError: `step_s` is not positive.
        """
        check_record_step(step_s)
        record = self.recorded(self._begin_s, self._now_s)

        def levels(edges: Array) -> Array:
            return interval_means(record, ["level"], edges)[None]

        return past_record(record, self._points, levels, self._now_s, step_s)

    def kpis(self) -> dict[str, float]:
        """Return BOPTEST's KPIs since the end of the warm-up; discomfort is that of the true temperature."""
        if self._now_s - self._start_s < _CLOCK_S:
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
        times = self._times[: self._n]
        first, last = np.searchsorted(times, [start_s - _CLOCK_S, final_s + _CLOCK_S])
        rows = self._rows[first:last]
        return {"time": times[first:last]} | {name: rows[:, i] for name, i in _COLUMN.items()}

    def close(self) -> None:
        """Do nothing: the plant holds no resources."""

    def __enter__(self) -> GeneratedHousePlant:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _prices(self, time_s: Array) -> tuple[Array, Array]:
        """Price per kWh and emissions, kg/kWh, of the billed energy at each time."""
        gas = self.house.machine == "boiler"
        emission = tariffs.GAS_EMISSION_KG_PER_KWH if gas else tariffs.EMISSION_KG_PER_KWH
        return self._tariffs[self._price](time_s), np.full(time_s.shape, emission)

    def _advance(self, forced: float, duration_s: float) -> None:
        n = max(math.floor(duration_s / physics.STEP_S + 1e-9), 1)
        rows = np.empty((n, len(physics.RECORD)))
        dt = duration_s / n
        physics.advance(self._state, self._now_s, n, dt, forced, self._grid, self._noise, self._parameters, rows)
        time_s = self._now_s + dt * np.arange(1.0, n + 1)
        self._now_s += duration_s
        time_s[-1] = self._now_s  # exact, without rounding
        if self._n + n > self._times.size:  # grow by doubling: steps are many and short
            room = max(2 * self._times.size, self._n + n) - self._times.size
            self._rows = np.concatenate([self._rows, np.empty((room, rows.shape[1]))])
            self._times = np.concatenate([self._times, np.empty(room)])
        self._rows[self._n : self._n + n], self._times[self._n : self._n + n] = rows, time_s
        self._n += n

    def _values(self) -> dict[str, float]:
        """Measured points of the latest sample by name, K and W."""
        p = self._points
        names = (*p.temperatures, p.outdoor_temperature, p.solar, *p.flows)
        return {name: float(self._rows[self._n - 1, _COLUMN[name]]) for name in names}

    def _first_row(self) -> Array:
        """Sample at the beginning, with the machine off, shape (12,)."""
        row = np.zeros(len(physics.RECORD))
        now = np.array([self._now_s])
        T = self.house.lower_C
        reading = physics.measured_C(self._parameters, T, self._noise[int(self._now_s / physics.STEP_S)])
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
    noise = np.random.default_rng([house.seed, house.index, 2]).standard_normal(round(YEAR_S / physics.STEP_S))
    noise.setflags(write=False)
    return weather, build_grid(house, weather), noise


def build_grid(house: House, weather: Weather) -> Array:
    """Return weather, sun through the windows and schedules of a year every 15 min, shape (35041, 7), see `physics`."""
    time_s = np.arange(0.0, YEAR_S + physics.GRID_S, physics.GRID_S)
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
