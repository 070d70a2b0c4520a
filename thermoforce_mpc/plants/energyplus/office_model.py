"""The DOE small office (new construction of 2004, Chicago) that ships with the engine: its file, zones and wiring.

Five conditioned zones under an unconditioned attic, each with a rooftop unit (PSZ-AC) of its own: gas burner, direct
expansion coil, fan of constant flow and outdoor air. Schedules of people, lights, plugs, infiltration and ventilation
are the file's. What acts are the heating and cooling set-points of each zone's thermostat.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, timedelta
from functools import cache, partial

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Array
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.energyplus.engine import (
    WEATHER_SENSORS,
    Wiring,
    reference_building,
    weather_file,
    weather_reading,
)
from thermoforce_mpc.plants.energyplus.idf import Calendar, Schedule, idf_objects
from thermoforce_mpc.plants.energyplus.process import SimulatedBuilding
from thermoforce_mpc.plants.energyplus.zone import YEAR

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
