"""The DOE small office (new construction of 2004, Chicago) that ships with the engine, as a plant with five zones.

Five conditioned zones under an unconditioned attic, each with a rooftop unit (PSZ-AC) of its own: gas burner, direct
expansion coil, fan of constant flow and outdoor air. Schedules of people, lights, plugs, infiltration and ventilation
are read from the engine's IDF file. What acts are the heating and cooling set-points of each zone's thermostat, whose
own loops deliver the heat, with a level of either sign: of burner and coil one works at a time, and the level is heat
over the burner's size, negative for cooling. Gas and electricity of a unit are billed apart: while heating at the price
of gas, while cooling at that of electricity. The engine runs in its own process.
"""

from __future__ import annotations

import calendar
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date, timedelta
from functools import cache, partial
from typing import Any

import numpy as np

from thermoforce_mpc.boundary import tariffs
from thermoforce_mpc.data import DAY_S, HOUR_S, ZERO_C_K, Array, Block, Measurement, PlantInfo, Record
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.energyplus.engine import (
    WEATHER_SENSORS,
    Wiring,
    file_hash,
    reference_building,
    weather_file,
    weather_reading,
)
from thermoforce_mpc.plants.energyplus.process import RUN_DAYS, EnginePlant, SimulatedBuilding, whole_steps
from thermoforce_mpc.plants.energyplus.zone import YEAR
from thermoforce_mpc.plants.kpis import EnergySupply
from thermoforce_mpc.plants.shell import RoomSetpointShell
from thermoforce_mpc.scenario.actuator import RoomSetpoints
from thermoforce_mpc.scenario.testcase import TestCase

_CLOCK_S = 1e-6
_DAYS = ("Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday")


def idf_objects(text: str, kind: str) -> list[list[str]]:
    """Return the fields of every object of a kind, without comments; the kind itself is left out."""
    objects = (
        [field.strip() for field in statement.split(",")] for statement in re.sub(r"![^\n]*", "", text).split(";")
    )
    return [fields[1:] for fields in objects if fields[0].lower() == kind.lower()]


@dataclass(frozen=True)
class Calendar:
    """Days of the engine's year (`zone.YEAR`, from a Monday) and of those after it.

    `holidays` and the ends of `daylight_saving` (None: none) are days as the engine's file gives them: 'July 4',
    '3rd Monday in January', 'Last Monday in May'. Daylight saving time holds on its first day, its last, and between.
    """

    holidays: tuple[str, ...] = ()
    daylight_saving: tuple[str, str] | None = None

    @classmethod
    def of(cls, text: str) -> Calendar:
        """Return the calendar of an IDF file; raises `PlantError` for a special day that is no holiday of one day."""
        special = idf_objects(text, "RunPeriodControl:SpecialDays")
        for name, _, days, kind in special:
            if (float(days), kind) != (1.0, "Holiday"):
                raise PlantError(f"EnergyPlus: special day '{name}' has {days} days as {kind}, expected 1 as Holiday")
        saving = idf_objects(text, "RunPeriodControl:DaylightSavingTime")
        return cls(tuple(row[1] for row in special), (saving[0][0], saving[0][1]) if saving else None)

    def kind(self, day: int) -> str:
        """Return 'Holiday' or the weekday of a day since 1 January of the engine's year (0)."""
        at = date(YEAR, 1, 1) + timedelta(days=day)
        if at in _dates(self.holidays, at.year):
            return "Holiday"
        return _DAYS[at.weekday()]

    def clock_s(self, time_s: Array) -> Array:
        """Return the time of clocks, s: an hour later than `time_s` (any shape) in daylight saving time."""
        days, index = np.unique(np.floor((time_s + _CLOCK_S) / DAY_S).astype(int), return_inverse=True)
        dates = [date(YEAR, 1, 1) + timedelta(days=int(day)) for day in days]
        ends = [_dates(self.daylight_saving, at.year) if self.daylight_saving else (date.max, date.min) for at in dates]
        saving = np.array([first <= at <= last for at, (first, last) in zip(dates, ends, strict=True)])
        return np.asarray(time_s + HOUR_S * saving[index].reshape(np.shape(time_s)))


@dataclass(frozen=True)
class Schedule:
    """Compact schedule of whole years.

    `rules` are kinds of days, as in 'Weekdays' or 'AllOtherDays', with the hours until which each value holds and the
    values; the first rule that covers a day counts.
    """

    name: str
    rules: tuple[tuple[frozenset[str], tuple[float, ...], tuple[float, ...]], ...]

    @classmethod
    def of(cls, text: str, name: str) -> Schedule:
        """Return the schedule `name` of an IDF file; raises `PlantError` if it is missing or differs over the year."""
        schedules = [fields for fields in idf_objects(text, "Schedule:Compact") if fields[0].lower() == name.lower()]
        if len(schedules) != 1:
            raise PlantError(f"EnergyPlus: the file has {len(schedules)} schedules '{name}', expected one")
        through, *fields = schedules[0][2:]
        if through.lower() != "through: 12/31" or any(field.lower().startswith("through") for field in fields):
            raise PlantError(
                f"EnergyPlus: schedule '{name}' differs over the year; only one of whole years can be read"
            )
        rules: list[tuple[frozenset[str], list[float], list[float]]] = []
        for field in fields:
            word, _, rest = field.partition(":")
            if word.lower() == "for":
                rules.append((frozenset(rest.split()), [], []))
            elif word.lower() == "until":
                hours, minutes = rest.split(":")
                rules[-1][1].append(float(hours) + float(minutes) / 60.0)
            else:
                rules[-1][2].append(float(field))
        return cls(name, tuple((kinds, tuple(until), tuple(values)) for kinds, until, values in rules))

    @property
    def values(self) -> tuple[float, ...]:
        """All values of the schedule."""
        return tuple(value for _, _, values in self.rules for value in values)

    def at(self, time_s: Array, calendar: Calendar) -> Array:
        """Return values over the steps that begin at `time_s` (n,), s since 1 January; raises `PlantError`."""
        clock_s = calendar.clock_s(np.asarray(time_s, dtype=np.float64)) + _CLOCK_S
        day = np.floor(clock_s / DAY_S).astype(int)
        hour = (clock_s - day * DAY_S) / HOUR_S
        days, index = np.unique(day, return_inverse=True)
        kinds = np.array([calendar.kind(int(one)) for one in days])[index]
        out = np.empty(day.shape)
        for kind in set(kinds.tolist()):
            here = kinds == kind
            until, values = self._rule(kind)
            out[here] = np.asarray(values)[np.searchsorted(until, hour[here], side="right")]
        return out

    def _rule(self, kind: str) -> tuple[Sequence[float], Sequence[float]]:
        names = {"AllDays", "AllOtherDays", "Holidays" if kind == "Holiday" else kind}
        if kind in _DAYS[:5]:
            names.add("Weekdays")
        for kinds, until, values in self.rules:
            if kinds & names:
                return until, values
        raise PlantError(f"EnergyPlus: schedule '{self.name}' has no rule for a {kind}")


@cache
def _dates(days: tuple[str, ...], year: int) -> tuple[date, ...]:
    return tuple(_date(day, year) for day in days)


def _date(day: str, year: int) -> date:
    months = {name: number for number, name in enumerate(calendar.month_name) if name}
    nth = re.fullmatch(r"(\d)(?:st|nd|rd|th) (\w+) in (\w+)", day)
    last = re.fullmatch(r"Last (\w+) in (\w+)", day)
    plain = re.fullmatch(r"(\w+) (\d+)", day)
    if plain:
        return date(year, months[plain[1]], int(plain[2]))
    if not (nth or last):
        raise PlantError(f"EnergyPlus: day '{day}': expected 'July 4', '3rd Monday in January' or 'Last Monday in May'")
    weekday, month = (nth[2], months[nth[3]]) if nth else (last[1], months[last[2]])  # type: ignore[index]
    of_month = [
        date(year, month, number)
        for number in range(1, calendar.monthrange(year, month)[1] + 1)
        if _DAYS[date(year, month, number).weekday()] == weekday
    ]
    return of_month[int(nth[1]) - 1] if nth else of_month[-1]


BUILDING = "RefBldgSmallOfficeNew2004_Chicago"
WEATHER = "Chicago-OHare"
STEPS_PER_HOUR = 12
STEP_S = HOUR_S / STEPS_PER_HOUR


@dataclass(frozen=True)
class OfficeZone:
    """Zone, its names in the engine's file, floor area, m², rated heat of its burner and gross sensible cooling, W."""

    name: str
    engine_name: str
    unit: str
    floor_area_m2: float
    heating_W: float
    cooling_W: float


ZONES = (
    OfficeZone("core", "Core_ZN", "PSZ-AC:1", 149.66, 15108.0, 7718.0),
    OfficeZone("south", "Perimeter_ZN_1", "PSZ-AC:2", 113.45, 11970.0, 6124.0),
    OfficeZone("east", "Perimeter_ZN_2", "PSZ-AC:3", 67.30, 9975.0, 5354.0),
    OfficeZone("north", "Perimeter_ZN_3", "PSZ-AC:4", 113.45, 12424.0, 6390.0),
    OfficeZone("west", "Perimeter_ZN_4", "PSZ-AC:5", 67.30, 9715.0, 5467.0),
)
# Floor area per person, m², at an occupancy of 1.
AREA_PER_PERSON_M2 = 18.58
# Share of people from which on the tight comfort band holds: weekdays 06:00 to 20:00, Saturdays 06:00 to 17:00.
OCCUPIED_FROM = 0.1


# A reading at the end of a step: temperatures of the zones, °C, outdoor temperature, global horizontal irradiance W/m²,
# and means over the step, W, of all burners, then all coils: heat, of coils negative, and power, gas and electric
# (compressor and fan).
_Z = len(ZONES)
T_ZONE, T_OUT, SOLAR = slice(0, _Z), _Z, _Z + 1
HEAT, POWER = slice(_Z + 2, 3 * _Z + 2), slice(3 * _Z + 2, 5 * _Z + 2)
OfficeReading = tuple[float, ...]


@dataclass(frozen=True)
class OfficeSchedules:
    """Schedules of the file, for times in s since 1 January of standard time (n,).

    `night_tolerance_K`: how far beyond the set-points of the night a zone may drift before its unit starts.
    """

    calendar: Calendar
    heating: Schedule
    cooling: Schedule
    people: Schedule
    night_tolerance_K: float

    def setpoints_C(self, time_s: Array) -> tuple[Array, Array]:
        """Return the native heating and cooling set-points of every zone, °C, (n,) each."""
        return self.heating.at(time_s, self.calendar), self.cooling.at(time_s, self.calendar)

    def bounds_C(self, time_s: Array) -> tuple[Array, Array]:
        """Return comfort bounds, °C, (n,) each: the set-points of the day while `OCCUPIED_FROM` of the people are in.

        Otherwise those of the night and the tolerance around them.
        """
        occupied, K = self.occupancy(time_s) >= OCCUPIED_FROM, self.night_tolerance_K
        lower, upper = self.heating.values, self.cooling.values
        return np.where(occupied, max(lower), min(lower) - K), np.where(occupied, min(upper), max(upper) + K)

    def occupancy(self, time_s: Array) -> Array:
        """Return the share of people who are present, (n,)."""
        return self.people.at(time_s, self.calendar)


@cache
def office_schedules() -> OfficeSchedules:
    """Return the schedules of the shipped file; raises `PlantError` where it is missing or differs."""
    text = _shipped()
    heating, cooling, people = (Schedule.of(text, name) for name in ("HTGSETP_SCH", "CLGSETP_SCH", "BLDG_OCC_SCH"))
    night_cycles = idf_objects(text, "AvailabilityManager:NightCycle")
    tolerance_K = max(float(fields[4]) for fields in night_cycles)
    return OfficeSchedules(Calendar.of(text), heating, cooling, people, tolerance_K)


def office_model(first_day: int, days: int, steps_per_hour: int) -> str:
    """Return the shipped IDF with a run period from `first_day` (0) and time steps; raises `PlantError`."""
    begin = date(YEAR, 1, 1) + timedelta(days=first_day)
    end = begin + timedelta(days=days - 1)
    text = _shipped()
    period = (
        f"Ours, {begin.month}, {begin.day}, {begin.year}, {end.month}, {end.day}, {end.year}, , No, No, No, Yes, Yes;"
    )
    changes = {
        r"Timestep,\s*6;": f"Timestep,{steps_per_hour};",
        r"(?s)RunPeriod,\s*Annual,.*?Use Weather File Snow Indicators": f"RunPeriod, {period} !",
        r"YES,(\s*!- Run Simulation for Sizing Periods)": r"NO,\1",
        r"NO,(\s*!- Run Simulation for Weather File Run Periods)": r"YES,\1",
    }
    for pattern, replacement in changes.items():
        text, replaced = re.subn(pattern, replacement, text)
        if replaced != 1:
            raise PlantError(f"EnergyPlus: {BUILDING}.idf has {replaced} places like '{pattern}', expected one")
    # Reports are not used, and writing them takes longer than the simulation.
    return re.sub(r"(?ms)^\s*Output:(?:Table|Meter|Variable|SQLite)[^;]*;[^\n]*$", "", text)


def _shipped() -> str:
    return reference_building(BUILDING).read_text(encoding="latin-1")


def _acting(
    heating_C: Array, cooling_C: Array, step: int, demand: tuple[float, ...] | None, last: OfficeReading | None
) -> tuple[dict[str, float], tuple[float, ...]]:
    """`SimulatedBuilding.acting` of the office: told a set-point per actuator, °C, NaN for the native one of its
    schedule.

    Where one set-point of a zone is told and the other is native, the native one gives way if it would lie on the wrong
    side: the engine refuses a zone that is to be heated above the temperature it is to be cooled to.
    """
    demand = demand or (math.nan,) * (2 * _Z)
    native = float(heating_C[max(step, 0)]), float(cooling_C[max(step, 0)])
    values: dict[str, float] = {}
    for zone, heating, cooling in zip(ZONES, demand[:_Z], demand[_Z:], strict=True):
        if math.isnan(heating) and native[0] > cooling:
            heating = cooling
        if math.isnan(cooling) and native[1] < heating:
            cooling = heating
        values |= {f"{zone.name}_heating": heating, f"{zone.name}_cooling": cooling}
    return values, demand


def _read(value: Mapping[str, float]) -> OfficeReading:
    def each(name: str) -> tuple[float, ...]:
        return tuple(value[f"{zone.name}_{name}"] for zone in ZONES)

    weather = weather_reading(value, math.nan)
    coils = tuple(0.0 - heat for heat in each("coil"))
    electric = tuple(a + b for a, b in zip(each("compressor"), each("fan"), strict=True))
    return (*each("T"), weather.T_out_C, weather.solar_W_m2, *each("burner"), *coils, *each("gas"), *electric)


def office_building(first_day: int, days: int) -> SimulatedBuilding[tuple[float, ...], OfficeReading]:
    """Return what the engine simulates from midnight of a day on."""
    n = round(days * DAY_S / STEP_S)
    times_s = first_day * DAY_S + STEP_S * np.arange(n, dtype=np.float64)
    acting = partial(_acting, *office_schedules().setpoints_C(times_s))
    model = office_model(first_day, days, STEPS_PER_HOUR)
    return SimulatedBuilding(first_day, STEP_S, n, model, weather_file(WEATHER), _WIRING, acting)


def _points(names: Mapping[str, tuple[str, str]]) -> dict[str, tuple[str, str]]:
    """Return `names` (variable, key with {zone} and {unit}) for every zone."""
    return {
        f"{zone.name}_{name}": (variable, key.format(zone=zone.engine_name, unit=zone.unit))
        for zone in ZONES
        for name, (variable, key) in names.items()
    }


_WIRING = Wiring(
    sensors=_points({"T": ("Zone Air Temperature", "{zone}")}) | WEATHER_SENSORS,
    means=_points(
        {
            "burner": ("Heating Coil Heating Rate", "{unit}_HeatC"),
            "gas": ("Heating Coil NaturalGas Rate", "{unit}_HeatC"),
            "coil": ("Cooling Coil Sensible Cooling Rate", "{unit}_CoolC DXCoil"),
            "compressor": ("Cooling Coil Electricity Rate", "{unit}_CoolC DXCoil"),
            "fan": ("Fan Electricity Rate", "{unit}_Fan"),
        }
    ),
    actuators={
        f"{zone.name}_{kind}": ("Zone Temperature Control", f"{kind.capitalize()} Setpoint", zone.engine_name)
        for zone in ZONES
        for kind in ("heating", "cooling")
    },
    read=_read,
    suffix="idf",
)


# Two weeks from a Monday without holidays: first day of the year, from 0.
PERIODS = {"peak_heat_day": 28, "cold_day": 343, "mix_day": 98, "peak_cool_day": 196}

_FLOOR_AREA_M2 = np.array([zone.floor_area_m2 for zone in ZONES])
_FULL_W = np.array([zone.heating_W for zone in ZONES])


class SmallOfficePlant(EnginePlant[tuple[float, ...], OfficeReading], RoomSetpointShell):
    """DOE small office (Chicago, TMY3 weather of O'Hare); zones, actuators and machines are those of its test case."""

    _periods = PERIODS
    _zones = tuple(zone.name for zone in ZONES)
    _carriers = ("GasPower", "ElectricPower")

    def __init__(self, testcase: TestCase, **options: Any) -> None:
        """Read the weather and the schedules; `options`: see `EnginePlant`, as for errors."""
        super().__init__(testcase, WEATHER, **options)
        self._schedules = office_schedules()
        self._points = testcase.points
        self._names, self._u_min = self._points.layout.names, self._points.layout.u_min

    @property
    def info(self) -> PlantInfo:
        """Building, weather and engine version."""
        what = f"DOE small office of {self.testcase.area_m2:.0f} m2, five zones with a rooftop unit each"
        return self._info("energyplus:small_office", what, building_sha256=file_hash(reference_building(BUILDING)))

    def _check_reset(self, start_s: float, warmup_s: float, price: str) -> None:
        super()._check_reset(start_s, warmup_s, price)
        for what, duration_s in (("start", start_s), ("warm-up", warmup_s)):
            whole_steps(what, duration_s, STEP_S)

    def _building(self, first_day: int) -> SimulatedBuilding[tuple[float, ...], OfficeReading]:
        return office_building(first_day, RUN_DAYS)

    def _demand(self, block: Block) -> tuple[float, ...]:
        setpoints_C = np.full(2 * _Z, math.nan)
        for a, (level, told, one) in enumerate(zip(block.u, block.command, self._points.actuators, strict=True)):
            actuator = one.actuator
            if level is None or not isinstance(actuator, RoomSetpoints):
                continue
            values = actuator.inputs(level, told if isinstance(told, tuple) else None)
            setpoints_C[a] = values[f"{actuator.heating}_u"] - ZERO_C_K
            setpoints_C[_Z + a] = values[f"{actuator.cooling}_u"] - ZERO_C_K
        return tuple(setpoints_C.tolist())

    def _row(self, reading: OfficeReading, acted: tuple[float, ...] | None) -> Sequence[float]:
        return reading

    def _people(self, time_s: Array) -> Array:
        return np.asarray(_FLOOR_AREA_M2[:, None] / AREA_PER_PERSON_M2 * self._schedules.occupancy(time_s))

    def _heating_price(self, time_s: Array) -> Array:
        return np.full(time_s.size, tariffs.GAS)

    def _past(self, edges: Array) -> Record:
        self._check_started()
        n = edges.size - 1
        every = whole_steps("history in steps", edges[1] - edges[0], STEP_S) if n else 1
        rows = self._samples.rows[-1 - n * every :]

        def means(place: slice) -> Array:
            return np.ascontiguousarray(rows[1:, place].reshape(n, every, 2 * _Z).mean(axis=1).T)

        T_zone, T_out, solar = (rows[::every, place].T.copy() for place in (T_ZONE, T_OUT, SOLAR))
        return Record(edges, T_zone, T_out, solar, **self._acting(means(HEAT), means(POWER)), names=self._names)

    def _supplies(self, time_s: Array, rows: Array) -> list[EnergySupply]:
        power = rows[:, POWER]
        gas = np.full(time_s.size, tariffs.GAS), np.full(time_s.size, tariffs.GAS_EMISSION_KG_PER_KWH)
        return [
            EnergySupply("GasPower", power[:, :_Z].sum(axis=1), *gas, of_steps=True),
            EnergySupply("ElectricPower", power[:, _Z:].sum(axis=1), *self._bought(time_s), of_steps=True),
        ]

    def _bounds(self, time_s: Array) -> tuple[Array, Array]:
        return self._schedules.bounds_C(time_s)

    def _measured(self, before_s: float) -> Measurement:
        steps, row = round((self._now_s - before_s) / STEP_S), self._samples.rows[-1]
        means = self._samples.rows[-steps:].mean(axis=0) if steps else np.full(row.size, math.nan)
        return Measurement(
            time_s=self._now_s,
            T_zone_C=row[T_ZONE].copy(),
            T_out_C=float(row[T_OUT]),
            solar_W_m2=float(row[SOLAR]),
            **self._acting(means[HEAT], means[POWER]),
            names=self._names,
        )

    def _acting(self, heat_W: Array, power_W: Array) -> dict[str, Any]:
        """Levels, heat and power of each unit, (Z,) or (Z, n), from those of burners and coils, (2 Z,) or (2 Z, n)."""
        heat, power = heat_W[:_Z] + heat_W[_Z:], power_W[:_Z] + power_W[_Z:]
        return {"u": np.clip(heat.T / _FULL_W, self._u_min, 1.0).T, "heat_W": heat, "power_W": power}
