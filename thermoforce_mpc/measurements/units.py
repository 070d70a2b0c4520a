"""Units of readings as maps, tables and devices write them: what each measures, and what a number of it is."""

from __future__ import annotations

import re
import unicodedata
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from thermoforce_mpc.data import J_PER_KWH, ZERO_C_K, Array
from thermoforce_mpc.data.prices import price_unit_of


class Unit(NamedTuple):
    """What a unit measures; x of it are `factor` x + `offset` °C, W, J, W/m², shares or per kWh."""

    quantity: str
    factor: float
    offset: float = 0.0


# British thermal units of the International Table (1055.05585262 J, also the therm of 100,000), calories likewise.
_BTU_J, _CAL_J = 1055.05585262, 4.1868
_ENERGIES_J = {
    "mWh": 3.6, "Wh": 3.6e3, "kWh": J_PER_KWH, "MWh": 3.6e9, "GWh": 3.6e12, "TWh": 3.6e15,
    "J": 1.0, "kJ": 1e3, "MJ": 1e6, "GJ": 1e9, "TJ": 1e12, "cal": _CAL_J, "kcal": 1e3 * _CAL_J, "Mcal": 1e6 * _CAL_J,
    "Gcal": 1e9 * _CAL_J, "BTU": _BTU_J, "kBTU": 1e3 * _BTU_J, "MMBTU": 1e6 * _BTU_J, "therm": 1e5 * _BTU_J,
}  # fmt: skip
UNITS: dict[str, Unit] = {
    "°C": Unit("temperature", 1.0), "K": Unit("temperature", 1.0, -ZERO_C_K),
    "°F": Unit("temperature", 5.0 / 9.0, -160.0 / 9.0), "°R": Unit("temperature", 5.0 / 9.0, -ZERO_C_K),
    **{unit: Unit("energy", J) for unit, J in _ENERGIES_J.items()},
    "mW": Unit("power", 1e-3), "W": Unit("power", 1.0), "kW": Unit("power", 1e3), "MW": Unit("power", 1e6),
    "GW": Unit("power", 1e9), "ton": Unit("power", 12e3 * _BTU_J / 3600.0),  # of refrigeration, 12,000 BTU/h
    **{
        f"{unit}/h": Unit("power", _ENERGIES_J[unit] / 3600.0)
        for unit in ("BTU", "kBTU", "MMBTU", "kJ", "MJ", "GJ", "kcal", "Mcal", "Gcal")
    },
    "0-1": Unit("share", 1.0), "%": Unit("share", 0.01),
    "W/m²": Unit("irradiance", 1.0), "kW/m²": Unit("irradiance", 1e3), "BTU/(h⋅ft²)": Unit("irradiance", 3.154590745),
    "per kWh": Unit("price", 1.0), "per MWh": Unit("price", 1e-3), "cent per kWh": Unit("price", 1e-2),
    "cent per MWh": Unit("price", 1e-5),
    # What a map has no place for: each is of a quantity of its own.
    **{
        unit: Unit(unit, 1.0)
        for unit in (
            "Hz", "rps", "rpm", "s", "ppm", "hPa", "Pa", "lx", "V", "A", "l/h", "m³", "m³/h", "cfm", "m/s", "km/h",
        )
    },
}  # fmt: skip
"""Units by the name that a map has for them."""
# As they are written elsewhere, in small letters.
_WRITTEN = {unit.lower(): unit for unit in UNITS if unit[:1] != "m" or unit[:2] == "m³" or "/" in unit} | {
    "degc": "°C", "deg c": "°C", "c": "°C", "celsius": "°C", "grad c": "°C", "°": "°C", "deg": "°C", "degf": "°F",
    "deg f": "°F", "f": "°F", "fahrenheit": "°F", "kelvin": "K", "degr": "°R", "rankine": "°R",
    "%rh": "%", "% rh": "%", "percent": "%", "percentage": "%", "pct": "%", "prozent": "%", "watt": "W", "watts": "W",
    "kwhs": "kWh",
    "kbtu/hr": "kBTU/h", "btu/hr": "BTU/h", "kbtuh": "kBTU/h", "btuh": "BTU/h", "mbh": "kBTU/h", "therms": "therm",
    "tons": "ton", "tr": "ton", "sec": "s", "seconds": "s", "u/min": "rpm", "w/m2": "W/m²", "w m-2": "W/m²",
    "w/m^2": "W/m²", "kw/m2": "kW/m²", "btu/(h·ft²)": "BTU/(h⋅ft²)", "m3": "m³", "m3/h": "m³/h",
}  # fmt: skip
# A currency before an energy; a mass is of emissions.
_PRICE = re.compile(r"(?!(?:[km]?g|t|l)/)(?:[^\W\d]{1,9}|[€$£¥¢])/[kM]Wh", re.IGNORECASE)
PER_STEP, COUNTER = " per step", " counter"
"""Ends of units of energy in a map: of each step, or counted from the first on."""


@lru_cache(maxsize=10_000)
def unit_named(text: str) -> str:
    """The name in `UNITS` of a unit as it is written, such as 'kWh' of 'KWH'; '' for one that is not known.

    Thousandths and millions are told apart by their letter, 'mW' and 'MW'; without a capital a 'mwh' is a MWh.
    """
    told = unicodedata.normalize("NFC", text).strip().replace("℃", "°C").replace("℉", "°F")
    if told in UNITS:
        return told
    if _PRICE.fullmatch(told):
        return price_unit_of(told) or ""
    return _WRITTEN.get(told.lower(), "")


def unit_of_map(unit: str) -> Unit:
    """A unit that a map says, also `per step` or of a `counter`: of energy then."""
    return UNITS[unit_named(unit.removesuffix(PER_STEP).removesuffix(COUNTER))]


def converted(values: Array, unit: str) -> Array:
    """`values` (n,) in `unit` of a map as °C, W, W/m², share or price per kWh; energies per step and counters as J."""
    _, factor, offset = unit_of_map(unit)
    return np.asarray(values * factor + offset)


def in_unit(values: Array | float, told: Unit, wanted: Unit) -> Array | float:
    """`values` of a unit that is `told` in another one of the same quantity."""
    if told.offset == wanted.offset == 0.0:
        return values * (told.factor / wanted.factor)
    return (values * told.factor + told.offset - wanted.offset) / wanted.factor
