"""Entries of a map: units, how time stamps and files are written, and columns with the rules for their readings."""

from __future__ import annotations

from datetime import date
from typing import Annotated, Any, Literal
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd
from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from thermoforce_mpc.data import J_PER_KWH, ZERO_C_K, Array
from thermoforce_mpc.data.limits import ZONE_C
from thermoforce_mpc.scenario.settings import StrictModel

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
    "W": 1.0, "kW": 1e3, "MW": 1e6, "BTU/h": _ENERGIES_J["BTU"] / 3600.0, "0-1": 1.0, "%": 0.01,
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


class Clock(StrictModel):
    """How time stamps are read."""

    column: str | None = Field(None, description="column of the time stamps; default: the first, or the table's index")
    format: str | None = Field(None, description="strptime format, such as %d.%m.%Y %H:%M; default: ISO 8601")
    zone: str | None = Field(
        None,
        description="time zone of stamps without an offset, such as Europe/Brussels (with daylight saving), UTC or "
        "Etc/GMT-1 (an hour ahead of UTC all year); stamps with an offset are converted to it",
    )
    unit: Literal["s", "ms", "min", "h", "D"] | None = Field(None, description="unit of stamps that are numbers")
    since: str | None = Field(None, description="what they count from, such as 2016-01-01 or 1970-01-01 in UTC")
    marks: Literal["start", "end"] = Field(
        "start", description="end of the interval for which powers, energies and levels hold that a stamp marks"
    )
    ambiguous: Literal["infer", "first", "second", "gap"] = Field(
        "infer",
        description="the hour that summer time's end repeats; infer: by the order of the rows; first or second: all "
        "its rows are the first (summer time) or second one; gap: leave them out",
    )
    nonexistent: Literal["refuse", "gap"] = Field(
        "refuse", description="rows in the hour that summer time's beginning skips: refuse, or leave them out"
    )
    order: Literal["refuse", "sort"] = Field("refuse", description="rows that are not in the order of time")
    duplicates: Literal["refuse", "first", "last"] = Field(
        "refuse", description="rows with the same time stamp: refuse, or keep the first or last one"
    )

    @field_validator("since", mode="before")
    @classmethod
    def _as_text(cls, value: Any) -> Any:
        return str(value) if isinstance(value, date) else value  # YAML reads dates

    @field_validator("zone")
    @classmethod
    def _known_zone(cls, value: str | None) -> str | None:
        if value is not None:
            try:
                ZoneInfo(value)
            except (KeyError, ValueError, OSError) as error:
                raise ValueError("no such time zone; use a name such as Europe/Brussels, Etc/GMT-1 or UTC") from error
        return value

    @model_validator(mode="after")
    def _numbers_count_from(self) -> Clock:
        if (self.unit is None) != (self.since is None):
            raise ValueError("unit and since belong together: stamps that are numbers need both")
        if self.since is not None:
            self.counted_from()
        return self

    def lenient(self) -> Clock:
        """The clock of a table that a machine appends to: what a person would be asked is decided."""
        kept = self.duplicates if self.duplicates != "refuse" else "last"
        return self.model_copy(update={"order": "sort", "duplicates": kept, "nonexistent": "gap"})

    def counted_from(self) -> pd.Timestamp:
        """The instant `since`, in `zone` where it has no offset; of an hour that comes twice the first is meant.

        Raises `ValueError` for what is no date, or does not exist on that clock.
        """
        try:
            since = pd.Timestamp(str(self.since))
        except ValueError as error:
            raise ValueError(f"since is no date: {self.since}") from error
        if pd.isna(since):
            raise ValueError(f"since is no date: {self.since}")
        if since.tz is not None or self.zone is None:
            return since
        localised = since.tz_localize(self.zone, ambiguous=True, nonexistent="NaT")
        if not isinstance(localised, pd.Timestamp):  # NaT
            raise ValueError(f"since does not exist in {self.zone}, where summer time begins: {self.since}")
        return localised


class CsvFormat(StrictModel):
    """How CSV files are written."""

    separator: str | None = Field(None, description="between cells; default: of comma, semicolon, tab the commonest")
    decimal: Literal[".", ","] = "."
    encoding: str = "utf-8"
    skip_lines: int = Field(0, ge=0, description="lines before the line of column names")
    missing: tuple[str, ...] = Field((), description="texts that stand for an empty cell besides NaN, n/a and the like")


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
