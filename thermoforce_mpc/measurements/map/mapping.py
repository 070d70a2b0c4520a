"""The map of a table (map.yaml): which column is what, in which unit, and the rules that its readings must pass."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from thermoforce_mpc.commands.command import Command, TemperatureCommand
from thermoforce_mpc.commands.kinds import KINDS, AnyCommand, names_of
from thermoforce_mpc.commands.tank import AnyTankCommand
from thermoforce_mpc.data import Array, Layout, Names
from thermoforce_mpc.data.limits import ZONE_C
from thermoforce_mpc.data.prices import PriceUnit, price_unit_of
from thermoforce_mpc.errors import ConfigError, DataError
from thermoforce_mpc.measurements.tables.forms import (
    CsvFormat,
    TableForm,
    TimeStampRules,
    Written,
    WrittenOtherwise,
    each_column,
)
from thermoforce_mpc.measurements.units import converted
from thermoforce_mpc.scenario.comfort import OfComfort, OfTankComfort
from thermoforce_mpc.scenario.settings import Currency, StrictModel, check_no_folder, read_yaml, validate

TemperatureUnit = Literal["°C", "C", "degC", "K", "°F", "F", "degF", "°R"]
PowerUnit = Literal[
    "W", "kW", "MW", "BTU/h", "kBTU/h", "MMBTU/h", "kJ/h", "MJ/h", "GJ/h", "kcal/h", "Mcal/h", "Gcal/h", "ton",
    "Wh per step", "kWh per step", "MWh per step", "J per step", "kJ per step", "MJ per step", "GJ per step",
    "BTU per step", "kBTU per step", "MMBTU per step", "therm per step", "kcal per step", "Mcal per step",
    "Gcal per step",
    "Wh counter", "kWh counter", "MWh counter", "J counter", "kJ counter", "MJ counter", "GJ counter",
    "BTU counter", "kBTU counter", "MMBTU counter", "therm counter", "kcal counter", "Mcal counter", "Gcal counter",
]  # fmt: skip
LevelUnit = Literal["0-1", "%"]
IrradianceUnit = Literal["W/m²", "W/m2", "kW/m²", "kW/m2", "BTU/(h⋅ft²)"]


def likelier(values: Array, declared: str, kind: str, usual: tuple[float, float]) -> str:
    """The unit of `kind` that brings the median of raw `values` into the `usual` range, '' where none other does."""
    units = {
        "temperature": ("°C", "K", "°F"), "set temperature": ("°C", "°F"), "level": ("0-1", "%"),
        "irradiance": ("W/m²", "kW/m²"),
    }.get(kind, ())  # fmt: skip
    if not units:
        return ""
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
    def _can_be_read(self) -> Signal:
        if not self.columns:
            raise ValueError("column: name one at least")
        if self.factor == 0.0:
            raise ValueError("factor: 0 makes every reading 0")
        if self.range is not None and self.range[0] >= self.range[1]:
            raise ValueError(f"range: the least, {self.range[0]:g}, is not below the largest, {self.range[1]:g}")
        return self

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that make up the signal."""
        return each_column(self.column)


class Temperature(Signal):
    """A temperature."""

    unit: TemperatureUnit = "°C"


def signal_of(command: Command, column: str, hold_h: float | None = None) -> Signal:
    """What was set, as it stands in a column."""
    if isinstance(command, TemperatureCommand):
        return Temperature(column=column, hold_h=hold_h, unit=command.unit)
    return Signal(column=column, hold_h=hold_h)


class Power(Signal):
    """A power, an energy per step or the reading of an energy counter."""

    unit: PowerUnit = "W"


class Level(Signal):
    """The level of an actuator."""

    unit: LevelUnit = "0-1"


class WindowContact(Level):
    """The contact of a window; of several columns the contacts of its windows."""

    open: Literal[0, 1] = Field(
        1,
        description="what it says while a window is open: 1 (open, on, true), or 0 (default of a column …#contact, as "
        "Zigbee2MQTT calls what is true while it is closed)",
    )

    @model_validator(mode="before")
    @classmethod
    def _as_its_name_says(cls, given: Any) -> Any:
        column = given.get("column") if isinstance(given, Mapping) else None
        names = [column] if isinstance(column, str) else column
        if not isinstance(names, list | tuple) or "open" in given:
            return given
        told = {str(name).endswith("#contact") for name in names}
        if len(told) > 1:
            raise ValueError("open: say it: only some of its columns are a contact of Zigbee2MQTT, true while closed")
        return {**given, "open": 0 if told == {True} else 1}


class Irradiance(Signal):
    """Global horizontal irradiance."""

    unit: IrradianceUnit = "W/m²"


class Humidity(Signal):
    """Relative humidity."""

    unit: LevelUnit = "%"


class Price(Signal):
    """A price of energy; its unit is by default the one that the name of its column tells."""

    unit: PriceUnit = Field("per kWh", description="default: as the name of the column tells, else per kWh")

    @model_validator(mode="before")
    @classmethod
    def _in_the_unit_of_its_name(cls, given: Any) -> Any:
        if not isinstance(given, Mapping) or "unit" in given or "factor" in given:
            return given
        column = given.get("column")
        names = [column] if isinstance(column, str) else column
        if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
            return given
        told = list(dict.fromkeys(price_unit_of(name) or "per kWh" for name in names))
        if len(told) > 1:
            raise ValueError(f"unit: the names of its columns tell {' and '.join(told)}: a sum is of one unit, name it")
        return {**given, "unit": told[0]} if told else given


def units_of(signals: Iterable[Signal]) -> dict[str, str]:
    """The unit of each column, which its cells must not contradict. A factor, 1 too, is of numbers as they stand there.

    Of a column with several units it is none that cells could have, such as 'kW and °C'.
    """
    units: dict[str, list[str]] = {}
    for signal in signals:
        unit = getattr(signal, "unit", "")
        if unit and (signal.factor == -1.0 or "factor" not in signal.model_fields_set):
            for column in signal.columns:
                units.setdefault(column, []).append(unit)
    return {column: " and ".join(dict.fromkeys(told)) for column, told in units.items()}


def _text_as_column(value: Any) -> Any:
    return {"column": value} if isinstance(value, str) else value


def _number_or_column(value: Any) -> Any:
    return value if isinstance(value, int | float) else _text_as_column(value)


# A kWh costs some thousands in the currencies of least worth.
_MOST_PRICE = 1e5


def _in_celsius(bound: float | Temperature) -> float | Temperature:
    if not isinstance(bound, Temperature) and not ZONE_C[0] <= bound <= ZONE_C[1]:
        least, most = ZONE_C
        raise ValueError(f"{bound:g} is no comfort bound in °C, between {least:g} and {most:g}: convert °F or K")
    return bound


OfTemperature = Annotated[Temperature, BeforeValidator(_text_as_column, json_schema_input_type=str | Temperature)]
OfPower = Annotated[Power, BeforeValidator(_text_as_column, json_schema_input_type=str | Power)]
OfLevel = Annotated[Level, BeforeValidator(_text_as_column, json_schema_input_type=str | Level)]
OfContact = Annotated[WindowContact, BeforeValidator(_text_as_column, json_schema_input_type=str | WindowContact)]
Bound = Annotated[
    float | Temperature,
    BeforeValidator(_number_or_column, json_schema_input_type=float | str | Temperature),
    AfterValidator(_in_celsius),
]


def _possible_price(price: float | Price) -> float | Price:
    if not isinstance(price, Price) and not 0.0 <= price <= _MOST_PRICE:  # hours may cost less, not all of them
        raise ValueError(f"{price:g} is no price of every kWh, from 0 to {_MOST_PRICE:g} in any currency")
    return price


OfPrice = Annotated[
    float | Price,
    BeforeValidator(_number_or_column, json_schema_input_type=float | str | Price),
    AfterValidator(_possible_price),
]


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
        return Irradiance(**self.model_dump(exclude={"estimate", "humidity"}, exclude_unset=True))


OfSun = Annotated[Sun, BeforeValidator(_text_as_column, json_schema_input_type=str | Sun)]


LEAST_STEP_S, MOST_STEP_S = 60.0, 3600.0
"""Limits of the step of a record, s."""


class Site(StrictModel):
    """Place of the building, for the position of the sun."""

    latitude: float = Field(ge=-90, le=90, description="°, north positive")
    longitude: float = Field(ge=-180, le=180, description="°, east positive")


class MappedZone(StrictModel):
    """A zone."""

    temperature: OfTemperature
    lower: Bound | None = Field(None, description="comfort bound, °C or a column")
    upper: Bound | None = Field(None, description="comfort bound, °C or a column")
    floor_area_m2: float | None = Field(None, gt=0)
    window: OfContact | None = Field(None, description="contact of its windows")

    @model_validator(mode="after")
    def _has_a_band(self) -> MappedZone:
        if isinstance(self.lower, float) and isinstance(self.upper, float) and self.lower >= self.upper:
            raise ValueError(f"the lower bound, {self.lower:g} °C, is not below the upper one, {self.upper:g} °C")
        return self


class MappedActuator(StrictModel):
    """What acts on a zone. Its level is measured, or its heat or its machine's power over its full one."""

    zone: str | None = Field(None, description="the zone that it serves; may be left out where there is one")
    machine: str | None = Field(None, description="the machine that feeds it; may be left out where there is one")
    mode: Literal["heating", "cooling", "both"] = Field(
        "heating", description="what it does; both: levels below 0 cool"
    )
    level: OfLevel | None = None
    flow: OfTemperature | None = Field(
        None,
        description="flow temperature of its water: its level is then that of the valve times what this is above "
        "the room, as a share of the 99th percentile; without a level the valve is taken as open",
    )
    heat: OfPower | None = Field(None, description="heat that it delivers, or with mode cooling takes out, above 0")
    full_W: float | None = Field(
        None,
        gt=0,
        description="heat or power at full level where no level is measured; default: 99th percentile of the steps in "
        "which it ran",
    )
    off_W: float = Field(0.0, ge=0, description="power while it is off, where no level is measured")
    share: float = Field(
        0.0, ge=0, le=1, description="share of its machine's capacity at full level; 0: as its power tells of each"
    )
    command: AnyCommand | None = Field(None, description=f"what can be set in its place: {names_of(KINDS)}")

    @model_validator(mode="after")
    def _heats_by_command(self) -> MappedActuator:
        for key in ("command", "flow"):
            if getattr(self, key) is not None and self.mode != "heating":
                raise ValueError(
                    f"{key}: of an actuator with mode heating, not {self.mode}: more of it must be more heat"
                )
        if self.flow is not None and self.heat is not None:
            raise ValueError("flow: not where its heat is measured, which says more")
        return self


class MappedMachine(StrictModel):
    """What takes energy."""

    power: OfPower | None = Field(None, description="electric power, or that of the gas; without it nothing is planned")
    return_water: OfTemperature | None = None
    hot_water: OfLevel | None = Field(
        None,
        description="on or 1 while it heats water for taps, as a mode with csv.words says: what it takes then is not "
        "counted to the rooms",
    )
    price: OfPrice | None = Field(None, description="price of its energy per kWh, or a column")
    command: AnyCommand | None = Field(
        None, description="one command for all that it feeds, as an offset of its heating curve"
    )


class MappedTank(StrictModel):
    """A tank of hot water that a machine heats in the place of the rooms."""

    temperature: OfTemperature
    machine: str | None = Field(None, description="the machine that heats it; may be left out where there is one")
    charging: OfLevel | None = Field(
        None, description="on or 1 while the machine heats the tank; without it that is read off its rise"
    )
    comfort: OfTankComfort = Field(
        description="lowest and highest temperature by weekday, hour and holiday on the clock of time.zone",
        examples=["6:00-9:00 44-58, 17:00-22:00 42-58, else 38-58"],
    )
    command: AnyTankCommand | None = Field(
        None, description="what can be set: tank_target or tank_charge; without it the tank is left to the device"
    )


class ForecastMap(StrictModel):
    """Where a forecast file differs from the table of measurements; what is left out stands there by the same key."""

    time: TimeStampRules | None = None
    csv: CsvFormat | None = None
    table: TableForm | None = None
    outdoor: OfTemperature | None = None
    sun: OfSun | None = None
    price: OfPrice | None = Field(None, description="price of all machines")
    load: OfPower | None = Field(None, description="power of all that is not planned behind the same meter")
    generation: OfPower | None = Field(None, description="power of photovoltaics behind the same meter, above 0")
    lower: Bound | None = Field(None, description="lower comfort bound of all zones")
    upper: Bound | None = Field(None, description="upper comfort bound of all zones")


class MeasurementMap(StrictModel):
    """Map of a table of measurements of one building."""

    time: TimeStampRules = TimeStampRules()
    csv: CsvFormat = CsvFormat()
    table: TableForm = TableForm()
    files: dict[str, WrittenOtherwise] = Field(
        default_factory=dict,
        description="files that are written otherwise, by name or pattern, as of the sensors of another maker",
        examples=[{"netatmo*.csv": {"csv": {"skip_lines": 2}}}],
    )
    step: str | None = Field(
        None, description="step of the record, such as 15min; default: the usual distance of the rows, 15 min to 1 h"
    )
    coverage: float = Field(0.5, ge=0.01, le=1, description="share of a step that readings must cover for its mean")
    site: Site | None = None
    outdoor: OfTemperature = Field(description="outdoor temperature")
    sun: OfSun | None = Field(
        None, description="global horizontal irradiance; without it the sun counts as a disturbance"
    )
    zones: dict[str, MappedZone] = Field(min_length=1)
    comfort: OfComfort | None = Field(
        None,
        description="comfort bounds by weekday, hour and holiday on the clock of time.zone, of zones without lower and "
        "upper",
        examples=["weekdays 6:00-22:00 21-24, else 17-26"],
    )
    actuators: dict[str, MappedActuator] = Field(default_factory=dict)
    machines: dict[str, MappedMachine] = Field(default_factory=dict)
    hot_water: MappedTank | None = Field(None, description="a tank that one of the machines heats too")
    currency: Currency = Field(
        "", description="of its prices, a code of three letters: told with what plans cost and save"
    )
    meter: OfPower | None = Field(
        None,
        description="power from the grid, below 0 what is fed in: peaks so far, where forecast.load says what else is "
        "behind the meter",
    )
    forecast: ForecastMap = ForecastMap()

    def written(self, path: Path) -> Written:
        """How a file of the building is written."""
        usual = Written(time=self.time, csv=self.csv, table=self.table)
        told = self.files.get(path.name) or next((f for p, f in self.files.items() if fnmatch(path.name, p)), None)
        return usual if told is None else told.of(usual)

    @field_validator("step")
    @classmethod
    def _is_a_duration(cls, value: str | None) -> str | None:
        if value is not None:
            try:
                seconds = pd.Timedelta(value).total_seconds()
            except ValueError as error:
                raise ValueError("no duration; write for example 15min or 1h") from error
            if not LEAST_STEP_S <= seconds <= MOST_STEP_S:
                raise ValueError("the step of a record lies between 1 min and 1 h")
        return value

    @model_validator(mode="after")
    def _check_references(self) -> MeasurementMap:
        try:
            self.names  # noqa: B018 (they are checked where they are made)
        except DataError as error:
            raise ValueError(str(error)) from error
        for name, actuator in self.actuators.items():
            for key, choices in (("zone", self.zones), ("machine", self.machines)):
                choice = getattr(actuator, key)
                if choice is not None and choice not in choices:
                    raise ValueError(f"actuators.{name}.{key}: there is no '{choice}'; there are {', '.join(choices)}")
            if actuator.zone is None and len(self.zones) > 1:
                raise ValueError(f"actuators.{name}.zone: say which zone it serves, of {', '.join(self.zones)}")
            if actuator.machine is None and len(self.machines) > 1:
                raise ValueError(f"actuators.{name}.machine: say what feeds it, of {', '.join(self.machines)}")
        machine_of = self.layout.machine_of
        for a, (name, actuator) in enumerate(self.actuators.items()):
            if actuator.level is not None or actuator.heat is not None or actuator.flow is not None:
                continue
            fed = machine_of.count(machine_of[a])
            powered = self.machines and list(self.machines.values())[machine_of[a]].power is not None
            if not powered or fed > 1:
                raise ValueError(
                    f"actuators.{name}: give its level, its heat, or the power of a machine that feeds it alone"
                )
        for name, zone in self.zones.items():
            if zone.temperature.columns == self.outdoor.columns:
                raise ValueError(f"zones.{name}.temperature and outdoor are the same column")
        set_by: dict[str, str] = {}
        rooms = dict(zip(self.actuators, (self.names.zones[z] for z in self.layout.home), strict=False))
        for m, (machine_name, machine) in enumerate(self.machines.items()):
            if machine.command is None:
                continue
            set_by[machine.command.column] = machine_name
            heated = [room for room, of in zip(rooms.values(), machine_of, strict=False) if of == m]
            self._check_rooms(f"machines.{machine_name}", machine.command, heated)
            for a, (name, actuator) in enumerate(self.actuators.items()):
                if machine_of[a] == m and (actuator.command is not None or actuator.mode != "heating"):
                    raise ValueError(
                        f"machines.{machine_name}.command: {name}, which it feeds, "
                        + ("has a command of its own: name one of the two" if actuator.command else "does not heat")
                    )
        for name, actuator in self.actuators.items():
            if actuator.command is not None:
                self._check_rooms(f"actuators.{name}", actuator.command, [rooms[name]])
            if actuator.command is not None and (other := set_by.setdefault(actuator.command.column, name)) != name:
                raise ValueError(
                    f"actuators.{name}.command: column '{actuator.command.column}' is the command of {other} too, and "
                    "one command cannot have two values: name it once, at the machine that feeds them"
                )
        if self.meter is not None and self.forecast.load is None:
            raise ValueError("meter: needs forecast.load, since plans are compared with what it read of all loads")
        if self.hot_water is not None:
            self._check_tank(self.hot_water, set_by)
        if self.comfort is not None:
            try:
                self.comfort.strictest_C(tuple(self.zones))
            except ConfigError as error:
                raise ValueError(str(error)) from error
            if self.time.zone is None:
                raise ValueError("comfort needs time.zone, whose clock its hours are of")
            for name, zone in self.zones.items():
                if zone.lower is not None or zone.upper is not None:
                    raise ValueError(f"zones.{name}: give lower and upper, or comfort for it, not both")
        estimates = [sun for sun in (self.sun, self.forecast.sun) if sun is not None and sun.estimate]
        if estimates and (self.site is None or self.time.zone is None):
            raise ValueError("sun.estimate needs site (latitude, longitude) and time.zone")
        self._check_bounds()
        return self

    def _check_bounds(self) -> None:
        """Raise `ValueError` where limits of a command leave no way to keep bounds that the map says itself."""
        found: list[tuple[str, Command, str, float, float]] = []
        rooms = list(self.zones)
        for name, z in zip(self.actuators, self.layout.home, strict=False):
            if (commanded := self.command_of(name)) is not None:
                where, command = commanded
                room = command.reference_of(rooms[z])
                lower_C, upper_C = self._strictest_C(room)
                found.append((f"{where}.command", command, room, lower_C, upper_C))
        if (tank := self.hot_water) is not None and tank.command is not None:
            found.append(("hot_water.command", tank.command, "the tank", *tank.comfort.strictest_C(("tank",))[0]))
        for where, command, of, lower_C, upper_C in found:
            try:
                command.check_bounds(of, lower_C, upper_C)
            except ValueError as error:
                raise ValueError(f"{where}.{error}") from error

    def _strictest_C(self, room: str) -> tuple[float, float]:
        """The highest lower and the lowest upper bound of a room, °C, infinite where a column says it, or nobody."""
        if self.comfort is not None:
            return dict(zip(self.zones, self.comfort.strictest_C(tuple(self.zones)), strict=True))[room]
        lower, upper = self.zones[room].lower, self.zones[room].upper
        return (
            float(lower) if isinstance(lower, int | float) else -np.inf,
            float(upper) if isinstance(upper, int | float) else np.inf,
        )

    @staticmethod
    def _check_rooms(where: str, command: Command, rooms: Sequence[str]) -> None:
        """Raise `ValueError` where a command does not fit the `rooms` that it heats."""
        try:
            command.check_rooms(list(dict.fromkeys(rooms)), of_machine=where.startswith("machines."))
        except ValueError as error:
            raise ValueError(f"{where}.command.{error}") from error

    def _check_tank(self, tank: MappedTank, set_by: Mapping[str, str]) -> None:
        """Raise `ValueError` where the tank has no machine or clock, or shares a column with something else."""
        if tank.machine is None and len(self.machines) != 1:
            raise ValueError(f"hot_water.machine: say which one heats it, of {', '.join(self.machines) or 'machines'}")
        if (twice := self.machines.get(self.tank_machine)) is not None and twice.hot_water is not None:
            raise ValueError(
                f"hot_water.charging is the place of machines.{self.tank_machine}.hot_water: name it there"
            )
        if tank.machine is not None and tank.machine not in self.machines:
            raise ValueError(
                f"hot_water.machine: there is no '{tank.machine}'; there are {', '.join(self.machines) or 'none'}"
            )
        if "hot_water" in (*self.actuators, *self.machines):
            raise ValueError(
                "hot_water is the tank's name for what it is set to: call the actuator or machine otherwise"
            )
        if self.time.zone is None:
            raise ValueError("hot_water.comfort needs time.zone, whose clock its hours are of")
        if tank.temperature.columns in [one.temperature.columns for one in self.zones.values()]:
            raise ValueError("hot_water.temperature is the column of a zone too")
        if tank.command is not None and (other := set_by.get(tank.command.column)) is not None:
            raise ValueError(f"hot_water.command: column '{tank.command.column}' is the command of {other} too")

    @property
    def names(self) -> Names:
        """Names of zones, actuators and machines; 'actuator' and 'machine' where none is given."""
        return Names(tuple(self.zones), tuple(self.actuators) or ("actuator",), tuple(self.machines) or ("machine",))

    @property
    def layout(self) -> Layout:
        """What acts where."""
        names = self.names
        actuators = tuple(self.actuators.values()) or (MappedActuator(),)
        return Layout(
            names=names,
            signs=tuple(-1 if actuator.mode == "cooling" else 1 for actuator in actuators),
            home=tuple(names.zones.index(actuator.zone) if actuator.zone else 0 for actuator in actuators),
            machine_of=tuple(
                names.machines.index(actuator.machine) if actuator.machine else 0 for actuator in actuators
            ),
            u_min=tuple(-1.0 if actuator.mode == "both" else 0.0 for actuator in actuators),
            shares=tuple(actuator.share for actuator in actuators),
            floor_area_m2=tuple(zone.floor_area_m2 or np.nan for zone in self.zones.values()),
        )

    def units(self) -> dict[str, str]:
        """See `units_of`."""
        return units_of(signal for _, signal in self.signals())

    def signals(self) -> Iterator[tuple[str, Signal]]:
        """Every column of the map by its key, such as 'zones.bath.temperature'."""
        yield "outdoor", self.outdoor
        if self.sun is not None:
            if self.sun.signal is not None:
                yield "sun", self.sun.signal
            if self.sun.humidity is not None:
                yield "sun.humidity", self.sun.humidity
        for kind in ("zones", "actuators", "machines"):
            for name, item in getattr(self, kind).items():
                for key in type(item).model_fields:
                    if isinstance(signal := getattr(item, key), Signal):
                        yield f"{kind}.{name}.{key}", signal
        for kind in ("actuators", "machines"):
            for name, item in getattr(self, kind).items():
                if item.command is not None:
                    yield f"{kind}.{name}.command", signal_of(item.command, item.command.column)
                    if isinstance(item.command.usual, str):
                        yield f"{kind}.{name}.command.usual", signal_of(item.command, item.command.usual)
        if self.meter is not None:
            yield "meter", self.meter
        if (tank := self.hot_water) is not None:
            yield "hot_water.temperature", tank.temperature
            if tank.charging is not None:
                yield "hot_water.charging", tank.charging
            if tank.command is not None:
                yield "hot_water.command", signal_of(tank.command, tank.command.column)

    @property
    def tank_machine(self) -> str:
        """The machine that heats the tank, '' without one."""
        if self.hot_water is None:
            return ""
        return self.hot_water.machine or next(iter(self.machines))

    def command_of(self, actuator: str) -> tuple[str, AnyCommand] | None:
        """Where the command of an actuator stands, its own or that of its machine, and it; None: its level is set."""
        own = self.actuators.get(actuator)
        if own is None:
            return None
        if own.command is not None:
            return f"actuators.{actuator}", own.command
        names = tuple(self.machines)
        machine = own.machine or (names[0] if names else "")
        of_machine = self.machines[machine].command if machine in self.machines else None
        return None if of_machine is None else (f"machines.{machine}", of_machine)


def load_map(path: Path) -> MeasurementMap:
    """The map in a YAML file; raises `ConfigError` where it is missing, or naming every wrong key or value."""
    if not Path(path).is_file():
        check_no_folder(Path(path))
        raise ConfigError(f"--map {path}: no such file; `tf-mpc data map FILE` writes one to start from")
    return validate(MeasurementMap, read_yaml(Path(path)), str(path))
