"""Points of the test cases: names, units and limits as in BOPTEST's documentation, and their values."""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import psychrolib

from thermoforce_mpc.boundary.weather.solar import SunPosition, sun_position
from thermoforce_mpc.boundary.weather.year import Weather
from thermoforce_mpc.data import HOUR_S, YEAR_S, ZERO_C_K, Array
from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.plants.embedded.cases import BOILER, CASES, FAN_COIL, HEAT_PUMP, EmulatedCase
from thermoforce_mpc.plants.embedded.emulator import Emulator
from thermoforce_mpc.plants.embedded.exposure import PRESSURE_PA
from thermoforce_mpc.plants.embedded.schedule import set_points_C

# Descriptions are part of the protocol: verbatim, typing errors included, from the replies of BOPTEST
# (github.com/ibpsa/project1-boptest) to /inputs, /measurements and /forecast_points of each test case.
_OVERWRITES = {
    HEAT_PUMP.name: {
        "oveHeaPumY": (
            "1",
            "Heat pump modulating signal for compressor speed between 0 (not working) and 1 (working at maximum "
            "capacity)",
        ),
        "oveTSet": ("K", "Zone operative temperature setpoint"),
        "ovePum": ("1", "Integer signal to control the emission circuit pump either on or off"),
        "oveFan": ("1", "Integer signal to control the heat pump evaporator fan either on or off"),
    },
    BOILER.name: {
        "oveTSetHea": ("K", "Zone operative temperature setpoint for heating"),
        "oveTSetCoo": ("K", "Zone operative temperature setpoint for cooling"),
        "oveTSetSup": ("K", "Supply temperature setpoint of the heater"),
        "ovePum": ("1", "Integer signal to control the stage of the pump either on or off"),
    },
    FAN_COIL.name: {
        "con_oveTSetHea": ("K", "Zone temperature setpoint for heating"),
        "con_oveTSetCoo": ("K", "Zone temperature setpoint for cooling"),
        "fcu_oveTSup": ("K", "Supply air temperature setpoint"),
        "fcu_oveFan": ("1", "Fan control signal as air mass flow rate normalized to the design air mass flow rate"),
    },
}
_MEASUREMENTS = {
    HEAT_PUMP.name: {
        "reaTZon_y": ("K", "Zone operative temperature"),
        "reaPHeaPum_y": ("W", "Heat pump electrical power"),
        "reaPFan_y": ("W", "Electrical power of the heat pump evaporator fan"),
        "reaPPumEmi_y": ("W", "Emission circuit pump electrical power"),
        "reaQHeaPumCon_y": ("W", "Heat pump thermal power exchanged in the condenser"),
        "reaQHeaPumEva_y": ("W", "Heat pump thermal power exchanged in the evaporator"),
        "reaQFloHea_y": ("W", "Floor heating thermal power released to the zone"),
        "reaTSup_y": ("K", "Supply water temperature to radiant floor"),
        "reaTRet_y": ("K", "Return water temperature from radiant floor"),
        "reaCOP_y": ("1", "Heat pump COP"),
        "reaTSetHea_y": ("K", "Zone operative temperature setpoint for heating"),
        "reaTSetCoo_y": ("K", "Zone operative temperature setpoint for cooling"),
        "reaCO2RooAir_y": ("ppm", "CO2 concentration in the zone"),
    },
    BOILER.name: {
        "reaTRoo_y": ("K", "Operative zone temperature"),
        "reaQHea_y": ("W", "Heating thermal power"),
        "reaPPum_y": ("W", "Pump electrical power"),
        "reaCO2RooAir_y": ("ppm", "CO2 concentration in the zone"),
    },
    FAN_COIL.name: {
        "zon_reaTRooAir_y": ("K", "Zone air temperature"),
        "fcu_reaPHea_y": ("W", "Heating thermal power consumption"),
        "fcu_reaPCoo_y": ("W", "Cooling electrical power consumption"),
        "fcu_reaPFan_y": ("W", "Supply fan electrical power consumption"),
        "fcu_reaFloSup_y": ("kg/s", "Supply air mass flow rate"),
        "zon_reaCO2RooAir_y": ("ppm", "Zone air CO2 concentration"),
        "zon_reaPLig_y": ("W", "Lighting power submeter"),
        "zon_reaPPlu_y": ("W", "Plug load power submeter"),
    },
}
# What stands before the name of a measurement of the weather station.
_STATION_AT = {HEAT_PUMP.name: "", BOILER.name: "", FAN_COIL.name: "zon_"}
# Weather station; keys are the forecast names of the signals.
_STATION = {
    "HDifHor": "Horizontal diffuse solar radiation measurement",
    "HDirNor": "Direct normal radiation measurement",
    "HGloHor": "Global horizontal solar irradiation measurement",
    "HHorIR": "Horizontal infrared irradiation measurement",
    "TBlaSky": "Black-body sky temperature measurement",
    "TDewPoi": "Dew point temperature measurement",
    "TDryBul": "Outside drybulb temperature measurement",
    "TWetBul": "Wet bulb temperature measurement",
    "ceiHei": "Cloud cover ceiling height measurement",
    "cloTim": "Day number with units of seconds",
    "lat": "Latitude of the location",
    "lon": "Longitude of the location",
    "nOpa": "Opaque sky cover measurement",
    "nTot": "Sky cover measurement",
    "pAtm": "Atmospheric pressure measurement",
    "relHum": "Outside relative humidity measurement",
    "solAlt": "Solar altitude angle measurement",
    "solDec": "Solar declination angle measurement",
    "solHouAng": "Solar hour angle measurement",
    "solTim": "Solar time",
    "solZen": "Solar zenith angle measurement",
    "winDir": "Wind direction measurement",
    "winSpe": "Wind speed measurement",
}
_FORECAST = {
    "EmissionsElectricPower": "Kilograms of carbon dioxide to produce 1 kWh of electricity",
    "EmissionsGasPower": "Kilograms of carbon dioxide to produce 1 kWh thermal from gas",
    "HDifHor": "Horizontal diffuse solar radiation",
    "HDirNor": "Direct normal radiation",
    "HGloHor": "Horizontal global radiation",
    "HHorIR": "Horizontal infrared irradiation",
    "InternalGainsCon[1]": "Convective internal gains of zone",
    "InternalGainsLat[1]": "Latent internal gains of zone",
    "InternalGainsRad[1]": "Radiative internal gains of zone",
    "LowerSetp[1]": "Lower temperature set point for thermal comfort of zone",
    "Occupancy[1]": "Number of occupants of zone",
    "PriceElectricPowerConstant": "Completely constant electricity price",
    "PriceElectricPowerDynamic": "Electricity price for a day/night tariff",
    "PriceElectricPowerHighlyDynamic": "Spot electricity price",
    "PriceGasPower": "Price to produce 1 kWh thermal from gas",
    "TBlaSky": "Black Sky temperature",
    "TDewPoi": "Dew point temperature",
    "TDryBul": "Dry bulb temperature at ground level",
    "TWetBul": "Wet bulb temperature",
    "UpperCO2[1]": "Upper CO2 set point for indoor air quality of zone",
    "UpperSetp[1]": "Upper temperature set point for thermal comfort of zone",
    "ceiHei": "Ceiling height",
    "cloTim": "One-based day number in seconds",
    "lat": "Latitude of the location",
    "lon": "Longitude of the location",
    "nOpa": "Opaque sky cover [0, 1]",
    "nTot": "Total sky Cover [0, 1]",
    "pAtm": "Atmospheric pressure",
    "relHum": "Relative Humidity",
    "solAlt": "Altitude angel",
    "solDec": "Declination angle",
    "solHouAng": "Solar hour angle.",
    "solTim": "Solar time",
    "solZen": "Zenith angle",
    "winDir": "Wind direction",
    "winSpe": "Wind speed",
}


psychrolib.SetUnitSystem(psychrolib.SI)


class WeatherSignal(NamedTuple):
    """Weather signal: unit, and function of its values (n,) at times (n,), s."""

    unit: str
    at: Callable[[Weather, Array], Array]


def _column(name: str, shift: float = 0.0) -> Callable[[Weather, Array], Array]:
    return lambda weather, time_s: weather.at(name, time_s) + shift


def _constant(value: Callable[[Weather], float]) -> Callable[[Weather, Array], Array]:
    return lambda weather, time_s: np.full(np.shape(time_s), value(weather))


def _sun(weather: Weather, time_s: Array) -> SunPosition:
    return sun_position(time_s, weather.latitude_deg, weather.longitude_deg, weather.timezone_h)


def _wet_bulb_K(weather: Weather, time_s: Array) -> Array:
    """Wet bulb temperature, K, from dry bulb, relative humidity and pressure (ASHRAE Fundamentals 2017, ch. 1)."""
    dry_C, humidity = weather.at("T_dry_C", time_s), weather.at("relative_humidity", time_s)
    wet_C = np.empty(np.size(dry_C))
    _write_wet_bulb_C(np.ravel(dry_C), np.ravel(humidity), wet_C)
    return wet_C.reshape(np.shape(dry_C)) + ZERO_C_K


@njit(cache=True)
def _write_wet_bulb_C(dry_C: Array, humidity: Array, wet_C: Array) -> None:
    """One by one, so that it is compiled once and kept: psychrolib compiles in every process, for over two seconds."""
    for i in range(dry_C.size):
        wet_C[i] = psychrolib.GetTWetBulbFromRelHum(dry_C[i], humidity[i], PRESSURE_PA)


# Keys: forecast names.
WEATHER_SIGNALS: dict[str, WeatherSignal] = {
    "HDifHor": WeatherSignal("W/m2", _column("diffuse_W_m2")),
    "HDirNor": WeatherSignal("W/m2", _column("normal_W_m2")),
    "HGloHor": WeatherSignal("W/m2", _column("global_W_m2")),
    "HHorIR": WeatherSignal("W/m2", _column("infrared_W_m2")),
    "TBlaSky": WeatherSignal("K", lambda w, t: w.sky_temperature_C(t) + ZERO_C_K),
    "TDewPoi": WeatherSignal("K", _column("T_dew_C", ZERO_C_K)),
    "TDryBul": WeatherSignal("K", _column("T_dry_C", ZERO_C_K)),
    "TWetBul": WeatherSignal("K", _wet_bulb_K),
    "ceiHei": WeatherSignal("m", _column("ceiling_m")),
    "cloTim": WeatherSignal("s", lambda _, t: np.asarray(t % YEAR_S)),
    "lat": WeatherSignal("rad", _constant(lambda w: float(np.deg2rad(w.latitude_deg)))),
    "lon": WeatherSignal("rad", _constant(lambda w: float(np.deg2rad(w.longitude_deg)))),
    "nOpa": WeatherSignal("1", _column("opaque_cover")),
    "nTot": WeatherSignal("1", _column("total_cover")),
    "pAtm": WeatherSignal("Pa", _constant(lambda _: PRESSURE_PA)),
    "relHum": WeatherSignal("1", _column("relative_humidity")),
    "solAlt": WeatherSignal("rad", lambda w, t: np.pi / 2 - _sun(w, t).zenith),
    "solDec": WeatherSignal("rad", lambda w, t: _sun(w, t).declination),
    # Not wrapped to ±π: like solar time, it increases from day to day.
    "solHouAng": WeatherSignal("rad", lambda w, t: _sun(w, t).hour_angle),
    "solTim": WeatherSignal("s", lambda w, t: np.asarray((_sun(w, t).hour_angle * 24.0 / (2 * np.pi) + 12.0) * HOUR_S)),
    "solZen": WeatherSignal("rad", lambda w, t: _sun(w, t).zenith),
    "winDir": WeatherSignal("rad", _column("wind_from_rad")),
    "winSpe": WeatherSignal("m/s", _column("wind_m_s")),
}


@dataclass(frozen=True)
class PointInfo:
    """Unit, description and limits of a point."""

    unit: str | None
    description: str
    minimum: float | None = None
    maximum: float | None = None

    def as_json(self, *, limits: bool) -> dict[str, str | float | None]:
        """As JSON object, with limits (inputs and measurements) or without (forecast points)."""
        content: dict[str, str | float | None] = {"Description": self.description, "Unit": self.unit}
        return content | {"Minimum": self.minimum, "Maximum": self.maximum} if limits else content


def _in_evaporator(plant: Emulator, record: Mapping[str, Array]) -> Array:
    return -record["Q_evaporator"]


def _set_point(which: int) -> Callable[[Emulator, Mapping[str, Array]], Array]:
    """A set-point of the schedule, heating or cooling.

    The heating control follows it with an offset or an overwrite; the cooling one has no effect, since the house has
    no cooling.
    """
    return lambda plant, record: set_points_C(plant.case.schedule.occupied(record["time"]))[which] + ZERO_C_K


# Measurements that follow from the record otherwise than as a column of it.
_DERIVED: dict[str, dict[str, Callable[[Emulator, Mapping[str, Array]], Array]]] = {
    HEAT_PUMP.name: {
        "reaQHeaPumEva_y": _in_evaporator,
        "reaTSetHea_y": _set_point(0),
        "reaTSetCoo_y": _set_point(1),
    }
}
_SCHEDULED_UNITS = {"Price": "($/Euro)/kWh", "Emissions": "kgCO2/kWh", "InternalGains": "W", "UpperCO2": "ppm"}


def _scheduled_unit(name: str) -> str:
    if name.startswith("Occupancy"):
        return "number of people"
    return next((unit for start, unit in _SCHEDULED_UNITS.items() if name.startswith(start)), "K")


@dataclass(frozen=True)
class ServedPoints:
    """Points of a test case by name: inputs and measurements with limits, forecast points."""

    case: EmulatedCase
    inputs: Mapping[str, PointInfo]
    measurements: Mapping[str, PointInfo]
    forecasts: Mapping[str, PointInfo]

    @property
    def _columns(self) -> dict[str, str]:
        """Column of the record of each input's signal in force, and of measurements."""
        applied = {f"{name}_u": column for name, column in zip(self.case.limits, self.case.applied, strict=True)}
        return applied | dict(self.case.measurements)

    @property
    def _station(self) -> dict[str, str]:
        return _station(self.case)

    def recorded(self, plant: Emulator, names: list[str], record: Mapping[str, Array]) -> dict[str, Array]:
        """Values of measurements and inputs, (n,), at the n samples of a record, with 'time'; names must be known."""
        time_s, columns, station = record["time"], self._columns, self._station

        def series(name: str) -> Array:
            if name in columns:
                return record[columns[name]]
            if name in station:
                return WEATHER_SIGNALS[station[name]].at(plant.weather, time_s)
            return _DERIVED[self.case.name][name](plant, record)

        return {name: series(name) for name in names} | {"time": time_s}

    def forecast(
        self,
        plant: Emulator,
        names: list[str],
        horizon_s: float,
        interval_s: float,
        erring_names: Collection[str] = (),
    ) -> dict[str, Array]:
        """Forecast of each point from now, with 'time'; `erring_names`: which of TDryBul and HGloHor have errors.

        Raises `InputError` where one of these is asked for beyond 48 h.
        """
        steps = np.arange(int(horizon_s / interval_s + 1e-9) + 1, dtype=np.float64)
        time_s: Array = plant.now_s + steps * interval_s
        erring: dict[str, Array] = {}
        if set(erring_names) & set(names):
            # A plant forecasts one interval at least; here the present alone may be asked for.
            boundary = plant.forecast(*((horizon_s, interval_s) if steps.size > 1 else (HOUR_S, HOUR_S)))
            series_of = {"TDryBul": boundary.T_out_C + ZERO_C_K, "HGloHor": boundary.solar_W_m2}
            erring = {name: series_of[name][: steps.size] for name in erring_names}
        scheduled = plant.scheduled

        def series(name: str) -> Array:
            if name in erring:
                return erring[name]
            if name in scheduled:
                return np.asarray(scheduled[name](time_s), dtype=np.float64)
            return WEATHER_SIGNALS[name].at(plant.weather, time_s)

        return {name: series(name) for name in names} | {"time": time_s}


def _station(case: EmulatedCase) -> dict[str, str]:
    """Forecast names of the signals of the weather station, by the names of its measurements."""
    at = _STATION_AT[case.name]
    return {f"{at}weaSta_reaWea{signal[0].upper()}{signal[1:]}_y": signal for signal in WEATHER_SIGNALS}


@functools.cache
def served_points(testcase: str) -> ServedPoints:
    """Points of an embedded test case by name."""
    case = CASES[testcase]
    inputs: dict[str, PointInfo] = {}
    for name, low, high in case.overwrites:
        unit, text = _OVERWRITES[testcase][name]
        inputs[f"{name}_u"] = PointInfo(unit, text, low, high)
        inputs[f"{name}_activate"] = PointInfo(None, f"Activation for {text}")
    measurements = {name: PointInfo(*told) for name, told in _MEASUREMENTS[testcase].items()}
    measurements |= {name: PointInfo(WEATHER_SIGNALS[of].unit, _STATION[of]) for name, of in _station(case).items()}
    scheduled = case.scheduled(case.prices(None))
    units = {name: _scheduled_unit(name) for name in scheduled}
    units |= {name: signal.unit for name, signal in WEATHER_SIGNALS.items()}
    forecasts = {name: PointInfo(units[name], text) for name, text in _FORECAST.items() if name in units}
    return ServedPoints(case, inputs, dict(sorted(measurements.items())), forecasts)
