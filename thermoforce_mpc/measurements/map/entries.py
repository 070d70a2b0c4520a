"""Entries of a map: units, and columns with the rules for their readings."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from thermoforce_mpc.data import J_PER_KWH, ZERO_C_K, Array
from thermoforce_mpc.data.limits import ZONE_C
from thermoforce_mpc.scenario.settings import StrictModel

TemperatureUnit = Literal["°C", "C", "degC", "K", "°F", "F", "degF"]
PowerUnit = Literal[
    "W", "kW", "MW", "BTU/h", "kBTU/h", "MMBTU/h", "kJ/h", "MJ/h", "kcal/h", "ton",
    "Wh per step", "kWh per step", "MWh per step", "J per step", "kJ per step", "MJ per step", "GJ per step",
    "BTU per step", "kBTU per step", "MMBTU per step", "therm per step", "kcal per step",
    "Wh counter", "kWh counter", "MWh counter", "J counter", "kJ counter", "MJ counter", "GJ counter",
    "BTU counter", "kBTU counter", "MMBTU counter", "therm counter", "kcal counter",
]  # fmt: skip
LevelUnit = Literal["0-1", "%"]
IrradianceUnit = Literal["W/m²", "W/m2", "kW/m²", "kW/m2"]
PriceUnit = Literal["per kWh", "per MWh"]

PER_STEP, COUNTER = " per step", " counter"

_TEMPERATURES = {"C": (1.0, 0.0), "K": (1.0, -ZERO_C_K), "F": (5.0 / 9.0, -160.0 / 9.0)}
# British thermal units of the International Table (1055.05585262 J, also the therm of 100,000), calories likewise.
_BTU_J, _KCAL_J = 1055.05585262, 4186.8
_ENERGIES_J = {
    "Wh": 3600.0, "kWh": J_PER_KWH, "MWh": 3.6e9, "J": 1.0, "kJ": 1e3, "MJ": 1e6, "GJ": 1e9, "BTU": _BTU_J,
    "kBTU": 1e3 * _BTU_J, "MMBTU": 1e6 * _BTU_J, "therm": 1e5 * _BTU_J, "kcal": _KCAL_J,
}  # fmt: skip
# A ton of refrigeration is 12,000 BTU/h.
_LINEAR = {
    "W": 1.0, "kW": 1e3, "MW": 1e6, "ton": 12e3 * _BTU_J / 3600.0, "0-1": 1.0, "%": 0.01,
    **{f"{unit}/h": _ENERGIES_J[unit] / 3600.0 for unit in ("BTU", "kBTU", "MMBTU", "kJ", "MJ", "kcal")},
    "W/m²": 1.0, "W/m2": 1.0, "kW/m²": 1e3, "kW/m2": 1e3, "per kWh": 1.0, "per MWh": 1e-3,
}  # fmt: skip


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


class Signal(StrictModel):
    """A column and the rules for its readings; a mere name stands for a column in the default unit."""

    column: str | tuple[str, ...] = Field(description="column; of several the sum is taken")
    factor: float = Field(1.0, description="the reading in its unit is multiplied by this")
    hold_h: float | None = Field(
        None,
        gt=0,
        description="longest time between two readings that is no gap, h; default: one and a half times the usual "
        "one (90th percentile), a step at least",
    )
    range: tuple[float, float] | None = Field(
        None, description="least and largest possible value in °C, W, W/m² or share; default: by kind"
    )
    spike: float | None = Field(
        None,
        gt=0,
        description="change from one reading to the next that is a spike if it comes back within 6 h; default: by kind",
    )
    stuck_h: float | None = Field(
        None, ge=0, description="time after which an unchanging reading is stuck, h; 0: never; default: by kind"
    )

    @model_validator(mode="after")
    def _has_a_column(self) -> Signal:
        if not self.columns:
            raise ValueError("column: name one at least")
        return self

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that make up the signal."""
        return (self.column,) if isinstance(self.column, str) else self.column


class Temperature(Signal):
    """A temperature."""

    unit: TemperatureUnit = "°C"


class Power(Signal):
    """A power, an energy per step or the reading of an energy counter."""

    unit: PowerUnit = "W"


class Level(Signal):
    """The level of an actuator."""

    unit: LevelUnit = "0-1"


class Irradiance(Signal):
    """Global horizontal irradiance."""

    unit: IrradianceUnit = "W/m²"


class Humidity(Signal):
    """Relative humidity."""

    unit: LevelUnit = "%"


class Price(Signal):
    """A price of energy."""

    unit: PriceUnit = "per kWh"


def _text_as_column(value: Any) -> Any:
    return {"column": value} if isinstance(value, str) else value


def _number_or_column(value: Any) -> Any:
    return value if isinstance(value, int | float) else _text_as_column(value)


def _in_celsius(bound: float | Temperature) -> float | Temperature:
    if not isinstance(bound, Temperature) and not ZONE_C[0] <= bound <= ZONE_C[1]:
        least, most = ZONE_C
        raise ValueError(f"{bound:g} is no comfort bound in °C, between {least:g} and {most:g}: convert °F or K")
    return bound


OfTemperature = Annotated[Temperature, BeforeValidator(_text_as_column, json_schema_input_type=str | Temperature)]
OfPower = Annotated[Power, BeforeValidator(_text_as_column, json_schema_input_type=str | Power)]
OfLevel = Annotated[Level, BeforeValidator(_text_as_column, json_schema_input_type=str | Level)]
Bound = Annotated[
    float | Temperature,
    BeforeValidator(_number_or_column, json_schema_input_type=float | str | Temperature),
    AfterValidator(_in_celsius),
]
OfPrice = Annotated[float | Price, BeforeValidator(_number_or_column, json_schema_input_type=float | str | Price)]


class Sun(StrictModel):
    """Where the irradiance comes from."""

    column: str | None = None
    unit: IrradianceUnit = "W/m²"
    factor: float = 1.0
    hold_h: float | None = Field(None, gt=0)
    range: tuple[float, float] | None = None
    spike: float | None = Field(None, gt=0)
    stuck_h: float | None = Field(None, ge=0)
    estimate: Literal["clear_sky", "humidity"] | None = Field(
        None,
        description="irradiance of a clear sky at `site`; with humidity times a clearness of each day "
        "(boundary/weather/solar.py)",
    )
    humidity: Annotated[Humidity, BeforeValidator(_text_as_column, json_schema_input_type=str | Humidity)] | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Sun:
        if (self.column is None) == (self.estimate is None):
            raise ValueError("give a column, or estimate: clear_sky or humidity")
        if (self.estimate == "humidity") != (self.humidity is not None):
            raise ValueError("estimate: humidity needs the key humidity with its column, and only it")
        return self

    @property
    def signal(self) -> Irradiance | None:
        """The column that was measured, None where the irradiance is estimated."""
        if self.column is None:
            return None
        return Irradiance(**self.model_dump(exclude={"estimate", "humidity"}))


OfSun = Annotated[Sun, BeforeValidator(_text_as_column, json_schema_input_type=str | Sun)]
