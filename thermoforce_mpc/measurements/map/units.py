"""Units that a map may declare, and their conversion to those inside: °C, W, W/m², shares and price per kWh."""

from __future__ import annotations

from typing import Literal

import numpy as np

from thermoforce_mpc.data import J_PER_KWH, ZERO_C_K, Array

TemperatureUnit = Literal["°C", "C", "degC", "K", "°F", "F", "degF"]
PowerUnit = Literal[
    "W", "kW", "MW", "BTU/h",
    "Wh per step", "kWh per step", "BTU per step", "kJ per step", "MJ per step",
    "Wh counter", "kWh counter", "MWh counter", "BTU counter", "kJ counter", "MJ counter",
]  # fmt: skip
LevelUnit = Literal["0-1", "%"]
IrradianceUnit = Literal["W/m²", "W/m2", "kW/m²", "kW/m2"]
PriceUnit = Literal["per kWh", "per MWh"]

PER_STEP, COUNTER = " per step", " counter"

_TEMPERATURES = {"C": (1.0, 0.0), "K": (1.0, -ZERO_C_K), "F": (5.0 / 9.0, -160.0 / 9.0)}
_ENERGIES_J = {"Wh": 3600.0, "kWh": J_PER_KWH, "MWh": 3.6e9, "BTU": 1055.05585262, "kJ": 1e3, "MJ": 1e6}
_LINEAR = {
    "W": 1.0,
    "kW": 1e3,
    "MW": 1e6,
    "BTU/h": _ENERGIES_J["BTU"] / 3600.0,
    "0-1": 1.0,
    "%": 0.01,
    "W/m²": 1.0,
    "W/m2": 1.0,
    "kW/m²": 1e3,
    "kW/m2": 1e3,
    "per kWh": 1.0,
    "per MWh": 1e-3,
}


def converted(values: Array, unit: str) -> Array:
    """`values` (n,) in `unit` as °C, W, W/m², share or price per kWh; energies per step and counters as J."""
    if unit.endswith((PER_STEP, COUNTER)):
        return np.asarray(values * _ENERGIES_J[unit.split(" ")[0]])
    if unit in _LINEAR:
        return np.asarray(values * _LINEAR[unit])
    factor, offset = _TEMPERATURES[unit.removeprefix("°").removeprefix("deg")]
    return np.asarray(values * factor + offset)


def likelier(values: Array, declared: str, kind: str, usual: tuple[float, float]) -> str:
    """The unit of `kind` that brings the median of raw `values` into the `usual` range, '' where none other does."""
    units = {"temperature": ("°C", "K", "°F"), "level": ("0-1", "%"), "irradiance": ("W/m²", "kW/m²")}.get(kind, ())
    middle = np.array([float(np.nanmedian(values))])
    if kind == "level":
        middle = np.array([float(np.nanmax(values))])
    as_declared = converted(middle, declared)[0]
    for unit in units:
        value = converted(middle, unit)[0]
        if usual[0] <= value <= usual[1] and not np.isclose(value, as_declared):
            return unit
    return ""
