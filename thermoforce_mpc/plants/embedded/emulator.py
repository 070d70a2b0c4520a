"""Embedded plants: emulators of test cases of BOPTEST from their documented physics.

A `PointEmulator` acts through the points of its test case's file, as a service and an FMU do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from boptest_client import Point
from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.forecast_error import ForecastError, forecast_weather
from thermoforce_mpc.boundary.periods import all_windows, heating_windows, kept_windows, published_windows
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import (
    DAY_S,
    YEAR_S,
    ZERO_C_K,
    Array,
    Block,
    Boundary,
    Measurement,
    Period,
    PlantInfo,
    Record,
)
from thermoforce_mpc.data.boundary import excess
from thermoforce_mpc.data.compiled import sources_hash
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.plants.embedded import exposure
from thermoforce_mpc.plants.embedded.cases import CASES, ELECTRICITY, HEAT_PUMP, EmulatedCase
from thermoforce_mpc.plants.embedded.envelope import AS_SCHEDULED, COOKING, PEOPLE, WINDOWS
from thermoforce_mpc.plants.embedded.exposure import build_exposure
from thermoforce_mpc.plants.embedded.kernel import STEP_S, integrals
from thermoforce_mpc.plants.embedded.schedule import OccupancySchedule
from thermoforce_mpc.plants.kpis import PEAKS, EnergySupply, Violation, building_kpis, peak_power
from thermoforce_mpc.plants.people import live
from thermoforce_mpc.plants.points import (
    acting_means,
    boundary,
    check_points,
    inputs,
    interval_means,
    mean_levels,
    measurement,
    past_record,
)
from thermoforce_mpc.plants.shell import CLOCK_S, BranchingShell, RoomSetpointShell, day_period, is_day
from thermoforce_mpc.scenario.building import Price
from thermoforce_mpc.scenario.testcase import TestCase
from thermoforce_mpc.version import VERSION

# Shortest step, s; shorter ones are lost in the rounding of the clock.
LEAST_STEP_S = 1e-3

# Initial value of every input, outside the limits of a set-point (0 K).
NEVER_GIVEN = 0.0


class Emulator(BranchingShell):
    """An emulated test case behind the `Plant` protocol. Deterministic: same inputs, same bytes.

    The weather year is periodic: time may run over its end.

    Attributes:
        case, weather: as given.
        scheduled: forecast points that depend on the time alone, see `EmulatedCase.scheduled`.
    """

    _changing = (*BranchingShell._changing, "_nodes", "_scalars")

    def __init__(
        self,
        case: EmulatedCase,
        weather: Weather,
        *,
        highly_dynamic: tariffs.Tariff | None = None,
        forecast_error: ForecastError | None = None,
        periods: Mapping[str, Period] | None = None,
        people: int | None = None,
    ) -> None:
        """Build the plant for a weather year.

        Args:
            case: the test case.
            highly_dynamic: highly dynamic tariff; default: a synthetic one, see `boundary.tariffs`.
            forecast_error: weather forecast errors; default: a perfect forecast.
            periods: windows by name; default: those of BOPTEST's rule for this weather.
            people: seed of people who do not keep to the schedule, see `plants.people`; default: they keep to it.
        """
        self.case = case
        self.weather = weather
        self._column = {name: i for i, name in enumerate(case.system.RECORD)}
        self._limits = case.limits
        self._forecast_error = forecast_error
        self._envelope = case.house.envelope
        grid = build_exposure(weather, case.house.facade)
        self._scheduled = grid, AS_SCHEDULED
        self._lived = self._scheduled if people is None else _with_people(grid, case.schedule, people)
        self._tariffs = case.prices(highly_dynamic)
        self.scheduled = case.scheduled(self._tariffs)
        self._periods = periods
        self.reset(0.0, 0.0)

    @property
    def info(self) -> PlantInfo:
        """Plant, weather and version."""
        return PlantInfo(
            kind="embedded",
            testcase=self.case.name,
            description=self.case.description,
            weather=self.weather.name,
            version=VERSION,
        )

    def period(self, name: str) -> Period:
        """Return a window of `case.periods` by BOPTEST's rule, or a start day; raises `InputError`."""
        if is_day(name):
            return day_period(name, ())
        if self._periods is None:
            self._periods = published_windows(self.case.name, self.weather) or self._windows_of_year()
        return self._periods[name] if name in self._periods else day_period(name, self._periods)

    def _windows_of_year(self) -> dict[str, Period]:
        code = sources_hash(__file__), sources_hash(str(self.case.system.__file__))
        return kept_windows((*code, self.case.name, self.weather.fingerprint), self.case.periods, self._find_windows)

    def _find_windows(self) -> dict[str, Period]:
        of_year = self.native_powers_W()
        if self.case.cooling is None:
            return heating_windows(of_year[self.case.heating])
        return all_windows(of_year[self.case.heating], of_year[self.case.cooling])

    def _first_row(self) -> Array:
        self._nodes = self._envelope.start_K.copy()
        self._scalars = np.zeros(self.case.system.N_SCALARS)
        row = np.empty(len(self._column))
        native = np.full(len(self._limits), math.nan)
        self.case.system.start(self._nodes, self._scalars, self._now_s, native, self._scheduled[0], self._envelope, row)
        return row

    def advance_points(self, overrides: Mapping[str, float], duration_s: float) -> Measurement:
        """Advance with overwrite inputs by BOPTEST name (temperatures in K); inputs not given stay native.

        Raises `InputError` for an unknown input, a value that is neither 0 nor a finite number within its limits, or a
        duration that is not between 1 ms and a year.
        """
        for name, value in overrides.items():
            if name not in self._limits:
                raise InputError(f"unknown input '{name}'; known: {', '.join(self._limits)}")
            low, high = self._limits[name]
            number = isinstance(value, int | float | np.number) and math.isfinite(value)
            if not number or not (low <= value <= high or value == NEVER_GIVEN):
                raise InputError(f"input '{name}' is {value!r}, expected a number from {low:g} to {high:g}")
        if not (isinstance(duration_s, int | float | np.number) and math.isfinite(duration_s)):
            raise InputError(f"step of {duration_s!r}: expected a number of seconds")
        if not LEAST_STEP_S <= duration_s < YEAR_S:
            raise InputError(f"step of {duration_s:g} s: expected {LEAST_STEP_S:g} s or more, less than a year")
        before_s = self._now_s
        self._samples.append(*self._simulated(overrides, float(duration_s)))
        return self._measured(before_s)

    def kpis(self) -> dict[str, float]:
        """Return BOPTEST's KPIs since the end of the warm-up, except the computing time, which the loop measures."""
        if self._now_s - self._start_s < CLOCK_S:  # no step simulated yet: BOPTEST returns zeros
            peaks = (PEAKS[name] for name in self.case.carriers)
            return dict.fromkeys(("ener_tot", "cost_tot", "emis_tot", "tdis_tot", "idis_tot", *peaks), 0.0)
        return self._kpis_so_far(self._kpis_between)

    def _kpis_between(self, start_s: float, final_s: float, open_end: bool) -> dict[str, float]:
        time_s, rows = self._samples.between(start_s, final_s)
        use, known = self.case.schedule, self.scheduled
        supplies = []
        for name, carrier in self.case.carriers.items():
            price = self._tariffs[self._price] if carrier.price_per_kWh is None else known[f"Price{name}"]
            power_W = np.sum([rows[:, self._column[column]] for column in carrier.columns], axis=0)
            supplies.append(EnergySupply(name, power_W, price(time_s), known[f"Emissions{name}"](time_s)))
        T_C = rows[:, self._column[self.case.zone]] - ZERO_C_K
        too_much = np.maximum(rows[:, self._column["CO2"]] - use.co2_limit_ppm(time_s), 0.0)
        return building_kpis(
            time_s,
            supplies=supplies,
            thermal=[Violation("1", excess(T_C, *use.bounds_C(time_s)))],
            air_quality=[Violation("1", too_much)],
            area_m2=self.case.house.area_m2,
            open_end=open_end,
        )

    @property
    def now_s(self) -> float:
        """Current time, s since 1 January."""
        return self._now_s

    @property
    def begin_s(self) -> float:
        """Start of the warm-up, s since 1 January."""
        return self._begin_s

    @property
    def tariff_names(self) -> tuple[str, ...]:
        """Names of the available tariffs."""
        return tuple(self._tariffs)

    def tariff(self, name: str) -> tariffs.Tariff:
        """Return the tariff `name`; raises `InputError`."""
        if name not in self._tariffs:
            raise InputError(f"unknown tariff '{name}'; known: {', '.join(self._tariffs)}")
        return self._tariffs[name]

    def use(self, price: str, forecast_error: ForecastError | None) -> None:
        """Set tariff and forecast errors, and nothing else; raises `InputError` for an unknown tariff."""
        self.tariff(price)
        self._price, self._forecast_error = cast(Price, price), forecast_error

    def recorded(self, start_s: float, final_s: float) -> dict[str, Array]:
        """Return the samples between two times: 'time' s and every column of `case.system.RECORD`, (n,) each.

        Each advance adds equally spaced samples, 30 to 60 s apart (30 s if its length is a multiple of 30 s), or one if
        it is shorter. The record starts with the warm-up and ends now; arrays are empty if nothing was recorded.
        """
        time_s, values = self._samples.between(start_s, final_s)
        return {"time": time_s} | {name: values[:, i] for name, i in self._column.items()}

    def _simulated(self, overrides: Mapping[str, float], duration_s: float) -> tuple[Array, Array]:
        """Simulate, and set the clock to the end; times (n,) and samples (n, columns)."""
        before_s = self._now_s
        # As in BOPTEST: the number of equal steps is that of whole 30 s in the duration, at least one.
        time_s = self._spaced(duration_s, STEP_S)
        n = time_s.size
        rows = np.empty((n, len(self._column)))
        forced = np.array([overrides.get(name, math.nan) for name in self._limits], dtype=np.float64)
        state = self._nodes, self._scalars, before_s, n, duration_s / n
        self.case.system.advance(*state, forced, *self._lived, self._envelope, rows)
        return time_s, rows

    def native_powers_W(self) -> dict[str, Array]:
        """Return 15-min means over a year under native control and schedule, W, (35040,), of the powers of its case."""
        here, lived = self.snapshot(), self._lived
        self._lived = self._scheduled
        try:
            self.reset(0.0, 0.0)
            means: dict[str, list[Array]] = {name: [] for name in (self.case.heating, self.case.cooling) if name}
            for _ in range(365):  # by days: samples of a year would take 150 MB
                _, rows = self._simulated({}, DAY_S)
                for name, of_days in means.items():
                    of_days.append(rows[:, self._column[name]].reshape(-1, 30).mean(axis=1))
            return {name: np.concatenate(of_days) for name, of_days in means.items()}
        finally:
            self._lived = lived
            self.restore(here)


_POWERS = HEAT_PUMP.carriers[ELECTRICITY].columns


class EmbeddedPlant(Emulator):
    """Emulator of `bestest_hydronic_heat_pump`, whose level is the speed of its compressor.

    ```python
    with EmbeddedPlant(load_weather(Path("Brussels.mos"))) as plant:
        plant.reset(start_s=16 * 86400, warmup_s=7 * 86400)
        measurement = plant.advance(u=0.5, duration_s=900)
    ```
    """

    def __init__(self, weather: Weather, **options: Any) -> None:
        """Build the plant for a weather year; options as of `Emulator`."""
        super().__init__(HEAT_PUMP, weather, **options)

    def _run(self, block: Block) -> None:
        self._samples.append(*self._simulated(_overrides(block), block.duration_s))

    def _advanced(self, block: Block) -> Measurement:
        return self.advance_points(_overrides(block), block.duration_s)

    def _boundary(self, time_s: Array) -> Boundary:
        lower, upper = self.case.schedule.bounds_C(time_s)
        T_out, solar = forecast_weather(self.weather, self._forecast_error, time_s)
        price, emission = self._bought(time_s)
        return Boundary(
            time_s=time_s,
            T_out_C=T_out,
            solar_W_m2=solar,
            occupancy=self.case.schedule.occupants(time_s),
            lower_C=lower,
            upper_C=upper,
            price_per_kWh=price,
            emission_kg_per_kWh=emission,
        )

    def _past(self, edges: Array) -> Record:
        record = self.recorded(self._begin_s, self._now_s)
        names = ("T_operative", "T_out", "solar")
        T_zone, T_out, solar = (np.interp(edges, record["time"], record[name]) for name in names)
        return Record(
            time_s=edges,
            T_zone_C=T_zone - ZERO_C_K,
            T_out_C=T_out - ZERO_C_K,
            solar_W_m2=solar,
            u=interval_means(record, ["level"], edges),
            power_W=interval_means(record, _POWERS, edges),
            heat_W=interval_means(record, ["Q_condenser"], edges),
            T_return_C=interval_means(record, ["T_return"], edges) - ZERO_C_K,
        )

    def _kpis_between(self, start_s: float, final_s: float, open_end: bool) -> dict[str, float]:
        time_s, rows = self._samples.between(start_s, final_s)
        Wh, cost, discomfort_Kh, excess_ppm_h = integrals(time_s, rows, self._tariffs[self._price](time_s))
        heat_pump_W, fan_W, pump_W = (rows[:, self._column[name]] for name in _POWERS)
        peak_W = peak_power(time_s, heat_pump_W + fan_W + pump_W, open_end=open_end)
        area_m2 = self.case.house.area_m2
        kWh = Wh / 1e3 / area_m2
        return {
            "ener_tot": kWh,
            "cost_tot": cost / 1e3 / area_m2,
            "emis_tot": kWh * tariffs.EMISSION_KG_PER_KWH,
            "tdis_tot": discomfort_Kh,
            "idis_tot": excess_ppm_h,
            "pele_tot": peak_W / 1e3 / area_m2,
        }

    def _measured(self, before_s: float) -> Measurement:
        """Return the last sample, with means since `before_s`, the last advance."""
        last = self._samples.rows[-1].tolist()
        means: list[Any] = [math.nan] * len(self._column)
        if before_s < self._now_s:
            rows = self._samples.between(before_s, self._now_s)[1][1:]
            means = (np.add.reduce(rows, axis=0) / len(rows)).tolist()
        points = {name: last[self._column[column]] for name, column in self.case.measurements.items()}
        return Measurement(
            time_s=self._now_s,
            T_zone_C=points["reaTZon_y"] - ZERO_C_K,
            T_out_C=points["weaSta_reaWeaTDryBul_y"] - ZERO_C_K,
            solar_W_m2=points["weaSta_reaWeaHGloHor_y"],
            u=means[self._column["level"]],
            power_W=sum(means[self._column[name]] for name in _POWERS),
            heat_W=means[self._column["Q_condenser"]],
            T_return_C=means[self._column["T_return"]] - ZERO_C_K,
            points=points,
        )


def _overrides(block: Block) -> dict[str, float]:
    level = block.u[0]
    return {} if level is None else {"oveHeaPumY": level}


def _with_people(grid: Array, schedule: OccupancySchedule, seed: int) -> tuple[Array, Array]:
    """Return the exposure behind the blinds of people, and what else differs from the schedule, see `AS_SCHEDULED`."""
    usual = schedule.occupied(np.arange(0.0, YEAR_S + exposure.GRID_S, exposure.GRID_S))
    life = live(
        [seed],
        usual,
        schedule.people,
        T_out_C=grid[:, exposure.T_OUT] - ZERO_C_K,
        solar_W_m2=grid[:, exposure.GLOBAL],
        cooks=not schedule.equipped,
    )
    shaded = grid.copy()
    shaded[:, [exposure.BEAM_IN, exposure.DIFFUSE_IN]] *= life.sun[0][:, None]
    shaded.setflags(write=False)  # as `grid`: numba compiles anew for an array that may be written
    differs = np.zeros((len(grid) - 1, AS_SCHEDULED.shape[1]))
    differs[:, PEOPLE] = (life.present - schedule.people * usual)[:-1]
    differs[:, COOKING], differs[:, WINDOWS] = life.cooking_W[:-1], life.windows_1_h[0, :-1]
    return shaded, differs


_WEATHER = {"TDryBul": "K", "HGloHor": "W/m2"}


class PointEmulator(Emulator, RoomSetpointShell):
    """Emulator of `bestest_hydronic` or `bestest_air`, whose levels act by the points that a test case file names.

    ```python
    with PointEmulator(load_testcase("bestest_air"), synthetic_weather(climate=CONTINENTAL)) as plant:
        window = plant.period("peak_cool_day")
        plant.reset(window.start_s, window.warmup_s)
        measurement = plant.advance(u=-0.2, duration_s=900, command=(21.0, 24.0))
    ```
    """

    _changing = (*Emulator._changing, "_T_zone_C", "_last")

    def __init__(self, testcase: TestCase, weather: Weather, **options: Any) -> None:
        """Build the plant that `testcase.plant` names for a weather year; options as of `Emulator`.

        Raises `ConfigError` where `testcase` names a point that the plant has not, or one in another unit.
        """
        case = CASES[testcase.plant or testcase.name]
        self._points = testcase.points
        self._names, self._u_min = self._points.layout.names, self._points.layout.u_min
        self._T_zone_C: Array = np.full(len(self._points.zones), math.nan)
        self._last: Measurement | None = None
        self._columns = dict(case.measurements)
        self._columns |= {f"{name}_u": column for (name, *_), column in zip(case.overwrites, case.applied, strict=True)}
        super().__init__(case, weather, **options)
        told = {name: Point(name, _unit(column), "", None, None) for name, column in case.measurements.items()}
        given = {f"{name}_activate": Point(f"{name}_activate", None, "", None, None) for name in case.limits}
        for name, (low, high) in case.limits.items():
            given[f"{name}_u"] = Point(f"{name}_u", "K" if low > 1.0 else "1", "", low, high)
        forecast = {name: Point(name, _forecast_unit(name), "", None, None) for name in (*self.scheduled, *_WEATHER)}
        check_points(testcase, given, told, forecast, f"the embedded plant '{case.name}'")

    def _asked(self, block: Block) -> dict[str, float]:
        """Overwritten points of a block, by BOPTEST's names."""
        asked = inputs(self._points, block, self._T_zone_C, self._last)
        return {name: asked[f"{name}_u"] for name in self._limits if asked.get(f"{name}_activate")}

    def _run(self, block: Block) -> None:
        self._samples.append(*self._simulated(self._asked(block), block.duration_s))

    def _measured(self, before_s: float) -> Measurement:
        """See `PlantShell`; the zone temperature serves the actuator's map next."""
        acting = None
        if before_s < self._now_s:
            edges, record = np.array([before_s, self._now_s]), self._record(before_s)
            acting = acting_means(record, self._points, mean_levels(record, self._points, edges, "_u"), edges)
        row = self._samples.rows[-1].tolist()
        values = {name: row[self._column[column]] for name, column in self._columns.items()}
        self._last = measurement(self._now_s, values, self._points, acting)
        self._T_zone_C = self._last.T_zone_C
        return self._last

    def _boundary(self, time_s: Array) -> Boundary:
        p = self._points
        weather = forecast_weather(self.weather, self._forecast_error, time_s)
        names = [name for name in p.forecast(self._price) if name not in _WEATHER]
        values = {name: np.asarray(self.scheduled[name](time_s), dtype=np.float64) for name in names}
        return boundary(time_s, values, p, self._price, weather)

    def _past(self, edges: Array) -> Record:
        record = self._record(self._begin_s)
        return past_record(record, self._points, mean_levels(record, self._points, edges, "_u"), edges)

    def _record(self, start_s: float) -> dict[str, Array]:
        """Points by name, with 'time', from `start_s` to now."""
        time_s, rows = self._samples.between(start_s, self._now_s)
        return {"time": time_s} | {name: rows[:, self._column[column]] for name, column in self._columns.items()}


def _unit(column: str) -> str | None:
    """Unit of a column of the record, as far as a test case file asks for it."""
    return "K" if column.startswith("T_") else "W" if column.startswith("P_") else "W/m2" if column == "solar" else None


def _forecast_unit(name: str) -> str | None:
    return _WEATHER.get(name, "K" if name.endswith("Setp[1]") else None)
