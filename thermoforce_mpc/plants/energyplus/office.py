"""The DOE small office as a plant with five zones; the engine runs in its own process.

Actuators are the heating and cooling set-point of each zone's thermostat, so the building's own loops deliver the heat
and its own protection stays in force. Building: `office_model`; what was measured: docs/how-it-works/plants.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.boundary.forecast_error import ForecastError, forecast_weather
from thermoforce_mpc.boundary.weather import load_weather
from thermoforce_mpc.data import DAY_S, Array, Period, PlantInfo
from thermoforce_mpc.errors import ConfigError, InputError, PlantError
from thermoforce_mpc.plants.checks import (
    check_levels,
    check_record_step,
    check_start,
    day_period,
    forecast_times,
)
from thermoforce_mpc.plants.energyplus.engine import engine_version, file_hash, reference_building, weather_file
from thermoforce_mpc.plants.energyplus.office_data import OfficeBoundary, OfficeMeasurement, OfficeRecord
from thermoforce_mpc.plants.energyplus.office_model import (
    AREA_PER_PERSON_M2,
    BUILDING,
    WEATHER,
    ZONES,
    OfficeReading,
    OfficeRun,
    office_schedules,
)
from thermoforce_mpc.plants.energyplus.process import RUN_DAYS, EngineProcess, whole_steps
from thermoforce_mpc.plants.kpis import Supply, Violation, building_kpis, excess
from thermoforce_mpc.plants.shell import Samples, WithProcess
from thermoforce_mpc.plants.waiting import PATIENCE_S

NAME = "energyplus:small_office"
ZONE_NAMES = tuple(zone.name for zone in ZONES)
ACTUATOR_NAMES = tuple(f"{zone}_{kind}" for kind in ("heating", "cooling") for zone in ZONE_NAMES)
MACHINE_NAMES = tuple(f"{zone}_{kind}" for kind in ("burner", "electric") for zone in ZONE_NAMES)
# Set-points that can be told, °C; they drive a unit to its limit or keep it off in any weather of the file.
SETPOINTS_C = (10.0, 35.0)
# Two weeks from a Monday without holidays: first day of the year, from 0.
PERIODS = {"peak_heat_day": 28, "cold_day": 343, "mix_day": 98, "peak_cool_day": 196}
# Share of people from which on the tight comfort band holds: weekdays 06:00 to 20:00, Saturdays 06:00 to 17:00.
OCCUPIED_FROM = 0.1

_Z = len(ZONES)
_CARRIERS = {"GasPower": slice(0, _Z), "ElectricPower": slice(_Z, 2 * _Z)}
# Place of each signal in a row of the record.
_WIDTHS = {
    "T_zone_C": _Z,
    "T_out_C": 1,
    "solar_W_m2": 1,
    "setpoint_C": 2 * _Z,
    "heat_W": 2 * _Z,
    "power_W": 2 * _Z,
    "supply_W": _Z,
    "fan_W": _Z,
}
_ENDS = np.cumsum(list(_WIDTHS.values()))
_PLACE = {name: slice(int(end) - width, int(end)) for (name, width), end in zip(_WIDTHS.items(), _ENDS, strict=True)}


class SmallOffice(WithProcess[EngineProcess[tuple[float, ...], OfficeReading]]):
    """DOE small office (Chicago, TMY3 weather of O'Hare), run through the engine's runtime API.

    ```python
    with SmallOffice() as office:
        office.reset(28 * 86400, warmup_s=7 * 86400)
        setpoint_C = np.full(10, np.nan)  # all zones by the file's own thermostats
        setpoint_C[office.actuators.index("south_heating")] = 22.0
        measurement = office.advance(setpoint_C, duration_s=900)
    ```

    Arrays are in the order of `zones` (Z = 5), `actuators` (A = 10: five heating, five cooling) and `machines` (M = 10:
    five burners, five electric parts with compressor and fan). Durations are multiples of the 5-min step. There is no
    snapshot; every reset starts a new process.
    """

    zones, actuators, machines = ZONE_NAMES, ACTUATOR_NAMES, MACHINE_NAMES

    def __init__(
        self,
        *,
        highly_dynamic: tariffs.Tariff | None = None,
        forecast_error: ForecastError | None = None,
        patience_s: float = PATIENCE_S,
    ) -> None:
        """Read the weather and the schedules; the engine starts at `reset`.

        Args:
            highly_dynamic: highly dynamic tariff of electricity; default: a synthetic one, see `boundary.tariffs`.
            forecast_error: weather forecast errors; default: a perfect forecast.
            patience_s: longest time for a quarter of an hour of the building's time, and for the engine's warm-up, s.

        Raises:
            ConfigError: the engine is not installed.
        """
        try:
            self._schedules = office_schedules()
        except PlantError as error:
            raise ConfigError(f"test case '{NAME}': {error}") from error
        self._file = weather_file(WEATHER)
        self.weather = load_weather(self._file)
        self._forecast_error, self._patience_s = forecast_error, patience_s
        self._tariffs = tariffs.by_name(highly_dynamic)
        self._price = "constant"
        self._start_s = 0.0

    @property
    def info(self) -> PlantInfo:
        """Building, weather and engine version."""
        return PlantInfo(
            kind="energyplus",
            testcase=NAME,
            description=f"DOE small office of {self.floor_area_m2.sum():.0f} m2, five zones with a rooftop unit each",
            weather=self._file.stem,
            version=engine_version(),
            details={
                "weather_sha256": file_hash(self._file),
                "building_sha256": file_hash(reference_building(BUILDING)),
            },
        )

    @property
    def floor_area_m2(self) -> Array:
        """Floor area of each zone, m², (Z,)."""
        return np.array([zone.floor_area_m2 for zone in ZONES])

    @property
    def capacity_W(self) -> Array:
        """Heat at level 1 of each actuator, W, (A,), negative for cooling: the burners' heat, and the gross sensible
        cooling of the coils at rated conditions.
        """
        return np.array([zone.heating_W for zone in ZONES] + [-zone.cooling_W for zone in ZONES])

    def period(self, name: str) -> Period:
        """Return the two weeks 'peak_heat_day', 'cold_day', 'mix_day' or 'peak_cool_day', or those of a start day.

        Raises:
            InputError: `name` is neither of these nor a day of the year.
        """
        if name in PERIODS:
            return Period(name, PERIODS[name] * DAY_S)
        return day_period(name, PERIODS)

    def reset(self, start_s: float, warmup_s: float, price: str = "constant") -> OfficeMeasurement:
        """Start at `start_s` after `warmup_s` of native control (shortened at the beginning of the year).

        Raises:
            InputError: a time is not a finite nonnegative number inside the year or no multiple of 5 min, or the tariff
                is unknown.
            PlantError: the engine failed.
        """
        check_start(start_s, warmup_s)
        if price not in self._tariffs:
            raise InputError(f"unknown tariff '{price}'; known: {', '.join(self._tariffs)}")
        begin_s = max(start_s - warmup_s, 0.0)
        run = OfficeRun(int(begin_s // DAY_S), RUN_DAYS)
        for what, duration_s in (("start", start_s), ("warm-up", warmup_s)):
            whole_steps(what, duration_s, run.step_s)
        self.close()
        self._price, self._start_s = price, float(start_s)
        self._process = EngineProcess(run, self._patience_s)
        # The engine repeats its first day to warm up, so the weather of this reading is that of the next midnight.
        midnight_s, (first,) = run.first_day * DAY_S, _rows_of([self._process.first])
        for signal, column in (("T_out_C", "T_dry_C"), ("solar_W_m2", "global_W_m2")):
            first[_PLACE[signal]] = self.weather.at(column, np.array([midnight_s]))
        self._samples = Samples(midnight_s, first)
        if begin_s > midnight_s:
            self._advance(None, begin_s - midnight_s)
            # The engine starts at midnight; the time up to the warm-up is not recorded.
            self._samples = Samples(begin_s, self._samples.rows[-1])
        if start_s > begin_s:
            self._advance(None, start_s - begin_s)
        return self._measurement(0)

    def advance(self, setpoint_C: ArrayLike | None, duration_s: float) -> OfficeMeasurement:
        """Let the thermostats keep `setpoint_C` for `duration_s`, a multiple of 5 min.

        Args:
            setpoint_C: set-point of each actuator, °C, (A,), in `SETPOINTS_C`; NaN, or None for all: the set-point of
                the file's schedule. Where one set-point of a zone is told, the zone's other one gives way to it if it
                is native and would lie on the wrong side.

        Raises:
            InputError: a set-point is out of range, a zone's heating set-point is above its cooling set-point, the
                duration is no multiple of 5 min, or the plant was not reset.
            PlantError: the engine failed.
        """
        check_levels(None, duration_s)
        return self._measurement(self._advance(None if setpoint_C is None else _checked(setpoint_C), float(duration_s)))

    def forecast(self, horizon_s: float, interval_s: float) -> OfficeBoundary:
        """Return boundary conditions from now to `horizon_s` ahead every `interval_s`, with forecast errors if set.

        Comfort bounds, the same in every zone: the thermostats' set-points of the day while `OCCUPIED_FROM` of the
        people are present; otherwise those of the night, and the tolerance at which a unit starts at night.

        Raises:
            InputError: horizon or interval is not positive, or the horizon is shorter than the interval.
        """
        time_s = forecast_times(self._now_s, horizon_s, interval_s)
        T_out, solar = forecast_weather(self.weather, self._forecast_error, time_s)
        lower, upper = self._bounds(time_s)
        prices = [self._supply_prices(carrier, time_s) for carrier in _CARRIERS for _ in ZONES]
        return OfficeBoundary(
            time_s=time_s,
            T_out_C=T_out,
            solar_W_m2=solar,
            occupancy=self.floor_area_m2[:, None] / AREA_PER_PERSON_M2 * self._schedules.occupancy(time_s),
            lower_C=np.tile(lower, (_Z, 1)),
            upper_C=np.tile(upper, (_Z, 1)),
            price_per_kWh=np.array([price for price, _ in prices]),
            emission_kg_per_kWh=np.array([emission for _, emission in prices]),
        )

    def past(self, step_s: float) -> OfficeRecord:
        """Return the record since the start of the warm-up at `step_s`; the oldest partial step is dropped.

        Raises:
            InputError: `step_s` is no positive multiple of 5 min, or the plant was not reset.
        """
        check_record_step(step_s)
        every = whole_steps("history in steps", step_s, self._step_s)
        n = (len(self._samples.rows) - 1) // every
        rows = self._samples.rows[-1 - n * every :]

        def samples(name: str) -> Array:
            return np.ascontiguousarray(rows[::every, _PLACE[name]].T)

        def means(name: str) -> Array:
            acting = rows[1:, _PLACE[name]]
            return np.ascontiguousarray(acting.reshape(n, every, acting.shape[1]).mean(axis=1).T)

        heat = means("heat_W")
        return OfficeRecord(
            time_s=self._now_s - step_s * np.arange(float(n), -1.0, -1.0),
            T_zone_C=samples("T_zone_C"),
            T_out_C=samples("T_out_C")[0],
            solar_W_m2=samples("solar_W_m2")[0],
            setpoint_C=means("setpoint_C"),
            level=np.minimum(np.abs(heat / self.capacity_W[:, None]), 1.0),
            heat_W=heat,
            power_W=means("power_W"),
            supply_W=means("supply_W"),
            fan_W=means("fan_W"),
        )

    def kpis(self) -> dict[str, float]:
        """Return BOPTEST's KPIs of the building since the end of the warm-up, from the 5-min record.

        Energy is that of burners, compressors and fans, not of lights and plugs; discomfort is the mean over zones.
        """
        return self._kpis(range(_Z))

    def zone_kpis(self) -> dict[str, dict[str, float]]:
        """Return the KPIs of each zone and its unit by name; energy and cost are per floor area of the whole building.

        So energies, costs and emissions sum to those of `kpis`, and discomforts, K·h, have them as their mean.
        """
        return {name: self._kpis([zone]) for zone, name in enumerate(ZONE_NAMES)}

    @property
    def _now_s(self) -> float:
        return self._running.now_s

    @property
    def _step_s(self) -> float:
        return self._running.step_s

    def _advance(self, setpoints_C: tuple[float, ...] | None, duration_s: float) -> int:
        """Advance and return the number of steps."""
        before_s = self._now_s
        readings = self._running.advance(setpoints_C, duration_s).readings
        self._samples.append(before_s + self._step_s * np.arange(1.0, len(readings) + 1), _rows_of(readings))
        return len(readings)

    def _bounds(self, time_s: Array) -> tuple[Array, Array]:
        """Return the comfort bounds of every zone, °C, (n,) each."""
        occupied = self._schedules.occupancy(time_s) >= OCCUPIED_FROM
        lower, upper = (
            np.where(occupied, tight, wide)
            for tight, wide in zip(self._schedules.tight_C(), self._schedules.wide_C(), strict=True)
        )
        return lower, upper

    def _supply_prices(self, carrier: str, time_s: Array) -> tuple[Array, Array]:
        """Return price, EUR/kWh, and emissions, kg/kWh, of a carrier, (n,) each."""
        if carrier == "GasPower":
            price, emission = np.full(time_s.size, tariffs.GAS), tariffs.GAS_EMISSION_KG_PER_KWH
        else:
            price, emission = self._tariffs[self._price](time_s), tariffs.EMISSION_KG_PER_KWH
        return price, np.full(time_s.size, emission)

    def _kpis(self, zones: Sequence[int]) -> dict[str, float]:
        now_s = self._now_s  # raises where the plant was not reset
        time_s, rows = self._samples.between(self._start_s, now_s)
        if len(rows) < 2:
            names = ("ener_tot", "cost_tot", "emis_tot", "tdis_tot", "pele_tot", "pgas_tot")
            of_zones = [f"tdis_tot[{ZONE_NAMES[zone]}]" for zone in zones] if len(zones) > 1 else []
            return dict.fromkeys((*names, *of_zones), 0.0)
        lower, upper = self._bounds(time_s)
        power, T_zone = rows[:, _PLACE["power_W"]], rows[:, _PLACE["T_zone_C"]]
        return building_kpis(
            time_s,
            supplies=[
                Supply(
                    carrier,
                    power[:, of_carrier][:, zones].sum(axis=1),
                    *self._supply_prices(carrier, time_s),
                    of_steps=True,
                )
                for carrier, of_carrier in _CARRIERS.items()
            ],
            thermal=[Violation(ZONE_NAMES[zone], excess(T_zone[:, zone], lower, upper)) for zone in zones],
            air_quality=[],
            area_m2=float(self.floor_area_m2.sum()),
        )

    def _measurement(self, steps: int) -> OfficeMeasurement:
        """Return the state now and the means over the last `steps` steps."""
        rows = self._samples.rows
        last = rows[-1]

        def mean(name: str) -> Array:
            values = rows[len(rows) - steps :, _PLACE[name]]
            return values.mean(axis=0) if steps else np.full(values.shape[1], np.nan)

        heat = mean("heat_W")
        return OfficeMeasurement(
            time_s=self._now_s,
            T_zone_C=last[_PLACE["T_zone_C"]].copy(),
            T_out_C=float(last[_PLACE["T_out_C"]][0]),
            solar_W_m2=float(last[_PLACE["solar_W_m2"]][0]),
            setpoint_C=mean("setpoint_C"),
            level=np.minimum(np.abs(heat / self.capacity_W), 1.0),
            heat_W=heat,
            power_W=mean("power_W"),
            supply_W=mean("supply_W"),
            fan_W=mean("fan_W"),
        )


def _rows_of(readings: Sequence[OfficeReading]) -> Array:
    """Rows (n, k) of readings, see `_PLACE`."""
    return np.array([np.hstack([getattr(reading, name) for name in _WIDTHS]) for reading in readings])


def _checked(setpoint_C: ArrayLike) -> tuple[float, ...]:
    """Return the set-points as numbers; raises `InputError` naming the actuator or zone of a wrong one."""
    try:
        values = np.asarray(setpoint_C, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"set-points: expected {len(ACTUATOR_NAMES)} numbers ({error})") from error
    if values.shape != (len(ACTUATOR_NAMES),):
        raise InputError(
            f"set-points of shape {values.shape}: expected one per actuator, ({len(ACTUATOR_NAMES)},), in the order "
            f"{', '.join(ACTUATOR_NAMES)}"
        )
    low, high = SETPOINTS_C
    for name, value in zip(ACTUATOR_NAMES, values, strict=True):
        if not (np.isnan(value) or low <= value <= high):
            raise InputError(
                f"set-point of {name}: {value:g} °C, expected {low:g} to {high:g} °C, or NaN for the file's schedule"
            )
    for zone, heating, cooling in zip(ZONE_NAMES, values[:_Z], values[_Z:], strict=True):
        if heating > cooling:
            raise InputError(
                f"zone {zone}: its heating set-point of {heating:g} °C is above its cooling set-point of {cooling:g} °C"
            )
    return tuple(values.tolist())
